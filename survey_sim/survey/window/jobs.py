"""Jobs of the window: allocate, route and play what was uploaded, in a thread, with progress."""

from __future__ import annotations

import shutil
import tempfile
import zipfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Literal

from pydantic import Field

from survey_sim.errors import InputError
from survey_sim.settings import Settings
from survey_sim.survey.field import allocate_field, route_field, simulate_field, view_page

Source = Literal["targets", "allocation", "router"]
# Finished jobs that are kept; older ones go.
N_KEPT = 20


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


@dataclass
class Job:
    """One job: its files, how far it is, and what came of it."""

    number: int
    folder: Path
    wish: Wish
    files: list[Path]
    start: Path | None
    state: Literal["waiting", "running", "done", "failed"] = "waiting"
    stage: str = "waiting for the job before"
    error: str = ""
    findings: list[str] = field(default_factory=list)
    page: str = ""

    @property
    def run_dir(self) -> Path:
        """Folder of the run that it makes."""
        return self.folder / "run"

    def report(self) -> dict[str, object]:
        """What the page is told."""
        return {"job": self.number, "state": self.state, "stage": self.stage, "error": self.error, "findings": self.findings}

    def work(self) -> None:
        """Do it; a fault of the input becomes `error`, and so does any other, in one line."""
        self.state = "running"
        try:
            self.page = self._play()
            self.state, self.stage = "done", "done"
        except InputError as fault:
            self.state, self.error = "failed", str(fault).replace(f"{self.folder}/", "")
        except Exception as fault:  # the window stays open whatever a job meets
            self.state, self.error = "failed", f"{type(fault).__name__}: {fault}"

    def _play(self) -> str:
        wish, sources = self.wish, list(self.files)
        if wish.source == "targets":
            self.stage = "allocating"
            allocate_field(
                sources[0],
                self.run_dir,
                instrument=wish.instrument or "taipan-150",
                algorithm=wish.algorithm,
                visits=wish.visits,
                travel_power=wish.travel_power,
                centre_deg=wish.centre_deg,
                overrides=wish.speeds,
            )
            sources = [self.run_dir]
        if wish.source != "router":
            route_field(
                sources,
                self.run_dir,
                router=wish.router,
                # what `allocate` made describes its own instrument
                instrument=None if wish.source == "targets" else wish.instrument,
                start=self.start,
                overrides=wish.speeds,
                on_progress=self._note_visit,
            )
            sources = [self.run_dir]
        self.stage = "simulating"
        instrument = wish.instrument if wish.source == "router" else None
        self.findings = simulate_field(sources, self.run_dir, instrument=instrument).findings
        self.stage = "drawing"
        return view_page([self.run_dir])

    def _note_visit(self, done: int, total: int) -> None:
        self.stage = f"routing visit {done + 1} of {total}"

    def archive(self) -> bytes:
        """The run's folder as a ZIP file."""
        buffer = BytesIO()
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as packed:
            for path in sorted(self.run_dir.rglob("*")):
                if path.is_file():
                    packed.write(path, path.relative_to(self.run_dir))
        return buffer.getvalue()


class Jobs:
    """All jobs of a window; one is done at a time. Their files go when the window closes."""

    def __init__(self) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="survey-sim-"))
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="job")
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
        self._pool.submit(job.work)
        return job

    def get(self, number: int) -> Job | None:
        """A job by its number."""
        return self._jobs.get(number)

    def close(self) -> None:
        """Drop what waits, and remove all files."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        shutil.rmtree(self._folder, ignore_errors=True)
