"""Robots in each other's way: the forbidden delays against a plain loop, and the exchanges that rid them of each other."""

import numpy as np
import pytest

from survey_sim.allocation import AllocationSettings, start_allocation
from survey_sim.allocation.kernels.untangle import forbidden_delays, untangle
from survey_sim.instrument import load_instrument, make_plate
from tests.mock_targets import survey_targets, uniform_xy
from tests.naive_allocation import least_distance_with_delay

RADIUS = 9.0


@pytest.mark.parametrize("seed", range(40))
def test_forbidden_delays_are_those_of_a_plain_loop(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = (rng.uniform(-15, 15, (2, 2)) for _ in range(2))
    if seed % 4 == 0:
        # Exchange of places, or nearly.
        b = a[::-1] + rng.uniform(-3, 3, (2, 2))
    args = []
    for begin, end in (a, b):
        length = np.hypot(*(end - begin))
        args += [*begin, *((end - begin) / length), length]
    low, high = forbidden_delays(*args, RADIUS)
    for delay in rng.uniform(-60, 60, 40):
        least = least_distance_with_delay(a, b, delay)
        if abs(least - RADIUS) > 0.05:
            assert (least < RADIUS) == (low < delay < high)


def test_who_exchange_places_have_no_delay_at_all() -> None:
    low, high = forbidden_delays(0.0, 0.0, 1.0, 0.0, 20.0, 20.0, 0.0, -1.0, 0.0, 20.0, RADIUS)
    assert (low, high) == (-np.inf, np.inf)


def test_an_idle_robot_takes_the_target_of_one_that_exchanges_places() -> None:
    """Robots 0 and 1 exchange places; 2 is idle and may go to the target of 1 instead; 3 sets the time, far away."""
    start = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 9.4], [100.0, 0.0]])
    park = start + np.array([[0.0, -12.0], [0.0, -12.0], [0.0, 8.0], [0.0, 0.0]])
    xy = np.array([[10.0, 0.0], [0.0, 0.5], [130.0, 0.0]])
    reach_first, reach_robot = np.array([0, 1, 3, 4]), np.array([0, 1, 2, 3], dtype=np.int32)
    none, held = np.empty(0, dtype=np.int32), np.array([0, 1, -1, 2])
    before, after = untangle(
        start, park, np.ones(4, dtype=bool), xy, 2.0, 0.3, reach_first, reach_robot, np.ones(4, dtype=bool),
        np.zeros(4, dtype=np.int64), none, np.empty(0, dtype=np.int64), RADIUS, held,
    )  # fmt: skip
    assert held.tolist() == [0, -1, 1, 2]
    assert after < before


@pytest.mark.parametrize("seed", range(3))
def test_every_target_stays_held_in_reach_and_apart(seed: int) -> None:
    plate, targets = make_plate(load_instrument("taipan-150"), dead=(7, 60)), survey_targets(uniform_xy(120, seed), seed)
    settings = AllocationSettings.load({"visits": 4, "wanted_sky": 6, "min_sky": 3, "wanted_standard": 2, "min_standard": 1})
    session = start_allocation(targets, plate, settings, np.random.default_rng(1))
    position, n_done = plate.park_mm, 0
    while (visit := session.next_visit(position)) is not None:
        robots = np.flatnonzero(visit.target >= 0)
        held = visit.target[robots]
        assert len(np.unique(held)) == len(held)
        assert (np.hypot(*(visit.goal_mm - plate.park_mm)[robots].T) <= plate.patrol_radius_mm[robots]).all()
        assert ((targets.kind[held] == 3) == plate.is_guide[robots]).all()
        apart = np.hypot(*(visit.goal_mm[:, None] - visit.goal_mm[None]).transpose(2, 0, 1))
        assert apart[~np.eye(len(apart), dtype=bool)].min() >= RADIUS
        assert plate.is_live[robots].all()
        n_done += visit.counts["science"]
        session.record(visit, np.ones(plate.n_robot, dtype=bool))
        position = visit.goal_mm
    assert n_done == session.is_complete.sum() > 100
