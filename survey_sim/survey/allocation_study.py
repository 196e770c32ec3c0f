"""The allocation algorithms compared on the paper's three fields: the tables behind its Figures 7 to 10, drawn again.

Nothing is routed: every robot arrives. The `paper` instrument; its patrol radius and separation vary. `make_study` writes
Parquet tables into one folder, which the scripts of `reports/allocation` draw.

| table | one row is | columns |
|---|---|---|
| `targets` | a target | source, target_id, kind, priority, x_mm, y_mm |
| `visits` | a visit of a run | the run's, visit (from 1), n_science, n_sky, n_idle, completeness_frac, travel_mean_mm, |
| | | travel_p95_mm, travel_max_mm (of robots that move), crossings |
| `priorities` | a visit and a threshold | the run's, visit, priority_min, completeness_frac (of targets of at least that |
| | | priority), efficiency_frac (of all fibres so far, those that took such a target) |
| `travel` | a robot that moves in a visit | the run's, visit, travel_mm; of the plain runs alone |
| `planned` | a number of visits | the run's, completeness_frac after the `planned_visits` that were planned |
| `limits` | a visit of a field | source, patrol_radius_mm, min_separation_mm, visit, bound_frac |

A run's columns: source, algorithm, patrol_radius_mm, min_separation_mm, min_sky, planned_visits.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from math import ceil
from pathlib import Path

import numpy as np
import polars as pl
from rich.console import Console
from rich.progress import Progress

from survey_sim import tables
from survey_sim.allocation import AllocationSettings, FieldTargets, VisitAllocation, completeness_bound, start_allocation
from survey_sim.geometry import FloatArray
from survey_sim.instrument import Plate, load_instrument, make_plate
from survey_sim.survey.studies import do_each
from survey_sim.survey.study_fields import paper_fields
from survey_sim.survey.tile import stream

ALGORITHMS = ("cda-basic", "cda-advanced", "matching", "plan")
# CDA-Basic knows no sky (Goodwin et al. 2014, Table 5).
SKY_BLIND = ("cda-basic",)
MIN_SKY = (10, 20, 30)
PATROL_RADII_MM = (50.0, 75.0)
SEPARATIONS_MM = (9.0, 11.65)
THRESHOLDS = (1, 3, 5, 7, 9)
# Above this the linear bound takes many seconds a visit: the fast one is given.
MAX_LINEAR = 2000
# Numbers of visits for which `plan` is made anew, as multiples of those that the ideal positioner needs.
PLANNED_FRACS = (0.3, 0.5, 0.65, 0.75, 0.85, 0.95, 1.05, 1.2, 1.4)

Advance = Callable[[int, int], None]
Frames = dict[str, pl.DataFrame]


@dataclass(frozen=True)
class Case:
    """One run: a field, an algorithm and what they are given.

    Attributes
    ----------
    planned_visits
        What `plan` is told; visits of the others.
    is_shown
        Whether its visits are kept, or only what the last of them reached.
    """

    source: str
    algorithm: str
    patrol_radius_mm: float = PATROL_RADII_MM[0]
    min_separation_mm: float = SEPARATIONS_MM[0]
    min_sky: int = 0
    planned_visits: int = 1
    is_shown: bool = True

    @property
    def is_plain(self) -> bool:
        """Whether this is the paper's plate, without sky fibres."""
        return (self.patrol_radius_mm, self.min_separation_mm, self.min_sky) == (PATROL_RADII_MM[0], SEPARATIONS_MM[0], 0)

    def plate(self) -> Plate:
        """The paper's plate with this patrol radius and separation."""
        changed = {"patrol_radius_mm": self.patrol_radius_mm, "min_separation_mm": self.min_separation_mm}
        return make_plate(load_instrument("paper", changed))

    def settings(self) -> AllocationSettings:
        """Science and the sky fibres asked for, nothing else."""
        n_sky = 0 if self.algorithm in SKY_BLIND else self.min_sky
        none = dict.fromkeys(("wanted_standard", "wanted_guide", "min_standard", "min_guide", "min_sky_region"), 0)
        own = {"algorithm": self.algorithm, "visits": self.planned_visits, "wanted_sky": n_sky, "min_sky": n_sky}
        return AllocationSettings.load({**none, **own}, section="allocation")


def draw_paper_figures(out: Path, console: Console, *, quick: bool = False) -> pl.DataFrame:
    """Make the fields, run every case and draw every figure into one folder; gives `summarise_study`.

    Parameters
    ----------
    quick
        Without the thousands of stars of Star-1.
    """
    from survey_sim.plotting.study import draw_study  # noqa: PLC0415 - matplotlib is slow to import

    with Progress(*Progress.get_default_columns(), console=console) as progress:
        task = progress.add_task("fields", total=None)
        sources = paper_fields(quick=quick)
        progress.update(task, description="allocations")
        n_worker = len(os.sched_getaffinity(0))
        make_study(sources, out, n_worker=n_worker, advance=lambda n, of: progress.update(task, completed=n, total=of))
        task = progress.add_task("figures", total=None)
        n_figure = len(list(draw_study(out, out)))
        progress.update(task, completed=n_figure, total=n_figure)
    return summarise_study(out)


