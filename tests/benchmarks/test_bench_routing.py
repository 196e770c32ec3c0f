"""Speed and quality of routing, as ratios to one `linear_sum_assignment` of 150 x 1500 in the same run.

ORCA (`pip install pyrvo`) is measured on the same fields if it is there: holonomic discs without turns, so its times are
against straight lines at full speed.
"""

import time
from functools import cache

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.optimize import linear_sum_assignment

from survey_sim.instrument import Plate, load_instrument, make_plate
from survey_sim.routing import ROUTERS, RoutingSettings, route
from survey_sim.simulation import SimulationSettings, execute, make_ticks, simulate
from tests.fields import chain, random_field

N_TARGET = {"taipan-150": 160, "taipan-300": 320, "manifest": 620}


@cache
def yardstick_s() -> float:
    """Least of 20 times of one assignment of 150 robots to 1500 targets, by squared distance."""
    rng = np.random.default_rng(1)
    robot, target = rng.uniform(-150, 150, (150, 2)), rng.uniform(-150, 150, (1500, 2))
    cost = ((robot[:, None] - target[None]) ** 2).sum(axis=2)
    times = []
    for _ in range(20):
        begin = time.perf_counter()
        linear_sum_assignment(cost)
        times.append(time.perf_counter() - begin)
    return min(times)


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
    speed, step_s = plate.instrument.coarse_speed_mm_s, 0.1
    distance = np.hypot(*(goal - start).T)

    def run() -> tuple[float, int]:
        world = pyrvo.RVOSimulator()
        world.set_time_step(step_s)
        world.set_agent_defaults(40.0, 20, 10.0, 10.0, plate.instrument.min_separation_mm / 2, speed)
        for point in start:
            world.add_agent(tuple(point))
        now, last_s, n_away = start.copy(), 0.0, len(start)
        for k in range(int(4 * distance.max() / speed / step_s)):
            wanted = goal - now
            away = np.hypot(*wanted.T)
            fastest = np.minimum(speed, away / step_s) / np.maximum(away, 1e-12)
            for robot, velocity in enumerate(wanted * fastest[:, None]):
                world.set_agent_pref_velocity(robot, tuple(velocity))
            world.do_step()
            now = np.array([[*_xy(world.get_agent_position(robot))] for robot in range(len(start))])
            is_away = np.hypot(*(goal - now).T) > 0.05
            n_away, last_s = int(is_away.sum()), (k + 1) * step_s
            if n_away == 0:
                break
        return last_s, n_away

    last_s, n_away = benchmark.pedantic(run, rounds=2, warmup_rounds=0)
    benchmark.extra_info["unrouted"] = n_away
    benchmark.extra_info["ratio_to_bound"] = last_s / (distance.max() / speed)
    benchmark.extra_info["ratio_to_assignment"] = benchmark.stats.stats.median / yardstick_s()


def _xy(vector) -> tuple[float, float]:
    """Coordinates of a `pyrvo` vector, whichever way this version gives them."""
    return (vector.x, vector.y) if hasattr(vector, "x") else (vector[0], vector[1])
