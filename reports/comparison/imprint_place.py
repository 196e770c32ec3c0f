"""The imprint of crowds and of parks.

Above: share of targets complete against local density (targets of the survey within half a degree). Below: against the
distance from the nearest live robot's park position. Bars: one binomial standard error.
"""

import polars as pl
from matplotlib.figure import Figure

from survey_sim.plotting.axes import as_percent, empty_figure, legend_above
from survey_sim.plotting.comparison import ComparisonTables, comparison_main, note_if_alike
from survey_sim.plotting.style import new_figure

ROWS = (
    ("imprint_density", "density_per_sq_deg", "Targets around (1/sq deg)"),
    ("imprint_park", "park_distance_mm", "From the nearest park (mm)"),
)


def draw(comparison: ComparisonTables) -> Figure:
    """Two rows of panels, a column a programme, a line a scenario."""
    programmes = comparison.programmes("imprint_density")
    if not programmes:
        return empty_figure(new_figure(), "no science targets")
    figure = new_figure(height_in=5.6)
    grid = figure.subplots(2, len(programmes), sharey=True, squeeze=False)
    for panels, (name, x, label) in zip(grid, ROWS, strict=True):
        for axes, programme in zip(panels, programmes, strict=True):
            for scenario in comparison.scenarios:
                rows = comparison.table(name, programme=programme, scenario=scenario, outcome="allocated").sort(pl.col(x))
                style = {"markersize": 3.0, "linewidth": 1.2, "elinewidth": 0.9, **comparison.style(scenario)}
                axes.errorbar(
                    rows[x], rows["completeness_frac"], yerr=rows["completeness_error_frac"], label=scenario, **style
                )
            own = comparison.table(name, programme=programme, outcome="allocated").sort(pl.col(x))
            note_if_alike(axes, own, "completeness_frac", where="lower left")
            axes.set(xlabel=label, ylim=(0, 1.03))
    for axes, programme in zip(grid[0], programmes, strict=True):
        axes.set_title(programme)
    as_percent(grid[0, 0].yaxis)
    for axes in grid[:, 0]:
        axes.set_ylabel("Targets complete (%)")
    legend_above(figure, grid[0])
    return figure


if __name__ == "__main__":
    comparison_main(__file__)
