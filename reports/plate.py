"""One plate.

Where the robots park, the science targets of the field, and the moves of one visit, as its legs go. Dashed: how far the
robots with the longest moves can reach from their park positions. The visit is the one with the most crossing moves,
unless the pipeline names another.
"""

from matplotlib.figure import Figure

from survey_sim.plotting import RunTables, main, new_figure
from survey_sim.plotting.axes import empty_figure
from survey_sim.plotting.plate import draw_plate, read_plate


def draw(run: RunTables) -> Figure:
    """The plate of the shown visit."""
    if run.shown_visit is None:
        return empty_figure(new_figure(), "no visits: no robot moves")
    figure = new_figure(height_in=6.2)
    axes = figure.add_subplot()
    axes.set_title(run.shown_visit.label)
    draw_plate(axes, run, read_plate(run, run.shown_visit))
    figure.legend(loc="outside right center", labelspacing=0.8)
    return figure


if __name__ == "__main__":
    main(__file__)
