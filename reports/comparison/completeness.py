"""Completeness against time, by scenario.

Share of a programme's targets observed in all the visits they want, after each night. Lines: means over seeds; bands: from
the least to the greatest of the seeds (none with one seed).
"""

import polars as pl
from matplotlib.figure import Figure

from survey_sim.plotting.axes import as_percent, empty_figure, legend_above, whole_numbers
from survey_sim.plotting.comparison import ComparisonTables, comparison_main, grid_of, note_if_alike
from survey_sim.plotting.style import new_figure


def draw(comparison: ComparisonTables) -> Figure:
    """A panel a programme, a line a scenario."""
    curves = comparison.table("completeness_curves")
    if curves.is_empty():
        return empty_figure(new_figure(), "no nights were scheduled")
    programmes = comparison.programmes("completeness_curves")
    figure, panels = grid_of(len(programmes), 3, 2.7, sharey=True)
    for axes, programme in zip(panels, programmes, strict=True):
        for scenario in comparison.scenarios:
            rows = curves.filter(programme=programme, scenario=scenario)
            value = pl.col("completeness_frac")
            line = rows.group_by("night").agg(low=value.min(), mean=value.mean(), high=value.max()).sort("night")
            style = {**comparison.style(scenario), "marker": ""}
            axes.plot(line["night"], line["mean"], label=scenario, **style)
            axes.fill_between(line["night"], line["low"], line["high"], color=style["color"], alpha=0.10, linewidth=0)
        note_if_alike(axes, curves.filter(programme=programme).sort("seed", "night"), "night", "completeness_frac")
        axes.set(title=programme, xlabel="Night", ylim=(0, 1.02))
        as_percent(axes.yaxis)
        whole_numbers(axes.xaxis)
    panels[0].set_ylabel("Targets complete (%)")
    legend_above(figure, panels)
    return figure


if __name__ == "__main__":
    comparison_main(__file__)
