"""Crossings and fibres.

Left: pairs of robots whose straight lines from start to target cross, over the visits of the tiles: the mean over
tiles, and the band that holds 80 % of them. Right: what the live robots of a visit are on, mean over tiles.
"""

import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim.plotting import RunTables, main, new_figure
from survey_sim.plotting.axes import add_legend, by_visit, draw_band, empty_figure, whole_numbers
from survey_sim.plotting.style import INK, KIND_COLOURS, survey_colours

KINDS = {"n_science": "science", "n_standard": "standard", "n_sky": "sky", "n_guide": "guide", "n_idle": "idle"}


def draw(run: RunTables) -> Figure:
    """Crossings of all surveys in one panel, use of robots in one panel a survey."""
    figure = new_figure()
    surveys = run.visits["survey"].unique().sort().to_list()
    if not surveys:
        return empty_figure(figure, "no visits: no robot moves")
    grid = figure.subplots(1, 1 + len(surveys), squeeze=False)[0]
    for survey in surveys:
        bands = by_visit(run.visits.filter(survey=survey), "crossings")
        draw_band(grid[0], bands, survey_colours(run)[survey], survey, middle="mean")
    grid[0].set(title="Crossings", ylabel="Crossing pairs in a visit")
    grid[0].set_ylim(bottom=0)
    add_legend(grid[0], loc="upper right")
    for axes, survey in zip(grid[1:], surveys, strict=True):
        _draw_use(axes, run, survey)
    for axes in grid:
        axes.set_xlabel("Visit of the tile (first is 0)")
        whole_numbers(axes.xaxis, 6)
    return figure


def _draw_use(axes: Axes, run: RunTables, survey: str) -> None:
    mean = run.visits.filter(survey=survey).group_by("visit_id").agg(pl.col(*KINDS).mean()).sort("visit_id")
    below = 0.0 * mean["n_idle"].to_numpy()
    for column, kind in KINDS.items():
        colour = survey_colours(run)[survey] if kind == "science" else KIND_COLOURS[kind]
        height = mean[column].to_numpy()
        axes.bar(mean["visit_id"], height, bottom=below, width=0.9, color=colour, edgecolor=INK, linewidth=0.2, label=kind)
        below = below + height
    axes.set(title=f"{survey}: robots on", ylabel="Robots, mean over tiles")
    axes.grid(False)
    axes.set_ylim(0, 1.22 * max(1.0, below.max()))
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles[::-1], labels[::-1], loc="upper center", ncol=3, columnspacing=0.9, handlelength=1.2, fontsize=8)


if __name__ == "__main__":
    main(__file__)
