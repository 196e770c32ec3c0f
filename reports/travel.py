"""Travel of the robots.

Left: straight distance from where a visit starts to where the robot ends, over the visits of the tiles: the mean of the
robots that travel, the distance that 95 % of them do not exceed, and the largest; lines are medians over tiles, bands
hold 80 % of them. Right: all robots that travel, at some of the visits, as shares of the robots of that visit.
"""

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim.plotting import RunTables, main, new_figure
from survey_sim.plotting.axes import add_legend, as_percent, by_visit, draw_band, empty_figure, whole_numbers
from survey_sim.plotting.run import TRAVEL_BIN_MM
from survey_sim.plotting.style import DASHES, shades, survey_colours

# Visits whose distributions are drawn.
N_VISIT = 4


def draw(run: RunTables) -> Figure:
    """Travel by visit, and its distribution, a row a survey."""
    surveys = run.visits["survey"].unique().sort().to_list()
    if not surveys:
        return empty_figure(new_figure(), "no visits: no robot travels")
    figure = new_figure(height_in=3.1 * len(surveys))
    grid = figure.subplots(len(surveys), 2, sharex="col", squeeze=False)
    for row, survey in zip(grid, surveys, strict=True):
        _draw_visits(row[0], run, survey)
        _draw_distribution(row[1], run, survey)
    grid[-1, 0].set_xlabel("Visit of the tile (first is 0)")
    grid[-1, 1].set_xlabel("Straight travel of a robot (mm)")
    return figure


def _draw_visits(axes: Axes, run: RunTables, survey: str) -> None:
    visits, colours = run.visits.filter(survey=survey), shades(survey_colours(run)[survey], 3)
    measures = {"travel_max_mm": "largest", "travel_p95_mm": "95 % of the robots", "travel_mean_mm": "mean"}
    for (column, label), colour, dashes in zip(measures.items(), colours, DASHES, strict=False):
        draw_band(axes, by_visit(visits, column), colour, label, linestyle=dashes)
    axes.set(title=f"{survey}: by visit", ylabel="Straight travel (mm)")
    axes.set_ylim(0, 1.2 * max(1.0, axes.dataLim.y1))
    add_legend(axes, loc="upper right", ncol=3, columnspacing=1.2)
    whole_numbers(axes.xaxis)


def _draw_distribution(axes: Axes, run: RunTables, survey: str) -> None:
    counts = run.travel_counts.filter(survey=survey)
    axes.set(title=f"{survey}: robots that travel", ylabel="Robots per mm (%)")
    as_percent(axes.yaxis)
    if counts.is_empty():
        return
    chosen = _some_visits(counts)
    last = int(counts["bin"].to_numpy().max())
    edges = np.arange(last + 2) * TRAVEL_BIN_MM
    for visit, colour, dashes in zip(chosen, shades(survey_colours(run)[survey], len(chosen)), DASHES, strict=False):
        own = counts.filter(visit_id=visit)
        share = np.bincount(own["bin"], weights=own["n_robot"], minlength=last + 1)
        label = f"visit {visit} ({own['n_robot'].sum():,} robots)"
        axes.stairs(share / share.sum() / TRAVEL_BIN_MM, edges, color=colour, linestyle=dashes, linewidth=1.4, label=label)
    add_legend(axes, loc="upper right")


def _some_visits(counts: pl.DataFrame) -> list[int]:
    """Evenly chosen visits, of those that hold at least a tenth of the robots of the fullest."""
    robots = counts.group_by("visit_id").agg(pl.col("n_robot").sum()).sort("visit_id")
    kept = robots.filter(pl.col("n_robot") >= 0.1 * pl.col("n_robot").max())["visit_id"]
    return sorted({kept[int(place)] for place in np.linspace(0, len(kept) - 1, N_VISIT).round()})


if __name__ == "__main__":
    main(__file__)
