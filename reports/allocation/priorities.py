"""Completeness by priority, and sky fibres.

Science targets of at least each priority that have had a robot after so many visits, with at least 10, 20 or 30 fibres on
sky at every visit (patrol radius 50 mm, separation 9 mm). A row a field and algorithm; CDA-Basic knows neither priorities
nor sky and is left out. Grey: the ideal positioner of each threshold, all 151 robots on new targets of it at every visit.
"""

from matplotlib.figure import Figure

from survey_sim.plotting.study import (
    PAPER_PLATE,
    StudyTables,
    completeness_axes,
    draw_ideal,
    draw_thresholds,
    make_grid,
    one_legend,
    study_main,
)

MIN_SKY = (10, 20, 30)


def draw(study: StudyTables) -> Figure:
    """A row a field and algorithm, a column a number of sky fibres, a line a threshold."""
    algorithms = [name for name in study.algorithms if name != "cda-basic"]
    rows = [(source, name) for source in study.sources for name in algorithms]
    grid = make_grid(rows, MIN_SKY, row_height_in=1.75, sharey=True)
    for (source, name), n_sky in grid.panels:
        axes = grid.panels[(source, name), n_sky]
        own = study.table("priorities", source=source, algorithm=name, min_sky=n_sky, **PAPER_PLATE)
        last = int(study.table("visits", source=source)["visit"].to_numpy().max())
        for n_target in own["n_target"].unique():
            draw_ideal(axes, study, n_target, last, color="#9A9A9A", linestyle="-")
        draw_thresholds(axes, own, "visit", "completeness_frac")
        completeness_axes(axes, last)
        axes.set_title(f"{source}, {name}, {n_sky} sky")
        if n_sky == MIN_SKY[0]:
            axes.set_ylabel("Allocated (%)")
        if name == algorithms[-1]:
            axes.set_xlabel("Visits of the field")
    one_legend(grid)
    return grid.figure


if __name__ == "__main__":
    study_main(__file__)
