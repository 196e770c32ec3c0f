"""Completeness by Galactic latitude.

Share of each programme's targets observed in all the visits they want against their distance from the Galactic equator,
with standard errors. Right: how many targets stand there, by survey.
"""

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from survey_sim.plotting import RunTables, main, new_figure
from survey_sim.plotting.axes import add_legend, as_percent, binned, draw_binned, empty_figure
from survey_sim.plotting.style import programme_lines, survey_colours
from survey_sim.region import abs_galactic_latitude_deg

# Bins across the latitudes of the run.
N_BIN = 12
N_LEAST = 10


def draw(run: RunTables) -> Figure:
    """Completeness and number of targets by distance from the Galactic equator."""
    figure = new_figure()
    if run.science.is_empty():
        return empty_figure(figure, "no science targets")
    latitude = abs_galactic_latitude_deg(run.science["ra_deg"].to_numpy(), run.science["dec_deg"].to_numpy())
    edges = np.linspace(np.floor(latitude.min()), np.ceil(latitude.max()), N_BIN + 1)
    left, right = figure.subplots(1, 2)
    programme, survey = run.science["programme"], run.science["survey"]
    done = run.science["is_observed" if run.is_scheduled else "is_allocated"].to_numpy()
    for name, line in programme_lines(run).items():
        own = (programme == name).to_numpy()
        draw_binned(left, binned(latitude[own], done[own], edges, N_LEAST), label=name, **line._asdict())
    for name, colour in survey_colours(run).items():
        right.stairs(_density(latitude[(survey == name).to_numpy()], edges), edges, color=colour, linewidth=1.6, label=name)
    left.set_ylim(0, 1.04)
    as_percent(left.yaxis)
    left.set_ylabel(f"Targets {'complete' if run.is_scheduled else 'allocated'} (%)")
    right.set_ylabel("Science targets per degree of latitude")
    right.set_ylim(bottom=0)
    right.yaxis.set_major_formatter("{x:,.0f}")
    left.set_title("Completeness")
    right.set_title("Targets")
    add_legend(left, loc="best")
    add_legend(right, loc="upper right")
    for axes in (left, right):
        axes.set_xlabel("Galactic latitude, absolute (deg)")
    return figure


def _density(latitude: npt.NDArray[np.float64], edges: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(n_bin,) targets per degree of latitude."""
    return np.histogram(latitude, edges)[0] / np.diff(edges)


if __name__ == "__main__":
    main(__file__)
