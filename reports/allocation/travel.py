"""Travel and crossings per visit.

Straight distance from where a robot starts to where it ends, of the robots that move: the greatest, the greatest once the
5 % that travel furthest are left out, and the mean; and the pairs of straight ways that cross. CDA-Basic starts every visit
from park, the others from where the visit before ended. No sky fibres, patrol radius 50 mm, separation 9 mm.
"""

from matplotlib.figure import Figure

from survey_sim.plotting.axes import whole_numbers
from survey_sim.plotting.study import PAPER_PLATE, StudyTables, draw_algorithms, from_zero, make_grid, one_legend, study_main

ROWS = {
    "travel_max_mm": "Maximum (mm)",
    "travel_p95_mm": "95 % of robots (mm)",
    "travel_mean_mm": "Mean (mm)",
    "crossings": "Crossing pairs",
}


def draw(study: StudyTables) -> Figure:
    """A row a quantity, a column a field, a line an algorithm."""
    grid = make_grid(list(ROWS), study.sources, row_height_in=1.9, sharex="col", sharey="row")
    for (column, source), axes in grid.panels.items():
        draw_algorithms(axes, study.table("visits", source=source, min_sky=0, **PAPER_PLATE), column)
        whole_numbers(axes.xaxis)
        if column == next(iter(ROWS)):
            axes.set_title(source)
        if source == study.sources[0]:
            axes.set_ylabel(ROWS[column])
        if column == "crossings":
            whole_numbers(axes.yaxis, 5)
            axes.set_xlabel("Visit of the field")
    from_zero(grid)
    one_legend(grid)
    return grid.figure


if __name__ == "__main__":
    study_main(__file__)
