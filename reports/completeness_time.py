"""Completeness against time.

Share of each programme's targets that have been observed in all the visits they want. Dotted: the completeness wanted.
"""

from matplotlib.figure import Figure

from survey_sim.plotting import RunTables, main, new_figure
from survey_sim.plotting.axes import add_legend, empty_figure
from survey_sim.plotting.timeline import draw_timeline


def draw(run: RunTables) -> Figure:
    """Completeness of each programme, night by night."""
    figure = new_figure(height_in=3.8)
    if run.nights.is_empty() or run.science.is_empty():
        return empty_figure(figure, "no nights were scheduled" if run.nights.is_empty() else "no science targets")
    axes = figure.add_subplot()
    draw_timeline(axes, run)
    add_legend(axes, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncol=3, columnspacing=1.5)
    return figure


if __name__ == "__main__":
    main(__file__)
