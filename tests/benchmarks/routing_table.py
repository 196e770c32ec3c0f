"""The table of docs/routing.md: `python -m tests.benchmarks.routing_table [--visits 200] [--only WORD ...]`.

Each row routes and proves many paths of one kind of field. Matched fields are chains of ten visits, each matched from the
one before by least sum of distance^4, routed three ways. The bound is that of the slowest robot alone; with dead robots, of
the slowest on its shortest way around them. "With exchanges" targets are matched and exchanged as at the telescope; its time
holds all that. The independent check's kernel looks for pairs nearer than the separation.
Times are CPU time, also over one assignment of 150 robots to 1,500 targets in the same run.
"""

import argparse
import importlib.util
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context

import numpy as np
from rich.console import Console
from rich.progress import track

from survey_sim.instrument import Plate, load_instrument, make_plate
from survey_sim.routing import ROUTERS, RoutedPath, RoutingSettings, UnroutedReason, route
from survey_sim.simulation import SimulationSettings, execute
from survey_sim.survey.tile import State
from survey_sim.survey.transitions.chains import ChainBatch, Goal, best_way
from tests.benchmarks.orca import steer
from tests.benchmarks.yardstick import yardstick_s
from tests.fields import chain, matched_field, random_field
from tests.naive_routing import time_around_s
from tests.proved import SEPARATION_TOLERANCE_MM, count_too_near

CHAIN = 10
HEAD = (
    *("paths", "arrive %", "at bound %", "within 5 %", "ratio p50", "p99", "p99.9", "max"),
    *("ms p50", "p99", "max", "p50 / assignment", "too near"),
)
EXECUTION_HEAD = ("fields", "below 9 mm %", "contact %", "time / planned: mean", "max")


@dataclass(frozen=True)
class Task:
    """One path to be routed."""

    label: str
    plate: Plate
    start_mm: np.ndarray
    theta_deg: np.ndarray
    goal_mm: np.ndarray


@dataclass(frozen=True)
class Measured:
    """What came of it; `ratio` is configuration time over bound."""

    label: str
    ratio: float
    n_live: int
    n_unrouted: int
    cpu_ms: float
    n_near: int


def matched(instrument: str, n_target: int, router: str, seed: int) -> Iterator[tuple[Task, RoutedPath, float]]:
    """A chain of visits, each routed three ways."""
    plate = make_plate(load_instrument(instrument))
    theta, still = np.zeros(plate.n_robot), np.zeros(plate.n_robot)
    settings = RoutingSettings.load({"router": router})
    at = plate.park_mm.copy()
    for start, goal in chain(plate, CHAIN, n_target, np.random.default_rng(seed)):
        # What a router leaves behind, it leaves in the way: each path is a problem of its own.
        moved = Task("start_to_target", plate, start, theta if (at == start).all() else still, goal)
        path, ms = timed(moved, settings, seed)
        yield moved, path, ms
        for task in (
            Task("start_to_park", plate, moved.start_mm, moved.theta_deg, plate.park_mm),
            Task("park_to_target", plate, plate.park_mm, still, goal),
        ):
            if (task.start_mm != task.goal_mm).any():
                yield task, *timed(task, settings, seed)
        at, theta = path.end_mm, path.end_theta_deg


def with_dead(n_dead: int, router: str, seed: int) -> Iterator[tuple[Task, RoutedPath, float]]:
    """Robots that died where they stood in the last of three visits; the next visit."""
    rng = np.random.default_rng(seed)
    plate = make_plate(load_instrument("taipan-150"))
    at = list(chain(plate, 3, 160, rng))[-1][1]
    dead = rng.choice(plate.robot_id[~plate.is_guide], n_dead, replace=False)
    plate = make_plate(load_instrument("taipan-150"), tuple(int(robot) for robot in dead))
    task = Task("start_to_target", plate, at, np.zeros(plate.n_robot), matched_field(plate, at, 160, rng).goal_mm)
    yield task, *timed(task, RoutingSettings.load({"router": router}), seed)


