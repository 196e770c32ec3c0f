"""Routing.

Left: least distance between the centres of any two robots at any instant of a path (the last bin holds all beyond it);
vertical: the least allowed. Middle: ticks, the synchronous moves that a path is cut into. Right: robots that the router
had to leave where they stood, by reason. Paths on which nobody moves are left out.
"""

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim.plotting import RunTables, main, new_figure
from survey_sim.plotting.axes import add_legend, empty_figure, log_scale, panels, say_empty, whole_numbers
from survey_sim.plotting.style import DASHES, INK, LIMIT_DASHES

PATH_COLOURS = {"start_to_target": "#222222", "start_to_park": "#009E73", "park_to_target": "#CC79A7"}
N_BIN = 40


def draw(run: RunTables) -> Figure:
    """Least separations, ticks, and unrouted robots."""
    figure = new_figure()
    if run.paths.is_empty():
        return empty_figure(figure, "no paths: no robot moves")
    grid = panels(figure, ["Least separation", "Ticks", "Unrouted robots"], share_y=False)
    limit = float(run.instrument["min_separation_mm"])
    least = run.paths["min_separation_mm"].to_numpy()
    near = np.linspace(min(least.min(), limit), max(np.quantile(least, 0.995), limit + 1.0), N_BIN + 1)
    _draw_paths(grid[0], run, "min_separation_mm", near)
    grid[0].axvline(limit, color=INK, linewidth=1.0, linestyle=LIMIT_DASHES)
    grid[0].set(xlabel="Least separation on the path (mm)", ylabel="Paths")
    log_scale(grid[0], "y")
    ticks = run.paths["ticks"].to_numpy().max()
    _draw_paths(grid[1], run, "ticks", np.arange(0, ticks + 2, max(1, ticks // N_BIN)) - 0.5)
    grid[1].set(xlabel="Ticks of the path", ylabel="Paths")
    whole_numbers(grid[1].xaxis, 6)
    grid[1].set_ylim(top=1.3 * grid[1].get_ylim()[1])
    add_legend(grid[1], loc="upper right")
    _draw_unrouted(grid[2], run)
    return figure


def _draw_paths(axes: Axes, run: RunTables, column: str, edges: np.ndarray) -> None:
    for (path, colour), dashes in zip(PATH_COLOURS.items(), DASHES, strict=False):
        values = run.paths.filter(path=path)[column].to_numpy().clip(edges[0], edges[-1])
        axes.stairs(np.histogram(values, edges)[0], edges, color=colour, linestyle=dashes, linewidth=1.4, label=path)


def _draw_unrouted(axes: Axes, run: RunTables) -> None:
    outcomes = run.robot_outcomes
    lost = outcomes.drop_nulls("reason")
    n_robot = outcomes["n_robot"].sum()
    if lost.is_empty():
        say_empty(axes, f"none of {n_robot:,} robots:\nall arrive on all paths")
        return
    reasons = lost.group_by("reason").agg(pl.col("n_robot").sum()).sort("n_robot", "reason")
    place = np.arange(len(reasons))
    before = np.zeros(len(reasons))
    for path, colour in PATH_COLOURS.items():
        counts = reasons.select("reason").join(
            lost.filter(path=path).group_by("reason").agg(pl.col("n_robot").sum()),
            on="reason",
            how="left",
            maintain_order="left",
        )
        width = counts["n_robot"].fill_null(0).to_numpy()
        axes.barh(place, width, left=before, color=colour, height=0.6, label=path)
        before = before + width
    axes.set_yticks(place, reasons["reason"])
    axes.set_xlabel(f"Robots, of {n_robot:,}")
    axes.grid(False, axis="y")


if __name__ == "__main__":
    main(__file__)