def make_study(
    sources: dict[str, pl.DataFrame], out: Path, *, n_worker: int = 1, advance: Advance = lambda done, total: None
) -> None:
    """Run every case and write the tables.

    Parameters
    ----------
    sources
        By name: target_id, kind, priority, x_mm, y_mm.
    n_worker
        Processes; 1 = all in this one.
    advance
        Called with the runs done and all runs after each.
    """
    cases = study_cases({name: _n_science(table) for name, table in sources.items()})
    jobs: list[tuple[Callable[[Case, pl.DataFrame], Frames], Case, pl.DataFrame]] = []
    jobs += [(run_case, case, sources[case.source]) for case in cases]
    jobs += [(limits_of, case, sources[case.source]) for case in _plates(cases)]
    parts: list[Frames] = []
    for part in do_each(_do, jobs, n_worker):
        parts.append(part)
        advance(len(parts), len(jobs))
    made = {"targets": pl.concat([table.insert_column(0, _name(name, table)) for name, table in sources.items()])}
    for name in dict.fromkeys(name for part in parts for name in part):
        keys = ["source", "algorithm", "patrol_radius_mm", "min_separation_mm", "min_sky", "planned_visits", "visit"]
        frame = pl.concat([part[name] for part in parts if name in part])
        made[name] = frame.sort([key for key in keys if key in frame.columns], maintain_order=True)
    for name, frame in made.items():
        tables.write_plain(frame, out / f"{name}.parquet")


def study_cases(n_target: dict[str, int]) -> list[Case]:
    """The runs for fields with so many science targets, the longest first.

    `plan` is told the visits that an ideal positioner would need with the same sky fibres (and, on the plain plate,
    other numbers too); the others go on for a quarter more, and three.
    """
    n_robot = make_plate(load_instrument("paper")).n_science_live
    cases = []
    for source, n in sorted(n_target.items(), key=lambda item: -item[1]):
        plain = Case(source, "plan", planned_visits=ceil(n / n_robot))
        others = sorted({max(1, round(share * n / n_robot)) for share in PLANNED_FRACS} - {plain.planned_visits})
        cases += [replace(plain, planned_visits=visits, is_shown=False) for visits in others]
        for algorithm in ALGORITHMS:
            plates = [(patrol, apart, 0) for patrol in PATROL_RADII_MM for apart in SEPARATIONS_MM]
            skies = () if algorithm in SKY_BLIND else MIN_SKY
            for patrol, apart, min_sky in plates + [(*plates[0][:2], n_sky) for n_sky in skies]:
                ideal = ceil(n / (n_robot - min_sky))
                visits = ideal if algorithm == "plan" else ceil(1.25 * ideal) + 3
                cases.append(Case(source, algorithm, patrol, apart, min_sky, visits))
    return cases


def run_case(case: Case, table: pl.DataFrame) -> Frames:
    """All visits of one run: frames of `visits`, `priorities`, `travel` and `planned`."""
    targets, plate = FieldTargets.from_table(table), case.plate()
    keys = {name: value for name, value in asdict(case).items() if name != "is_shown"}
    visits, priorities, travel = [], [], []
    for number, (visit, is_complete) in enumerate(all_visits(targets, plate, case.settings()), start=1):
        own = {**keys, "visit": number}
        visits.append({**own, **_visit_row(visit, plate, is_complete, targets)})
        priorities += [{**own, **row} for row in _priority_rows(is_complete, targets, plate, number)]
        travel += [{**own, "travel_mm": float(moved)} for moved in visit.travel_mm[visit.travel_mm > 0]]
    frames = {}
    if case.algorithm == "plan" and case.is_plain:
        frames["planned"] = pl.DataFrame([{**keys, "completeness_frac": visits[-1]["completeness_frac"]}])
        if not case.is_shown:
            return frames
    if case.is_plain:
        frames["travel"] = pl.DataFrame(travel)
    return {**frames, "visits": pl.DataFrame(visits), "priorities": pl.DataFrame(priorities)}


def all_visits(
    targets: FieldTargets, plate: Plate, settings: AllocationSettings
) -> Iterator[tuple[VisitAllocation, np.ndarray]]:
    """Visits of a field whose robots all arrive, with the science targets (n_target,) complete after each."""
    session = start_allocation(targets, plate, settings, stream(1, "allocation", "study", 0))
    position, has_arrived = plate.park_mm, np.ones(plate.n_robot, dtype=bool)
    while (visit := session.next_visit(position)) is not None:
        session.record(visit, has_arrived)
        position = visit.goal_mm
        yield visit, session.is_complete


