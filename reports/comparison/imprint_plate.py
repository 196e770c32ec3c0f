"""The imprint of the plate.

Share of targets complete by place on their home plate, in squares of 15 mm; squares of fewer than 20 targets are left
blank, programmes with too few squares left out. The first four scenarios.
"""

from typing import Any

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim.plotting.axes import as_percent, empty_figure
from survey_sim.plotting.comparison import ComparisonTables, comparison_main
from survey_sim.plotting.style import COMPLETENESS_MAP, FULL_WIDTH, new_figure

SQUARE_MM = 15.0
# Scenarios that are drawn: more make the maps too small.
N_SHOWN = 4
# Maps of fewer squares say nothing.
N_SQUARE = 30


def draw(comparison: ComparisonTables) -> Figure:
    """A map for each programme (row) and scenario (column)."""
    table = comparison.table("imprint_plate", outcome="allocated")
    squares = table.group_by("programme").agg(n=pl.struct("x_mm", "y_mm").n_unique()).filter(pl.col("n") >= N_SQUARE)
    programmes, scenarios = squares["programme"].sort().to_list(), comparison.scenarios[:N_SHOWN]
    if not programmes:
        return empty_figure(new_figure(), "too few targets for a map of the plate")
    side = min(2.6, (FULL_WIDTH - 1.6) / len(scenarios))
    figure = new_figure(side * len(scenarios) + 1.6, (side + 0.35) * len(programmes) + 0.3)
    grid = figure.subplots(len(programmes), len(scenarios), sharex=True, sharey=True, squeeze=False)
    low = min(0.9, float(np.floor(10 * np.quantile(table["completeness_frac"].to_numpy(), 0.02)) / 10))
    for panels, programme in zip(grid, programmes, strict=True):
        for axes, scenario in zip(panels, scenarios, strict=True):
            mesh = _draw_map(axes, table.filter(programme=programme, scenario=scenario), low)
            axes.set_title(f"{programme}\n{scenario}", fontsize=8)
    for axes in grid[-1]:
        axes.set_xlabel("Plate x, east (mm)")
    for axes in grid[:, 0]:
        axes.set_ylabel("Plate y, north (mm)")
    bar = figure.colorbar(mesh, ax=grid, shrink=0.8, aspect=30, label="Targets complete (%)", extend="min")
    as_percent(bar.ax.yaxis)
    return figure


def _draw_map(axes: Axes, rows: pl.DataFrame, low: float) -> Any:
    extent = 12
    cells = np.full((2 * extent, 2 * extent), np.nan)
    x, y = (np.floor(rows[name].to_numpy() / SQUARE_MM).astype(int) + extent for name in ("x_mm", "y_mm"))
    cells[y, x] = rows["completeness_frac"].to_numpy()
    edges = (np.arange(2 * extent + 1) - extent) * SQUARE_MM
    axes.set(aspect="equal", xlim=(-180, 180), ylim=(-180, 180))
    axes.grid(False)
    return axes.pcolormesh(edges, edges, np.ma.masked_invalid(cells), cmap=COMPLETENESS_MAP, vmin=low, vmax=1.0)


if __name__ == "__main__":
    comparison_main(__file__)
