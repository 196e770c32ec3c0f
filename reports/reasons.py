"""Targets not complete.

Share of each programme's targets that did not get all the visits they want, by reason.
"""

import numpy as np
import polars as pl
from matplotlib.figure import Figure

from survey_sim.plotting import RunTables, main, new_figure
from survey_sim.plotting.axes import add_legend, as_percent, empty_figure
from survey_sim.plotting.style import programme_lines


def draw(run: RunTables) -> Figure:
    """Bars of reasons, one a programme."""
    lost = run.lost_counts
    if run.science.is_empty() or lost.is_empty():
        return empty_figure(new_figure(), _why_empty(run))
    reasons = lost.group_by("reason").agg(pl.col("n_target").sum()).sort("n_target", "reason")["reason"].to_list()
    programmes = [programme for programme in run.programmes if programme.n_target]
    figure = new_figure(height_in=1.3 + 0.2 * len(reasons) * (len(programmes) + 0.6))
    axes = figure.add_subplot()
    height = 0.84 / len(programmes)
    for number, programme in enumerate(programmes):
        counts = dict(lost.filter(programme=programme.name).select("reason", "n_target").iter_rows())
        share = np.array([counts.get(reason, 0) / programme.n_target for reason in reasons])
        place = np.arange(len(reasons)) + height * ((len(programmes) - 1) / 2 - number)
        colour = programme_lines(run)[programme.name].color
        bars = axes.barh(
            place, share, height=0.92 * height, color=colour, label=f"{programme.name} ({programme.n_target:,} targets)"
        )
        axes.bar_label(bars, [f"{counts.get(reason, 0):,}" for reason in reasons], padding=3, fontsize=8)
    axes.set_yticks(np.arange(len(reasons)), reasons)
    axes.set_xlabel("Share of the programme's targets (%); at the bars: targets")
    as_percent(axes.xaxis)
    axes.grid(False, axis="y")
    axes.margins(x=0.1)
    add_legend(axes, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncol=3)
    return figure


def _why_empty(run: RunTables) -> str:
    if run.science.is_empty():
        return "no science targets"
    done = run.science["is_observed" if run.is_scheduled else "is_allocated"]
    return "every target is complete" if done.all() else "the run's tables give no reasons"


if __name__ == "__main__":
    main(__file__)
