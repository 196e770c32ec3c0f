"""Configuration time against its bound.

The bound is the time of the slowest robot, were it alone on the plate. Left: every path of every visit. Right: share of
paths that take longer than the bound by more than so much. Paths on which nobody moves are left out.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim.plotting import RunTables, main, new_figure
from survey_sim.plotting.axes import add_legend, as_percent, empty_figure, log_scale
from survey_sim.plotting.style import BOUND, BOUND_DASHES, survey_colours

# Excess that counts as none: rounding of sums of times.
EXACT_FRAC = 1e-6
# The right panel begins at this excess, and reaches at least to the other.
LEAST_FRAC, REACH_FRAC = 1e-4, 1.0


def draw(run: RunTables) -> Figure:
    """Time against bound, and the distribution of the excess."""
    figure = new_figure()
    paths = run.paths.filter(run.paths["lower_bound_s"] > 0)
    if paths.is_empty():
        return empty_figure(figure, "no paths: no robot moves")
    left, right = figure.subplots(1, 2)
    excess = (paths["configuration_time_s"] / paths["lower_bound_s"] - 1.0).to_numpy()
    grid = np.geomspace(LEAST_FRAC, max(REACH_FRAC, 1.5 * excess.max()), 300)
    for survey in paths["survey"].unique().sort():
        own, colour = paths.filter(survey=survey), survey_colours(run)[survey]
        bound, time = own["lower_bound_s"].to_numpy(), own["configuration_time_s"].to_numpy()
        left.scatter(bound, time, s=7, color=colour, alpha=0.45, linewidth=0, label=survey, rasterized=True)
        _draw_excess(right, grid, time / bound - 1.0, colour, survey)
    ends = np.array([0.0, 1.05 * paths["configuration_time_s"].to_numpy().max()])
    left.plot(ends, ends, color=BOUND, linestyle=BOUND_DASHES, linewidth=1.2, label="bound")
    left.set(title="All paths", xlabel="Slowest robot alone (s)", ylabel="Configuration time (s)", xlim=ends, ylim=ends)
    add_legend(left, loc="upper left")
    right.set(
        title="Excess over the bound", xlabel="Excess over the bound (%)", ylabel="Share of paths beyond that excess (%)"
    )
    right.set(xlim=(grid[0], grid[-1]), ylim=(0, None))
    log_scale(right, "x", percent=True)
    right.set_ylim(top=1.25 * right.get_ylim()[1])
    as_percent(right.yaxis)
    add_legend(right, loc="upper right")
    return figure


def _draw_excess(axes: Axes, grid: np.ndarray, excess: np.ndarray, colour: str, survey: str) -> None:
    beyond = 1.0 - np.searchsorted(np.sort(excess), grid, side="right") / len(excess)
    exact = (excess <= EXACT_FRAC).mean()
    axes.plot(grid, beyond, color=colour, label=f"{survey}: {exact:.1%} of {len(excess):,} paths at the bound")


if __name__ == "__main__":
    main(__file__)
