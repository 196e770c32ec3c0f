"""Timing of each robot.

The robots of the slowest visit that move, from start to target, in order of when they come to rest: how long each
turns, goes, and stands still before it has arrived. Dashed: when 95 % of them are at rest.
"""

import numpy as np
import polars as pl
from matplotlib.figure import Figure

from survey_sim.plotting import RunTables, main, new_figure
from survey_sim.plotting.axes import add_legend, empty_figure
from survey_sim.plotting.style import IDEAL_DASHES, INK, MOTION_COLOURS

LABELS = {"rotating_s": "turning", "moving_s": "going", "waiting_s": "standing"}


def draw(run: RunTables) -> Figure:
    """Stacked times of the robots of one visit."""
    figure = new_figure()
    visit = run.slowest_visit
    times = run.rows_of("robot_times", visit).filter(path="start_to_target") if visit else pl.DataFrame()
    moving = times.filter(pl.col("moving_s") + pl.col("rotating_s") > 0) if len(times) else times
    if visit is None or moving.is_empty():
        return empty_figure(figure, "no robot moves")
    axes = figure.add_subplot()
    moving = moving.with_columns(rest=pl.sum_horizontal(*LABELS)).sort("rest", "robot_id")
    place, below = np.arange(len(moving)), np.zeros(len(moving))
    for column, label in LABELS.items():
        height = moving[column].to_numpy()
        axes.bar(place, height, bottom=below, width=1.0, color=MOTION_COLOURS[column], linewidth=0, label=label)
        below = below + height
    p95 = run.visits.filter(survey=visit.survey, tile_id=visit.tile_id, visit_id=visit.visit_id)["configuration_time_p95_s"]
    axes.axhline(p95.item(), color=INK, linestyle=IDEAL_DASHES, linewidth=1.0, label=f"95 % at rest: {p95.item():.1f} s")
    axes.set(title=f"{visit.label}: {len(moving)} robots move", xlim=(-1, len(moving)))
    axes.set(xlabel="Robots, in order of coming to rest", ylabel="Time from the start of the path (s)")
    axes.set_ylim(0, 1.15 * below.max())
    add_legend(axes, loc="upper left", ncol=4)
    axes.grid(False, axis="x")
    return figure


if __name__ == "__main__":
    main(__file__)
