"""Completeness by patrol radius and separation.

Points of completeness short of the ideal positioner, which knows neither limit, against visit: with patrol radii of 50 and
75 mm and separations of 9 and 11.65 mm, no sky fibres. Dotted: what no allocation on that plate can avoid, by the proven
bound.
"""

import polars as pl
from matplotlib.figure import Figure

from survey_sim.plotting.axes import whole_numbers
from survey_sim.plotting.study import (
    StudyTables,
    draw_algorithms,
    from_zero,
    ideal_frac,
    make_grid,
    one_legend,
    plates_of,
    study_main,
)
from survey_sim.plotting.style import BOUND, BOUND_DASHES


def draw(study: StudyTables) -> Figure:
    """A row a field, a column a plate, a line an algorithm."""
    plates = plates_of(study)
    grid = make_grid(study.sources, plates, row_height_in=2.1, sharex="row", sharey=True)
    for (source, (patrol, apart)), axes in grid.panels.items():
        plate = {"source": source, "patrol_radius_mm": patrol, "min_separation_mm": apart}
        limits = _lost(study, study.table("limits", **plate).sort("visit"), "bound_frac")
        axes.plot(
            limits["visit"],
            limits["lost"],
            color=BOUND,
            linestyle=BOUND_DASHES,
            linewidth=1.6,
            label="proven bound",
            zorder=3,
        )
        draw_algorithms(axes, _lost(study, study.table("visits", min_sky=0, **plate), "completeness_frac"), "lost")
        whole_numbers(axes.xaxis)
        axes.set_title(f"{source}: {patrol:g}, {apart:g} mm")
        if (patrol, apart) == plates[0]:
            axes.set_ylabel("Short of the ideal\n(points of %)")
        if source == study.sources[-1]:
            axes.set_xlabel("Visits of the field")
    from_zero(grid)
    one_legend(grid)
    return grid.figure


def _lost(study: StudyTables, rows: pl.DataFrame, column: str) -> pl.DataFrame:
    """Rows of one field with `lost`: points of completeness short of the ideal positioner."""
    ideal = ideal_frac(study, study.n_science(rows["source"][0]), rows["visit"])
    return rows.with_columns(lost=(ideal - rows[column]) * 100.0)


if __name__ == "__main__":
    study_main(__file__)
