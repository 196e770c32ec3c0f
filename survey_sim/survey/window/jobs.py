"""Jobs of the window: allocate, route and play what was uploaded, in a process of their own, with progress.

One process does one job after the other, so that it loads the kernels once; to cancel a job is to end that process.
"""

from __future__ import annotations

import multiprocessing
import shutil
import signal
import tempfile
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from survey_sim.errors import InputError
from survey_sim.settings import Settings
from survey_sim.survey.field import allocate_field, route_field, simulate_field, view_page

Source = Literal["targets", "allocation", "router"]
# Finished jobs that are kept; older ones go.
N_KEPT = 20
# How often a running job is asked whether it was cancelled.
POLL_S = 0.1


class Wish(Settings):
    """What the window's form says; empty fields are absent.

    Attributes
    ----------
    source
        What the files are: targets of one field, allocation files or router files.
    """

    source: Source
    instrument: str | None = None
    algorithm: str = "plan"
    router: str = "coordinated"
    visits: int | None = Field(None, ge=1, le=50)
    travel_power: float = Field(4.0, gt=0, le=8)
    centre_ra_deg: float | None = Field(None, ge=0, le=360)
    centre_dec_deg: float | None = Field(None, ge=-90, le=90)
    coarse_speed_mm_s: float | None = Field(None, gt=0)
    precise_speed_mm_s: float | None = Field(None, gt=0)
    rotation_speed_deg_s: float | None = Field(None, gt=0)

    @property
    def speeds(self) -> dict[str, float]:
        """Constants of the instrument that are wished otherwise."""
        names = ("coarse_speed_mm_s", "precise_speed_mm_s", "rotation_speed_deg_s")
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    @property
    def centre_deg(self) -> tuple[float, float] | None:
        """The field centre, if both its coordinates are given."""
        if self.centre_ra_deg is None or self.centre_dec_deg is None:
            return None
        return self.centre_ra_deg, self.centre_dec_deg


@dataclass(frozen=True)
class Task:
    """What a job's process is given."""

    wish: Wish
    files: list[Path]
    start: Path | None
    run_dir: Path


@dataclass
class Job:
    """One job: its files, how far it is, and what came of it."""

    number: int
    folder: Path
    wish: Wish
    files: list[Path]
    start: Path | None
    state: Literal["waiting", "running", "done", "failed", "cancelled"] = "waiting"
    stage: str = "waiting for the job before"
    error: str = ""
    findings: list[str] = field(default_factory=list)
    page: str = ""

    @property
    def task(self) -> Task:
        """What its process is given."""
        return Task(self.wish, self.files, self.start, self.folder / "run")

    def report(self) -> dict[str, object]:
        """What the page is told."""
        return {"job": self.number, "state": self.state, "stage": self.stage, "error": self.error, "findings": self.findings}

    def note(self, **news: Any) -> None:
        """What its process says; nothing is news of a job that was cancelled."""
        if self.state != "cancelled":
            for name, value in news.items():
                setattr(self, name, value)

    def archive(self) -> bytes:
        """The run's folder as a ZIP file."""
        run_dir = self.task.run_dir
        buffer = BytesIO()
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as packed:
            for path in sorted(run_dir.rglob("*")):
                if path.is_file():
                    packed.write(path, path.relative_to(run_dir))
        return buffer.getvalue()


