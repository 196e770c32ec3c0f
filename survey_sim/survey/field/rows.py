"""Tables from the visits of one field, and visits from a run's tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from survey_sim import tables
from survey_sim.allocation import AllocationSettings, FieldTargets, LostReason, Minima
from survey_sim.errors import InputError
from survey_sim.exchange import MINIMA_PARAMS, RoutedVisit, Standing, parked
from survey_sim.instrument import Instrument, Plate, make_plate
from survey_sim.motion import Legs, alone_time_s
from survey_sim.schema import PATHS
from survey_sim.simulation import make_ticks, simulate
from survey_sim.survey.rows import PlayedPath, TileRows

# What a visit was allocated by, as far as its files and run.json say it.
ALLOCATION_PARAMS = ("algorithm", "travel_power", *(column.name for column in MINIMA_PARAMS))
KEYS = ("survey", "tile_id", "visit_id")
_LEG_COLUMNS = ("start_s", "rotate_deg", "dx_mm", "dy_mm", "precise_mm", "x_mm", "y_mm", "theta_deg")
_MOVE_COLUMNS = ("x_mm", "y_mm", "theta_deg", "dx_mm", "dy_mm", "dtheta_deg", "precise_mm", "start_s")


def keys_of(visit: RoutedVisit) -> dict[str, Any]:
    """survey, tile_id, visit_id of a visit; what its file does not say is the field's."""
    return {key: visit.params.get(key, default) for key, default in zip(KEYS, ("field", 0, 0), strict=True)}


def move_rows(visit: RoutedVisit) -> dict[str, pl.DataFrame]:
    """Rows of the router file's three tables of moves: legs cut into ticks."""
    rows = {}
    for path in PATHS:
        legs = visit.legs[path]
        ticks = make_ticks(visit.plate.instrument, legs)
        columns = {"tick": ticks.tick, "robot_id": visit.plate.robot_id[ticks.robot]}
        frame = pl.DataFrame({**columns, **{name: getattr(ticks, name) for name in _MOVE_COLUMNS}})
        rows[path] = frame.with_columns(leg=_leg_of_moves(legs, ticks.robot, ticks.start_s))
    return rows


def visit_tables(
    visits: Sequence[RoutedVisit], field: FieldTargets, lost: pl.DataFrame | None = None
) -> dict[str, pl.DataFrame]:
    """visits, allocations, paths, legs and robot_times of one tile's visits, played.

    Parameters
    ----------
    lost
        Rows of `unallocated` when these visits were allocated; the table is then made again.
    """
    first = visits[0]
    survey, tile_id, _ = keys_of(first).values()
    rows = TileRows(survey, tile_id, field, first.plate, _minima(first.params), "fast" if _is_from_park(first) else "none")
    for visit in visits:
        paths = {path: _played(visit, path) for path in PATHS}
        for path, made in paths.items():
            rows.add_path(path, made)
        begin, end = visit.begin("start_to_target").position_mm, visit.end("start_to_target").position_mm
        rows.add_visit(visit.start, places_of(visit.held, field), begin, end, paths["start_to_target"])
    if lost is None:
        return {name: frame for name, frame in rows.frames().items() if name not in {"unallocated", "executions"}}
    # What was allocated in all its visits, and is not complete now, the router has lost.
    reason = np.full(field.n_target, LostReason.UNROUTED)
    code = {member.label: member.value for member in LostReason}
    reason[np.searchsorted(field.target_id, lost["target_id"].to_numpy())] = [code[label] for label in lost["reason"]]
    rows.add_unallocated(reason)
    return {name: frame for name, frame in rows.frames().items() if name != "executions"}


def places_of(held: pl.DataFrame, field: FieldTargets) -> np.ndarray:
    """(n_robot,) places in `field` of the `target_id` that robots hold, or -1."""
    found = np.searchsorted(field.target_id, held["target_id"].fill_null(0).to_numpy())
    return np.where(held["target_id"].is_not_null().to_numpy(), found, -1)


def minima_params(settings: AllocationSettings, plate: Plate) -> dict[str, int]:
    """Least acceptable fibres of a visit, as PARAMs of its files."""
    return asdict(Minima.of(settings, plate))


def _minima(params: Mapping[str, Any]) -> Minima | None:
    """The same from a visit's file, if it says all of them."""
    names = [column.name for column in MINIMA_PARAMS]
    return Minima(**{name: params[name] for name in names}) if all(name in params for name in names) else None


def _is_from_park(visit: RoutedVisit) -> bool:
    """Whether dead robots stand at park, where the bound of completeness has them."""
    return bool((visit.standing.position_mm == visit.plate.park_mm)[~visit.plate.is_live].all())


