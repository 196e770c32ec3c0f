"""Runs the stages that are out of date. Contents of files, settings and code decide, not dates.

doit decides and remembers; the tasks stand in `pipelines/dodo.py`. The memory is saved after every stage. A stage that was
killed, or that the memory lost, runs again from its whole parts.
"""

from __future__ import annotations

import json
import os
import runpy
import sqlite3
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

from doit.dependency import DatabaseException, Dependency, MD5Checker, SqliteDB
from doit.task import Task, dict_to_task

from survey_sim import interrupts
from survey_sim.folders import data_folder
from survey_sim.survey.run import Run
from survey_sim.survey.store import Store
from survey_sim.tables import checksum, unwritable


class Unchanged:
    """doit's `uptodate` check that named values are what they were when the task last succeeded.

    Parameters
    ----------
    what
        What the values are ("settings", "code"), for the reason given.
    values
        Plain values; the check also tells which of them changed.
    """

    def __init__(self, what: str, values: Mapping[str, Any]) -> None:
        self.what = what
        self.digests = {key: _digest(value) for key, value in flatten(values).items()}
        self.changed: list[str] = []

    def configure_task(self, task: Task) -> None:
        """Called by doit: what to remember when the task succeeds."""
        task.value_savers.append(lambda: {self.what: self.digests})

    def __call__(self, task: Task, values: Mapping[str, Any]) -> bool:
        """Whether nothing changed since the remembered values; called by doit."""
        before = values.get(self.what)
        if before is None:
            return False
        self.changed = sorted(key for key in {*before, *self.digests} if before.get(key) != self.digests.get(key))
        return not self.changed

    def reason(self) -> str:
        """Why the check failed, in words."""
        if not self.changed or self.what != "settings":
            return f"{self.what} changed"
        shown = ", ".join(self.changed[:4])
        return f"settings changed: {shown}" + (f" and {len(self.changed) - 4} more" if len(self.changed) > 4 else "")


class Whole:
    """doit's `uptodate` check that tables hold what the task wrote, byte for byte."""

    def __init__(self, files: Iterable[Path]) -> None:
        self.files = [path for path in files if path.suffix == ".parquet"]
        self.damaged: list[str] = []

    def configure_task(self, task: Task) -> None:
        """Called by doit: what to remember when the task succeeds."""
        task.value_savers.append(lambda: {"sha256": {path.name: checksum(path) for path in self.files}})

    def __call__(self, task: Task, values: Mapping[str, Any]) -> bool:
        """Whether all are as they were written; called by doit. Absent files are doit's own to notice."""
        known = values.get("sha256", {})
        there = [path for path in self.files if path.is_file()]
        self.damaged = [path.name for path in there if checksum(path) != known.get(path.name)]
        return not self.damaged

    def reason(self) -> str:
        """Why the check failed, in words."""
        return f"damaged: {', '.join(self.damaged)}"


class _ContentsIn(MD5Checker):
    """doit's check of files by their contents, of files that go by their names in a run's folder (`Run.name_of`).

    So the memory holds wherever the folder is moved or copied to.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def exists(self, name: str) -> bool:
        """Whether a file is there; called by doit, as are the others."""
        return (self.folder / name).exists()

    def info(self, name: str) -> os.stat_result:
        """What the disk says of it."""
        return (self.folder / name).stat()

    def get_state(self, name: str, state: Any) -> Any:
        """What to remember of it."""
        return super().get_state(str(self.folder / name), state)

    def check_modified(self, name: str, stat: os.stat_result, state: Any) -> bool:
        """Whether it is other than what is remembered."""
        return bool(super().check_modified(str(self.folder / name), stat, state))


@dataclass(frozen=True)
class Stage:
    """One stage as a make-style task.

    Attributes
    ----------
    action
        What it does.
    needs, makes
        Files it reads, whose contents count, and files it writes.
    unchanged
        Values that count.
    is_whole
        Whether what it made, besides `makes`, is still as it was.
    """

    name: str
    action: Callable[[Run], None]
    needs: tuple[Path, ...]
    makes: tuple[Path, ...]
    unchanged: tuple[Unchanged, ...]
    is_whole: Callable[[], bool] = field(default=lambda: True)

    def task(self, run: Run) -> Task:
        """The stage of a run as doit sees it."""
        return dict_to_task(
            {
                "name": self.name,
                "actions": None,
                "file_dep": [run.name_of(path) for path in self.needs],
                "targets": [run.name_of(path) for path in self.makes],
                "uptodate": [*self.unchanged, Whole(self.makes), self.is_whole],
            }
        )


def run_stages(run: Run, store: Store | None = None, skipped: Collection[str] = ()) -> None:
    """Run every stage that is out of date, in order, and note its time in run.json.

    run.json is begun after the first stage, which reads all input: bad input leaves nothing behind.

    Parameters
    ----------
    store
        Where runs share what their stages make; none by default.
    skipped
        Names of stages that are not wanted.
    """
    try:
        for number, stage in enumerate(stage for stage in load_stages(run) if stage.name not in skipped):
            interrupts.stop_if_asked()
            _bring_up_to_date(run, stage, store)
            if number == 0:
                run.record_settings()
    finally:
        run.workers.close()


def _bring_up_to_date(run: Run, stage: Stage, store: Store | None) -> None:
    reasons, task = _status(run, stage)
    if not reasons:
        run.console.print(f"[dim]{stage.name}: up to date[/dim]")
    elif store is None:
        run.console.print(f"[bold]{stage.name}[/bold] ({'; '.join(reasons)})")
        _execute(run, stage, task)
    else:
        _share(run, stage, task, store, reasons)


def _execute(run: Run, stage: Stage, task: Task) -> None:
    _act(run, stage)
    _remember(run, task)


def _act(run: Run, stage: Stage) -> None:
    with run.timed(stage.name):
        stage.action(run)


def _remember(run: Run, task: Task) -> None:
    task.save_extra_values()
    with _memory(run) as memory:
        memory.save_success(task)


def _share(run: Run, stage: Stage, task: Task, store: Store, reasons: list[str]) -> None:
    """Take from the store what another run's stage made, or run the stage and keep what it makes there."""
    place = store.place(run, stage)
    with store.alone(place):
        taken = store.fetch(run, stage, place)
        if taken is None:
            run.console.print(f"[bold]{stage.name}[/bold] ({'; '.join(reasons)})")
            with store.keep(run, stage, place):
                _act(run, stage)
        else:
            run.console.print(f"[dim]{stage.name}: as in {taken}[/dim]")
    _remember(run, task)


