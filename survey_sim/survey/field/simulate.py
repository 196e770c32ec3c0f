"""`survey-sim simulate`: router files played; times, collisions, tables and CSV."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import combinations
from pathlib import Path

import numpy as np
import polars as pl

from survey_sim import tables
from survey_sim.errors import InputError
from survey_sim.exchange import RoutedVisit, Standing, positions_document, read_router, router_document, to_bytes
from survey_sim.instrument import load_instrument, make_plate
from survey_sim.motion import FloatArray, Legs, leg_times_s, make_trajectories, wrap_deg
from survey_sim.schema import PATHS
from survey_sim.simulation.play import SEPARATION_TOLERANCE_MM, least_separation
from survey_sim.survey.field.folder import (
    STOW_FILE,
    XML,
    check_out,
    common_files,
    common_tables,
    file_name,
    find_files,
    table_path,
    write_folder,
)
from survey_sim.survey.field.route import check_plates
from survey_sim.survey.field.rows import ALLOCATION_PARAMS, move_rows, visit_tables
from survey_sim.survey.field.targets import SURVEY, field_targets, targets_of_files

# A file's initial positions are where the last one ended, to this much (what exchange files promise).
SAME_PLACE_MM, SAME_ANGLE_DEG = 1e-3, 1e-4
# A robot turns at most so far in one leg.
TURN_MAX_DEG = 45.0
STOPPED_FILE = "positions_stopped.xml"


@dataclass(frozen=True)
class FieldSimulation:
    """What playing router files shows.

    Attributes
    ----------
    paths
        Rows of `paths`.
    findings
        Sentences: collisions, robots that leave plate or reach.
    """

    out: Path
    paths: pl.DataFrame
    findings: list[str]


def simulate_field(
    sources: Sequence[Path],
    out: Path | None = None,
    *,
    instrument: str | Path | None = None,
    stop_at_s: float | None = None,
) -> FieldSimulation:
    """Play router files one after the other, in the order given.

    A file that begins where the last one ended goes straight on. Any other is reached by way of park: by `start_to_park` of
    the file that begins where the last one ended (given, or beside those given), then by its own `park_to_target` (Goodwin
    et al. 2014, section 4), so that the night's order can change without routing again.

    Parameters
    ----------
    sources
        One run folder (of `route`), or router files in the night's order; visits are numbered by it.
    out
        By default the run folder named, or `runs/field`.
    stop_at_s
        Also write the backup file of where the robots stand so long after the last visit's `start_to_target` began.

    Raises
    ------
    InputError
        Files that do not fit, or that no given file leads to.
    """
    files = find_files(sources, "router")
    is_run = sources[0].is_dir()
    out = out or (sources[0] if is_run else Path("runs") / SURVEY)
    check_out(out)
    given = None if instrument is None else make_plate(load_instrument(instrument))
    read = [read_router(path, given) for path in files]
    check_plates(read)
    visits = list(_in_order(read))
    plate = visits[0].plate
    targets, centre_deg = targets_of_files(visits)
    frames = visit_tables(visits, field_targets(targets))
    texts = {f"{name}.csv": tables.csv_bytes(frames[name]) for name in ("paths", "robot_times")}
    if stop_at_s is not None:
        stopped = standing_at(visits[-1], PATHS[0], stop_at_s)
        texts[f"{XML}/{STOPPED_FILE}"] = to_bytes(positions_document(plate, stopped))
    if is_run and out.resolve() == sources[0].resolve():
        for name, frame in frames.items():
            tables.write(frame, name, table_path(out, name))
        for place, content in texts.items():
            tables.write_bytes(content, out / place)
    else:
        written = common_files(plate, targets, centre_deg) | texts
        for visit in visits:
            name = file_name("router", visit.params["visit_id"])
            written[f"{XML}/{name}"] = to_bytes(router_document(visit, move_rows(visit)))
        write_folder(out, plate, common_tables(plate, targets, centre_deg) | frames, written, _record(files, visits))
    return FieldSimulation(out, frames["paths"], [text for visit in visits for text in find_faults(visit)])


def standing_at(visit: RoutedVisit, path: str, time_s: float) -> Standing:
    """Where all robots stand, and how they are turned, some seconds after a path began."""
    begin, legs, plate = visit.begin(path), visit.legs[path], visit.plate
    way = make_trajectories(plate.instrument, begin.position_mm, legs)
    position, theta = begin.position_mm.copy(), begin.theta_deg.copy()
    for robot in range(plate.n_robot):
        own = slice(way.first[robot], way.first[robot + 1])
        position[robot] = [np.interp(time_s, way.t_s[own], axis[own]) for axis in (way.x_mm, way.y_mm)]
    turning_s = leg_times_s(plate.instrument, legs)[0]
    for leg in np.flatnonzero(legs.start_s <= time_s):
        share = 1.0 if turning_s[leg] == 0 else min((time_s - legs.start_s[leg]) / turning_s[leg], 1.0)
        theta[legs.robot[leg]] = legs.theta_deg[leg] - legs.rotate_deg[leg] * (1.0 - share)
    return Standing(position, wrap_deg(theta))


def find_faults(visit: RoutedVisit) -> Iterator[str]:
    """What no path may do: two robots nearer than the separation, a robot outside plate or reach."""
    plate = visit.plate
    least = plate.instrument.min_separation_mm - SEPARATION_TOLERANCE_MM
    for path in PATHS:
        way = make_trajectories(plate.instrument, visit.begin(path).position_mm, visit.legs[path])
        where = f"{visit.label}, {path}"
        owner = np.repeat(np.arange(plate.n_robot), np.diff(way.first))
        point = np.column_stack([way.x_mm, way.y_mm])
        live = plate.is_live[owner]
        for rule, is_bad in (
            ("leave the plate", np.hypot(*point.T) > plate.instrument.plate_radius_mm + SEPARATION_TOLERANCE_MM),
            (
                "go further from park than their patrol radius",
                np.hypot(*(point - plate.park_mm[owner]).T) > plate.patrol_radius_mm[owner] + SEPARATION_TOLERANCE_MM,
            ),
        ):
            robots = np.unique(plate.robot_id[owner[is_bad & live]]).tolist()
            if robots:
                yield f"{where}: robots {robots} {rule}"
        n_near, _ = least_separation(way.t_s, way.x_mm, way.y_mm, way.first, least)
        for one, other in combinations(range(plate.n_robot), 2) if n_near else ():
            rows = np.r_[way.first[one] : way.first[one + 1], way.first[other] : way.first[other + 1]]
            first = np.array([0, way.first[one + 1] - way.first[one], len(rows)])
            near, distance = least_separation(way.t_s[rows], way.x_mm[rows], way.y_mm[rows], first, least)
            if near:
                pair = f"robots {plate.robot_id[one]} and {plate.robot_id[other]}"
                yield f"{where}: {pair} collide, {distance:.3f} mm between their centres"


def _in_order(given: list[RoutedVisit]) -> Iterator[RoutedVisit]:
    """The visits as one chain, numbered; by way of park where the order was changed."""
    end = given[0].standing
    for visit_id, visit in enumerate(given):
        params = {**visit.params, "survey": SURVEY, "tile_id": 0, "visit_id": visit_id}
        chained = replace(visit, params=params)
        if not _is_same_place(visit.standing, end):
            chained = _by_park(chained, _leading_from(end, given, visit))
        chained = _turned(chained, end)
        yield chained
        end = chained.end(PATHS[0])


def _leading_from(end: Standing, given: list[RoutedVisit], visit: RoutedVisit) -> RoutedVisit:
    """A file that begins where the robots stand, and so leads to park: one of those given, or beside them."""
    for other in given:
        if _is_same_place(other.standing, end):
            return other
    folder = visit.file.parent if visit.file else Path()
    for path in (folder / STOW_FILE, *sorted(folder.glob("router_*.xml"))):
        if path.is_file() and _is_same_place((other := read_router(path, visit.plate)).standing, end):
            return other
    rule = "begins elsewhere than the file before it ends, and no file leads from there to park"
    remedy = "give also the file that begins there, or route the allocations again in this order"
    raise InputError(rule, file=visit.file, place="table initial_positions", remedy=remedy)


def _by_park(visit: RoutedVisit, leads: RoutedVisit) -> RoutedVisit:
    """The visit reached from where `leads` begins: to park, then from park."""
    to_target = visit.legs["park_to_target"]
    legs = {"start_to_target": to_target, "start_to_park": leads.legs["start_to_park"], "park_to_target": to_target}
    own, lead = visit.reasons, leads.reasons
    reasons = {PATHS[0]: own.get(PATHS[2], []), PATHS[1]: lead.get(PATHS[1], []), PATHS[2]: own.get(PATHS[2], [])}
    return replace(visit, params={**visit.params, "start": "park"}, standing=leads.standing, legs=legs, reasons=reasons)


def _turned(visit: RoutedVisit, end: Standing) -> RoutedVisit:
    """The visit begun from other orientations than it was routed from: robots that move first turn in place.

    A robot that came by way of park stands turned otherwise than the plan has it; to turn in place takes no room.
    """
    turn = wrap_deg(visit.standing.theta_deg - end.theta_deg)
    if (np.abs(turn) <= SAME_ANGLE_DEG).all():
        return visit
    from_here = [path for path in PATHS[:2] if not (path == PATHS[0] and visit.start == "park")]
    legs = {**visit.legs, **{path: _turning_first(visit, path, turn) for path in from_here}}
    return replace(visit, standing=replace(visit.standing, theta_deg=end.theta_deg), legs=legs)


def _turning_first(visit: RoutedVisit, path: str, turn: FloatArray) -> Legs:
    """Legs of a path with turns of at most 45 deg put before them, all of which end before the first robot goes."""
    legs, begin = visit.legs[path], visit.standing
    movers = np.unique(legs.robot)
    movers = movers[np.abs(turn[movers]) > SAME_ANGLE_DEG]
    n_turn = np.ceil(np.abs(turn[movers]) / TURN_MAX_DEG - 1e-9).astype(np.int64)
    robot = np.repeat(movers, n_turn).astype(np.int32)
    nth = np.concatenate([np.arange(n) for n in n_turn]) if len(movers) else np.empty(0, dtype=np.int64)
    each = np.repeat(turn[movers] / n_turn, n_turn)
    lasts_s = np.abs(each) / visit.plate.instrument.rotation_speed_deg_s
    theta = wrap_deg(begin.theta_deg[robot] - turn[robot] + each * (nth + 1))
    none = np.zeros(len(robot))
    x, y = begin.position_mm[robot].T
    turns = Legs(robot, nth.astype(np.int16), lasts_s * nth, each, none, none, none, x, y, theta)
    delay_s = float((lasts_s * (nth + 1)).max(initial=0.0))
    shift = np.bincount(movers, n_turn, visit.plate.n_robot).astype(np.int16)
    later = replace(legs, start_s=legs.start_s + delay_s, leg=legs.leg + shift[legs.robot])
    both = Legs(*(np.concatenate([getattr(turns, f.name), getattr(later, f.name)]) for f in fields(Legs)))
    return both.take(np.lexsort((both.leg, both.robot)))


def _is_same_place(one: Standing, other: Standing) -> bool:
    same_shape = one.position_mm.shape == other.position_mm.shape
    return same_shape and bool((np.hypot(*(one.position_mm - other.position_mm).T) <= SAME_PLACE_MM).all())


def _record(files: Sequence[Path], visits: Sequence[RoutedVisit]) -> dict:
    first = visits[0]
    settings = {
        "allocation": {name: first.params.get(name) for name in ALLOCATION_PARAMS},
        "routing": {"router": first.params.get("router")},
    }
    start = {"position_mm": first.standing.position_mm.tolist(), "theta_deg": first.standing.theta_deg.tolist()}
    return {"settings": settings, "plan": [path.name for path in files], "start_positions": {"file": files[0].name, **start}}
