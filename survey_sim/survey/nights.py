"""The schedule stage's tables, from those of the tile stage."""

from __future__ import annotations

import json
from hashlib import sha256

import polars as pl

from survey_sim import tables
from survey_sim.schedule import Programme, Robots, Schedule, make_completeness, make_schedule, make_time_budget
from survey_sim.survey.progress import night_progress
from survey_sim.survey.run import Run, code_digest
from survey_sim.survey.transitions import Configurations, PlateRobots, Ways, drop_parts, route_and_pack, write_parts

# Rooms whose code decides what the robots do between two pointings.
WAY_ROOMS = ("allocation", "routing", "simulation", "survey/exchanges", "survey/rows", "survey/tile", "survey/transitions")


def schedule_run(run: Run) -> Schedule:
    """Observe a run's visits night by night, and write what the plate does (`EXPOSURE_TABLES`), unless a constant is set."""
    if run.settings.schedule.configuration_s != "routed":
        drop_parts(run)
        return _make_schedule(run, None)
    run.workers.begin(route_and_pack)
    power = {survey: run.settings.allocation.of(survey).travel_power for survey in run.settings.surveys}
    with night_progress(run.console, run.settings.schedule.n_night) as advance:
        robots = PlateRobots(
            configurations=Configurations.read(run.folder, run.plate, power),
            plate=run.plate,
            routing=run.settings.routing,
            seed=run.settings.run.seed,
            fixed=_fixed(run),
            ways=Ways(run.state / "ways"),
            workers=run.workers,
            on_accept=advance,
        )
        made = _make_schedule(run, robots)
    write_parts(run, robots)
    return made


def made_tables(run: Run, made: Schedule) -> dict[str, pl.DataFrame]:
    """Tables of a schedule, and what they come to."""
    science = tables.scan(run.folder, "targets").filter(kind="science").collect()
    return {
        "exposures": made.exposures,
        "nights": made.nights,
        "target_status": made.target_status,
        "completeness": make_completeness(science, made.target_status, made.nights),
        "time_budget": make_time_budget(made.exposures, made.nights),
    }


def way_parameters(run: Run) -> dict[str, object]:
    """Settings on which the robots' ways depend, besides the visits."""
    settings = run.settings
    return {
        "seed": settings.run.seed,
        "instrument": run.instrument.model_dump(mode="json"),
        "dead_robots": run.plate.robot_id[~run.plate.is_live].tolist(),
        "routing": settings.routing.model_dump(mode="json"),
        "travel_power": {survey: settings.allocation.of(survey).travel_power for survey in settings.surveys},
    }


def _fixed(run: Run) -> str:
    content = json.dumps([way_parameters(run), code_digest(*WAY_ROOMS)], sort_keys=True)
    return sha256(content.encode()).hexdigest()


def _make_schedule(run: Run, robots: Robots | None) -> Schedule:
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
        robots=robots,
    )
