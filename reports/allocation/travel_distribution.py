"""Distribution of robots' travel.

Share of the robots that move at most so far in a visit, for visits at the beginning, in the middle and towards the end of
what an ideal positioner would need, the darker the later. No sky fibres, patrol radius 50 mm, separation 9 mm.
"""

import polars as pl
from matplotlib.figure import Figure

from survey_sim.plotting.axes import as_percent, draw_cumulative
from survey_sim.plotting.study import StudyTables, from_zero, make_grid, study_main
from survey_sim.plotting.style import DASHES

COLOURS = ("#56B4E9", "#0072B2", "#D55E00", "#222222")
SHARES = (0.0, 0.4, 0.75, 1.0)


def draw(study: StudyTables) -> Figure:
    """A row a field, a column an algorithm, a line a visit."""
    grid = make_grid(study.sources, study.algorithms, row_height_in=2.3, sharex=True, sharey=True)
    for (source, name), axes in grid.panels.items():
        rows = study.table("travel", source=source, algorithm=name)
        n_ideal = -(-study.n_science(source) // study.n_robot())
        chosen = sorted({1 + round(share * (n_ideal - 1)) for share in SHARES})
        for visit, colour, dashes in zip(chosen, COLOURS, reversed(DASHES), strict=False):
            travel = rows.filter(pl.col("visit") == visit)["travel_mm"].to_numpy()
            draw_cumulative(axes, travel, color=colour, linestyle=dashes, linewidth=1.4, label=f"visit {visit}")
        axes.set(title=f"{source}, {name}", ylim=(0, 1.02))
        as_percent(axes.yaxis)
        axes.legend(loc="lower right")
        if name == study.algorithms[0]:
            axes.set_ylabel("Robots (%)")
        if source == study.sources[-1]:
            axes.set_xlabel("Travel at most (mm)")
    from_zero(grid)
    return grid.figure


if __name__ == "__main__":
    study_main(__file__)
