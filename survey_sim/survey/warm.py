"""Compiles all kernels once, by a small survey from end to end: `python -m survey_sim.survey.warm`.

numba keeps what it compiles on disk, beside the sources; the first run after an installation would otherwise wait for it.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console

from survey_sim.allocation.resting import resting_places
from survey_sim.check import check_run
from survey_sim.survey.engine import load_stages
from survey_sim.survey.run import open_run
from survey_sim.survey.specimen import write_specimen
from survey_sim.survey.workers import Workers

_SECTIONS = """
[simulation]
leg_speed_scatter_frac = 0.01

[schedule]
start_date = 2016-10-01
end_date = 2016-10-02
weather = { mean_loss_frac = 0.0 }
"""


def compile_kernels() -> None:
    """Run and check a survey of one tile and 300 stars in a temporary folder."""
    with TemporaryDirectory(prefix="survey-sim-") as name:
        run = open_run(write_specimen(Path(name), _SECTIONS), Workers(), Path(name) / "run")
        # The specimen's robots need not be in each other's way.
        resting_places(run.plate, run.plate.park_mm, run.plate.park_mm, 0)
        with run.locked():
            for stage in load_stages(run):
                if stage.name != "report":
                    stage.action(run)
            run.record_settings()
        check_run(run.folder)


if __name__ == "__main__":
    with Console(stderr=True).status("compiling kernels, once"):
        compile_kernels()