def serve_tasks(pipe: Connection) -> None:
    """Body of the process: do the tasks that come, and tell how far each is, until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl+C is the window's, which then ends this process
    with suppress(EOFError, OSError):
        while True:
            task = pipe.recv()
            pipe.send(_outcome(task, lambda stage: pipe.send({"stage": stage})))


def _outcome(task: Task, tell: Callable[[str], None]) -> dict[str, Any]:
    """What came of a task; a fault of the input becomes `error`, and so does any other, in one line."""
    try:
        findings, page = _play(task, tell)
    except InputError as fault:
        return {"state": "failed", "error": str(fault).replace(f"{task.run_dir.parent}/", "")}
    except Exception as fault:  # the window stays open whatever a job meets
        return {"state": "failed", "error": f"{type(fault).__name__}: {fault}"}
    return {"findings": findings, "page": page, "stage": "done", "state": "done"}


def _play(task: Task, tell: Callable[[str], None]) -> tuple[list[str], str]:
    """Findings of the simulation, and the player's page."""
    wish, sources, run_dir = task.wish, list(task.files), task.run_dir
    if wish.source == "targets":
        tell("allocating")
        allocate_field(
            sources[0],
            run_dir,
            instrument=wish.instrument or "taipan-150",
            algorithm=wish.algorithm,
            visits=wish.visits,
            travel_power=wish.travel_power,
            centre_deg=wish.centre_deg,
            overrides=wish.speeds,
        )
        sources = [run_dir]
    if wish.source != "router":
        route_field(
            sources,
            run_dir,
            router=wish.router,
            # what `allocate` made describes its own instrument
            instrument=None if wish.source == "targets" else wish.instrument,
            start=task.start,
            overrides=wish.speeds,
            on_progress=lambda done, total: tell(f"routing visit {done + 1} of {total}"),
        )
        sources = [run_dir]
    tell("simulating")
    instrument = wish.instrument if wish.source == "router" else None
    findings = simulate_field(sources, run_dir, instrument=instrument).findings
    tell("drawing")
    return findings, view_page([run_dir])


class _Worker:
    """The process that does the jobs; begun when it is first needed, and again after it was ended."""

    def __init__(self) -> None:
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None

    def work(self, job: Job) -> None:
        """Do a job, and note what its process tells; end the process when the job is cancelled."""
        job.note(state="running", stage="beginning")
        if job.state == "cancelled":
            return
        pipe = self._begun()
        try:
            pipe.send(job.task)
            while job.state == "running":
                if pipe.poll(POLL_S):
                    job.note(**pipe.recv())
        except (EOFError, OSError):
            job.note(state="failed", error="the job's process was ended, by lack of memory perhaps; run it again")
        if job.state == "cancelled":
            self.end()

    def end(self) -> None:
        """End the process, whatever it is doing."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process = None

    def _begun(self) -> Connection:
        if self._process is None or not self._process.is_alive() or self._pipe is None:
            context = multiprocessing.get_context("spawn")
            self._pipe, theirs = context.Pipe()
            self._process = context.Process(target=serve_tasks, args=(theirs,), daemon=True)
            self._process.start()
            theirs.close()
        return self._pipe


class Jobs:
    """All jobs of a window; one is done at a time. Their files go when the window closes."""

    def __init__(self) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="survey-sim-"))
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="job")
        self._worker = _Worker()
        self._jobs: dict[int, Job] = {}
        self._n_made = 0

    def reserve(self) -> tuple[int, Path]:
        """Number and empty folder of one more job."""
        self._n_made += 1
        folder = self._folder / f"job{self._n_made}"
        folder.mkdir()
        return self._n_made, folder

    def begin(self, job: Job) -> Job:
        """Begin a job, or let it wait for those before; its files are in its folder, or anywhere on this machine."""
        self._jobs[job.number] = job
        for number in list(self._jobs)[:-N_KEPT]:
            shutil.rmtree(self._jobs.pop(number).folder, ignore_errors=True)
        self._pool.submit(self._worker.work, job)
        return job

    def get(self, number: int) -> Job | None:
        """A job by its number."""
        return self._jobs.get(number)

    def cancel(self, job: Job) -> None:
        """End a job that waits or runs; one that has ended stays as it is."""
        if job.state not in {"done", "failed"}:
            job.note(stage="cancelled", state="cancelled")

    def close(self) -> None:
        """Drop what waits, end what runs, and remove all files."""
        for job in self._jobs.values():
            self.cancel(job)
        self._pool.shutdown()
        self._worker.end()
        shutil.rmtree(self._folder, ignore_errors=True)
