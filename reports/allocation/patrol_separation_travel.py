"""Travel by patrol radius and separation.

Greatest travel of a robot in each visit, with patrol radii of 50 and 75 mm and separations of 9 and 11.65 mm; no sky
fibres. CDA-Basic starts every visit from park, the others from where the visit before ended.
"""

from matplotlib.figure import Figure

from survey_sim.plotting.axes import whole_numbers
from survey_sim.plotting.study import StudyTables, draw_algorithms, from_zero, make_grid, one_legend, plates_of, study_main


def draw(study: StudyTables) -> Figure:
    """A row a field, a column a plate, a line an algorithm."""
    plates = plates_of(study)
    grid = make_grid(study.sources, plates, row_height_in=2.0, sharey=True)
    for (source, (patrol, apart)), axes in grid.panels.items():
        plate = {"source": source, "patrol_radius_mm": patrol, "min_separation_mm": apart}
        draw_algorithms(axes, study.table("visits", min_sky=0, **plate), "travel_max_mm")
        whole_numbers(axes.xaxis)
        axes.set_title(f"{source}: {patrol:g}, {apart:g} mm")
        if (patrol, apart) == plates[0]:
            axes.set_ylabel("Greatest travel (mm)")
        if source == study.sources[-1]:
            axes.set_xlabel("Visit of the field")
    from_zero(grid)
    one_legend(grid)
    return grid.figure


if __name__ == "__main__":
    study_main(__file__)
