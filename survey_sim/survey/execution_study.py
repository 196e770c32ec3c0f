"""Errors of execution against safety and time: measured on chained visits, and drawn.

Uniform targets on the `taipan-150` plate, matched visit after visit; each visit is routed three ways, with several margins,
and each path played with errors of several sizes in all modes. `make_execution_study` writes one table, `executions`, which
the scripts of `reports/execution` draw; a row is a path played once:

field, visit, path, margin_mm, mode, scatter_frac (of speed, of each leg), planned_time_s, lower_bound_s, moving_time_s,
metrology_rounds, metrology_time_s, min_separation_mm, is_near (some pair below the separation), is_touching (in contact)
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import polars as pl
from rich.console import Console
from rich.progress import Progress

from survey_sim import tables
from survey_sim.allocation import AllocationSettings, FieldTargets, start_allocation
from survey_sim.instrument import Plate, load_instrument, make_plate
from survey_sim.routing import RoutedPath, RoutingSettings, route
from survey_sim.simulation import SimulationSettings, execute
from survey_sim.survey.studies import do_each
from survey_sim.survey.tile import stream

MODES = ("open-loop", "resync", "keep-order")
SCATTERS_FRAC = (0.0, 0.005, 0.01, 0.02, 0.03, 0.05)
MARGINS_MM = (0.0, 0.5, 1.0)
# Fields, and visits of each: with three paths, 240 played paths a point (36 if quick).
FIELDS, QUICK_FIELDS, VISITS = 20, 3, 4
# Uniform targets of a field: about six for each robot.
N_TARGET = 900

Advance = Callable[[int, int], None]


def draw_execution_study(out: Path, console: Console, *, quick: bool = False) -> pl.DataFrame:
    """Measure, write the table and draw every figure into one folder; gives `summarise_executions`."""
    from survey_sim.plotting.execution import draw_executions  # noqa: PLC0415 - matplotlib is slow to import

    with Progress(*Progress.get_default_columns(), console=console) as progress:
        task = progress.add_task("fields", total=None)
        rows = make_execution_study(
            out,
            n_field=QUICK_FIELDS if quick else FIELDS,
            n_worker=len(os.sched_getaffinity(0)),
            advance=lambda n, of: progress.update(task, completed=n, total=of),
        )
        task = progress.add_task("figures", total=None)
        n_figure = len(list(draw_executions(out, out)))
        progress.update(task, completed=n_figure, total=n_figure)
    return summarise_executions(rows)


def make_execution_study(
    out: Path, *, n_field: int, n_worker: int = 1, advance: Advance = lambda done, total: None
) -> pl.DataFrame:
    """Play every field and write `executions`; gives the table.

    Parameters
    ----------
    n_worker
        Processes; 1 = all in this one.
    advance
        Called with the fields done and all fields after each.
    """
    parts: list[pl.DataFrame] = []
    for part in do_each(play_field, [(field,) for field in range(n_field)], n_worker):
        parts.append(part)
        advance(len(parts), n_field)
    rows = pl.concat(parts).sort("field", "visit", "path", "margin_mm", "mode", "scatter_frac")
    tables.write_plain(rows, out / "executions.parquet")
    return rows


def play_field(field: int, n_visit: int = VISITS) -> pl.DataFrame:
    """All paths of one field, with every margin, mode and size of error."""
    plate = make_plate(load_instrument("taipan-150"))
    rows = []
    for visit, path, start, planned in _routed_paths(field, plate, n_visit):
        for margin, routed in planned.items():
            keys = {"field": field, "visit": visit, "path": path, "margin_mm": margin}
            rows += [{**keys, **row} for row in _played(plate, start, routed, f"{field}-{visit}-{path}")]
    return pl.DataFrame(rows)


def summarise_executions(rows: pl.DataFrame) -> pl.DataFrame:
    """Shares and times of each margin, mode and size of error.

    Returns
    -------
        margin_mm, mode, scatter_frac, paths, near_frac and contact_frac (paths with a pair below the separation, and in
        contact), cost_frac (mean of moving over planned time, less 1), margin_cost_frac (mean of planned time over bound,
        less 1), metrology_s (mean)
    """
    return (
        rows.group_by("margin_mm", "mode", "scatter_frac")
        .agg(
            paths=pl.len(),
            near_frac=pl.col("is_near").mean(),
            contact_frac=pl.col("is_touching").mean(),
            cost_frac=(pl.col("moving_time_s") / pl.col("planned_time_s")).mean() - 1.0,
            margin_cost_frac=(pl.col("planned_time_s") / pl.col("lower_bound_s")).mean() - 1.0,
            metrology_s=pl.col("metrology_time_s").mean(),
        )
        .sort("margin_mm", "mode", "scatter_frac")
    )


def _routed_paths(field: int, plate: Plate, n_visit: int) -> Iterator[tuple[int, str, np.ndarray, dict[float, RoutedPath]]]:
    """Visit, path, start and the routed path with each margin; the next visit starts where that without margin ends."""
    session = start_allocation(
        _targets(field, plate),
        plate,
        AllocationSettings.load({"algorithm": "matching", "visits": n_visit}),
        stream(1, "allocation", "execution", field),
    )
    at, theta, park, still = plate.park_mm, np.zeros(plate.n_robot), plate.park_mm, np.zeros(plate.n_robot)
    for visit in range(n_visit):
        if (chosen := session.next_visit(at)) is None:
            return
        ways = {
            "start_to_target": (at, theta, chosen.goal_mm),
            "start_to_park": (at, theta, park),
            "park_to_target": (park, still, chosen.goal_mm),
        }
        for path, (start, turned, goal) in ways.items():
            if (start != goal).any():
                planned = {margin: _route(plate, start, turned, goal, margin, (field, visit, path)) for margin in MARGINS_MM}
                yield visit, path, start, planned
                if path == "start_to_target":
                    end = planned[0.0]
        session.record(chosen, end.reason == 0)
        at, theta = end.end_mm, end.end_theta_deg


def _route(
    plate: Plate, start: np.ndarray, theta: np.ndarray, goal: np.ndarray, margin: float, keys: tuple[int, int, str]
) -> RoutedPath:
    return route(plate, start, theta, goal, RoutingSettings(margin_mm=margin), stream(1, "routing", "execution", *keys))


def _played(plate: Plate, start: np.ndarray, routed: RoutedPath, name: str) -> Iterator[dict[str, float | str | bool]]:
    """The same errors, drawn once, in every mode and at every size."""
    for mode in MODES:
        for frac in SCATTERS_FRAC:
            settings = SimulationSettings.load({"mode": mode, "leg_speed_scatter_frac": frac})
            done = execute(plate, start, routed.legs, settings, stream(1, "simulation", "execution", name))
            yield {
                "mode": mode,
                "scatter_frac": frac,
                "planned_time_s": routed.configuration_time_s,
                "lower_bound_s": routed.lower_bound_s,
                "moving_time_s": done.moving_time_s,
                "metrology_rounds": done.metrology_rounds,
                "metrology_time_s": done.metrology_time_s,
                "min_separation_mm": done.min_separation_mm,
                "is_near": done.collisions > 0,
                "is_touching": done.contacts > 0,
            }


def _targets(field: int, plate: Plate) -> FieldTargets:
    """Uniform science targets."""
    rng = np.random.default_rng(field)
    radius, angle = plate.instrument.plate_radius_mm * np.sqrt(rng.random(N_TARGET)), 2 * np.pi * rng.random(N_TARGET)
    place = {"x_mm": radius * np.cos(angle), "y_mm": radius * np.sin(angle)}
    return FieldTargets.from_table(
        pl.DataFrame({"target_id": np.arange(N_TARGET), "kind": "science", "priority": 5, **place})
    )
