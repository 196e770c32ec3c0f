"""The schedule stage's tables, from those of the tile stage."""

from __future__ import annotations

import polars as pl

from survey_sim import tables
from survey_sim.schedule import Programme, Schedule, make_schedule
from survey_sim.survey.run import Run


def schedule_run(run: Run) -> Schedule:
    """Observe a run's visits night by night."""
    targets = tables.scan(run.folder, "targets").filter(kind="science").collect()
    holdings = (
        tables.scan(run.folder, "allocations")
        .filter(pl.col("kind") == "science")
        .select("survey", "tile_id", "visit_id", "target_id")
        .collect()
    )
    programmes = [Programme(p.name, p.survey, p.exposure_s, p.completeness_frac) for p in run.settings.science]
    return make_schedule(
        tables.read(run.folder, "visits"),
        tables.read(run.folder, "paths"),
        tables.read(run.folder, "tiles"),
        targets,
        holdings,
        programmes,
        run.settings.schedule,
        run.settings.run.seed,
        allocation_reasons=tables.scan(run.folder, "unallocated").select("target_id", "reason").collect(),
    )
