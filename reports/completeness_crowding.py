"""Completeness by crowding.

Left: share of targets complete against the number of other targets of the same survey nearer than two robots may stand
to each other: two targets so near cannot be observed in one visit. Right: share of a tile's targets complete against
how many targets it has, a dot a tile.
"""

import numpy as np
import numpy.typing as npt
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from survey_sim.geometry import chord, unit_vectors
from survey_sim.plotting import RunTables, main, new_figure
from survey_sim.plotting.axes import add_legend, as_percent, binned, draw_binned, empty_figure, log_scale, whole_numbers
from survey_sim.plotting.style import survey_colours

# Targets of a survey whose neighbours are counted, evenly taken from all; among all.
N_COUNTED = 100_000
# Numbers of neighbours at which bins begin, ever wider.
BINS = np.array([0, 1, 2, 3, 4, 5, 6, 8, 10, 13, 17, 22, 29, 38, 50, 66, 87, 115, 1_000_000], dtype=np.float64)
# Bins of fewer targets say nothing.
N_LEAST = 30


def draw(run: RunTables) -> Figure:
    """Completeness by neighbours, and by targets of the tile."""
    figure = new_figure()
    if run.science.is_empty():
        return empty_figure(figure, "no science targets")
    left, right = figure.subplots(1, 2, sharey=True)
    _draw_neighbours(left, run)
    _draw_tiles(right, run)
    for axes in (left, right):
        axes.set_ylim(0, 1.04)
        as_percent(axes.yaxis)
        add_legend(axes, loc="lower left")
    left.set_ylabel(f"Targets {'complete' if run.is_scheduled else 'allocated'} (%)")
    return figure


def _draw_neighbours(axes: Axes, run: RunTables) -> None:
    radius_arcmin = float(run.instrument["min_separation_mm"] * run.instrument["plate_scale_arcsec_mm"] / 60.0)
    for survey, colour in survey_colours(run).items():
        targets = run.science.filter(survey=survey)
        if targets.is_empty():
            continue
        near, row = _neighbours(targets, radius_arcmin / 60.0)
        done = targets["is_observed" if run.is_scheduled else "is_allocated"].to_numpy()[row]
        edges = BINS[: np.searchsorted(BINS, near.max()) + 1] - 0.5
        draw_binned(axes, binned(near.astype(np.float64), done, edges, N_LEAST), color=colour, label=survey)
    whole_numbers(axes.xaxis)
    axes.set_title("By neighbours")
    axes.set_xlabel(f"Other targets within {radius_arcmin:.1f} arcmin ({run.instrument['min_separation_mm']:g} mm)")


def _neighbours(targets: pl.DataFrame, radius_deg: float) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Other targets within a radius of evenly taken targets, and the rows of these."""
    vectors = unit_vectors(targets["ra_deg"].to_numpy(), targets["dec_deg"].to_numpy())
    row = np.arange(0, len(vectors), max(1, len(vectors) // N_COUNTED))
    near = cKDTree(vectors).query_ball_point(vectors[row], chord(radius_deg), return_length=True)
    return np.asarray(near) - 1, row


def _draw_tiles(axes: Axes, run: RunTables) -> None:
    done = pl.col("n_observed" if run.is_scheduled else "n_allocated")
    for survey, colour in survey_colours(run).items():
        tiles = run.tiles.filter((pl.col("survey") == survey) & (pl.col("n_target") > 0))
        share = tiles.select(share=done / pl.col("n_target"))["share"]
        axes.scatter(tiles["n_target"], share, s=16, color=colour, alpha=0.75, linewidth=0, label=survey, rasterized=True)
    axes.set_title("By tile")
    axes.set(xlabel="Science targets of the tile")
    log_scale(axes, "x")


if __name__ == "__main__":
    main(__file__)
