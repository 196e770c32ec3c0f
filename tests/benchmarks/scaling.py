"""How the cost grows with robots, targets, tiles, sky and workers: `python -m tests.benchmarks.scaling FOLDER [--workers]`.

Writes scaling.csv and scaling.png. CPU time, as ratios to the yardstick. `--workers` adds wall time, which wants a machine
that does nothing else: the five-year survey of a strip of the sky and of one twice as wide, from catalogues to schedule, and
the wider strip by one worker; stages.csv has the seconds of each stage.
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
from survey_sim.folders import find_pipeline
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
STARS_A_DEG = 75
# Strips of both surveys, away from the Galactic plane: widths in right ascension, some 1,000 and 2,000 square degrees.
STRIP_DEG = (45.0, 90.0)
STRIP_DEC_DEG = (-40.0, -15.0)
# Strips and workers that are timed.
TIMED = ((0, 2), (1, 2), (1, 1))


def main(folder: Path, *, with_workers: bool) -> None:
    """Measure, write and draw."""
    rows = pl.DataFrame(list(_rows()))
    if with_workers:
        stages = pl.concat([_strip(STRIP_DEG[strip], n) for strip, n in TIMED])
        tables.write_bytes(stages.write_csv().encode(), folder / "stages.csv")
        print(stages.pivot("stage", index=["width_deg", "workers", "n_visit"], values="wall_s"))
        rows = pl.concat([rows, *_wall(stages)])
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


def _rows() -> Iterator[dict[str, Any]]:
    simulate_tile(tile_job(N_TARGET[0]))
    for n in N_TARGET:
        spent, visits = _spent(lambda n=n: len(simulate_tile(tile_job(n))["visits"]))
        yield {"what": "targets a tile", "n": n, "cost": spent / visits / yardstick_s(), "unit": "CPU a visit / yardstick"}
    for name, n in INSTRUMENTS.items():
        spent, visits = _spent(lambda name=name: len(simulate_tile(tile_job(1000, name))["visits"]))
        yield {"what": "robots", "n": n, "cost": spent / visits / yardstick_s(), "unit": "CPU a visit / yardstick"}
    with TemporaryDirectory() as place:
        _run(_survey(Path(place) / "first", WIDTH_DEG[0]), "tiles")  # loads what is loaded once
        for width_deg in WIDTH_DEG:
            run = _survey(Path(place) / f"{width_deg:g}", width_deg)
            spent, tiles = _spent(lambda run=run: _run(run, "tiles"))
            yield {"what": "tiles", "n": tiles, "cost": spent / yardstick_s(), "unit": "CPU of a run / yardstick"}


def _strip(width_deg: float, n_worker: int) -> pl.DataFrame:
    """Wall time of each stage of the five-year survey on a strip of sky, from catalogues to schedule."""
    ra_deg, dec_deg = [0.0, width_deg], list(STRIP_DEC_DEG)
    changes = (f"tiling.region.ra_deg={ra_deg}", f"tiling.region.dec_deg={dec_deg}", "output.tiles_per_part=4")
    with TemporaryDirectory() as place:
        run = open_run(find_pipeline("five-year"), Workers(n_worker), Path(place) / "run", changes)
        with run.locked():
            run_stages(run, skipped=("report",))
        wall_s = {stage: spent["wall_s"] for stage, spent in run.recorded()["stages"].items()}
        visits = tables.read(run.folder, "visits").height
    return pl.DataFrame({"stage": wall_s.keys(), "wall_s": wall_s.values()}).with_columns(
        width_deg=pl.lit(width_deg), workers=pl.lit(n_worker), n_visit=pl.lit(visits)
    )


def _wall(stages: pl.DataFrame) -> Iterator[pl.DataFrame]:
    """Seconds of a run against the strip's width, with all workers; visits a second of the tile stage against workers."""
    most = stages["workers"].max()
    cost = stages.filter(workers=most).group_by(n="width_deg").agg(cost=pl.col("wall_s").sum()).sort("n")
    yield _named(cost, "degrees of sky", "seconds of a run")
    widest = stages.filter(pl.col("stage") == "visits", width_deg=STRIP_DEG[-1])
    cost = widest.select(n="workers", cost=pl.col("n_visit") / pl.col("wall_s")).sort("n")
    yield _named(cost, "workers", "visits a second")


def _named(cost: pl.DataFrame, what: str, unit: str) -> pl.DataFrame:
    return cost.select(
        what=pl.lit(what), n=pl.col("n").cast(pl.Int64), cost=pl.col("cost").cast(pl.Float64), unit=pl.lit(unit)
    )


def _spent(call: Callable[[], int]) -> tuple[float, int]:
    begin = time.process_time()
    done = call()
    return time.process_time() - begin, done


def _survey(place: Path, width_deg: float) -> Run:
    pipeline = write_specimen(place, "[output]\ntiles_per_part = 1\n", int(STARS_A_DEG * width_deg), width_deg)
    return open_run(pipeline, Workers(), place / "run")


def _run(run: Run, table: str) -> int:
    """The stages up to the visits; rows of a table then."""
    with run.locked():
        run_stages(run, skipped=("schedule", "report"))
    return tables.read(run.folder, table).height


if __name__ == "__main__":
    main(Path(sys.argv[1]), with_workers="--workers" in sys.argv)
