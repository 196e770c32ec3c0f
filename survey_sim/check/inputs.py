"""What the check reads: the instrument's constants, the small tables whole, and the large ones part by part."""

import json
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import numpy.typing as npt
import polars as pl

from survey_sim import tables
from survey_sim.check.faults import Fault, FaultLog
from survey_sim.check.relations import check_small, check_table
from survey_sim.errors import InputError

SMALL = ("robots", "targets", "tiles", "visits", "paths")
LARGE = ("allocations", "legs", "robot_times")
OPTIONAL = ("unallocated", "exposures", "nights", "target_status", "rejected")
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
    schedule
        Settings of the schedule.
    """

    constants: Constants
    robots: pl.DataFrame
    targets: pl.DataFrame
    tiles: pl.DataFrame
    visits: pl.DataFrame
    paths: pl.DataFrame
    optional: dict[str, pl.DataFrame]
    schedule: ScheduleRules
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
    constants = _read_constants(run_dir, log)
    wanted = [*SMALL, *(table for table in OPTIONAL if tables.files(run_dir, table))]
    found = {table: _read_small(run_dir, table, log) for table in wanted}
    has_large = [_check_files(run_dir, table, log) for table in LARGE]
    sound = {table: frame for table, frame in found.items() if frame is not None}
    if constants is None or not all(has_large) or len(sound) < len(wanted):
        return None
    check_small(log, sound["robots"], sound["tiles"], sound["visits"], sound["paths"])
    key = ["survey", "tile_id", "visit_id"]
    visits = sound["visits"].sort(key).with_row_index("visit_row")
    paths = sound["paths"].join(visits.select(*key, "visit_row"), on=key, how="inner", maintain_order="left")
    targets = sound["targets"].sort("target_id")
    return Run(
        constants=constants,
        robots=sound["robots"],
        targets=targets,
        tiles=sound["tiles"],
        visits=visits,
        paths=paths,
        optional={table: frame for table, frame in sound.items() if table in OPTIONAL},
        schedule=_read_schedule(run_dir),
        target_ids=targets["target_id"].to_numpy(),
    )


def part_groups(run_dir: Path, log: FaultLog) -> list[list[str]]:
    """Names of the parts that all three large tables have, some together; a fault for each that one of them lacks."""
    names = {table: {path.name for path in tables.files(run_dir, table)} for table in LARGE}
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
        size += sum((run_dir / table / name).stat().st_size for table in LARGE)
    return groups


def read_group(run_dir: Path, names: list[str], log: FaultLog) -> dict[str, pl.DataFrame] | None:
    """The three large tables of some parts; None, with faults logged, if one is not sound."""
    found = {table: _read_files([run_dir / table / name for name in names], table, log) for table in LARGE}
    sound = {table: frame for table, frame in found.items() if frame is not None}
    return sound if len(sound) == len(LARGE) else None


def _read_constants(run_dir: Path, log: FaultLog) -> Constants | None:
    path = run_dir / "run.json"
    try:
        given = json.loads(path.read_text(encoding="utf-8"))["instrument"]
        return Constants(**{field.name: float(given[field.name]) for field in fields(Constants)})
    except (OSError, ValueError, KeyError, TypeError) as failure:
        detail = f"run.json gives no instrument: {type(failure).__name__} {failure}"
        log.add_one(Fault("schema", "run.json", detail=detail))
        return None


def _read_schedule(run_dir: Path) -> ScheduleRules:
    """Rules of the schedule; the plain ones (routed times, every target succeeds) where run.json has none."""
    record = json.loads((run_dir / "run.json").read_text(encoding="utf-8"))
    settings = record.get("settings", {}).get("schedule") or {}
    given = settings.get("configuration_s", "routed")
    success = settings.get("success_frac", {})
    uncertain = tuple(sorted(programme for programme, frac in success.items() if frac < 1))
    return ScheduleRules(None if given == "routed" else float(given), uncertain)


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
