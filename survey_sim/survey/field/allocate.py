"""`survey-sim allocate`: the visits of one field, before any routing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from survey_sim.allocation import ALGORITHMS, AllocationSettings, VisitAllocation, start_allocation
from survey_sim.errors import InputError, did_you_mean
from survey_sim.exchange import AllocatedVisit, allocation_document, to_bytes
from survey_sim.instrument import Plate, load_instrument, make_plate
from survey_sim.schema import TARGET_KINDS
from survey_sim.survey.field.folder import (
    XML,
    centre_params,
    check_out,
    common_files,
    common_tables,
    file_name,
    write_folder,
)
from survey_sim.survey.field.rows import allocation_rows, conformed
from survey_sim.survey.field.targets import SURVEY, field_targets, read_targets
from survey_sim.survey.tile import stream


@dataclass(frozen=True)
class FieldAllocation:
    """What `allocate` made.

    Attributes
    ----------
    files
        One allocation file a visit.
    summary
        A row a visit: what it holds, travel, crossings, completeness.
    n_off_plate
        Targets that lie outside the plate.
    """

    out: Path
    files: list[Path]
    summary: pl.DataFrame
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
) -> FieldAllocation:
    """Allocate the targets of one field, and write a run's tables and one allocation file a visit.

    Parameters
    ----------
    visits
        How many; by default as many as completeness needs.
    overrides
        Constants of the instrument (speeds, say) that differ from it.

    Raises
    ------
    InputError
        Unknown algorithm or instrument; targets that are no targets; a folder that holds something else.
    """
    if algorithm not in ALGORITHMS:
        raise InputError(f"unknown algorithm {algorithm!r}", place="--algorithm", remedy=did_you_mean(algorithm, ALGORITHMS))
    values = {"algorithm": algorithm, "visits": visits, "travel_power": travel_power}
    settings = AllocationSettings.load(values, section="allocation")
    check_out(out)
    plate = make_plate(load_instrument(instrument, overrides), dead)
    targets = read_targets(targets_path, plate, centre_deg)
    made = _allocate(plate, targets, settings, seed)
    if not made:
        rule = f"no target can be reached by {plate.instrument.name}: no visit is worth its time"
        raise InputError(rule, file=targets_path, remedy="check units and --centre")
    params = {"survey": SURVEY, "tile_id": 0, "algorithm": algorithm, "travel_power": travel_power}
    params |= centre_params(centre_deg)
    rows, files, summary = [], common_files(plate, targets, centre_deg), []
    for visit, held, completeness in made:
        keys = {"survey": SURVEY, "tile_id": 0, "visit_id": visit.visit_id}
        own = {**params, "visit_id": visit.visit_id, "start": visit.start}
        document = allocation_document(AllocatedVisit(plate, own, held, visit.goal_mm), visit.travel_mm)
        files[f"{XML}/{file_name('allocation', visit.visit_id)}"] = to_bytes(document)
        rows.append(allocation_rows(keys, plate, held, visit.travel_mm, visit.goal_mm))
        summary.append(_summary(visit, completeness))
    frames = common_tables(plate, targets, centre_deg) | {"allocations": conformed(pl.concat(rows), "allocations")}
    record = {
        "seed": seed,
        "settings": {"allocation": settings.model_dump(mode="json"), "instrument": {"dead_robots": list(dead)}},
        "targets": str(targets_path),
        "centre_deg": centre_deg,
    }
    write_folder(out, plate, frames, files, record)
    n_off = int((~field_targets(targets).is_on_plate(plate.instrument.plate_radius_mm)).sum())
    names = [file_name("allocation", visit.visit_id) for visit, _, _ in made]
    return FieldAllocation(out, [out / XML / name for name in names], pl.DataFrame(summary), n_off)


def _allocate(
    plate: Plate, targets: pl.DataFrame, settings: AllocationSettings, seed: int
) -> list[tuple[VisitAllocation, pl.DataFrame, float]]:
    """Visits with what each robot holds, and the completeness after each, were all of them routed."""
    field = field_targets(targets)
    session = start_allocation(field, plate, settings, stream(seed, "allocation", SURVEY, 0))
    kinds = np.array([*TARGET_KINDS, None], dtype=object)
    position = plate.park_mm
    n_science = max(int(field.is_science.sum()), 1)
    made = []
    while (visit := session.next_visit(position)) is not None:
        has_target = visit.target >= 0
        ids = pl.Series("target_id", field.target_id[visit.target])
        kind = kinds[np.where(has_target, field.kind[visit.target], -1)].tolist()
        held = pl.DataFrame({"target_id": ids, "kind": pl.Series(kind, dtype=pl.String)})
        held = held.with_columns(target_id=pl.when(pl.Series(has_target)).then("target_id"))
        session.record(visit, np.ones(plate.n_robot, dtype=bool))
        made.append((visit, held, float(session.is_complete.sum() / n_science)))
        position = visit.goal_mm
    return made


def _summary(visit: VisitAllocation, completeness: float) -> dict[str, float | int]:
    travel = visit.travel_mm[visit.travel_mm > 0]
    counts = {f"n_{kind}": number for kind, number in visit.counts.items()}
    return {
        "visit_id": visit.visit_id,
        **counts,
        "travel_mean_mm": float(travel.mean()) if len(travel) else 0.0,
        "travel_max_mm": float(travel.max(initial=0.0)),
        "crossings": visit.crossings,
        "completeness_frac": completeness,
    }
