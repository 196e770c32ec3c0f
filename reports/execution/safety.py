"""Errors of execution and safety.

Share of routed paths on which two robots come nearer than the separation (9 mm), and on which two touch (8 mm), against
the relative scatter of speed of each leg. Lines: legs started by the clock (open-loop), tick by tick (resync), or each robot
waiting for those that should pass a place before it (keep-order). Columns: extra separation planned where starts and goals
allow.
"""

import polars as pl
from matplotlib.figure import Figure

from survey_sim.plotting.execution import draw_by_margin, execution_main


def draw(rows: pl.DataFrame) -> Figure:
    """Both shares; a column a margin."""
    panels = {
        "Paths below the\nseparation (%)": pl.col("is_near").mean(),
        "Paths with\ncontact (%)": pl.col("is_touching").mean(),
    }
    return draw_by_margin(rows, panels)


if __name__ == "__main__":
    execution_main(__file__)
