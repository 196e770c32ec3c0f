"""Speed of what surrounds allocation and routing: a whole tile, playing, tables, exchange files, projection, the report."""

from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
from pytest_benchmark.fixture import BenchmarkFixture

from survey_sim import tables
from survey_sim.check import check_run
from survey_sim.geometry import sky_to_plate
from survey_sim.instrument import load_instrument, make_plate
from survey_sim.routing import RoutingSettings, route
from survey_sim.simulation import simulate
from survey_sim.survey.report import make_report
from survey_sim.survey.tile import simulate_tile
from tests.benchmarks.tiles import tile_job
from tests.fields import chain
from tests.report_run import write_run


@cache
def tile() -> dict[str, pl.DataFrame]:
    """Tables of one tile of 700 galaxies."""
    return simulate_tile(tile_job(700))


def test_tile_of_700_galaxies(benchmark: BenchmarkFixture) -> None:
    made = benchmark.pedantic(simulate_tile, args=(tile_job(700),), rounds=3, warmup_rounds=1)
    n_visit = len(made["visits"])
    benchmark.extra_info |= {"visits": n_visit, "ms a visit": 1e3 * benchmark.stats.stats.min / n_visit}


def test_play_a_path(benchmark: BenchmarkFixture) -> None:
    plate = make_plate(load_instrument("taipan-150"))
    start, goal = list(chain(plate, 2, 160, np.random.default_rng(3)))[-1]
    theta = np.zeros(plate.n_robot)
    legs = route(plate, start, theta, goal, RoutingSettings(), np.random.default_rng(0)).legs
    benchmark.pedantic(simulate, args=(plate, start, theta, legs), rounds=20, warmup_rounds=1)


def test_encode_legs(benchmark: BenchmarkFixture) -> None:
    legs = tile()["legs"]
    content = benchmark.pedantic(tables.encode, args=(legs, "legs"), rounds=5, warmup_rounds=1)
    benchmark.extra_info |= {"rows": len(legs), "bytes a row": len(content) / len(legs)}


def test_read_legs(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    tables.write(tile()["legs"], "legs", tmp_path / "legs" / "one.parquet")
    benchmark.pedantic(tables.read, args=(tmp_path, "legs"), rounds=5, warmup_rounds=1)


def test_project_a_million_targets(benchmark: BenchmarkFixture) -> None:
    rng = np.random.default_rng(1)
    ra_deg, dec_deg = rng.uniform(147.0, 153.0, 1_000_000), rng.uniform(-33.0, -27.0, 1_000_000)
    benchmark.pedantic(sky_to_plate, args=(ra_deg, dec_deg, (150.0, -30.0), 67.2), rounds=3, warmup_rounds=1)


def test_report(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    run = write_run(tmp_path / "run")
    benchmark.pedantic(make_report, args=(run,), rounds=1, warmup_rounds=1)


def test_check_finds_the_faults_of_a_made_up_run(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    run = write_run(tmp_path / "run")
    found = benchmark.pedantic(check_run, args=(run,), rounds=3, warmup_rounds=1)
    benchmark.extra_info["faults"] = sum(found.n_faults.values())
