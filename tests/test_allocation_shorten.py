"""Ways made shorter by exchanges: against a plain search for one more exchange that gains, and the rules of a plan."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from survey_sim.allocation.kernels.lists import near_lists, reach_lists
from survey_sim.allocation.kernels.shorten import sample_within, shorten
from tests import naive_allocation as naive

POWER, PULL, HOT_MM, COLD_MM = 4.0, 0.3, 10.0, 3.0
PATROL_MM = 14.0
# Gains below this share of the greatest heat do not count.
LEAST = 1.01e-9 * HOT_MM**POWER


class Plan:
    """A legal plan of few robots and visits, drawn at random, and what `shorten` makes of it."""

    def __init__(self, seed, n_visit, n_item, separation, *, n_sweep, capacity):
        rng = np.random.default_rng(seed)
        self.park = np.array([(x, y) for x in (0.0, 12.0, 24.0) for y in (0.0, 12.0)])
        self.start = self.park + rng.uniform(-4, 4, self.park.shape)
        self.xy = rng.uniform(-6, 30, (n_item, 2))
        self.delay = rng.uniform(0, 2000, n_item)
        self.kin = rng.integers(-1, 2, n_item)
        n_robot, everywhere = len(self.park), np.ones(n_item, dtype=bool)
        first, near = near_lists(self.xy[:, 0].copy(), self.xy[:, 1].copy(), separation)
        reach_first, reach_robot = reach_lists(
            self.park, np.full(n_robot, PATROL_MM), np.zeros(n_robot, bool), self.xy, ~everywhere, everywhere
        )
        self.near = [set(near[first[i] : first[i + 1]].tolist()) for i in range(n_item)]
        self.reach = [set(reach_robot[reach_first[i] : reach_first[i + 1]].tolist()) for i in range(n_item)]
        self.capacity = capacity
        self.before = self.drawn(rng, n_visit, n_robot)
        self.slot = self.before.copy()
        self.visit_of, self.robot_of = self.places(self.slot)
        state = rng.integers(1, 2**63, size=1, dtype=np.uint64)
        shorten(
            n_sweep, HOT_MM**POWER, COLD_MM**POWER, POWER / 2, PULL, self.start, self.park, self.xy, separation,
            np.ones(n_item, dtype=np.int64), self.kin, self.delay, first, near, np.arange(n_item), reach_first, reach_robot,
            np.ones(len(reach_robot), dtype=bool), np.zeros((n_item, n_visit), dtype=bool),
            np.full(n_visit, capacity), sample_within(self.xy, 50.0, n_item, state), self.slot, self.visit_of, self.robot_of,
            state,
        )  # fmt: skip

    def drawn(self, rng, n_visit, n_robot):
        """(n_visit, n_robot) items in places where they may be, a fifth of them waiting."""
        slot = np.full((n_visit, n_robot), -1)
        for item in rng.permutation(len(self.xy))[: -len(self.xy) // 5]:
            place = rng.integers(n_visit), rng.integers(n_robot)
            if slot[place] < 0:
                slot[place] = item
                slot[place] = item if naive.is_legal(slot, self.reach, self.near, self.capacity) else -1
        return slot

    def places(self, slot):
        """Visit and robot of each item, -1 while it waits."""
        visit_of, robot_of = np.full((2, len(self.xy)), -1)
        visit, robot = np.nonzero(slot >= 0)
        visit_of[slot[visit, robot]], robot_of[slot[visit, robot]] = visit, robot
        return visit_of, robot_of

    def cost(self, slot, delay=None):
        return naive.ways_cost(slot, self.start, self.park, self.xy, self.delay if delay is None else delay, POWER, PULL)

    def with_waiting(self, slot):
        """All plans in which an item that waits takes the place of one of its kin."""
        waiting = set(range(len(self.xy))) - set(slot[slot >= 0].tolist())
        for place in zip(*np.nonzero(slot >= 0), strict=True):
            for item in waiting:
                if self.kin[item] == self.kin[slot[place]] >= 0:
                    changed = slot.copy()
                    changed[place] = item
                    yield changed


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.sampled_from([0, 3]))
def test_no_exchange_is_left_that_gains(seed, n_visit, n_sweep):
    plan = Plan(seed, n_visit, 5 * n_visit + 3, 1e-9, n_sweep=n_sweep, capacity=6)
    cost = plan.cost(plan.slot)
    for other in naive.exchanges(plan.slot):
        assert plan.cost(other) > cost - LEAST or not naive.is_legal(other, plan.reach, plan.near, plan.capacity)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.sampled_from([0, 3]))
def test_a_shortened_plan_is_legal_holds_as_many_of_each_kin_and_is_no_dearer(seed, n_visit, n_sweep):
    plan = Plan(seed, n_visit, 6 * n_visit + 3, 7.0, n_sweep=n_sweep, capacity=4)
    assert naive.is_legal(plan.slot, plan.reach, plan.near, plan.capacity)
    kin = [np.bincount(plan.kin[slot[slot >= 0]] + 1, minlength=3).tolist() for slot in (plan.before, plan.slot)]
    assert kin[0] == kin[1]
    np.testing.assert_array_equal((plan.visit_of, plan.robot_of), plan.places(plan.slot))
    if n_sweep == 0 and not set(plan.slot.ravel()) - set(plan.before.ravel()):
        assert plan.cost(plan.slot) <= plan.cost(plan.before)


@pytest.mark.parametrize("seed", range(5))
def test_an_item_that_waits_takes_the_place_of_its_kin_where_that_shortens_ways(seed):
    plan = Plan(seed, 1, 12, 1e-9, n_sweep=0, capacity=6)
    still = np.zeros_like(plan.delay)
    cost = plan.cost(plan.slot, still)
    for other in plan.with_waiting(plan.slot):
        assert plan.cost(other, still) > cost - LEAST or not naive.is_legal(other, plan.reach, plan.near, plan.capacity)
