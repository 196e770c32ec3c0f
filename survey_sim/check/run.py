"""The whole check of a run: small tables, then part by part, then what the parts add up to."""

from collections.abc import Callable
from pathlib import Path

import polars as pl

from survey_sim.check.exposures import check_plate, read_exposures
from survey_sim.check.faults import CheckResult, FaultLog
from survey_sim.check.inputs import EXPOSURE_LARGE, LARGE, Run, part_groups, read_group, read_run
from survey_sim.check.outcome import check_outcome
from survey_sim.check.part import OF_VISITS, Part, make_part
from survey_sim.check.relations import TILE, check_refers, unsound_tiles
from survey_sim.check.routes import (
    check_ends,
    check_executions,
    check_legs,
    check_reach,
    check_robot_times,
    check_times,
    path_separations,
)
from survey_sim.check.schedule import check_schedule, check_tiles
from survey_sim.check.targets import check_targets, check_unallocated, check_wanted
from survey_sim.check.visits import check_visits

_REACHED = {"visit_row": pl.UInt32, "target_id": pl.Int64, "is_science": pl.Boolean}


def check_run(run_dir: Path, on_progress: Callable[[int, int], None] | None = None) -> CheckResult:
    """Prove every allocation and every leg of a run again, from its tables alone.

    Memory is bounded by the small tables and a few parts.

    Parameters
    ----------
    on_progress
        Called with the number of parts done and of all parts.

    Raises
    ------
    InputError
        There is no such folder. Whatever is wrong inside it is a fault of the result.
    """
    log, totals = FaultLog(), _Totals()
    run = read_run(run_dir, log)
    if run is None:
        return totals.result(log)
    check_tiles(log, run)
    exposures = read_exposures(log, run)
    groups = part_groups(run_dir, LARGE, log)
    plate_groups = part_groups(run_dir, EXPOSURE_LARGE, log) if exposures is not None else []
    n_part, n_done = sum(map(len, [*groups, *plate_groups])), 0

    def progress(n_more: int) -> None:
        nonlocal n_done
        n_done += n_more
        if on_progress is not None:
            on_progress(n_done, n_part)

    seen, found = run.tiles.select(TILE).clear(), []
    for names in groups:
        if (tables := read_group(run_dir, LARGE, names, log)) is not None:
            found.append(_check_part(log, tables, run, seen, totals))
            seen = pl.concat([seen, tables["allocations"].select(TILE).unique()])
        progress(len(names))
    check_refers(log, run.visits, "allocations", seen, "the parts", TILE)
    reached = pl.concat(found) if found else pl.DataFrame(schema=_REACHED)
    science = reached.filter("is_science").drop("is_science")
    check_wanted(log, science, run)
    check_unallocated(log, science, run)
    check_executions(log, run)
    observed = None
    if exposures is not None:
        observed = _check_plates(log, run_dir, run, exposures, reached.drop("is_science"), plate_groups, totals, progress)
    check_schedule(log, run, science, observed)
    check_outcome(log, run)
    return totals.result(log)


def _check_plates(
    log: FaultLog,
    run_dir: Path,
    run: Run,
    exposures: pl.DataFrame,
    reached: pl.DataFrame,
    groups: list[list[str]],
    totals: "_Totals",
    progress: Callable[[int], None],
) -> pl.DataFrame:
    """Check what the plate did; gives exposure_id and target_id of every row that holds a science target."""
    left, found = exposures, [pl.DataFrame(schema={"exposure_id": pl.Int32, "target_id": pl.Int64})]
    for names in groups:
        if (tables := read_group(run_dir, EXPOSURE_LARGE, names, log)) is not None:
            part, separations, held = check_plate(log, tables, run, left, reached)
            found.append(held)
            totals.add(part, separations)
            nights = left.join(tables["exposure_allocations"].select("exposure_id").unique(), on="exposure_id", how="semi")
            left = left.join(nights.select("night").unique(), on="night", how="anti", maintain_order="left")
        progress(len(names))
    lost = left.select("survey", "tile_id", "visit_id", "exposure_id")
    log.add("schema", "exposure_allocations", lost, "no part has the pointing")
    return pl.concat(found)


class _Totals:
    """What has been looked at so far."""

    def __init__(self) -> None:
        self.n_visit = self.n_exposure = self.n_path = self.n_leg = self.n_pair = 0
        self.least_separation_mm = float("inf")

    def add(self, part: Part, separations: pl.DataFrame) -> None:
        """Count the visits or pointings of a part, their paths, legs and pairs."""
        robots = part.rows.group_by("visit_row").len("n")["n"].cast(pl.Int64)
        if part.names == OF_VISITS:
            self.n_visit += len(robots)
        else:
            self.n_exposure += len(robots)
        self.n_path += separations.height
        self.n_leg += part.legs.height
        self.n_pair += int((robots * (robots - 1)).sum()) // 2 * len(part.paths)
        least = separations["own_min_separation_mm"].min()
        self.least_separation_mm = min(self.least_separation_mm, float("inf") if least is None else float(least))  # type: ignore[arg-type]

    def result(self, log: FaultLog) -> CheckResult:
        """The result, once all is looked at."""
        counts = {check: n for check, n in log.count.items() if n}
        numbers = (self.n_visit, self.n_exposure, self.n_path, self.n_leg, self.n_pair)
        return CheckResult(log.frame(), counts, *numbers, self.least_separation_mm)


def _check_part(
    log: FaultLog, tables: dict[str, pl.DataFrame], run: Run, seen: pl.DataFrame, totals: _Totals
) -> pl.DataFrame:
    """Check one part; gives visit_row, target_id and is_science of its rows that hold a target."""
    bad = unsound_tiles(log, tables, run.visits, run.robots, seen)
    sound = {name: frame.join(bad, on=TILE, how="anti", maintain_order="left") for name, frame in tables.items()}
    part = make_part(sound, run)
    check_legs(log, part, run.constants)
    check_ends(log, part)
    check_reach(log, part, run.constants)
    separations = path_separations(log, part, run.constants)
    check_robot_times(log, part)
    check_times(log, part, run.paths, separations, run.constants)
    held = check_targets(log, part, run)
    check_visits(log, part, run, held)
    totals.add(part, separations)
    return held.select("visit_row", "target_id", is_science=pl.col("kind") == "science")
