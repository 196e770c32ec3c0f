"""One visit as the exchange files hold it: an allocation, or its three routes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from survey_sim.errors import InputError
from survey_sim.exchange.model import ALLOCATION, POSITIONS, ROUTER
from survey_sim.exchange.moves import legs_from_moves
from survey_sim.exchange.robots import plate_of, robot_columns, robot_params, rows_of_robots
from survey_sim.exchange.votable import Document, read
from survey_sim.instrument import Plate
from survey_sim.motion import FloatArray, Legs
from survey_sim.schema import PATHS, TARGET_KINDS

STARTS = ("previous", "park")


@dataclass(frozen=True)
class Standing:
    """Where all robots of a plate stand, and how they are turned: (n_robot, 2) mm and (n_robot,) deg."""

    position_mm: FloatArray
    theta_deg: FloatArray


@dataclass(frozen=True)
class AllocatedVisit:
    """Where every robot shall go in one visit.

    Attributes
    ----------
    params
        survey, tile_id, visit_id, algorithm, start (previous or park), the field centre; what a file does not say is absent.
    held
        target_id and kind of every robot, in the plate's order; null where it is idle.
    goal_mm
        (n_robot, 2) mm.
    """

    plate: Plate
    params: Mapping[str, Any]
    held: pl.DataFrame
    goal_mm: FloatArray
    file: Path | None = None

    @property
    def start(self) -> str:
        """Where `start_to_target` begins: previous (where the robots stand) or park."""
        return str(self.params.get("start", "previous"))


@dataclass(frozen=True)
class RoutedVisit:
    """The three routes of one visit.

    Attributes
    ----------
    params
        As of `AllocatedVisit`, and router.
    held
        target_id and kind of every robot, in the plate's order: the target that it reaches.
    standing
        The initial positions.
    legs
        Legs of each path.
    reasons
        Of each path, why each robot was not routed; None where it was.
    """

    plate: Plate
    params: Mapping[str, Any]
    held: pl.DataFrame
    standing: Standing
    legs: Mapping[str, Legs]
    reasons: Mapping[str, list[str | None]] = field(default_factory=dict)
    file: Path | None = None

    @property
    def start(self) -> str:
        """Where `start_to_target` begins: previous (the initial positions) or park."""
        return str(self.params.get("start", "previous"))

    @property
    def label(self) -> str:
        """Survey, tile and visit, in words."""
        keys = {"survey": "", "tile_id": "tile ", "visit_id": "visit "}
        return ", ".join(f"{word}{self.params[key]}" for key, word in keys.items() if key in self.params)

    @property
    def goal_mm(self) -> FloatArray:
        """(n_robot, 2) mm, where every robot ends."""
        return self.end("start_to_target").position_mm

    def begin(self, path: str) -> Standing:
        """Where a path begins."""
        if path == "park_to_target" or (path == "start_to_target" and self.start == "park"):
            return parked(self.plate, self.standing)
        return self.standing

    def end(self, path: str) -> Standing:
        """Where a path ends."""
        begin, legs = self.begin(path), self.legs[path]
        position, theta = begin.position_mm.copy(), begin.theta_deg.copy()
        last = np.flatnonzero(np.diff(legs.robot, append=-1) != 0)
        position[legs.robot[last]] = np.column_stack([legs.x_mm[last], legs.y_mm[last]])
        theta[legs.robot[last]] = legs.theta_deg[last]
        return Standing(position, theta)


def parked(plate: Plate, standing: Standing | None = None) -> Standing:
    """All robots at park, turned back to 0; dead ones where they stand."""
    position, theta = plate.park_mm.copy(), np.zeros(plate.n_robot)
    if standing is not None:
        position[~plate.is_live] = standing.position_mm[~plate.is_live]
        theta[~plate.is_live] = standing.theta_deg[~plate.is_live]
    return Standing(position, theta)


def allocation_document(visit: AllocatedVisit, travel_mm: FloatArray) -> Document:
    """The allocation file of a visit."""
    frame = robot_columns(visit.plate).hstack(visit.held)
    frame = frame.with_columns(x_mm=visit.goal_mm[:, 0], y_mm=visit.goal_mm[:, 1], travel_mm=travel_mm)
    return Document(ALLOCATION, {**visit.params, **robot_params(visit.plate)}, {"allocation": frame})


def read_allocation(path: Path, plate: Plate | None = None) -> AllocatedVisit:
    """A visit from its allocation file; InputError as of `read` and `plate_of`."""
    document = read(path, ALLOCATION)
    plate = plate_of(document, plate)
    rows = rows_of_robots(document, plate)
    goal = np.ascontiguousarray(rows.select("x_mm", "y_mm").to_numpy())
    return AllocatedVisit(plate, _visit_params(document), _held(rows, document), goal, path)


def router_document(visit: RoutedVisit, moves: Mapping[str, pl.DataFrame]) -> Document:
    """The router file of a visit.

    Parameters
    ----------
    moves
        Rows of each path's table: its legs cut into ticks.
    """
    stand = visit.standing
    frame = robot_columns(visit.plate).hstack(visit.held)
    frame = frame.with_columns(
        pl.Series(f"reason_{path}", visit.reasons.get(path) or [None] * visit.plate.n_robot, pl.String) for path in PATHS
    )
    frame = frame.with_columns(x_mm=stand.position_mm[:, 0], y_mm=stand.position_mm[:, 1], theta_deg=stand.theta_deg)
    params = {**visit.params, **robot_params(visit.plate)}
    return Document(ROUTER, params, {"initial_positions": frame, **{path: moves[path] for path in PATHS}})


def read_router(path: Path, plate: Plate | None = None) -> RoutedVisit:
    """A visit from its router file; InputError as of `read`, `plate_of` and `legs_from_moves`."""
    document = read(path, ROUTER)
    plate = plate_of(document, plate)
    rows = rows_of_robots(document, plate)
    reasons = {name: rows[f"reason_{name}"].to_list() for name in PATHS if f"reason_{name}" in rows.columns}
    visit = RoutedVisit(plate, _visit_params(document), _held(rows, document), _standing(rows), {}, reasons, path)
    legs = {}
    for name in PATHS:
        begin = visit.begin(name)
        legs[name] = legs_from_moves(document, name, plate, begin.position_mm, begin.theta_deg)
    return RoutedVisit(plate, visit.params, visit.held, visit.standing, legs, reasons, path)


def positions_document(plate: Plate, standing: Standing, survey: str = "field", tile_id: int = 0) -> Document:
    """The backup file of where the robots stand."""
    frame = robot_columns(plate).with_columns(
        x_mm=standing.position_mm[:, 0], y_mm=standing.position_mm[:, 1], theta_deg=standing.theta_deg
    )
    return Document(POSITIONS, {"survey": survey, "tile_id": tile_id, **robot_params(plate)}, {"positions": frame})


def read_positions(path: Path, plate: Plate) -> tuple[Standing, Plate]:
    """Where the robots of a plate stand, from a backup file, and the plate with those dead that the file says are."""
    document = read(path, POSITIONS)
    rows = rows_of_robots(document, plate)
    if "state" in rows.columns:
        is_live = plate.is_live & (rows["state"] != "dead").to_numpy()
        plate = Plate(plate.instrument, plate.robot_id, plate.is_guide, is_live, plate.park_mm, plate.patrol_radius_mm)
    return _standing(rows), plate


def _standing(rows: pl.DataFrame) -> Standing:
    position = np.ascontiguousarray(rows.select("x_mm", "y_mm").to_numpy())
    return Standing(position, rows["theta_deg"].to_numpy().copy())


def _visit_params(document: Document) -> dict[str, Any]:
    """PARAMs that are about the visit, not about the instrument."""
    constants = {column.name for column in POSITIONS.params} - {"survey", "tile_id"}
    params = {name: value for name, value in document.params.items() if name not in constants}
    if params.get("start", "previous") not in STARTS:
        rule = f"{params['start']!r} is neither 'previous' nor 'park'"
        raise InputError(rule, file=document.file, place="PARAM start")
    return params


def _held(rows: pl.DataFrame, document: Document) -> pl.DataFrame:
    """target_id and kind of each robot; without a kind a target is one of science."""
    none = pl.lit(None)
    target = pl.col("target_id") if "target_id" in rows.columns else none.cast(pl.Int64)
    kind = pl.col("kind") if "kind" in rows.columns else none.cast(pl.String)
    held = rows.select(target.alias("target_id"), kind.alias("kind"))
    held = held.with_columns(pl.when(pl.col("target_id").is_not_null()).then(pl.col("kind").fill_null("science")))
    place = f"table {document.model.tables[0].name}"
    odd = ~held["kind"].is_in(TARGET_KINDS).fill_null(True)
    if odd.any():
        rule = f"none of {', '.join(TARGET_KINDS)}"
        raise InputError(rule, file=document.file, place=f"{place}, kind", rows=odd.arg_true().to_list())
    twice = held["target_id"].is_duplicated() & held["target_id"].is_not_null()
    if twice.any():
        rule = "one target for two robots"
        raise InputError(rule, file=document.file, place=f"{place}, target_id", rows=twice.arg_true().to_list())
    return held
