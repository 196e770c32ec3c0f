"""Stages shared by the runs of a sweep: what one run's stage made, another's takes if it would make the same.

A stage's outcome is kept under a digest of its name, its settings, the code it runs, and the contents of all files it reads:
nothing else goes into it. Files are shared as hard links (copies where the disk has none); tables are only ever replaced
whole, never changed in place, so a run that goes on by itself leaves the others as they are.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from survey_sim import tables
from survey_sim.survey.run import Run

if TYPE_CHECKING:
    from survey_sim.survey.engine import Stage

# Files of a run that belong to it alone.
_OWN = ("run.json", ".state/engine.db", ".state/lock")
_MADE = "made.json"


@dataclass(frozen=True)
class Store:
    """A folder of outcomes: `<stage>-<digest>/`, each whole or absent, with the files and `made.json` about them."""

    folder: Path

    def place(self, run: Run, stage: Stage) -> Path:
        """Where the outcome of a stage is, or would be; what it needs must be there."""
        parts = sorted((run.state / "parts").glob("*.json")) if run.table("visits") in stage.needs else []
        content: dict[str, Any] = {
            "unchanged": {check.what: check.digests for check in stage.unchanged},
            "needs": [(run.name_of(path), tables.checksum(path)) for path in (*stage.needs, *parts)],
            "makes": sorted(run.name_of(path) for path in stage.makes),
        }
        digest = sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
        return self.folder / f"{stage.name}-{digest[:32]}"

    @contextmanager
    def alone(self, place: Path) -> Iterator[None]:
        """Wait while another process makes the same outcome."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with place.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield

    def fetch(self, run: Run, stage: Stage, place: Path) -> str | None:
        """Take the outcome that another run made: gives that run's name, or None if there is none or it is damaged."""
        made = self._read(place)
        if made is None:
            return None
        for name in set(_remembered(run, stage)) - set(made["files"]):
            (run.folder / name).unlink(missing_ok=True)
        for name in made["files"]:
            _link(place / name, run.folder / name)
        run.record(**made["record"])
        _remember(run, stage, list(made["files"]))
        return str(made["run"])

    def find(self, run: Run, stage: Stage) -> str | None:
        """Name of the run whose outcome would be taken; None if there is none."""
        if not all(path.exists() for path in stage.needs):
            return None
        made = self._read(self.place(run, stage))
        return None if made is None else str(made["run"])

    @contextmanager
    def keep(self, run: Run, stage: Stage, place: Path) -> Iterator[None]:
        """Keep as the outcome what the block writes into the run's folder, and what it notes in run.json."""
        run.noted.clear()
        yield
        names = sorted(_files(run, stage))
        aside = place.with_suffix(".part")
        shutil.rmtree(aside, ignore_errors=True)
        shutil.rmtree(place, ignore_errors=True)
        for name in names:
            _link(run.folder / name, aside / name)
        files = {name: tables.checksum(aside / name) for name in names}
        made = {"run": run.settings.run.name, "files": files, "record": run.noted}
        tables.write_bytes(json.dumps(made, sort_keys=True).encode(), aside / _MADE)
        aside.replace(place)
        _remember(run, stage, names)

    def _read(self, place: Path) -> dict[str, Any] | None:
        """What is said of an outcome whose files are all as they were."""
        try:
            made: dict[str, Any] = json.loads((place / _MADE).read_text(encoding="utf-8"))
        except (FileNotFoundError, json.JSONDecodeError, UnicodeDecodeError):
            return None
        is_whole = all((place / n).is_file() and tables.checksum(place / n) == d for n, d in made["files"].items())
        return made if is_whole else None


def _files(run: Run, stage: Stage) -> set[str]:
    """Files of a run that neither are its own nor were made by another stage."""
    others = {
        name
        for note in (run.state / "shared").glob("*.json")
        if note.stem != stage.name
        for name in json.loads(note.read_text(encoding="utf-8"))
    }
    found = {path.relative_to(run.folder).as_posix() for path in run.folder.rglob("*") if path.is_file()}
    drawn = {name for name in found if name.startswith("report/") and stage.name != "report"}
    return {name for name in found if name not in _OWN and not name.startswith(".state/shared/")} - others - drawn


def _remembered(run: Run, stage: Stage) -> list[str]:
    """Files that the stage made, or took, the last time."""
    with suppress(FileNotFoundError, json.JSONDecodeError):
        return list(json.loads((run.state / "shared" / f"{stage.name}.json").read_text(encoding="utf-8")))
    return []


def _remember(run: Run, stage: Stage, names: list[str]) -> None:
    tables.write_bytes(json.dumps(names).encode(), run.state / "shared" / f"{stage.name}.json")


def _link(source: Path, target: Path) -> None:
    """The same file at another place; a copy where the disk has no hard links. Whole or absent."""
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.parent.parent / f".{target.name}-{os.getpid()}{tables.TEMPORARY}"
    try:
        os.link(source, temporary)
    except OSError:
        shutil.copyfile(source, temporary)
    temporary.replace(target)
