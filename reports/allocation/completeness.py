"""Completeness against visit.

Science targets that have had a robot after so many visits of the field, without sky fibres (patrol radius 50 mm, separation
9 mm). `plan` is one plan, for the number of visits that an ideal positioner would need; each open circle is another plan,
made for just so many visits. Dashed: the ideal positioner, whose every robot takes a new target at every visit. Dotted:
the proven bound of any allocation. Below: points of completeness short of that bound.
"""

import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim.plotting.study import (
    ALGORITHM_STYLES,
    PAPER_PLATE,
    StudyTables,
    completeness_axes,
    draw_algorithms,
    draw_bound,
    draw_ideal,
    from_zero,
    make_grid,
    one_legend,
    study_main,
)


def draw(study: StudyTables) -> Figure:
    """Completeness above, what is lost to the bound below; a column a field."""
    grid = make_grid(["completeness", "lost"], study.sources, sharex="col", sharey="row", height_ratios=[3, 2])
    for source in study.sources:
        _draw_source(grid.panels["completeness", source], grid.panels["lost", source], study, source)
    grid.panels["completeness", study.sources[0]].set_ylabel("Targets allocated (%)")
    grid.panels["lost", study.sources[0]].set_ylabel("Short of the bound\n(points of %)")
    from_zero(grid)
    one_legend(grid)
    return grid.figure


def _draw_source(axes: Axes, below: Axes, study: StudyTables, source: str) -> None:
    visits = study.table("visits", source=source, min_sky=0, **PAPER_PLATE)
    limits = study.table("limits", source=source, **PAPER_PLATE)
    planned = study.table("planned", source=source).sort("planned_visits")
    last = int(visits["visit"].to_numpy().max())
    draw_ideal(axes, study, study.n_science(source), last)
    draw_bound(axes, limits)
    draw_algorithms(axes, visits, "completeness_frac")
    own = {"linestyle": "none", "marker": "o", "fillstyle": "none", "color": ALGORITHM_STYLES["plan"]["color"]}
    axes.plot(
        planned["planned_visits"], planned["completeness_frac"], label="plan for so many", markersize=7, zorder=3, **own
    )
    lost = (pl.col("bound_frac") - pl.col("completeness_frac")) * 100.0
    draw_algorithms(below, visits.join(limits, on="visit").with_columns(lost.alias("lost")), "lost")
    best = planned.join(limits.select("bound_frac", planned_visits="visit"), on="planned_visits").with_columns(
        lost.alias("lost")
    )
    below.plot(best["planned_visits"], best["lost"], markersize=7, zorder=3, **own)
    axes.set_title(f"{source}: {study.n_science(source):,} targets")
    completeness_axes(axes, last)
    below.set_xlabel("Visits of the field")


if __name__ == "__main__":
    study_main(__file__)