def limits_of(case: Case, table: pl.DataFrame) -> Frames:
    """Proven upper bound of completeness after each visit, on one plate."""
    targets, plate = FieldTargets.from_table(table.filter(pl.col("kind") == "science")), case.plate()
    keys = {name: asdict(case)[name] for name in ("source", "patrol_radius_mm", "min_separation_mm")}
    rows = []
    for visit in range(1, case.planned_visits + 1):
        bound = completeness_bound(targets, plate, visit, method="linear" if targets.n_target <= MAX_LINEAR else "fast")
        rows.append({**keys, "visit": visit, "bound_frac": bound})
    return {"limits": pl.DataFrame(rows)}


def summarise_study(folder: Path) -> pl.DataFrame:
    """The plain runs in numbers, a row a field and algorithm.

    Returns
    -------
        source, algorithm, visits (the ideal positioner's), completeness_frac and bound_frac after them, visits_90 (that
        complete 90 %; null if never), travel_mean_mm, and medians over these visits of travel_p95_mm and travel_max_mm;
        crossings in all of them.
    """
    ran, limits = (pl.read_parquet(folder / f"{name}.parquet") for name in ("visits", "limits"))
    plate = {"patrol_radius_mm": PATROL_RADII_MM[0], "min_separation_mm": SEPARATIONS_MM[0]}
    ran = ran.filter(min_sky=0, **plate)
    planned = ran.filter(algorithm="plan").select("source", visits="planned_visits").unique()
    first = (
        ran.filter(pl.col("completeness_frac") >= 0.9).group_by("source", "algorithm").agg(visits_90=pl.col("visit").min())
    )
    own = ran.join(planned, on="source").filter(pl.col("visit") <= pl.col("visits"))
    figures = own.group_by("source", "algorithm", "visits", maintain_order=True).agg(
        pl.col("completeness_frac").max(),
        pl.col("travel_mean_mm").mean(),
        pl.col("travel_p95_mm", "travel_max_mm").median(),
        pl.col("crossings").sum(),
    )
    bound = limits.filter(**plate).select("source", "bound_frac", visits="visit")
    joined = figures.join(bound, on=["source", "visits"], how="left").join(first, on=["source", "algorithm"], how="left")
    return joined.select(
        "source", "algorithm", "visits", "completeness_frac", "bound_frac", "visits_90",
        "travel_mean_mm", "travel_p95_mm", "travel_max_mm", "crossings",
    )  # fmt: skip


def _do(job: Callable[[Case, pl.DataFrame], Frames], case: Case, table: pl.DataFrame) -> Frames:
    return job(case, table)


def _plates(cases: list[Case]) -> list[Case]:
    """One case for each field and plate, with the most visits that any run has there."""
    longest: dict[tuple[str, float, float], Case] = {}
    for case in cases:
        key = (case.source, case.patrol_radius_mm, case.min_separation_mm)
        if case.min_sky == 0 and case.planned_visits > longest.get(key, replace(case, planned_visits=0)).planned_visits:
            longest[key] = case
    return list(longest.values())


def _visit_row(visit: VisitAllocation, plate: Plate, is_complete: np.ndarray, targets: FieldTargets) -> dict[str, float]:
    travel: FloatArray = np.sort(visit.travel_mm[visit.travel_mm > 0])
    n = len(travel)
    return {
        "n_science": visit.counts["science"],
        "n_sky": visit.counts["sky"],
        "n_idle": int((plate.is_live & (visit.target < 0)).sum()),
        "completeness_frac": float(is_complete.sum() / max(1, targets.is_science.sum())),
        "travel_mean_mm": float(travel.mean()) if n else 0.0,
        "travel_p95_mm": float(travel[ceil(0.95 * n - 1e-9) - 1]) if n else 0.0,
        "travel_max_mm": float(travel[-1]) if n else 0.0,
        "crossings": visit.crossings,
    }


def _priority_rows(is_complete: np.ndarray, targets: FieldTargets, plate: Plate, n_visit: int) -> Iterator[dict[str, float]]:
    """A row for each threshold that parts the field's targets anew."""
    present = sorted(set(targets.priority[targets.is_science].tolist()))
    thresholds = {min(value for value in present if value >= limit) for limit in THRESHOLDS if limit <= present[-1]}
    for limit in sorted(thresholds):
        is_counted = targets.is_science & (targets.priority >= limit)
        n_complete = int((is_complete & is_counted).sum())
        yield {
            "priority_min": limit,
            "n_target": int(is_counted.sum()),
            "completeness_frac": n_complete / int(is_counted.sum()),
            "efficiency_frac": n_complete / (n_visit * plate.n_science_live),
        }


def _n_science(table: pl.DataFrame) -> int:
    return table.filter(pl.col("kind") == "science").height


def _name(name: str, table: pl.DataFrame) -> pl.Series:
    return pl.Series("source", [name] * len(table))
