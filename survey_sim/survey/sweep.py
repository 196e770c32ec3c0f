"""Scenarios: runs of one pipeline that differ in what is asked about and in nothing else, each with several seeds.

A sweep is a TOML file: a base pipeline, seeds, and the changes of each scenario. All runs of one seed have the same sky, and
where a scenario does not change them the same tiles and the same weather, so that scenarios are compared in pairs. Stages
that would give the same are computed once (`survey_sim.survey.store`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any, Self

from pydantic import Field, model_validator
from rich.console import Console

from survey_sim import interrupts
from survey_sim.errors import InputError, did_you_mean
from survey_sim.folders import find_pipeline
from survey_sim.settings import Settings, read_toml
from survey_sim.survey.engine import load_stages, plan_stages, run_stages
from survey_sim.survey.run import Run, open_run
from survey_sim.survey.store import Store
from survey_sim.survey.workers import Workers, deaf_to_interrupt

# Stages that the runs of a sweep leave out: the sweep has a page of its own, `survey-sim report` draws that of one run.
SKIPPED = ("report",)
_NAME = r"^[A-Za-z0-9][A-Za-z0-9._-]*$"


class Scenario(Settings):
    """`[[scenario]]`: its name, and the settings that it changes, by `section.key`."""

    name: str = Field(pattern=_NAME)
    set: dict[str, Any] = Field(default_factory=dict)


class SweepSettings(Settings):
    """A file of scenarios."""

    # Name of the sweep's folder under runs/; the TOML file's own name by default.
    name: str = Field(pattern=_NAME)
    # What the sweep asks, in words.
    title: str = ""
    # The pipeline that scenarios change: the name of one that is shipped, or a path, from this file's folder.
    base: str
    # Each seeds one realisation of everything random, mock catalogues and weather included; all scenarios have them all.
    seeds: tuple[int, ...] = Field(min_length=1)
    # Changes of all scenarios.
    set: dict[str, Any] = Field(default_factory=dict)
    # What the others are compared to; the first scenario by default.
    reference: str = ""
    scenario: tuple[Scenario, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _names_are_known_and_unique(self) -> Self:
        names = [scenario.name for scenario in self.scenario]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"scenario names used twice: {', '.join(twice)}")
        if self.reference and self.reference not in names:
            raise ValueError(f"reference {self.reference!r} is no scenario; {did_you_mean(self.reference, names)}")
        if len(set(self.seeds)) < len(self.seeds) or min(self.seeds) < 0:
            raise ValueError("seeds are different whole numbers from 0 on")
        return self

    @property
    def reference_name(self) -> str:
        """The scenario that the others are compared to."""
        return self.reference or self.scenario[0].name


@dataclass(frozen=True)
class Member:
    """One run of a sweep: all that another process needs to do it."""

    sweep: str
    title: str
    scenario: str
    seed: int
    reference: str
    order: tuple[str, ...]
    base: Path
    folder: Path
    values_set: Mapping[str, Any]
    changes: tuple[str, ...]
    store: Store

    @property
    def label(self) -> str:
        """Scenario and seed in words."""
        return f"{self.scenario}, seed {self.seed}"

    def open(self, workers: Workers, console: Console | None = None) -> Run:
        """The run; its settings are checked."""
        scenario = {
            "sweep": self.sweep,
            "title": self.title,
            "scenario": self.scenario,
            "reference": self.reference,
            "order": list(self.order),
            "seed": self.seed,
            "changes": dict(self.values_set),
        }
        name = f"{self.scenario}-seed-{self.seed}"
        own = {"run.name": name, "run.seed": self.seed, "run.mock_seed": self.seed}
        try:
            return open_run(
                self.base,
                workers,
                self.folder,
                self.changes,
                console,
                values_set={**own, **self.values_set},
                scenario=scenario,
            )
        except InputError as failure:
            raise InputError(f"scenario {self.scenario}: {failure}") from None


@dataclass(frozen=True)
class Sweep:
    """All runs of a file of scenarios: the reference's first, so that the others find what they share."""

    settings: SweepSettings
    folder: Path
    members: tuple[Member, ...]


