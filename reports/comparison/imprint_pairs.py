"""The imprint on pairs.

Above: share of the pairs of targets at a separation of which both are complete. Below: (1 + w) of complete targets over that
of all targets, which is 1 where targets are lost at random, without an imprint. Bars:
jackknife errors (patches of the sky). The dotted line is the least separation of two robots, the right end a plate's
diameter.
"""

import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim.plotting.axes import as_percent, empty_figure, legend_above, log_scale
from survey_sim.plotting.comparison import ComparisonTables, comparison_main, note_if_alike
from survey_sim.plotting.style import MUTED, new_figure


def draw(comparison: ComparisonTables) -> Figure:
    """Two rows of panels, a column a programme, a line a scenario."""
    table = comparison.table("imprint_pairs", outcome="allocated").filter(pl.col("n_pair") >= 10)
    if table.is_empty():
        return empty_figure(new_figure(), "too few targets for pairs")
    programmes = table["programme"].unique().sort().to_list()
    figure = new_figure(height_in=5.4)
    grid = figure.subplots(2, len(programmes), sharex=True, sharey="row", squeeze=False)
    limits = comparison.about.get("min_separation_deg", {})
    for column, programme in enumerate(programmes):
        for scenario in comparison.scenarios:
            rows = table.filter(programme=programme, scenario=scenario)
            _draw_line(grid[0, column], comparison, scenario, rows, "pair_completeness_frac", "pair_completeness_error_frac")
            _draw_line(grid[1, column], comparison, scenario, rows, "ratio", "ratio_error")
        note_if_alike(grid[0, column], table.filter(programme=programme), "pair_completeness_frac")
        grid[0, column].set_title(programme)
        grid[0, column].set_ylim(0, 1.03)
        grid[1, column].axhline(1.0, color=MUTED, linewidth=0.8)
        grid[1, column].set_xlabel("Separation (deg)")
        for axes in grid[:, column]:
            if limits.get(comparison.reference):
                axes.axvline(limits[comparison.reference], color=MUTED, linewidth=0.8, linestyle=":")
    log_scale(grid[1, 0], "x")
    as_percent(grid[0, 0].yaxis)
    grid[0, 0].set_ylabel("Pairs complete (%)")
    grid[1, 0].set_ylabel("(1 + w complete) / (1 + w all)")
    legend_above(figure, grid[0])
    return figure


def _draw_line(axes: Axes, comparison: ComparisonTables, scenario: str, rows: pl.DataFrame, value: str, error: str) -> None:
    middle = (rows["separation_low_deg"] * rows["separation_high_deg"]).sqrt()
    bars = rows[error].fill_null(0.0)
    style = {"markersize": 3.0, "linewidth": 1.2, "elinewidth": 0.9, **comparison.style(scenario)}
    axes.errorbar(middle, rows[value], yerr=bars, label=scenario, **style)


if __name__ == "__main__":
    comparison_main(__file__)
