"""Efficiency against completeness.

Of all fibres of the visits so far, those that took a new target of at least each priority, against the completeness of
these targets; it is also the number of visits that the ideal positioner needs for as much, over the visits made. At least
30 fibres on sky at every visit (dashed: what that leaves); patrol radius 50 mm, separation 9 mm. CDA-Basic knows neither
priorities nor sky and is left out.
"""

from matplotlib.figure import Figure

from survey_sim.plotting.axes import as_percent
from survey_sim.plotting.study import PAPER_PLATE, StudyTables, draw_thresholds, make_grid, one_legend, study_main
from survey_sim.plotting.style import IDEAL, IDEAL_DASHES

N_SKY = 30


def draw(study: StudyTables) -> Figure:
    """A row a field, a column an algorithm, a line a threshold."""
    algorithms = [name for name in study.algorithms if name != "cda-basic"]
    grid = make_grid(study.sources, algorithms, row_height_in=2.3, sharex=True, sharey=True)
    for (source, name), axes in grid.panels.items():
        own = study.table("priorities", source=source, algorithm=name, min_sky=N_SKY, **PAPER_PLATE)
        draw_thresholds(axes, own, "completeness_frac", "efficiency_frac")
        left = 1.0 - N_SKY / study.n_robot()
        axes.axhline(left, color=IDEAL, linestyle=IDEAL_DASHES, linewidth=1.1, label="all fibres but sky")
        axes.set(title=f"{source}, {name}", xlim=(0, 1.02), ylim=(0, 1.0))
        as_percent(axes.xaxis)
        as_percent(axes.yaxis)
        if name == algorithms[0]:
            axes.set_ylabel("Efficiency (%)")
        if source == study.sources[-1]:
            axes.set_xlabel("Targets of the threshold allocated (%)")
    one_legend(grid)
    return grid.figure


if __name__ == "__main__":
    study_main(__file__)
