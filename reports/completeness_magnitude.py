"""Completeness by magnitude.

Share of each programme's targets observed in all the visits they want, in bins of magnitude (the catalogue's own band),
with standard errors. Below: targets in each bin.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim.plotting import RunTables, main, new_figure
from survey_sim.plotting.axes import add_legend, as_percent, binned, draw_binned, empty_figure, log_scale
from survey_sim.plotting.style import programme_lines

BIN_MAG = 0.25
# Bins of fewer targets say nothing.
N_LEAST = 10


def draw(run: RunTables) -> Figure:
    """Completeness and counts by magnitude, a panel a survey."""
    figure = new_figure(height_in=4.2)
    known = run.science.filter(run.science["mag"].is_not_null())
    surveys = known["survey"].unique().sort().to_list()
    if not surveys:
        return empty_figure(figure, "no science targets with magnitudes")
    grid = figure.subplots(2, len(surveys), sharex="col", sharey="row", squeeze=False, height_ratios=[3, 1])
    for column, survey in enumerate(surveys):
        grid[0, column].set_title(survey)
        for programme in run.programmes:
            if programme.survey == survey:
                _draw_programme(grid[0, column], grid[1, column], run, programme.name)
        add_legend(grid[0, column], loc="lower left")
        grid[1, column].set_xlabel("Magnitude (mag)")
        log_scale(grid[1, column], "y")
    grid[0, 0].set(ylabel=f"Targets {'complete' if run.is_scheduled else 'allocated'} (%)", ylim=(0, 1.04))
    grid[1, 0].set_ylabel("Targets\nper bin")
    as_percent(grid[0, 0].yaxis)
    return figure


def _draw_programme(axes: Axes, below: Axes, run: RunTables, name: str) -> None:
    targets = run.science.filter(programme=name).drop_nulls("mag")
    if targets.is_empty():
        return
    line, mag = programme_lines(run)[name], targets["mag"].to_numpy()
    edges = np.arange(np.floor(mag.min() / BIN_MAG), np.floor(mag.max() / BIN_MAG) + 2) * BIN_MAG
    done = targets["is_observed" if run.is_scheduled else "is_allocated"].to_numpy()
    draw_binned(axes, binned(mag, done, edges, N_LEAST), label=name, **line._asdict())
    below.stairs(np.histogram(mag, edges)[0], edges, color=line.color, linewidth=1.2)


if __name__ == "__main__":
    main(__file__)