def _played(visit: RoutedVisit, path: str) -> PlayedPath:
    plate, begin, legs = visit.plate, visit.begin(path), visit.legs[path]
    alone = alone_time_s(plate.instrument, begin.position_mm, begin.theta_deg, visit.end(path).position_mm)
    reason = np.array(visit.reasons.get(path) or [None] * plate.n_robot, dtype=object)
    played = simulate(plate, begin.position_mm, begin.theta_deg, legs)
    return PlayedPath(legs, played, reason, float(alone.max(initial=0.0)))


def plate_of_run(run_dir: Path, survey: str) -> Plate:
    """The robots of a finished run."""
    record = tables.read_record(run_dir)
    if "instrument" not in record:
        raise InputError("gives no instrument", file=run_dir / "run.json", remedy="run it again")
    robots = tables.scan(run_dir, "robots").filter(survey=survey).collect()
    dead = robots.filter(state="dead")["robot_id"].to_list()
    plate = make_plate(Instrument.load(record["instrument"], file=run_dir / "run.json"), dead)
    if robots["robot_id"].sort().to_list() != plate.robot_id.tolist():
        raise InputError("has other robots than run.json's instrument", file=run_dir / "robots.parquet")
    reach = robots.sort("robot_id")["patrol_radius_mm"].to_numpy()
    return replace(plate, patrol_radius_mm=np.ascontiguousarray(reach))


def visits_of_run(run_dir: Path, survey: str, tile_id: int, visit_ids: Iterable[int] | None = None) -> list[RoutedVisit]:
    """Visits of one tile of a run, from its tables.

    Parameters
    ----------
    visit_ids
        Those wanted; all by default.
    """
    plate = plate_of_run(run_dir, survey)
    of_tile = {
        table: tables.scan(run_dir, table).filter(survey=survey, tile_id=tile_id).collect()
        for table in ("visits", "allocations", "legs", "robot_times")
    }
    record = tables.read_record(run_dir)
    params = {"survey": survey, "tile_id": tile_id, **_settings_params(record, survey, plate)}
    standing = parked(plate) if "start_positions" not in record else _recorded_standing(record)
    wanted = None if visit_ids is None else set(visit_ids)
    made = []
    for row in of_tile["visits"].sort("visit_id").iter_rows(named=True):
        visit_id = row["visit_id"]
        own = {
            table: frame.filter(visit_id=visit_id).sort("robot_id") for table, frame in of_tile.items() if table != "visits"
        }
        visit = RoutedVisit(
            plate=plate,
            params={**params, "visit_id": visit_id, "start": row["start"]},
            held=own["allocations"].select("target_id", "kind"),
            standing=standing,
            legs={path: _legs(own["legs"].filter(path=path), plate) for path in PATHS},
            reasons={path: own["robot_times"].filter(path=path)["reason"].to_list() for path in PATHS},
        )
        standing = visit.end("start_to_target")
        if wanted is None or visit_id in wanted:
            made.append(visit)
    absent = sorted((wanted or set()) - {visit.params["visit_id"] for visit in made})
    if absent or not made:
        rule = f"has no such visit of {survey}, tile {tile_id}"
        raise InputError(rule, file=run_dir, place="visit", rows=absent or None, remedy="visits.parquet lists them")
    return made


def _settings_params(record: Mapping[str, Any], survey: str, plate: Plate) -> dict[str, Any]:
    """What a run's visits were made by, as PARAMs of exchange files."""
    settings = record.get("settings", {})
    allocation = settings.get("allocation", {})
    allocation = allocation.get("surveys", {}).get(survey) or allocation.get("every", allocation)
    found = {
        **{name: allocation.get(name) for name in ALLOCATION_PARAMS},
        **({} if "wanted_sky" not in allocation else minima_params(AllocationSettings.load(allocation), plate)),
        "router": settings.get("routing", {}).get("router"),
    }
    return {name: value for name, value in found.items() if value is not None}


def _recorded_standing(record: Mapping[str, Any]) -> Standing:
    start = record["start_positions"]
    return Standing(np.array(start["position_mm"], dtype=np.float64), np.array(start["theta_deg"], dtype=np.float64))


def _legs(rows: pl.DataFrame, plate: Plate) -> Legs:
    rows = rows.sort("robot_id", "leg")
    robot = np.searchsorted(plate.robot_id, rows["robot_id"].to_numpy()).astype(np.int32)
    return Legs(robot, rows["leg"].to_numpy(), *(rows[name].to_numpy() for name in _LEG_COLUMNS))


def _leg_of_moves(legs: Legs, robot: np.ndarray, start_s: np.ndarray) -> pl.Series:
    """Which leg each move is a part of: the robot's last that has begun."""
    own = pl.DataFrame({"robot": legs.robot, "start_s": legs.start_s, "leg": legs.leg}).sort("start_s", "leg")
    moves = pl.DataFrame({"robot": robot, "start_s": start_s}).with_row_index().sort("start_s")
    found = moves.join_asof(own, on="start_s", by="robot", strategy="backward", check_sortedness=False)
    return found.sort("index")["leg"].cast(pl.Int16)
