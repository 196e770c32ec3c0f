"""Configuration time, by scenario.

Share of visits (start to target, all seeds) whose robots are all at rest after a time. Grey, or told where it is longer than
all: the readout of the CCD, within which configuration costs nothing.
"""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim.plotting.axes import as_percent, empty_figure, legend_above, note
from survey_sim.plotting.comparison import ComparisonTables, comparison_main, grid_of, note_if_alike
from survey_sim.plotting.style import FAINT, new_figure


def draw(comparison: ComparisonTables) -> Figure:
    """A panel a survey, a line a scenario."""
    quantiles = comparison.table("configuration_quantiles")
    if quantiles.is_empty():
        return empty_figure(new_figure(), "no visits")
    surveys = quantiles["survey"].unique().sort().to_list()
    figure, panels = grid_of(len(surveys), 2, 2.9, sharey=True)
    for axes, survey in zip(panels, surveys, strict=True):
        own = quantiles.filter(survey=survey)
        longest = own["configuration_time_s"].to_numpy().max()
        _draw_readout(axes, own["readout_s"].drop_nulls().max(), longest)
        for scenario in comparison.scenarios:
            rows = own.filter(scenario=scenario).sort("quantile_frac")
            style = {**comparison.style(scenario), "marker": ""}
            axes.plot(rows["configuration_time_s"], rows["quantile_frac"], label=scenario, **style)
        note_if_alike(axes, own.sort("quantile_frac"), "configuration_time_s", where="upper left")
        axes.set(title=survey, xlabel="Configuration time (s)", xlim=(0, 1.05 * max(longest, 1.0)), ylim=(0, 1.02))
        as_percent(axes.yaxis)
    panels[0].set_ylabel("Visits at rest (%)")
    legend_above(figure, panels)
    return figure


def _draw_readout(axes: Axes, readout_s: Any, longest_s: float) -> None:
    """The readout, or a remark if all visits are at rest before it ends."""
    if readout_s is not None and readout_s >= longest_s:
        note(axes, f"all within the readout of {readout_s:g} s", where="lower right")
    elif readout_s is not None:
        axes.axvspan(0, readout_s, color=FAINT, alpha=0.5, linewidth=0, zorder=0)


if __name__ == "__main__":
    comparison_main(__file__)
