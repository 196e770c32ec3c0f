"""`survey-sim route`: the three paths of each visit, from allocation files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl

from survey_sim import tables
from survey_sim.errors import InputError
from survey_sim.exchange import (
    AllocatedVisit,
    RoutedVisit,
    Standing,
    allocation_document,
    parked,
    positions_document,
    read_allocation,
    read_positions,
    router_document,
    to_bytes,
)
from survey_sim.instrument import Instrument, Plate, load_instrument, make_plate
from survey_sim.routing import RoutedPath, RoutingSettings, UnroutedReason, route
from survey_sim.schema import PATHS
from survey_sim.survey.field.folder import (
    STOW_FILE,
    XML,
    check_out,
    common_files,
    common_tables,
    file_name,
    find_files,
    write_folder,
)
from survey_sim.survey.field.rows import ALLOCATION_PARAMS, move_rows, visit_tables
from survey_sim.survey.field.targets import SURVEY, field_targets, targets_of_files
from survey_sim.survey.settings import changed_section
from survey_sim.survey.tile import stream


@dataclass(frozen=True)
class FieldRoutes:
    """What `route` made: a router file a visit, and the rows of `paths`."""

    out: Path
    files: list[Path]
    paths: pl.DataFrame


def route_field(
    sources: Sequence[Path],
    out: Path | None = None,
    *,
    router: str = "coordinated",
    instrument: str | Path | None = None,
    start: Path | None = None,
    seed: int = 1,
    overrides: Mapping[str, float] | None = None,
    changes: Sequence[str] = (),
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> FieldRoutes:
    """Route the visits of allocation files one after the other, in the order given.

    Parameters
    ----------
    sources
        One run folder (of `allocate`), or allocation files in the night's order; visits are numbered by it.
    out
        By default the run folder named, or `runs/field`.
    instrument
        By default the one that the files describe.
    start
        Backup file of the robots' positions; the first visit begins there. By default from park.
    overrides
        Constants of the instrument (speeds, say) that differ from it.
    changes
        Settings of the routing that differ from their defaults, as `routing.key=value`.
    on_progress
        Called with the number of visits done and of all.

    Raises
    ------
    InputError
        Files that do not fit, start or goals that are not legal.
    """
    settings = RoutingSettings.load(changed_section("routing", {"router": router}, changes), section="routing")
    files = find_files(sources, "allocation")
    out = out or (sources[0] if sources[0].is_dir() else Path("runs") / SURVEY)
    check_out(out)
    given = None if instrument is None else make_plate(load_instrument(instrument))
    allocated = [read_allocation(path, given) for path in files]
    check_plates(allocated)
    plate = _changed(allocated[0].plate, overrides or {})
    allocated = [replace(visit, plate=plate) for visit in allocated]
    standing, backup = parked(plate), {}
    if start is not None:
        standing, plate = read_positions(start, plate)
        allocated = [replace(visit, plate=plate) for visit in allocated]
        backup = {"start_positions": _recorded(start, standing)}
    targets, centre_deg = targets_of_files(allocated)
    lost = tables.read(sources[0], "unallocated") if tables.files(sources[0], "unallocated") else None
    routed = []
    for visit_id, visit in enumerate(allocated):
        on_progress(visit_id, len(allocated))
        routed.append(_route_visit(visit, visit_id, standing, settings, seed))
        standing = routed[-1].end("start_to_target")
    frames = common_tables(plate, targets, centre_deg) | visit_tables(routed, field_targets(targets), lost)
    written = common_files(plate, targets, centre_deg) | _visit_files(allocated, routed)
    stow = _stow(routed[-1], settings, seed)
    written[f"{XML}/{STOW_FILE}"] = to_bytes(router_document(stow, move_rows(stow)))
    record = {
        "seed": seed,
        "settings": {
            "allocation": {name: allocated[0].params.get(name) for name in ALLOCATION_PARAMS},
            "routing": settings.model_dump(mode="json"),
        },
        "plan": [path.name for path in files],
        "centre_deg": centre_deg,
        **backup,
    }
    write_folder(out, plate, frames, written, record)
    names = [out / XML / file_name("router", visit_id) for visit_id in range(len(routed))]
    return FieldRoutes(out, names, frames["paths"])


def route_paths(
    visit: AllocatedVisit, standing: Standing, settings: RoutingSettings, seed: int, visit_id: int
) -> dict[str, RoutedPath]:
    """The three paths of one visit from where the robots stand."""
    plate = visit.plate
    park = parked(plate, standing)
    begin = park if visit.start == "park" else standing
    goal = np.where(plate.is_live[:, None], visit.goal_mm, standing.position_mm)

    def one(path: str, start: Standing, goal_mm: np.ndarray) -> RoutedPath:
        rng = stream(seed, "routing", SURVEY, 0, visit_id, path)
        try:
            return route(plate, start.position_mm, start.theta_deg, goal_mm, settings, rng)
        except InputError as fault:
            place = f"{path}, {'where it begins' if fault.place == 'start_mm' else 'where it ends'}"
            raise InputError(fault.rule, file=visit.file, place=place, rows=fault.rows, remedy=fault.remedy) from None

    to_target = one(PATHS[0], begin, goal)
    to_park = one(PATHS[1], standing, park.position_mm)
    return {PATHS[0]: to_target, PATHS[1]: to_park, PATHS[2]: one(PATHS[2], park, to_target.end_mm)}


def _route_visit(
    visit: AllocatedVisit, visit_id: int, standing: Standing, settings: RoutingSettings, seed: int
) -> RoutedVisit:
    """The visit with its three paths."""
    paths = route_paths(visit, standing, settings, seed, visit_id)
    is_arrived = paths["start_to_target"].reason == UnroutedReason.ARRIVED
    held = visit.held.with_columns(pl.when(pl.Series(is_arrived)).then(pl.all()))
    params = {**visit.params, "survey": SURVEY, "tile_id": 0, "visit_id": visit_id, "start": visit.start}
    return RoutedVisit(
        plate=visit.plate,
        params={**params, "router": settings.router},
        held=held,
        standing=standing,
        legs={name: path.legs for name, path in paths.items()},
        reasons={name: _reasons(path) for name, path in paths.items()},
    )


def _changed(plate: Plate, overrides: Mapping[str, float]) -> Plate:
    """The same robots with some constants changed."""
    values = plate.instrument.model_dump() | dict(overrides)
    return replace(plate, instrument=Instrument.load(values, section="instrument"))


def _visit_files(allocated: Sequence[AllocatedVisit], routed: Sequence[RoutedVisit]) -> dict[str, bytes]:
    """Allocation, router and end-position file of each visit, under its number in this run."""
    files = {}
    for visit_id, (before, after) in enumerate(zip(allocated, routed, strict=True)):
        files[f"{XML}/{file_name('allocation', visit_id)}"] = _allocation_again(before, after)
        files[f"{XML}/{file_name('router', visit_id)}"] = to_bytes(router_document(after, move_rows(after)))
        positions = positions_document(after.plate, after.end("start_to_target"))
        files[f"{XML}/{file_name('positions', visit_id)}"] = to_bytes(positions)
    return files


def _stow(last: RoutedVisit, settings: RoutingSettings, seed: int) -> RoutedVisit:
    """The way to park from the end of the last visit; on the other two paths everybody stays."""
    plate, standing = last.plate, last.end("start_to_target")
    rng = stream(seed, "routing", SURVEY, 0, "stow")
    home = parked(plate, standing).position_mm
    routed = route(plate, standing.position_mm, standing.theta_deg, home, settings, rng)
    stays = routed.legs.take(np.zeros(len(routed.legs), dtype=bool))
    legs = {"start_to_target": stays, "start_to_park": routed.legs, "park_to_target": stays}
    params = {**last.params, "visit_id": last.params["visit_id"] + 1, "start": "previous"}
    held = last.held.clear(plate.n_robot)
    return RoutedVisit(plate, params, held, standing, legs, {"start_to_park": _reasons(routed)})


def _allocation_again(before: AllocatedVisit, after: RoutedVisit) -> bytes:
    """The allocation file under the visit's number in this run; what was asked for, not what was reached."""
    params = {name: value for name, value in after.params.items() if name != "router"}
    travel = np.hypot(*(before.goal_mm - after.begin("start_to_target").position_mm).T)
    return to_bytes(allocation_document(replace(before, params=params), travel))


def _recorded(path: Path, standing: Standing) -> dict[str, object]:
    position, theta = standing.position_mm.tolist(), standing.theta_deg.tolist()
    return {"file": path.name, "position_mm": position, "theta_deg": theta}


def _reasons(path: RoutedPath) -> list[str | None]:
    codes = [UnroutedReason(code) for code in path.reason.tolist()]
    return [None if code is UnroutedReason.ARRIVED else code.code for code in codes]


def check_plates(visits: Sequence[AllocatedVisit] | Sequence[RoutedVisit]) -> None:
    """Refuse files of different plates."""
    first = visits[0].plate
    for visit in visits[1:]:
        if not _is_same(first, visit.plate):
            rule = f"is for another plate than {visits[0].file}"
            raise InputError(rule, file=visit.file, remedy="route the files of one instrument at a time")


def _is_same(one: Plate, other: Plate) -> bool:
    names = ("robot_id", "is_live", "is_guide", "park_mm", "patrol_radius_mm")
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)