def is_sweep(path: Path) -> bool:
    """Whether a TOML file holds scenarios rather than a pipeline."""
    return not {"base", "scenario"}.isdisjoint(read_toml(path))


def load_sweep(path: Path, out: Path | None = None, changes: Sequence[str] = ()) -> Sweep:
    """The runs of a file of scenarios, every one's settings checked; nothing is written yet.

    Parameters
    ----------
    out
        Folder of the sweep; runs/<name> by default.
    changes
        `section.key=value`, for all runs.

    Raises
    ------
    InputError
        Missing or malformed file, unknown key, or settings that a run refuses.
    """
    values = read_toml(path)
    values.setdefault("name", path.stem)
    settings = SweepSettings.load(values, file=path)
    beside = path.parent / settings.base
    base = beside if beside.is_file() else find_pipeline(settings.base)
    folder = out if out is not None else Path("runs") / settings.name
    store = Store(folder / ".shared")
    ordered = sorted(settings.scenario, key=lambda scenario: scenario.name != settings.reference_name)
    members = tuple(
        Member(
            sweep=settings.name,
            title=settings.title,
            scenario=scenario.name,
            seed=seed,
            reference=settings.reference_name,
            order=tuple(scenario.name for scenario in settings.scenario),
            base=base,
            folder=folder / scenario.name / f"seed-{seed}",
            values_set={**settings.set, **scenario.set},
            changes=tuple(changes),
            store=store,
        )
        for scenario in ordered
        for seed in settings.seeds
    )
    for member in members:
        member.open(Workers())
    return Sweep(settings, folder, members)


def plan_sweep(sweep: Sweep) -> Iterator[str]:
    """Lines that say what each run would do, and why, or whose outcome it would take. Nothing is written."""
    for member in sweep.members:
        run = member.open(Workers())
        stages = {stage.name: stage for stage in load_stages(run)}
        for name, reasons in plan_stages(run, SKIPPED):
            taken = member.store.find(run, stages[name]) if reasons else None
            words = f"as in {taken}" if taken else "; ".join(reasons) or "up to date"
            yield f"{member.scenario}, seed {member.seed}: {name}: {words}"


def run_sweep(sweep: Sweep, workers: Workers, console: Console) -> None:
    """Do all runs of a sweep, or what is out of date of them: whole runs side by side, one a process.

    Raises
    ------
    InputError
        A run was refused; the others are done first.
    """
    failures: list[InputError] = []
    done = _in_turn(sweep, workers) if workers.n <= 1 else _side_by_side(sweep, workers)
    for number, (member, failure) in enumerate(done, start=1):
        console.print(f"  {number} of {len(sweep.members)}: {member.label}{' failed' if failure else ''}")
        failures += [failure] if failure else []
    if failures:
        raise failures[0]


def run_member(member: Member, workers: Workers) -> None:
    """Do one run, in this process or with the workers given."""
    run = member.open(workers)
    with run.locked():
        run_stages(run, member.store, SKIPPED)


def _in_turn(sweep: Sweep, workers: Workers) -> Iterator[tuple[Member, InputError | None]]:
    for member in sweep.members:
        try:
            run_member(member, workers)
        except InputError as failure:
            yield member, InputError(f"{member.label}: {failure}")
        else:
            yield member, None


def _side_by_side(sweep: Sweep, workers: Workers) -> Iterator[tuple[Member, InputError | None]]:
    """A run that needs what another is making waits for it (`Store.alone`). When interrupted, all end at once."""
    pool = ProcessPoolExecutor(min(workers.n, len(sweep.members)), mp_context=get_context("spawn"))
    try:
        with deaf_to_interrupt():
            futures: dict[Future[None], Member] = {pool.submit(run_member, m, Workers()): m for m in sweep.members}
        for future in as_completed(futures):
            interrupts.stop_if_asked()
            member = futures[future]
            try:
                future.result()
            except InputError as failure:
                yield member, InputError(f"{member.label}: {failure}")
            except BrokenProcessPool:
                rule = f"{member.label}: its process was killed"
                raise InputError(rule, remedy="run again: what is done is kept") from None
            else:
                yield member, None
    except KeyboardInterrupt:
        for process in active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)
