"""What the check reads: the instrument's constants, the small tables whole, and the large ones part by part."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import polars as pl

from survey_sim import tables
from survey_sim.check.faults import Fault, FaultLog
from survey_sim.check.minima import read_minima
from survey_sim.check.relations import check_small, check_table
from survey_sim.errors import InputError

SMALL = ("robots", "targets", "tiles", "visits", "paths")
LARGE = ("allocations", "legs", "robot_times")
EXPOSURE_LARGE = ("exposure_allocations", "exposure_legs")
OPTIONAL = (
    *("executions", "unallocated", "exposures", "exposure_paths", "nights", "time_budget", "completeness"),
    *("target_status", "rejected"),
)
RECORD = "run.json"
# Parts are looked at together up to so many bytes on disk: enough to be quick, few enough to bound memory.
GROUP_BYTES = 16 * 2**20


@dataclass(frozen=True)
class Constants:
    """What the check needs of the instrument; see `Instrument` for meaning and source."""

    plate_radius_mm: float
    plate_scale_arcsec_mm: float
    patrol_radius_mm: float
    guide_patrol_radius_mm: float
    min_separation_mm: float
    coarse_speed_mm_s: float
    precise_speed_mm_s: float
    rotation_speed_deg_s: float
    precise_approach_mm: float


@dataclass(frozen=True)
class ScheduleRules:
    """What the check needs of the schedule's settings.

    Attributes
    ----------
    configuration_s
        The time charged for every pointing; None: as routed.
    uncertain
        Programmes of which not every target observed succeeds.
    """

    configuration_s: float | None
    uncertain: tuple[str, ...]


@dataclass(frozen=True)
class Run:
    """A run's constants and small tables.

    Attributes
    ----------
    targets
        Sorted by target_id, which `target_ids` holds as an array.
    visits, paths
        With `visit_row`, the visit's number in the run.
    optional
        Those of `OPTIONAL` that the run has.
    robots
        With the state in which a tile's first visit finds it: `first_x_mm`, `first_y_mm`, `first_theta_deg`.
    schedule
        Settings of the schedule.
    minima
        As `read_minima` gives them.
    """

    constants: Constants
    robots: pl.DataFrame
    targets: pl.DataFrame
    tiles: pl.DataFrame
    visits: pl.DataFrame
    paths: pl.DataFrame
    optional: dict[str, pl.DataFrame]
    schedule: ScheduleRules
    minima: pl.DataFrame
    target_ids: npt.NDArray[np.int64]


def read_run(run_dir: Path, log: FaultLog) -> Run | None:
    """Constants and small tables; None, with faults logged, if one is absent or not sound: all the rest stands on them.

    Raises
    ------
    InputError
        There is no such folder.
    """
    if not run_dir.is_dir():
        raise InputError("no such folder", file=run_dir, remedy="name the folder of a finished run")
    record = _read_record(run_dir, log)
    constants = _read_constants(record, log)
    wanted = [*SMALL, *(table for table in OPTIONAL if tables.files(run_dir, table))]
    found = {table: _read_small(run_dir, table, log) for table in wanted}
    large = (*LARGE, *EXPOSURE_LARGE) if "exposure_paths" in wanted else LARGE
    has_large = [_check_files(run_dir, table, log) for table in large]
    sound = {table: frame for table, frame in found.items() if frame is not None}
    if constants is None or not all(has_large) or len(sound) < len(wanted):
        return None
    try:
        robots = _with_first_state(sound["robots"], record.get("start_positions"))
        schedule = _read_schedule(record)
        minima = read_minima(record, robots)
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, pl.exceptions.PolarsError) as failure:
        log.add_one(Fault("schema", RECORD, detail=f"not as a run writes it: {type(failure).__name__} {failure}"))
        return None
    check_small(log, sound["robots"], sound["tiles"], sound["visits"], sound["paths"])
    key = ["survey", "tile_id", "visit_id"]
    visits = sound["visits"].sort(key).with_row_index("visit_row")
    paths = sound["paths"].join(visits.select(*key, "visit_row"), on=key, how="inner", maintain_order="left")
    targets = sound["targets"].sort("target_id")
    return Run(
        constants=constants,
        robots=robots,
        targets=targets,
        tiles=sound["tiles"],
        visits=visits,
        paths=paths,
        optional={table: frame for table, frame in sound.items() if table in OPTIONAL},
        schedule=schedule,
        minima=minima,
        target_ids=targets["target_id"].to_numpy(),
    )


def part_groups(run_dir: Path, large: Sequence[str], log: FaultLog) -> list[list[str]]:
    """Names of the parts that all these large tables have, some together; a fault for each that one of them lacks."""
    names = {table: {path.name for path in tables.files(run_dir, table)} for table in large}
    for table, own in names.items():
        for lacking in sorted(set.union(*names.values()) - own):
            log.add_one(Fault("schema", table, detail=f"part {lacking} is missing"))
    groups: list[list[str]] = []
    size = GROUP_BYTES
    for name in sorted(set.intersection(*names.values())):
        if size >= GROUP_BYTES:
            groups.append([])
            size = 0
        groups[-1].append(name)
        size += sum((run_dir / table / name).stat().st_size for table in large)
    return groups


def read_group(run_dir: Path, large: Sequence[str], names: list[str], log: FaultLog) -> dict[str, pl.DataFrame] | None:
    """The large tables of some parts; None, with faults logged, if one is not sound."""
    found = {table: _read_files([run_dir / table / name for name in names], table, log) for table in large}
    sound = {table: frame for table, frame in found.items() if frame is not None}
    return sound if len(sound) == len(large) else None


def _read_record(run_dir: Path, log: FaultLog) -> dict[str, Any]:
    """run.json; empty, with a fault, where it is no JSON object."""
    try:
        record = json.loads((run_dir / "run.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as failure:
        log.add_one(Fault("schema", RECORD, detail=f"not readable: {type(failure).__name__} {failure}"))
        return {}
    return record if isinstance(record, dict) else {}


def _read_constants(record: dict[str, Any], log: FaultLog) -> Constants | None:
    try:
        given = record["instrument"]
        return Constants(**{field.name: float(given[field.name]) for field in fields(Constants)})
    except (ValueError, KeyError, TypeError) as failure:
        detail = f"gives no instrument: {type(failure).__name__} {failure}"
        log.add_one(Fault("schema", RECORD, detail=detail))
        return None


def _read_schedule(record: dict[str, Any]) -> ScheduleRules:
    """Rules of the schedule; the plain ones (routed times, every target succeeds) where run.json has none."""
    settings = record.get("settings", {}).get("schedule") or {}
    given = settings.get("configuration_s", "routed")
    success = settings.get("success_frac", {})
    uncertain = tuple(sorted(programme for programme, frac in success.items() if frac < 1))
    return ScheduleRules(None if given == "routed" else float(given), uncertain)


def _with_first_state(robots: pl.DataFrame, given: dict[str, Any] | None) -> pl.DataFrame:
    """Robots with the state in which a tile's first visit finds them: park and theta 0, or what run.json says of a field.

    `start_positions` there holds `position_mm` (x, y) and `theta_deg` for each robot, in the order of their ids.
    """
    robots = robots.sort("survey", "robot_id")
    if given is None:
        return robots.with_columns(first_x_mm="park_x_mm", first_y_mm="park_y_mm", first_theta_deg=pl.lit(0.0))
    x, y = (
        pl.Series(name, [place[i] for place in given["position_mm"]]) for i, name in enumerate(("first_x_mm", "first_y_mm"))
    )
    first = pl.DataFrame([x, y, pl.Series("first_theta_deg", given["theta_deg"])]).cast(pl.Float64)
    if first.height != robots.height:
        raise ValueError(f"start_positions has {first.height} robots, the table {robots.height}")
    return robots.hstack(first)


def _check_files(run_dir: Path, table: str, log: FaultLog) -> bool:
    """Whether a table is there, of this schema's version, with its columns."""
    try:
        tables.scan(run_dir, table)
    except InputError as failure:
        log.add_one(Fault("schema", table, detail=f"{failure.place or table}: {failure.rule}"))
        return False
    return True


def _read_small(run_dir: Path, table: str, log: FaultLog) -> pl.DataFrame | None:
    if not _check_files(run_dir, table, log):
        return None
    return _read_files([run_dir / f"{table}.parquet"], table, log)


def _read_files(paths: list[Path], table: str, log: FaultLog) -> pl.DataFrame | None:
    try:
        frame = pl.read_parquet(paths, glob=False)
    except (pl.exceptions.PolarsError, OSError) as failure:
        detail = f"{paths[0].name} to {paths[-1].name}: not readable: {failure}"
        log.add_one(Fault("schema", table, detail=detail))
        return None
    return frame if check_table(log, frame, table) else None