def exchanged(n_dead: int, n_target: int, seed: int) -> Iterator[tuple[Task, RoutedPath, float]]:
    """The last of four visits, robots dead as in `with_dead`; who holds it up exchanges targets, as at the telescope."""
    rng = np.random.default_rng(seed)
    plate = make_plate(load_instrument("taipan-150"))
    at = list(chain(plate, 3, n_target, rng))[-1][1]
    dead = rng.choice(plate.robot_id[~plate.is_guide], n_dead, replace=False)
    plate = make_plate(load_instrument("taipan-150"), tuple(int(robot) for robot in dead))
    field, robot = matched_field(plate, at, n_target, rng), np.arange(plate.n_robot)
    target = np.where(field.is_assigned, robot, -1)
    goal = Goal(("field", 0, seed), target, np.where(field.is_assigned, 0, -1).astype(np.int8), field.goal_mm, 4.0)
    batch = ChainBatch((), plate, RoutingSettings(), seed)
    begin = time.process_time()
    way = best_way(batch, goal, State(at, np.zeros(plate.n_robot)))
    ms = 1e3 * (time.process_time() - begin)
    yield Task("start_to_target", plate, at, np.zeros(plate.n_robot), way.goal_mm), way.routed[0], ms


def unmatched(router: str, seed: int) -> Iterator[tuple[Task, RoutedPath, float]]:
    """Goals anywhere in reach, from park."""
    plate = make_plate(load_instrument("taipan-150"))
    goal = random_field(plate, plate.park_mm, np.random.default_rng(seed)).goal_mm
    task = Task("park_to_target", plate, plate.park_mm, np.zeros(plate.n_robot), goal)
    yield task, *timed(task, RoutingSettings.load({"router": router}), seed)


def timed(task: Task, settings: RoutingSettings, seed: int) -> tuple[RoutedPath, float]:
    """The path, and the CPU time that it took, ms."""
    begin = time.process_time()
    path = route(task.plate, task.start_mm, task.theta_deg, task.goal_mm, settings, np.random.default_rng(seed))
    return path, 1e3 * (time.process_time() - begin)


def warm() -> None:
    """Load what is compiled, so that no measured path waits for it."""
    for router in ROUTERS:
        for task, path, _ in with_dead(1, router, 0):
            count_too_near(task.plate, task.start_mm, path.legs)


def measure(make: Callable[[int], Iterator[tuple[Task, RoutedPath, float]]], seed: int) -> list[Measured]:
    """Route and prove the paths of one seed."""
    rows = []
    for task, path, ms in make(seed):
        plate, is_routed = task.plate, path.reason == UnroutedReason.ARRIVED
        bound_s = path.lower_bound_s
        if not plate.is_live.all():
            bound_s = max(bound_s, time_around_s(plate, task.start_mm, task.theta_deg, task.goal_mm, is_routed))
        ratio = path.configuration_time_s / bound_s if bound_s > 0 else 1.0
        n_live = int(plate.is_live.sum())
        n_lost = int((plate.is_live & ~is_routed & (path.reason != UnroutedReason.UNREACHABLE)).sum())
        rows.append(Measured(task.label, ratio, n_live, n_lost, ms, count_too_near(task.plate, task.start_mm, path.legs)))
    return rows


def orca(make: Callable[[int], Iterator[tuple[Task, RoutedPath, float]]], seed: int) -> list[Measured]:
    """The fields of one seed by the baseline."""
    import pyrvo

    rows = []
    for task, _, _ in make(seed):
        instrument = task.plate.instrument
        begin = time.process_time()
        done = steer(pyrvo, task.start_mm, task.goal_mm, instrument.coarse_speed_mm_s, instrument.min_separation_mm)
        ms = 1e3 * (time.process_time() - begin)
        is_near = done.min_separation_mm < instrument.min_separation_mm - SEPARATION_TOLERANCE_MM
        rows.append(Measured(task.label, done.ratio, task.plate.n_robot, done.n_away, ms, int(is_near)))
    return rows


def executed(mode: str, frac: float, seed: int) -> list[tuple[float, bool, bool]]:
    """Time over planned, below the separation, in contact: the matched fields of one seed played with errors of speed."""
    settings = SimulationSettings.load({"mode": mode, "leg_speed_scatter_frac": frac})
    rows = []
    for task, path, _ in matched("taipan-150", 160, "coordinated", seed):
        done = execute(task.plate, task.start_mm, path.legs, settings, np.random.default_rng(seed))
        rows.append((done.moving_time_s / path.configuration_time_s, done.collisions > 0, done.contacts > 0))
    return rows


