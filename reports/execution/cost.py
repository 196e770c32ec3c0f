"""Errors of execution and time.

Above: how much longer than planned the planned legs take, in the mean of all paths. Below: how much longer than the slowest
robot alone, so with what the margin costs. Without the metrology that follows. Lines and columns as for safety.
"""

import polars as pl
from matplotlib.figure import Figure

from survey_sim.plotting.execution import draw_by_margin, execution_main


def draw(rows: pl.DataFrame) -> Figure:
    """Both costs; a column a margin."""
    moving = pl.col("moving_time_s")
    panels = {
        "Longer than\nplanned (%)": (moving / pl.col("planned_time_s")).mean() - 1.0,
        "Longer than\nthe bound (%)": (moving / pl.col("lower_bound_s")).mean() - 1.0,
    }
    return draw_by_margin(rows, panels)


if __name__ == "__main__":
    execution_main(__file__)
