"""Speed and quality of routing, as ratios to one `linear_sum_assignment` of 150 x 1500 in the same run.

ORCA is measured on the same fields if it is there (`pip install pyrvo`). `python -m tests.benchmarks.routing_table` measures
many more.
"""

from functools import cache

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from survey_sim.instrument import Plate, load_instrument, make_plate
from survey_sim.routing import ROUTERS, RoutingSettings, route
from survey_sim.simulation import SimulationSettings, execute, make_ticks, simulate
from tests.benchmarks.orca import steer
from tests.benchmarks.yardstick import yardstick_s
from tests.fields import chain, random_field

N_TARGET = {"taipan-150": 160, "taipan-300": 320, "manifest": 620}


@cache
def field(instrument: str, kind: str) -> tuple[Plate, np.ndarray, np.ndarray]:
    """Plate, start and goal of one field."""
    plate = make_plate(load_instrument(instrument))
    if kind == "random":
        return plate, plate.park_mm, random_field(plate, plate.park_mm, np.random.default_rng(3)).goal_mm
    visits = list(chain(plate, 4, N_TARGET[instrument], np.random.default_rng(3)))
    start, goal = visits[-1]
    return plate, start, plate.park_mm if kind == "to-park" else goal


def timed(benchmark: BenchmarkFixture, instrument: str, kind: str, router: str) -> None:
    plate, start, goal = field(instrument, kind)
    theta, settings = np.zeros(plate.n_robot), RoutingSettings.load({"router": router})

    def run():
        return route(plate, start, theta, goal, settings, np.random.default_rng(0))

    path = benchmark.pedantic(run, rounds=5, warmup_rounds=1)
    played = simulate(plate, start, theta, path.legs)
    assert played.collisions == 0
    benchmark.extra_info["unrouted"] = int((path.reason != 0).sum())
    benchmark.extra_info["ratio_to_bound"] = path.configuration_time_s / path.lower_bound_s
    benchmark.extra_info["ticks"] = played.ticks
    benchmark.extra_info["ratio_to_assignment"] = benchmark.stats.stats.median / yardstick_s()


@pytest.mark.parametrize("kind", ["matched", "to-park", "random"])
@pytest.mark.parametrize("router", sorted(ROUTERS))
def test_150_robots(benchmark: BenchmarkFixture, router: str, kind: str) -> None:
    timed(benchmark, "taipan-150", kind, router)


@pytest.mark.parametrize("instrument", ["taipan-300", "manifest"])
def test_more_robots(benchmark: BenchmarkFixture, instrument: str) -> None:
    timed(benchmark, instrument, "matched", "coordinated")


@pytest.mark.parametrize("mode", ["open-loop", "resync", "keep-order"])
def test_execution(benchmark: BenchmarkFixture, mode: str) -> None:
    plate, start, goal = field("taipan-150", "matched")
    legs = route(plate, start, np.zeros(plate.n_robot), goal, RoutingSettings(), np.random.default_rng(0)).legs
    settings = SimulationSettings.load({"mode": mode, "leg_speed_scatter_frac": 0.02})
    done = benchmark.pedantic(
        lambda: execute(plate, start, legs, settings, np.random.default_rng(0)), rounds=5, warmup_rounds=1
    )
    benchmark.extra_info["contacts"] = done.contacts
    benchmark.extra_info["ratio_to_assignment"] = benchmark.stats.stats.median / yardstick_s()


def test_ticks(benchmark: BenchmarkFixture) -> None:
    plate, start, goal = field("taipan-150", "matched")
    legs = route(plate, start, np.zeros(plate.n_robot), goal, RoutingSettings(), np.random.default_rng(0)).legs
    benchmark.pedantic(lambda: make_ticks(plate.instrument, legs), rounds=5, warmup_rounds=1)
    benchmark.extra_info["ratio_to_assignment"] = benchmark.stats.stats.median / yardstick_s()


@pytest.mark.parametrize("kind", ["matched", "to-park", "random"])
def test_orca(benchmark: BenchmarkFixture, kind: str) -> None:
    pyrvo = pytest.importorskip("pyrvo")
    plate, start, goal = field("taipan-150", kind)
    instrument = plate.instrument
    done = benchmark.pedantic(
        lambda: steer(pyrvo, start, goal, instrument.coarse_speed_mm_s, instrument.min_separation_mm),
        rounds=2,
        warmup_rounds=0,
    )
    benchmark.extra_info["unrouted"] = done.n_away
    benchmark.extra_info["ratio_to_bound"] = done.ratio
    benchmark.extra_info["ratio_to_assignment"] = benchmark.stats.stats.median / yardstick_s()
