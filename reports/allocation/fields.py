"""The fields on the plate.

Science targets of each field, sky positions, and the parks of the 151 robots (crosses), with the patrol disc of one of
them. Galaxies and stars in shades of their priority: the darker, the higher.
"""

from matplotlib.figure import Figure
from matplotlib.patches import Circle

from survey_sim.instrument import load_instrument, make_plate
from survey_sim.plotting.study import PAPER_PLATE, THRESHOLD_COLOURS, StudyTables, make_grid, one_legend, study_main
from survey_sim.plotting.style import INK, KIND_COLOURS, MUTED


def draw(study: StudyTables) -> Figure:
    """A panel a field."""
    plate = make_plate(load_instrument("paper"))
    radius = plate.instrument.plate_radius_mm
    grid = make_grid([0], study.sources, row_height_in=3.3, sharex=True, sharey=True)
    for source in study.sources:
        axes = grid.panels[0, source]
        science, sky = (study.table("targets", source=source, kind=kind) for kind in ("science", "sky"))
        axes.scatter(sky["x_mm"], sky["y_mm"], s=2.5, color=KIND_COLOURS["sky"], linewidths=0, label="sky position")
        bands = ((1, 2), (3, 4), (5, 6), (7, 8), (9, 9))
        for (low, high), colour in zip(bands, THRESHOLD_COLOURS, strict=True):
            own = science.filter(science["priority"].is_between(low, high))
            label = f"priority {low}" if low == high else f"priority {low}, {high}"
            if own.height:
                size = min(9.0, 9000 / science.height)
                axes.scatter(own["x_mm"], own["y_mm"], s=size, color=colour, linewidths=0, label=label)
        axes.plot(*plate.park_mm.T, linestyle="none", marker="+", color=INK, markersize=4, markeredgewidth=0.6, label="park")
        axes.add_patch(Circle((0, 0), radius, fill=False, color=MUTED))
        axes.add_patch(Circle((0, 0), PAPER_PLATE["patrol_radius_mm"], fill=False, color=INK, linestyle=(0, (3, 2))))
        axes.set(aspect="equal", title=f"{source}: {science.height:,} targets", xlabel="x (mm)")
        axes.grid(False)
    grid.panels[0, study.sources[0]].set_ylabel("y (mm)")
    one_legend(grid)
    return grid.figure


if __name__ == "__main__":
    study_main(__file__)
