"""Completeness against visit.

Share of the science targets that robots have reached in all the visits they want, after so many visits of each tile:
all tiles together, and the band that holds 80 % of the tiles. Dashed: an ideal positioner (no separation to keep,
unbounded reach), which takes a new target with every robot at every visit. Dotted, where computed: the proven bound of
any allocation. Below: how many tiles have so many visits; the others keep the completeness of their last.
"""

import numpy as np
import numpy.typing as npt
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim.plotting import RunTables, main, new_figure
from survey_sim.plotting.axes import add_legend, as_percent, empty_figure, whole_numbers
from survey_sim.plotting.style import BOUND, BOUND_DASHES, IDEAL, IDEAL_DASHES, survey_colours

FloatArray = npt.NDArray[np.float64]


def draw(run: RunTables) -> Figure:
    """Completeness by number of visits, a panel a survey."""
    figure = new_figure(height_in=4.2)
    if run.visits.is_empty():
        return empty_figure(figure, "no visits: nothing was allocated")
    surveys = run.visits["survey"].unique().sort().to_list()
    grid = figure.subplots(2, len(surveys), sharex="col", sharey="row", squeeze=False, height_ratios=[4, 1])
    for column, survey in enumerate(surveys):
        _draw_survey(grid[0, column], grid[1, column], run, survey)
    grid[0, 0].set_ylabel("Targets allocated (%)")
    grid[1, 0].set_ylabel("Tiles")
    return figure


def _draw_survey(axes: Axes, below: Axes, run: RunTables, survey: str) -> None:
    visits, colour = run.visits.filter(survey=survey), survey_colours(run)[survey]
    tiles = run.tiles.filter((pl.col("survey") == survey) & (pl.col("n_target") > 0))
    axes.set_title(f"{survey}: {len(visits):,} visits of {visits['tile_id'].n_unique():,} of {len(tiles):,} tiles")
    below.set_xlabel("Visit of the tile (first is 0)")
    if tiles.is_empty():
        return
    n_target = tiles["n_target"].to_numpy()
    reached = _filled(visits, tiles, "completeness_frac")
    number = np.arange(reached.shape[1])
    axes.fill_between(number, *np.quantile(reached, [0.1, 0.9], axis=0), color=colour, alpha=0.16, linewidth=0)
    axes.plot(number, _mean(reached, n_target), color=colour, marker="o", markersize=3, label="allocated")
    ideal = _mean(_filled(visits, tiles, "ideal_completeness_frac"), n_target)
    axes.plot(number, ideal, color=IDEAL, linestyle=IDEAL_DASHES, linewidth=1.3, label="ideal positioner")
    if visits["completeness_bound_frac"].is_not_null().any():
        bounded = visits.with_columns(pl.col("completeness_bound_frac").fill_null(1.0))
        bound = _mean(_filled(bounded, tiles, "completeness_bound_frac"), n_target)
        axes.plot(number, bound, color=BOUND, linestyle=BOUND_DASHES, linewidth=1.5, label="proven bound")
    axes.set_ylim(0, 1.03)
    as_percent(axes.yaxis)
    add_legend(axes, loc="lower right")
    below.bar(number, np.bincount(visits["visit_id"], minlength=len(number)), color=colour, width=0.8)
    whole_numbers(below.xaxis)
    whole_numbers(below.yaxis, 3)


def _filled(visits: pl.DataFrame, tiles: pl.DataFrame, column: str) -> FloatArray:
    """(n_tile, n_visit) a fraction by tile and visit; a tile keeps its last, and one without visits has 0."""
    place = tiles.with_row_index("place").select("tile_id", "place").join(visits, on="tile_id")
    table = np.zeros((len(tiles), 1 + int(visits["visit_id"].to_numpy().max())))
    table[place["place"].to_numpy(), place["visit_id"].to_numpy()] = place[column].to_numpy()
    return np.maximum.accumulate(table, axis=1)


def _mean(share: FloatArray, weight: npt.NDArray[np.int64]) -> FloatArray:
    """(n_visit,) mean over tiles, weighted by their targets."""
    return np.average(share, axis=0, weights=weight)


if __name__ == "__main__":
    main(__file__)
