"""Rows of a run's tables from visits of one field, and visits from a run's tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from survey_sim import tables
from survey_sim.allocation import crossings, ideal_completeness
from survey_sim.errors import InputError
from survey_sim.exchange import RoutedVisit, Standing, parked
from survey_sim.instrument import Instrument, Plate, make_plate
from survey_sim.motion import Legs, alone_time_s
from survey_sim.schema import PATHS, TABLES, TARGET_KINDS
from survey_sim.simulation import SimulatedPath, make_ticks, simulate
from survey_sim.survey.field.targets import field_targets

KEYS = ("survey", "tile_id", "visit_id")
_LEG_COLUMNS = ("start_s", "rotate_deg", "dx_mm", "dy_mm", "precise_mm", "x_mm", "y_mm", "theta_deg")
_MOVE_COLUMNS = ("x_mm", "y_mm", "theta_deg", "dx_mm", "dy_mm", "dtheta_deg", "precise_mm", "start_s")
_PATH_FIGURES = (
    "configuration_time_s",
    "configuration_time_p95_s",
    "configuration_time_median_s",
    "ticks",
    "collisions",
    "min_separation_mm",
)


def keys_of(visit: RoutedVisit) -> dict[str, Any]:
    """survey, tile_id, visit_id of a visit; what its file does not say is the field's."""
    return {key: visit.params.get(key, default) for key, default in zip(KEYS, ("field", 0, 0), strict=True)}


def play(visit: RoutedVisit) -> dict[str, SimulatedPath]:
    """The three paths, played."""
    played = {}
    for path in PATHS:
        begin = visit.begin(path)
        played[path] = simulate(visit.plate, begin.position_mm, begin.theta_deg, visit.legs[path])
    return played


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


def path_rows(visit: RoutedVisit, played: Mapping[str, SimulatedPath]) -> pl.DataFrame:
    """Rows of `paths`."""
    rows = []
    for path, result in played.items():
        row = {name: getattr(result, name) for name in _PATH_FIGURES}
        n_unrouted = sum(reason is not None for reason in visit.reasons.get(path, ()))
        rows.append(
            {**keys_of(visit), "path": path, **row, "lower_bound_s": _lower_bound_s(visit, path), "unrouted": n_unrouted}
        )
    return pl.DataFrame(rows)


def leg_rows(visit: RoutedVisit) -> pl.DataFrame:
    """Rows of `legs`."""
    frames = []
    for path in PATHS:
        legs = visit.legs[path]
        columns = {"robot_id": visit.plate.robot_id[legs.robot], "leg": legs.leg}
        frame = pl.DataFrame({**columns, **{name: getattr(legs, name) for name in _LEG_COLUMNS}})
        frames.append(_keyed(frame, visit).with_columns(path=pl.lit(path)))
    return pl.concat(frames)


def time_rows(visit: RoutedVisit, played: Mapping[str, SimulatedPath]) -> pl.DataFrame:
    """Rows of `robot_times`."""
    frames = []
    for path, result in played.items():
        frame = pl.DataFrame(
            {
                "robot_id": visit.plate.robot_id,
                "rotating_s": result.rotating_s,
                "moving_s": result.moving_s,
                "waiting_s": result.waiting_s,
                "reason": visit.reasons.get(path) or [None] * visit.plate.n_robot,
            },
            schema_overrides={"reason": pl.String},
        )
        frames.append(_keyed(frame, visit).with_columns(path=pl.lit(path)))
    return pl.concat(frames)


def allocation_rows(
    keys: Mapping[str, Any], plate: Plate, held: pl.DataFrame, travel_mm: np.ndarray, end_mm: np.ndarray
) -> pl.DataFrame:
    """Rows of `allocations` of one visit."""
    frame = held.with_columns(robot_id=plate.robot_id, x_mm=end_mm[:, 0], y_mm=end_mm[:, 1], travel_mm=travel_mm)
    return frame.with_columns(**{key: pl.lit(value) for key, value in keys.items()})


