"""Plates from files, and files from plates."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import polars as pl

from survey_sim.errors import InputError
from survey_sim.exchange.model import (
    INSTRUMENT_PARAMS,
    ROBOT_COLUMNS,
    STARBUGS,
    SYSTEM_PARAMETERS,
)
from survey_sim.exchange.votable import Document, read
from survey_sim.instrument import PRESETS, Instrument, Plate, load_instrument, make_plate, robots_table

_CONSTANTS = tuple(column.name for column in INSTRUMENT_PARAMS if column.name != "instrument")


def robot_params(plate: Plate) -> dict[str, Any]:
    """PARAMs of the instrument's constants."""
    return {"instrument": plate.instrument.name, **{name: getattr(plate.instrument, name) for name in _CONSTANTS}}


def robot_columns(plate: Plate) -> pl.DataFrame:
    """robot_id, robot_kind, state, park position and reach of every robot of the plate, in its order."""
    return robots_table(plate, "").rename({"kind": "robot_kind"}).drop("survey")


def plate_documents(plate: Plate) -> tuple[Document, Document]:
    """The files of system parameters and of Starbug data."""
    robots, params = robot_columns(plate), robot_params(plate)
    system = Document(SYSTEM_PARAMETERS, params, {"park_positions": robots.drop("patrol_radius_mm")})
    starbugs = Document(STARBUGS, params, {"starbugs": robots.drop("park_x_mm", "park_y_mm")})
    return system, starbugs


def read_plate(system_path: Path, starbugs_path: Path) -> Plate:
    """The plate of the two files that describe an instrument."""
    system, starbugs = read(system_path, SYSTEM_PARAMETERS), read(starbugs_path, STARBUGS)
    park, robots = system.table(), starbugs.table()
    if set(park["robot_id"]) != set(robots["robot_id"]):
        odd = sorted(set(park["robot_id"]) ^ set(robots["robot_id"]))
        raise InputError(f"robots differ from those of {system_path}", file=starbugs_path, place="robot_id", rows=odd)
    joined = park.join(robots.select("robot_id", "patrol_radius_mm"), on="robot_id", how="left", maintain_order="left")
    params = {**starbugs.params, **system.params}
    absent = [name for name in _CONSTANTS if name not in params]
    if absent:
        raise InputError(f"PARAMs absent: {', '.join(absent)}", file=starbugs_path, remedy="give them in either file")
    return _plate(params, joined, system_path)


def plate_of(document: Document, plate: Plate | None = None) -> Plate:
    """The plate that a file is for: the one given, else the one it describes, else the preset that it names.

    Raises
    ------
    InputError
        The file describes no plate and names no preset; its robots are not those of the plate.
    """
    frame = document.table()
    _check_rows_once(document)
    if plate is None:
        names = {column.name for column in ROBOT_COLUMNS}
        if names <= set(frame.columns) and set(_CONSTANTS) <= set(document.params):
            return _plate(document.params, frame, document.file)
        name = document.params.get("instrument")
        if name not in PRESETS:
            rule = "does not describe its robots, and names no preset instrument"
            raise InputError(rule, file=document.file, remedy="give the instrument (--instrument)")
        plate = make_plate(load_instrument(str(name)))
    rows_of_robots(document, plate)
    return plate


def rows_of_robots(document: Document, plate: Plate) -> pl.DataFrame:
    """The first table's rows in the plate's order: one for each robot, or an error that names the ids."""
    frame = document.table()
    place = _check_rows_once(document)
    known = pl.Series(plate.robot_id)
    unknown = ~frame["robot_id"].is_in(known.implode())
    if unknown.any():
        rule = f"not a robot of {plate.instrument.name} (1 to {plate.n_robot})"
        raise InputError(rule, file=document.file, place=place, rows=frame["robot_id"].filter(unknown).to_list())
    absent = known.filter(~known.is_in(frame["robot_id"].implode()))
    if len(absent):
        raise InputError("robots have no row", file=document.file, place=place, rows=absent.to_list())
    return frame.sort("robot_id")


def _check_rows_once(document: Document) -> str:
    """Refuse a first table with two rows for one robot; gives the place of its ids, for messages."""
    place = f"table {document.model.tables[0].name}, robot_id"
    repeated = document.table()["robot_id"].is_duplicated()
    if repeated.any():
        rule = "two rows for one robot"
        raise InputError(rule, file=document.file, place=place, rows=repeated.arg_true().to_list(), remedy="keep one")
    return place


def _plate(params: Mapping[str, Any], frame: pl.DataFrame, file: Path | None) -> Plate:
    robots = frame.sort("robot_id")
    is_guide = _code(robots["robot_kind"], ("science", "guide"), file)
    is_dead = _code(robots["state"], ("live", "dead"), file)
    ids = robots["robot_id"].to_numpy()
    if not np.array_equal(ids, np.arange(1, len(ids) + 1)) or (np.diff(is_guide.astype(np.int8)) < 0).any():
        rule = "robots are not numbered from 1, science robots first"
        raise InputError(rule, file=file, place="robot_id", remedy="number them so")
    park = [tuple(place) for place in robots.select("park_x_mm", "park_y_mm").rows()]
    n_science = int((~is_guide).sum())
    values = {name: params[name] for name in _CONSTANTS}
    values |= {
        "name": params.get("instrument") or "unnamed",
        "n_science": n_science,
        "park_positions_mm": tuple(park[:n_science]),
        "guides": "lattice" if is_guide.any() else "none",
        "guide_places_mm": tuple(park[n_science:]),
    }
    plate = make_plate(Instrument.load(values, file=file), dead=ids[is_dead].tolist())
    reach = robots["patrol_radius_mm"].to_numpy()
    if (reach < 0).any():
        rows = ids[reach < 0].tolist()
        raise InputError("negative", file=file, place="patrol_radius_mm", rows=rows)
    return replace(plate, patrol_radius_mm=np.ascontiguousarray(reach))


def _code(values: pl.Series, codes: tuple[str, str], file: Path | None) -> npt.NDArray[np.bool_]:
    """Whether each is the second code."""
    odd = ~values.is_in(codes)
    if odd.any():
        rule = f"neither {codes[0]!r} nor {codes[1]!r}"
        raise InputError(rule, file=file, place=values.name, rows=odd.arg_true().to_list())
    return (values == codes[1]).to_numpy()
