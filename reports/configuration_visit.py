"""Configuration time by visit and by tile.

Left: when all robots of a visit are at rest, and when 95 % of those that move are (dashed), over the visits of the
tiles: medians, and bands that hold 80 % of the tiles. Right: each tile's median configuration time against its number
of targets.
"""

import polars as pl
from matplotlib.figure import Figure

from survey_sim.plotting import RunTables, main, new_figure
from survey_sim.plotting.axes import add_legend, by_visit, draw_band, empty_figure, log_scale, whole_numbers
from survey_sim.plotting.style import IDEAL_DASHES, survey_colours


def draw(run: RunTables) -> Figure:
    """Configuration time against visit, and against the targets of the tile."""
    figure = new_figure()
    if run.visits.is_empty():
        return empty_figure(figure, "no visits: no robot moves")
    left, right = figure.subplots(1, 2, sharey=True)
    tiles = run.visits.group_by("survey", "tile_id").agg(pl.col("configuration_time_s").median())
    tiles = tiles.join(run.tiles, on=["survey", "tile_id"]).filter(pl.col("n_target") > 0)
    for survey in run.visits["survey"].unique().sort():
        colour, visits = survey_colours(run)[survey], run.visits.filter(survey=survey)
        draw_band(left, by_visit(visits, "configuration_time_s"), colour, survey)
        filtered = by_visit(visits, "configuration_time_p95_s")
        left.plot(filtered["visit"], filtered["middle"], color=colour, linestyle=IDEAL_DASHES, linewidth=1.2)
        own = tiles.filter(survey=survey)
        style = {"s": 16, "alpha": 0.75, "linewidth": 0, "rasterized": True}
        right.scatter(own["n_target"], own["configuration_time_s"], color=colour, label=survey, **style)
    left.set(title="By visit", ylabel="Configuration time (s)", xlabel="Visit of the tile (first is 0)")
    left.set_ylim(bottom=0)
    whole_numbers(left.xaxis)
    right.set(title="By tile", xlabel="Science targets of the tile")
    log_scale(right, "x")
    for axes in (left, right):
        add_legend(axes, loc="lower right")
    return figure


if __name__ == "__main__":
    main(__file__)
