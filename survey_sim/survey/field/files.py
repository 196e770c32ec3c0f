"""The paper's exchange files of one tile of any run, from its tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl

from survey_sim import tables
from survey_sim.exchange import (
    CATALOGUE,
    AllocatedVisit,
    Document,
    allocation_document,
    plate_documents,
    positions_document,
    router_document,
    to_bytes,
)
from survey_sim.survey.field.folder import CATALOGUE_FILE, centre_params, file_name
from survey_sim.survey.field.rows import move_rows, visits_of_run
from survey_sim.survey.field.view import choose_tile, tile_targets


def export_exchange(
    run_dir: Path,
    out: Path,
    *,
    survey: str | None = None,
    tile_id: int | None = None,
    visit_ids: Sequence[int] | None = None,
) -> list[Path]:
    """Write system parameters, Starbug data and catalogue of a tile, and each visit's allocation, routes and end positions.

    Parameters
    ----------
    survey, tile_id
        By default the tile in which most science targets are reached.

    Returns
    -------
        The files.
    """
    survey, tile_id = choose_tile(run_dir, survey, tile_id)
    visits = visits_of_run(run_dir, survey, tile_id, visit_ids)
    plate = visits[0].plate
    tile = tables.scan(run_dir, "tiles").filter(survey=survey, tile_id=tile_id).collect().row(0, named=True)
    centre = centre_params((tile["ra_deg"], tile["dec_deg"]))
    system, starbugs = plate_documents(plate)
    targets = tile_targets(run_dir, plate, survey, tile_id).drop("mag", "priority", "kind")
    whole = targets.join(tables.read(run_dir, "targets"), on="target_id", how="left", maintain_order="left")
    columns = [column.name for column in CATALOGUE.tables[0].columns]
    params = {**system.params, "survey": survey, "tile_id": tile_id, **centre}
    files = {
        "system_parameters.xml": to_bytes(system),
        "starbugs.xml": to_bytes(starbugs),
        CATALOGUE_FILE: to_bytes(Document(CATALOGUE, params, {"targets": whole.select(pl.col(columns))})),
    }
    for visit in visits:
        visit_id = visit.params["visit_id"]
        routed = {**visit.params, **centre}
        begin, end = visit.begin("start_to_target"), visit.end("start_to_target")
        allocated = {name: value for name, value in routed.items() if name != "router"}
        travel = np.hypot(*(end.position_mm - begin.position_mm).T)
        allocation = allocation_document(AllocatedVisit(plate, allocated, visit.held, end.position_mm), travel)
        files[file_name("allocation", visit_id)] = to_bytes(allocation)
        document = router_document(visit, move_rows(visit))
        files[file_name("router", visit_id)] = to_bytes(
            Document(document.model, {**document.params, **centre}, document.tables)
        )
        files[file_name("positions", visit_id)] = to_bytes(positions_document(plate, end, survey, tile_id))
    for name, content in files.items():
        tables.write_bytes(content, out / name)
    return [out / name for name in files]