def visit_rows(
    visits: Sequence[RoutedVisit], paths: pl.DataFrame, allocations: pl.DataFrame, targets: pl.DataFrame
) -> pl.DataFrame:
    """Rows of `visits`, in the order of the visits.

    Parameters
    ----------
    paths, allocations
        Rows of all these visits.
    targets
        As `read_targets` gives them.
    """
    plate = visits[0].plate
    ideal = ideal_completeness(field_targets(targets), plate, len(visits))
    completeness = _completeness(allocations, targets)
    to_target = paths.filter(pl.col("path") == "start_to_target").drop("path", "configuration_time_median_s")
    rows = []
    for i, visit in enumerate(visits):
        keys = keys_of(visit)
        own = allocations.filter(visit_id=keys["visit_id"])
        start, end = visit.begin("start_to_target"), own.sort("robot_id").select("x_mm", "y_mm").to_numpy(order="c")
        travel = own["travel_mm"].filter(own["travel_mm"] > 0).sort()
        mag = own.filter(kind="science").join(targets.select("target_id", "mag"), on="target_id")["mag"]
        held = dict(zip(visit.plate.robot_id.tolist(), visit.plate.is_live.tolist(), strict=True))
        n_idle = sum(held[robot] for robot in own.filter(pl.col("target_id").is_null())["robot_id"])
        figures = {
            **keys,
            "start": visit.start,
            "mag_bright": mag.min(),
            "mag_faint": mag.max(),
            **{f"n_{kind}": own.filter(kind=kind).height for kind in TARGET_KINDS},
            "n_idle": n_idle,
            "completeness_frac": completeness[i],
            "ideal_completeness_frac": float(ideal[i]),
            "completeness_bound_frac": None,
            "travel_mean_mm": travel.mean() if len(travel) else 0.0,
            "travel_p95_mm": travel[int(np.ceil(0.95 * len(travel) - 1e-9)) - 1] if len(travel) else 0.0,
            "travel_max_mm": travel[-1] if len(travel) else 0.0,
            "crossings": int(crossings(start.position_mm, end)),
        }
        rows.append(figures)
    frame = pl.DataFrame(rows, infer_schema_length=None).with_columns(pl.col("mag_bright", "mag_faint").cast(pl.Float64))
    return frame.join(to_target.drop("min_separation_mm"), on=KEYS, how="left", maintain_order="left")


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
    params = {"survey": survey, "tile_id": tile_id, **_settings_params(record, survey)}
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


def conformed(frame: pl.DataFrame, table: str) -> pl.DataFrame:
    """Rows as the schema wants them."""
    return tables.conform(frame.select(TABLES[table].names), table)


def _settings_params(record: Mapping[str, Any], survey: str) -> dict[str, Any]:
    settings = record.get("settings", {})
    allocation = settings.get("allocation", {})
    allocation = allocation.get("surveys", {}).get(survey) or allocation.get("every", allocation)
    found = {
        "algorithm": allocation.get("algorithm"),
        "travel_power": allocation.get("travel_power"),
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


def _lower_bound_s(visit: RoutedVisit, path: str) -> float:
    begin, end = visit.begin(path), visit.end(path)
    alone = alone_time_s(visit.plate.instrument, begin.position_mm, begin.theta_deg, end.position_mm)
    return float(alone.max(initial=0.0))


def _completeness(allocations: pl.DataFrame, targets: pl.DataFrame) -> list[float]:
    """Complete science targets / science targets, after each visit."""
    science = targets.filter(kind="science").select("target_id", "wanted_visits")
    held = allocations.join(science, on="target_id").sort("visit_id")
    nth = held.with_columns(nth=pl.col("target_id").cum_count().over("target_id"))
    done = nth.filter(pl.col("nth") == pl.col("wanted_visits")).group_by("visit_id").len()
    visits = (
        allocations.select("visit_id")
        .unique(maintain_order=True)
        .join(done, on="visit_id", how="left", maintain_order="left")
    )
    total = visits["len"].fill_null(0).cum_sum()
    return (total / science.height).to_list() if science.height else [1.0] * len(total)


def _keyed(frame: pl.DataFrame, visit: RoutedVisit) -> pl.DataFrame:
    return frame.with_columns(**{key: pl.lit(value) for key, value in keys_of(visit).items()})
