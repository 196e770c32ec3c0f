"""How the cost grows with robots, targets, tiles and workers: `python -m tests.benchmarks.scaling FOLDER [--workers]`.

Writes scaling.csv and scaling.png. CPU time, as ratios to the yardstick; `--workers` adds visits a second of wall time,
which wants a machine that does nothing else.
"""

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import polars as pl
from matplotlib.ticker import LogLocator

from survey_sim import tables
from survey_sim.plotting import figure_style, new_figure
from survey_sim.survey.engine import run_stages
from survey_sim.survey.run import Run, open_run
from survey_sim.survey.specimen import write_specimen
from survey_sim.survey.tile import simulate_tile
from survey_sim.survey.workers import Workers
from tests.benchmarks.tiles import tile_job
from tests.benchmarks.yardstick import yardstick_s

N_TARGET = (250, 500, 1000, 2000)
INSTRUMENTS = {"taipan-150": 159, "taipan-300": 309, "manifest": 600}
WIDTH_DEG = (4.0, 8.0, 16.0, 32.0)
N_WORKER = (1, 2, 4)
STARS_A_DEG = 75


def main(folder: Path, *, with_workers: bool) -> None:
    """Measure, write and draw."""
    rows = pl.DataFrame(list(_rows(with_workers)))
    tables.write_bytes(rows.write_csv().encode(), folder / "scaling.csv")
    draw(rows, folder / "scaling.png")
    print(rows)


def draw(rows: pl.DataFrame, file: Path) -> None:
    """A panel for each quantity."""
    parts = rows.partition_by("what", maintain_order=True)
    with figure_style():
        figure = new_figure(3.0 * len(parts), 2.8)
        for axes, part in zip(figure.subplots(1, len(parts)), parts, strict=True):
            axes.loglog(part["n"], part["cost"], "o-")
            axes.set(xlabel=part["what"][0], ylabel=part["unit"][0], ylim=(part["cost"].min() / 3, part["cost"].max() * 3))
            axes.set_xticks(part["n"], [str(n) for n in part["n"]])
            axes.minorticks_off()
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter("{x:g}")
        figure.savefig(file, dpi=130)


def _rows(with_workers: bool) -> Iterator[dict[str, Any]]:
    simulate_tile(tile_job(N_TARGET[0]))
    for n in N_TARGET:
        spent, visits = _spent(lambda n=n: len(simulate_tile(tile_job(n))["visits"]))
        yield {"what": "targets a tile", "n": n, "cost": spent / visits / yardstick_s(), "unit": "CPU a visit / yardstick"}
    for name, n in INSTRUMENTS.items():
        spent, visits = _spent(lambda name=name: len(simulate_tile(tile_job(1000, name))["visits"]))
        yield {"what": "robots", "n": n, "cost": spent / visits / yardstick_s(), "unit": "CPU a visit / yardstick"}
    with TemporaryDirectory() as place:
        for width_deg in WIDTH_DEG:
            run = _survey(Path(place) / f"{width_deg:g}", width_deg, Workers())
            spent, tiles = _spent(lambda run=run: _run(run, "tiles"))
            yield {"what": "tiles", "n": tiles, "cost": spent / yardstick_s(), "unit": "CPU of a run / yardstick"}
        for n in N_WORKER if with_workers else ():
            run = _survey(Path(place) / f"workers-{n}", WIDTH_DEG[-1], Workers(n))
            begin = time.perf_counter()
            visits = _run(run, "visits")
            yield {"what": "workers", "n": n, "cost": visits / (time.perf_counter() - begin), "unit": "visits a second"}


def _spent(call: Callable[[], int]) -> tuple[float, int]:
    begin = time.process_time()
    done = call()
    return time.process_time() - begin, done


def _survey(place: Path, width_deg: float, workers: Workers) -> Run:
    pipeline = write_specimen(place, "[output]\ntiles_per_part = 1\n", int(STARS_A_DEG * width_deg), width_deg)
    return open_run(pipeline, workers, place / "run")


def _run(run: Run, table: str) -> int:
    """The stages up to the visits; rows of a table then."""
    with run.locked():
        run_stages(run, skipped=("schedule", "report"))
    return tables.read(run.folder, table).height


if __name__ == "__main__":
    main(Path(sys.argv[1]), with_workers="--workers" in sys.argv)
