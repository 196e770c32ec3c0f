"""One run: its folder, its settings, its lock, and the record that it keeps in run.json."""

from __future__ import annotations

import fcntl
import json
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import IO, Any

from rich.console import Console

from survey_sim import __version__, tables
from survey_sim.errors import InputError
from survey_sim.folders import PACKAGE
from survey_sim.instrument import Instrument, Plate
from survey_sim.schema import SCHEMA_VERSION, TABLES
from survey_sim.survey.settings import PipelineSettings, load_pipeline
from survey_sim.survey.workers import Workers, memory_mib


@dataclass(frozen=True)
class Run:
    """A run of one pipeline.

    Attributes
    ----------
    folder
        Where its tables go.
    pipeline
        The TOML file that it was read from; files that it names are looked for beside it.
    scenario
        For a run of a sweep: `sweep`, `scenario`, `seed` and `changes`, as run.json has them.
    noted
        What `record` was given since it was last cleared.
    """

    folder: Path
    pipeline: Path
    settings: PipelineSettings
    workers: Workers
    console: Console = field(default_factory=lambda: Console(stderr=True, quiet=True))
    scenario: Mapping[str, Any] = field(default_factory=dict)
    noted: dict[str, Any] = field(default_factory=dict, compare=False)

    @property
    def state(self) -> Path:
        """Folder of what a run needs to go on, which is no table: manifests of parts, the engine's memory, the lock."""
        return self.folder / ".state"

    @cached_property
    def plate(self) -> Plate:
        """The robots."""
        return self.settings.plate(self.pipeline.parent)

    @cached_property
    def instrument(self) -> Instrument:
        """The instrument."""
        return self.settings.instrument.load(self.pipeline.parent)

    def table(self, name: str) -> Path:
        """File or folder of a table."""
        return self.folder / (name if TABLES[name].is_in_parts else f"{name}.parquet")

    def name_of(self, path: Path) -> str:
        """A file's name in the run's folder, the same wherever the folder is; the full path of one that is not in it."""
        return path.relative_to(self.folder).as_posix() if path.is_relative_to(self.folder) else str(path.absolute())

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other runs out of the folder; the system drops the lock when the process ends, however it ends.

        A folder in which nothing was done goes away again.
        """
        made = [folder for folder in (self.state, self.folder, *self.folder.parents) if not folder.exists()]
        tables.make_folder(self.state)
        with _lock(self.state / "lock", self.folder):
            try:
                tables.clean_up(self.folder)
                yield
            finally:
                if made and not (self.folder / "run.json").exists():
                    for file in ("lock", "engine.db"):
                        (self.state / file).unlink(missing_ok=True)
                    with suppress(OSError):
                        for folder in made:
                            folder.rmdir()

    def record(self, **entries: Any) -> None:
        """Set entries of run.json; entries that are mappings are merged."""
        known = self.recorded()
        for key, value in entries.items():
            for record in (known, self.noted):
                record[key] = {**record.get(key, {}), **value} if isinstance(value, Mapping) else value
        tables.write_bytes((json.dumps(known, indent=2, sort_keys=True) + "\n").encode(), self.folder / "run.json")

    def recorded(self) -> dict[str, Any]:
        """What run.json holds; nothing if it is absent or damaged."""
        try:
            return tables.read_record(self.folder)
        except InputError:
            return {}

    def record_settings(self) -> None:
        """Start run.json: everything that the run depends on, so that a reader needs nothing else."""
        settings = self.settings.model_dump(mode="json")
        header = {"package": "survey-sim", "version": __version__, "schema_version": SCHEMA_VERSION}
        known = self.recorded()
        kept: dict[str, Any] = {key: known[key] for key in ("stages", "catalogues", "targets", "warnings") if key in known}
        entries: dict[str, Any] = {
            **header,
            "name": self.settings.run.name,
            "seed": self.settings.run.seed,
            "settings": settings,
            "extensions": self.settings.extensions,
            "instrument": self.instrument.model_dump(mode="json"),
            **({"scenario": dict(self.scenario)} if self.scenario else {}),
            **kept,
        }
        content = json.dumps(entries, indent=2, sort_keys=True, default=str) + "\n"
        tables.write_bytes(content.encode(), self.folder / "run.json")

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Note what a stage takes, its workers included: wall and CPU seconds, and the largest memory so far, MiB."""
        wall, cpu = time.perf_counter(), time.process_time() + self.workers.cpu_s
        yield
        spent = {
            "wall_s": round(time.perf_counter() - wall, 3),
            "cpu_s": round(time.process_time() + self.workers.cpu_s - cpu, 3),
            "memory_mib": round(memory_mib() + sum(self.workers.memory_mib.values())),
        }
        self.record(stages={stage: spent})


def open_run(
    pipeline: Path,
    workers: Workers,
    out: Path | None = None,
    changes: tuple[str, ...] = (),
    console: Console | None = None,
    *,
    values_set: Mapping[str, Any] | None = None,
    scenario: Mapping[str, Any] | None = None,
) -> Run:
    """A run of a pipeline file, its settings checked; nothing is written yet.

    Parameters
    ----------
    changes, values_set
        Settings that differ from the file's: as `section.key=value`, and by `section.key` (`load_pipeline`).
    scenario
        Of a run of a sweep (`Run.scenario`).
    """
    settings = load_pipeline(pipeline, changes, values_set)
    folder = out if out is not None else Path("runs") / settings.run.name
    if folder.exists() and not folder.is_dir():
        raise InputError("is a file, not a folder", file=folder, remedy="choose another --out")
    return Run(folder, pipeline, settings, workers, console or Console(stderr=True, quiet=True), scenario or {})


def code_digest(*rooms: str) -> str:
    """Digest of the source of rooms of the package (a module or a folder each), the same wherever it is installed."""
    digest = sha256(str(SCHEMA_VERSION).encode())
    for room in sorted({*rooms, "schema", "tables", "geometry", "instrument", "motion", "region", "settings"}):
        sources = sorted((PACKAGE / room).rglob("*.py")) or [PACKAGE / f"{room}.py"]
        for source in sources:
            digest.update(source.relative_to(PACKAGE).as_posix().encode() + source.read_bytes())
    return digest.hexdigest()


def _lock(path: Path, folder: Path) -> IO[str]:
    """The lock's file, open and held until it is closed."""
    try:
        file = path.open("w")
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        rule = "another run is at work in this folder"
        raise InputError(rule, file=folder, remedy="wait for it, or choose another --out") from None
    except OSError as failure:
        raise tables.unwritable(path, failure) from None
    return file
