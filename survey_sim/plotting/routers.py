"""Routers compared visit by visit, as in Figure 15 of Goodwin et al. 2014."""

from __future__ import annotations

import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim.plotting.axes import whole_numbers
from survey_sim.plotting.style import BOUND_DASHES, INK, new_figure

# Okabe and Ito's, and a mark of its own for each, so that a print in grey is still read.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
MARKS = ("o", "s", "^", "D")
# Panels in the paper's places: what fails, the median; the 95 % filter, all robots.
PANELS = (
    ("unrouted", "Robots left unrouted (dashed: collisions)"),
    ("configuration_time_median_s", "Median robot at rest (s)"),
    ("configuration_time_p95_s", "95 % of robots at rest (s)"),
    ("configuration_time_s", "All robots at rest (s); dotted: lower bound"),
)


def draw_routers(rows: pl.DataFrame) -> Figure:
    """The four panels, a line a router.

    Parameters
    ----------
    rows
        router, visit_id and the columns of `paths`, of one path.
    """
    figure = new_figure(height_in=6.0)
    routers = rows["router"].unique(maintain_order=True).to_list()
    for axes, (column, title) in zip(figure.subplots(2, 2, sharex=True).ravel(), PANELS, strict=True):
        for number, router in enumerate(routers):
            _draw_router(axes, rows.filter(router=router).sort("visit_id"), column, number, router)
        axes.set_title(title)
        axes.margins(y=0.1)
        axes.set_ylim(bottom=0)
        whole_numbers(axes.xaxis)
        if column == "unrouted":
            whole_numbers(axes.yaxis)
        if column == "configuration_time_s":
            bound = rows.group_by("visit_id").agg(pl.col("lower_bound_s").max()).sort("visit_id")
            axes.plot(bound["visit_id"], bound["lower_bound_s"], color=INK, linestyle=BOUND_DASHES, linewidth=1.2)
    for axes in figure.axes[2:]:
        axes.set_xlabel("Visit")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(routers))
    return figure


def _draw_router(axes: Axes, rows: pl.DataFrame, column: str, number: int, router: str) -> None:
    color, marker = COLOURS[number % len(COLOURS)], MARKS[number % len(MARKS)]
    axes.plot(rows["visit_id"], rows[column], label=router, color=color, marker=marker, markersize=4)
    if column == "unrouted":
        axes.plot(rows["visit_id"], rows["collisions"], linestyle="--", color=color, marker=marker, markersize=4)
