"""Compiles all kernels once, by a small survey from end to end: `python -m survey_sim.survey.warm`.

numba keeps what it compiles on disk, beside the sources; the first run after an installation would otherwise wait for it.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import polars as pl
from rich.console import Console

from survey_sim.check import check_run
from survey_sim.survey.batches import Workers
from survey_sim.survey.engine import load_stages
from survey_sim.survey.run import open_run

_PROGRAMME = '[[programme]]\nname = "{kind}"\nsurvey = "stars"\nkind = "{kind}"\n{catalogue}\n'
_PIPELINE = """
[tiling]
region = {{ ra_deg = [10.0, 14.0], dec_deg = [-32.0, -28.0] }}

{programmes}
[schedule]
start_date = 2016-10-01
end_date = 2016-10-02
"""


def compile_kernels() -> None:
    """Run and check a survey of one tile and 300 stars in a temporary folder."""
    with TemporaryDirectory(prefix="survey-sim-") as name:
        run = open_run(_write_survey(Path(name)), Workers(), Path(name) / "run")
        with run.locked():
            for stage in load_stages(run):
                if stage.name != "report":
                    stage.action(run)
            run.record_settings()
        check_run(run.folder)


def _write_survey(folder: Path) -> Path:
    rng = np.random.default_rng(1)
    n = 300
    stars = pl.DataFrame(
        {
            "source_id": [str(i) for i in range(n)],
            "ra_deg": 10.0 + 4.0 * rng.random(n),
            "dec_deg": -32.0 + 4.0 * rng.random(n),
            "mag": 8.0 + 3.0 * rng.random(n),
        }
    )
    stars.write_csv(folder / "stars.csv")
    kinds = ("science", "standard", "guide", "sky")
    programmes = [_PROGRAMME.format(kind=k, catalogue="" if k == "sky" else 'catalogue = "stars.csv"') for k in kinds]
    pipeline = folder / "warm.toml"
    pipeline.write_text(_PIPELINE.format(programmes="\n".join(programmes)), encoding="utf-8")
    return pipeline


if __name__ == "__main__":
    with Console(stderr=True).status("compiling kernels, once"):
        compile_kernels()