def cases(n_visit: int) -> dict[str, tuple[Callable[[int], list], int]]:
    """What is measured: by name, a function of a seed, and how many seeds."""
    n_chain = max(1, n_visit // CHAIN)
    few = max(1, n_chain // 10)
    found: dict[str, tuple[Callable[[int], list], int]] = {}
    many = {
        "paper": (151, n_chain),
        "taipan-150": (160, n_chain),
        "taipan-300": (320, max(1, n_chain // 4)),
        "manifest": (620, few),
    }
    for instrument, (n_target, n) in many.items():
        found[f"coordinated, {instrument}"] = partial(measure, partial(matched, instrument, n_target, "coordinated")), n
    for n_dead in (5, 15):
        found[f"coordinated, {n_dead} dead"] = partial(measure, partial(with_dead, n_dead, "coordinated")), n_visit
    for n_dead in (0, 5, 15):
        found[f"with exchanges, {n_dead} dead"] = partial(measure, partial(exchanged, n_dead, 160)), n_visit
    found["coordinated, random"] = partial(measure, partial(unmatched, "coordinated")), max(1, n_visit // 4)
    for router in ("simple-vector", "traffic-light", "cooperative-astar"):
        found[f"{router}, taipan-150"] = partial(measure, partial(matched, "taipan-150", 160, router)), few
        found[f"{router}, random"] = partial(measure, partial(unmatched, router)), few
    if importlib.util.find_spec("pyrvo"):
        found["ORCA, taipan-150"] = partial(orca, partial(matched, "taipan-150", 160, "coordinated")), 1
        found["ORCA, random"] = partial(orca, partial(unmatched, "simple-vector")), few
    for mode in ("open-loop", "resync", "keep-order"):
        found[f"execution, 2 % a leg, {mode}"] = partial(executed, mode, 0.02), n_chain
    return found


def rows_of(name: str, results: list) -> Iterator[list[str]]:
    """Rows of the printed table."""
    if name.startswith("execution"):
        ratio, is_near, is_touching = np.array(results, dtype=float).T
        figures = (len(ratio), 100 * is_near.mean(), 100 * is_touching.mean(), ratio.mean(), ratio.max())
        yield [name, *(f"{figure:.4g}" for figure in figures)]
        return
    labels = dict.fromkeys(row.label for row in results)
    for label in labels:
        own = [row for row in results if row.label == label]
        yield [f"{name}, {label}", *path_figures(own)]
    if len(labels) > 1:
        yield [f"{name}, all", *path_figures([replace(row, label="all") for row in results])]


def path_figures(rows: list[Measured]) -> list[str]:
    """Figures of `HEAD`."""
    ratio, ms = np.array([row.ratio for row in rows]), np.array([row.cpu_ms for row in rows])
    arrive = 1.0 - sum(row.n_unrouted for row in rows) / sum(row.n_live for row in rows)
    quantiles = np.quantile(ratio, [0.5, 0.99, 0.999, 1.0])
    times = np.quantile(ms, [0.5, 0.99, 1.0])
    figures = [f"{len(rows)}", f"{100 * arrive:.3f}", f"{100 * (ratio <= 1 + 1e-9).mean():.1f}"]
    figures.append(f"{100 * (ratio <= 1.05).mean():.1f}")
    figures += [f"{value:.3f}" for value in quantiles] + [f"{value:.1f}" for value in times]
    return [*figures, f"{times[0] / 1e3 / yardstick_s():.1f}", f"{sum(row.n_near for row in rows)}"]


def main() -> None:
    """Measure and print Markdown tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--visits", type=int, default=200, help="of the instruments with 150 robots; others have fewer")
    parser.add_argument("--only", nargs="*", default=[], metavar="WORD", help="cases whose names hold one of these")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    given = parser.parse_args()
    print(f"one assignment: {1e3 * yardstick_s():.3f} ms\n", flush=True)
    head: tuple[str, ...] = ()
    with ProcessPoolExecutor(given.workers, get_context("spawn"), warm) as pool:
        for name, (do, n_seed) in cases(given.visits).items():
            if given.only and not any(word in name for word in given.only):
                continue
            made = track(pool.map(do, range(1, n_seed + 1)), name, n_seed, console=Console(stderr=True))
            results = [row for rows in made for row in rows]
            wanted = EXECUTION_HEAD if name.startswith("execution") else HEAD
            if wanted != head:
                head = wanted
                print("\n| " + " | ".join(("fields", *head)) + " |\n|" + "---|" * (len(head) + 1))
            for row in rows_of(name, results):
                print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
