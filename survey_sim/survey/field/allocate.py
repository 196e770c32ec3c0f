"""`survey-sim allocate`: the visits of one field, before any routing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from survey_sim.allocation import (
    AllocationSettings,
    FieldTargets,
    Minima,
    VisitAllocation,
    start_allocation,
)
from survey_sim.errors import InputError
from survey_sim.exchange import AllocatedVisit, allocation_document, to_bytes
from survey_sim.instrument import Plate, load_instrument, make_plate
from survey_sim.survey.field.folder import (
    XML,
    centre_params,
    check_out,
    common_files,
    common_tables,
    file_name,
    write_folder,
)
from survey_sim.survey.field.rows import minima_params
from survey_sim.survey.field.targets import SURVEY, field_targets, read_targets
from survey_sim.survey.rows import TileRows
from survey_sim.survey.settings import changed_section
from survey_sim.survey.tile import stream

# Tables that need no routes.
TABLES_MADE = ("visits", "allocations", "unallocated")


@dataclass(frozen=True)
class FieldAllocation:
    """What `allocate` made.

    Attributes
    ----------
    files
        One allocation file a visit.
    visits
        Rows of `visits`.
    n_off_plate
        Targets that lie outside the plate.
    """

    out: Path
    files: list[Path]
    visits: pl.DataFrame
    n_off_plate: int


def allocate_field(
    targets_path: Path,
    out: Path,
    *,
    instrument: str | Path = "taipan-150",
    algorithm: str = "plan",
    visits: int | None = None,
    travel_power: float = 4.0,
    centre_deg: tuple[float, float] | None = None,
    dead: tuple[int, ...] = (),
    seed: int = 1,
    overrides: Mapping[str, float] | None = None,
    changes: Sequence[str] = (),
) -> FieldAllocation:
    """Allocate the targets of one field, and write a run's tables and one allocation file a visit.

    Parameters
    ----------
    visits
        How many; by default as many as completeness needs.
    overrides
        Constants of the instrument (speeds, say) that differ from it.
    changes
        Settings of the allocation that differ from their defaults, as `allocation.key=value`.

    Raises
    ------
    InputError
        Unknown algorithm or instrument; targets that are no targets; a folder that holds something else.
    """
    values = {"algorithm": algorithm, "visits": visits, "travel_power": travel_power}
    settings = AllocationSettings.load(changed_section("allocation", values, changes), section="allocation")
    check_out(out)
    plate = make_plate(load_instrument(instrument, overrides), dead)
    targets = read_targets(targets_path, plate, centre_deg)
    field = field_targets(targets)
    made, tile_rows = _allocate(plate, field, settings, seed)
    if not made:
        rule = f"no target can be reached by {plate.instrument.name}: no visit is worth its time"
        raise InputError(rule, file=targets_path, remedy="check units, --centre, and that calibration leaves robots")
    params: dict[str, object] = {"survey": SURVEY, "tile_id": 0}
    params |= {"algorithm": settings.algorithm, "travel_power": settings.travel_power}
    params |= {**centre_params(centre_deg), **minima_params(settings, plate)}
    files = common_files(plate, targets, centre_deg)
    rows = {name: frame for name, frame in tile_rows.frames().items() if name in TABLES_MADE}
    for visit in made:
        held = rows["allocations"].filter(visit_id=visit.visit_id).select("target_id", "kind")
        own = {**params, "visit_id": visit.visit_id, "start": visit.start}
        document = allocation_document(AllocatedVisit(plate, own, held, visit.goal_mm), visit.travel_mm)
        files[f"{XML}/{file_name('allocation', visit.visit_id)}"] = to_bytes(document)
    record = {
        "seed": seed,
        "settings": {"allocation": settings.model_dump(mode="json"), "instrument": {"dead_robots": list(dead)}},
        "targets": str(targets_path),
        "centre_deg": centre_deg,
    }
    write_folder(out, plate, common_tables(plate, targets, centre_deg) | rows, files, record)
    n_off = int((~field.is_on_plate(plate.instrument.plate_radius_mm)).sum())
    names = [file_name("allocation", visit.visit_id) for visit in made]
    return FieldAllocation(out, [out / XML / name for name in names], rows["visits"], n_off)


def _allocate(
    plate: Plate, targets: FieldTargets, settings: AllocationSettings, seed: int
) -> tuple[list[VisitAllocation], TileRows]:
    """Visits as they are if every robot arrives, and their rows."""
    session = start_allocation(targets, plate, settings, stream(seed, "allocation", SURVEY, 0))
    rows = TileRows(SURVEY, 0, targets, plate, Minima.of(settings, plate), settings.bound)
    position, made = plate.park_mm, []
    while (visit := session.next_visit(position)) is not None:
        begin = np.where(plate.is_live[:, None], plate.park_mm, position) if visit.start == "park" else position
        session.record(visit, np.ones(plate.n_robot, dtype=bool))
        rows.add_visit(visit.start, visit.target, begin, visit.goal_mm, None)
        made.append(visit)
        position = visit.goal_mm
    rows.add_unallocated(session.lost_reasons())
    return made, rows
