"""The whole check of a run: small tables, then part by part, then what the parts add up to."""

from collections.abc import Callable
from pathlib import Path

import polars as pl

from survey_sim.check.faults import CheckResult, FaultLog
from survey_sim.check.inputs import Run, part_groups, read_group, read_run
from survey_sim.check.part import make_part
from survey_sim.check.relations import TILE, check_refers, unsound_tiles
from survey_sim.check.routes import check_ends, check_legs, check_reach, check_times, path_separations
from survey_sim.check.schedule import check_schedule, check_tiles
from survey_sim.check.targets import check_targets, check_unallocated, check_wanted
from survey_sim.check.visits import check_visits


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
    groups = part_groups(run_dir, log)
    n_part, n_done = sum(map(len, groups)), 0
    seen, reached = run.tiles.select(TILE).clear(), []
    for names in groups:
        if (tables := read_group(run_dir, names, log)) is not None:
            reached.append(_check_part(log, tables, run, seen, totals))
            seen = pl.concat([seen, tables["allocations"].select(TILE).unique()])
        n_done += len(names)
        if on_progress is not None:
            on_progress(n_done, n_part)
    check_refers(log, run.visits, "allocations", seen, "the parts", TILE)
    science = pl.concat(reached) if reached else pl.DataFrame(schema={"visit_row": pl.UInt32, "target_id": pl.Int64})
    check_wanted(log, science, run)
    check_unallocated(log, science, run)
    check_schedule(log, run, science)
    return totals.result(log)


class _Totals:
    """What has been looked at so far."""

    def __init__(self) -> None:
        self.n_visit = self.n_path = self.n_leg = self.n_pair = 0
        self.least_separation_mm = float("inf")

    def add(self, rows: pl.DataFrame, separations: pl.DataFrame, n_leg: int) -> None:
        """Count a part's visits, paths, legs and pairs."""
        robots = rows.group_by("visit_row").len("n")["n"].cast(pl.Int64)
        n_path = separations.height // max(len(robots), 1)
        self.n_visit += len(robots)
        self.n_path += separations.height
        self.n_leg += n_leg
        self.n_pair += int((robots * (robots - 1)).sum()) // 2 * n_path
        least = separations["own_min_separation_mm"].min()
        self.least_separation_mm = min(self.least_separation_mm, float("inf") if least is None else float(least))  # type: ignore[arg-type]

    def result(self, log: FaultLog) -> CheckResult:
        """The result, once all is looked at."""
        counts = {check: n for check, n in log.count.items() if n}
        return CheckResult(log.frame(), counts, self.n_visit, self.n_path, self.n_leg, self.n_pair, self.least_separation_mm)


def _check_part(
    log: FaultLog, tables: dict[str, pl.DataFrame], run: Run, seen: pl.DataFrame, totals: _Totals
) -> pl.DataFrame:
    """Check one part; gives visit_row and target_id of its rows that hold a science target."""
    bad = unsound_tiles(log, tables, run.visits, run.robots, seen)
    sound = {name: frame.join(bad, on=TILE, how="anti", maintain_order="left") for name, frame in tables.items()}
    part = make_part(sound, run)
    check_legs(log, part, run.constants)
    check_ends(log, part)
    check_reach(log, part, run.constants)
    separations = path_separations(log, part, run.constants)
    check_times(log, part, run.paths, separations, run.constants)
    held = check_targets(log, part, run)
    check_visits(log, part, run, held)
    totals.add(part.rows, separations, part.legs.height)
    return held.filter(pl.col("kind") == "science").select("visit_row", "target_id")