def plan_stages(run: Run, skipped: Collection[str] = ()) -> Iterator[tuple[str, list[str]]]:
    """Name of every stage with the reasons why it would run; none if it is up to date. Nothing is written."""
    remade: set[Path] = set()
    for stage in (stage for stage in load_stages(run) if stage.name not in skipped):
        reasons = _status(run, stage)[0] if run.state.is_dir() else ["never run"]
        waits_for = remade & set(stage.needs)
        if waits_for:
            reasons = [reason for reason in reasons if "changed: " not in reason or reason.startswith("settings")]
            reasons = reasons or ["an earlier stage remakes what it needs"]
        remade |= set(stage.makes) if reasons else set()
        yield stage.name, reasons


def load_stages(run: Run) -> list[Stage]:
    """The stages of a run, from the task file."""
    return list(runpy.run_path(str(data_folder("pipelines") / "dodo.py"))["make_stages"](run))


def flatten(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested settings as one level, keys joined by dots."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def _status(run: Run, stage: Stage) -> tuple[list[str], Task]:
    """Why a stage is out of date, in words (nothing if it is not), and its task."""
    absent = [path.name for path in stage.needs if not path.exists()]
    task = stage.task(run)
    if absent:
        return [f"not made yet: {', '.join(absent)}"], task
    with _memory(run) as memory:
        status = memory.get_status(task, {}, get_log=True)
        is_known = memory.get_values(stage.name) != {}
    if not is_known:
        return ["never finished"], task
    if status.status == "up-to-date":
        return [] if stage.name in run.recorded().get("stages", {}) else ["run.json does not tell of it"], task
    return list(_reasons(stage, status.reasons)), task


def _reasons(stage: Stage, found: Mapping[str, Any]) -> Iterator[str]:
    """doit's reasons, in words."""
    for check, *_ in found.get("uptodate_false", []):
        yield check.reason() if isinstance(check, Unchanged | Whole) else "a part is absent or damaged"
    for key, words in (("changed_file_dep", "changed"), ("missing_target", "absent")):
        if found.get(key):
            yield f"{words}: {', '.join(sorted(Path(name).name for name in found[key]))}"
    if found.get("added_file_dep") or found.get("removed_file_dep"):
        yield "needs other files"


@contextmanager
def _memory(run: Run) -> Iterator[Dependency]:
    """doit's memory, saved when the block ends; one that cannot be read is begun anew."""
    path = run.state / "engine.db"
    begin = partial(Dependency, SqliteDB, str(path), checker_cls=partial(_ContentsIn, run.folder))
    try:
        memory = begin()
    except (DatabaseException, sqlite3.DatabaseError):
        path.unlink(missing_ok=True)
        memory = begin()
    yield memory
    try:
        memory.close()
    except sqlite3.OperationalError as failure:
        raise unwritable(path, failure) from None


def _digest(value: Any) -> str:
    return sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()
