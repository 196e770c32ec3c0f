"""The run at a glance.

Left: completeness of each tile on the sky, a map a survey, with the Galactic equator and the parallels at 10 degrees.
Middle: one plate, and the moves of one visit. Right: completeness of each programme, night by night; dotted lines:
completeness wanted.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim.plotting import RunTables, main, new_figure
from survey_sim.plotting.axes import add_legend, say_empty
from survey_sim.plotting.plate import draw_plate, read_plate
from survey_sim.plotting.sky import completeness_bar, draw_completeness, tile_frame
from survey_sim.plotting.timeline import draw_timeline

# More maps than this would be too small to read.
N_MAP_MAX = 2


def draw(run: RunTables) -> Figure:
    """Sky maps, one plate, and completeness against time, side by side."""
    figure = new_figure(11.0, 4.5)
    sky, middle, right = np.asarray(figure.subfigures(1, 3, width_ratios=[1.05, 1.5, 1.3]))
    _draw_maps(sky, run)
    _draw_plate(middle.add_subplot(), run)
    axes = right.add_subplot()
    axes.set_title("Completeness against time")
    draw_timeline(axes, run)
    if axes.get_lines():
        add_legend(axes, loc="upper left", bbox_to_anchor=(0.0, -0.16))
    return figure


def _draw_maps(figure: Figure, run: RunTables) -> None:
    surveys = run.tiles["survey"].unique().sort().to_list()[:N_MAP_MAX]
    if not surveys:
        say_empty(figure.add_subplot(), "no tiles")
        return
    frame, grid = tile_frame(run), figure.add_gridspec(len(surveys), 1)
    drawn = [draw_completeness(figure, grid[place], run, survey, frame) for place, survey in enumerate(surveys)]
    for (axes, _), survey in zip(drawn, surveys, strict=True):
        axes.set_title(survey)
        if frame.is_whole:
            axes.texts[0].set_visible(False)
            axes.coords[0].set_ticklabel_visible(False)
            axes.coords[1].set_ticklabel_visible(False)
            continue
        axes.coords[1].set_axislabel("Dec (deg)")
        is_last = axes is drawn[-1][0]
        axes.coords[0].set_axislabel("RA (deg)" if is_last else " ")
        axes.coords[0].set_ticklabel_visible(is_last)
    where = {"location": "bottom", "shrink": 0.9, "aspect": 30} if frame.is_whole else {"shrink": 0.8, "aspect": 25}
    completeness_bar(figure, run, drawn[0][1], [axes for axes, _ in drawn], **where)


def _draw_plate(axes: Axes, run: RunTables) -> None:
    visit = run.shown_visit
    if visit is None:
        axes.set_title("Plate")
        say_empty(axes, "no visits")
        return
    axes.set_title(visit.label)
    draw_plate(axes, run, read_plate(run, visit))
    add_legend(axes, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncol=2, fontsize=7.5, columnspacing=1.0)


if __name__ == "__main__":
    main(__file__)
