"""Differences from the reference.

Mean over seeds of scenario less reference, runs of one seed being a pair, with the 95 % interval of Student's t; no bar with
one seed. Shares are in percentage points. Measures in which no scenario differs are left out.
"""

import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim.plotting.axes import empty_figure
from survey_sim.plotting.comparison import KEY_MEASURES, ComparisonTables, comparison_main, grid_of, words_of
from survey_sim.plotting.style import MUTED, new_figure


def draw(comparison: ComparisonTables) -> Figure:
    """A panel a measure."""
    rows = comparison.table("comparison").filter(
        pl.col("scenario") != comparison.reference, pl.col("measure").is_in(KEY_MEASURES), pl.col("difference").is_not_null()
    )
    differs = rows.group_by("of", "measure").agg(pl.col("difference").abs().max()).filter(pl.col("difference") > 0)
    panels_of = sorted(differs.select("of", "measure").rows(), key=lambda panel: (KEY_MEASURES.index(panel[1]), panel[0]))
    if not panels_of:
        return empty_figure(new_figure(), "no scenario differs from the reference")
    others = comparison.scenarios[1:]
    figure, panels = grid_of(len(panels_of), 3, 0.85 + 0.19 * len(others), sharey=True)
    for axes, (of, measure) in zip(panels, panels_of, strict=True):
        _draw_panel(axes, comparison, rows.filter(of=of, measure=measure), others)
        axes.set_title(f"{of}\n{words_of(measure)}", fontsize=8)
    return figure


def _draw_panel(axes: Axes, comparison: ComparisonTables, rows: pl.DataFrame, others: list[str]) -> None:
    unit = rows["unit"][0]
    scale, label = (100.0, "points") if rows["measure"][0].endswith("_frac") else (1.0, unit)
    axes.axvline(0.0, color=MUTED, linewidth=0.8)
    for place, scenario in enumerate(others):
        for row in rows.filter(scenario=scenario).iter_rows(named=True):
            style = comparison.style(scenario)
            if row["difference_low"] is not None:
                ends = [scale * row["difference_low"], scale * row["difference_high"]]
                axes.plot(ends, [place, place], color=style["color"], linewidth=1.6, solid_capstyle="butt")
            axes.plot(scale * row["difference"], place, marker=style["marker"], color=style["color"], markersize=4.5)
    axes.set_yticks(range(len(others)), others)
    axes.set_ylim(len(others) - 0.4, -0.6)
    axes.margins(x=0.12)
    axes.locator_params(axis="x", nbins=4)
    axes.set_xlabel(f"difference ({label})" if label else "difference", fontsize=8)


if __name__ == "__main__":
    comparison_main(__file__)
