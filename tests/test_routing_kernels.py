"""Compiled geometry of routing against plain loops."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from survey_sim.instrument import load_instrument
from survey_sim.motion import alone_time_s, leg_times_s, make_legs, make_trajectories
from survey_sim.routing.kernels import conflicts, coordinate, delays, parted, planned, repair, shapes
from tests import naive_routing as naive

R = 9.0
INSTRUMENT = load_instrument("taipan-150")
PHYSICS = planned.Physics(2.0, 0.3, 35.0, 0.02, 163.5)


def _knots(rng):
    n = rng.integers(1, 6)
    t, x, y = np.sort(rng.uniform(0, 20, n)), rng.uniform(-15, 15, n), rng.uniform(-15, 15, n)
    for k in range(1, n):
        if rng.random() < 0.3:
            x[k], y[k] = x[k - 1], y[k - 1]
    return t, x, y


def _box(knots):
    return np.array([knots[1].min(), knots[1].max(), knots[2].min(), knots[2].max()])


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_forbidden_delays_are_those_of_brute_force(seed):
    rng = np.random.default_rng(seed)
    a, b = _knots(rng), _knots(rng)
    rests = [-1, *(k for k in range(len(a[0]) - 1) if (a[1][k], a[2][k]) == (a[1][k + 1], a[2][k + 1]))]
    rest = rests[rng.integers(len(rests))]
    lo, hi = np.empty(16), np.empty(16)
    n = delays.forbidden_delays(*a, len(a[0]), rest, *b, len(b[0]), _box(b), R, 25.0, lo, hi)
    assert (lo[:n] < hi[:n]).all()
    assert (hi[: max(n - 1, 0)] < lo[1:n]).all()
    for delay in rng.uniform(0, 25, 12):
        nearest = naive.sampled_distance(naive.late(a, rest, delay), a, b[0], b)
        if abs(nearest - R) > 0.02:
            assert bool(((lo[:n] < delay) & (delay < hi[:n])).any()) == (nearest < R)


def test_full_speed_straight_lines_have_one_forbidden_interval():
    rng = np.random.default_rng(2)
    lo, hi = np.empty(16), np.empty(16)
    for _ in range(200):
        (xa, ya), (xb, yb) = rng.uniform(-40, 40, (2, 2, 2))
        ta, tb = (np.array([0.0, np.hypot(x[1] - x[0], y[1] - y[0]) / 2]) for x, y in ((xa, ya), (xb, yb)))
        # All delays of either robot: as if the second started 100 s late.
        assert delays.forbidden_delays(ta, xa, ya, 2, -1, tb + 100.0, xb, yb, 2, _box((tb, xb, yb)), R, 300.0, lo, hi) <= 1


def test_interval_ends_are_exact_contact():
    # Crossing at right angles at 2 mm/s: nearest approach is |delay| * 2 / sqrt(2) mm.
    line = np.array([0.0, 40.0])
    t, x, y = line, line * 2 - 40, np.zeros(2)
    lo, hi = np.empty(16), np.empty(16)
    n = delays.forbidden_delays(t, x, y, 2, -1, t + 20.0, y, x, 2, _box((t, y, x)), R, 100.0, lo, hi)
    assert n == 1
    assert lo[0] == pytest.approx(20 - R / np.sqrt(2), abs=1e-9)
    assert hi[0] == pytest.approx(20 + R / np.sqrt(2), abs=1e-9)


def test_both_ends_of_the_line_blocked_leave_no_delay():
    t, x, y = np.array([0.0, 22.5]), np.array([0.0, 45.0]), np.zeros(2)
    other_t, other_x = np.array([0.0, 6.0]), np.array([20.0, 32.0])
    lo, hi = np.empty(16), np.empty(16)
    n = delays.forbidden_delays(
        t, x, y, 2, -1, other_t, other_x, np.zeros(2), 2, _box((other_t, other_x, np.zeros(2))), R, 1e3, lo, hi
    )
    assert n == 1
    assert lo[0] < 0
    assert hi[0] == np.inf


def _tasks(start, goal):
    """Records of free robots with a patrol radius of 50 mm around their starts, theta 0."""
    tasks = np.zeros(len(start), planned.ROBOT)
    for name, values in zip(("sx", "sy", "gx", "gy", "park_x", "park_y"), np.hstack([start, goal, start]).T, strict=True):
        tasks[name] = values
    tasks["hx"], tasks["reach"], tasks["is_free"] = 1.0, 50.0, True
    return tasks


@given(st.floats(-180, 179), st.floats(-40, 40), st.floats(-40, 40), st.booleans())
@settings(max_examples=60, deadline=None)
def test_kernel_legs_are_the_legs_of_motion(theta, x, y, is_turned):
    assume(np.hypot(x, y) > 0.1)
    way = np.array([[x, y], [x + 3.0, y - 8.0]])
    robot, turned = np.zeros(2, dtype=np.int32), np.array([is_turned, True])
    heading = np.cos(np.radians(theta)), np.sin(np.radians(theta))
    task = _tasks(np.zeros((1, 2)), way[1:])
    task["hx"], task["hy"] = heading
    task["reach"] = 160.0
    plan = np.zeros(1, planned.PLAN)
    for name, values in (("x", way[:, 0]), ("y", way[:, 1]), ("turned", turned), ("wait", (0.0, 4.0))):
        plan[name][0, :2] = values
    end = planned.build_knots(PHYSICS, task[0], plan[0], 2)
    n, knot_t, knot_x, knot_y = (plan[name][0] for name in ("n_knot", "kt", "kx", "ky"))
    turned_s, square_s = planned.leg_options(PHYSICS, *heading, x, y, False)
    start_s = np.array([0.0, (turned_s if is_turned else square_s) + 4.0])
    legs = make_legs(INSTRUMENT, np.zeros((1, 2)), np.array([theta]), robot, start_s, way, turned)
    if is_turned and abs(abs(legs.rotate_deg[0]) - 45) > 1e-6:
        after = np.radians(legs.theta_deg[0])
        assert planned.turned_heading(*heading, x, y) == pytest.approx((np.cos(after), np.sin(after)), abs=1e-9)
    assert end == pytest.approx(start_s[1] + np.sum(leg_times_s(INSTRUMENT, legs), axis=0)[1])
    knots = make_trajectories(INSTRUMENT, np.zeros((1, 2)), legs)
    when = np.linspace(0, end, 50)
    np.testing.assert_allclose(np.interp(when, knot_t[:n], knot_x[:n]), np.interp(when, knots.t_s, knots.x_mm), atol=1e-7)
    np.testing.assert_allclose(np.interp(when, knot_t[:n], knot_y[:n]), np.interp(when, knots.t_s, knots.y_mm), atol=1e-7)


@given(st.floats(-180, 179), st.floats(-40, 40), st.floats(-40, 40))
def test_kernel_time_alone_is_that_of_motion(theta, x, y):
    times = planned.leg_options(PHYSICS, np.cos(np.radians(theta)), np.sin(np.radians(theta)), x, y, True)
    alone = alone_time_s(INSTRUMENT, np.zeros((1, 2)), np.array([theta]), np.array([[x, y]]))[0]
    assert min(times) == pytest.approx(alone, abs=1e-9)


def test_near_robots_are_those_that_any_way_in_time_may_meet():
    """From (0, 0) to (20, 0) in 16 s: ways of 32 mm, which reach 6 mm beyond either end."""
    places = np.array([[0.0, 0.0], [34.9, 0.0], [35.1, 0.0], [10.0, 24.9], [10.0, 25.1], [10.0, 5.0]])
    n = len(places)
    goal = places.copy()
    goal[0] = [20.0, 0.0]
    plans = conflicts.stand_still(_tasks(places, goal), np.zeros(n, planned.PLAN))
    near = np.empty(n, dtype=np.int64)

    def found():
        n_near = conflicts.find_near(PHYSICS, plans.robot, plans.plan, plans.conflict, 0, 16.0, R, 0.0, near)
        return near[:n_near].tolist()

    assert sorted(found()) == [1, 3, 5]
    shapes.start_directly(PHYSICS, plans, R, 0.0)
    assert found() == [5, 3, 1]


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_parted_is_what_a_flood_fill_finds(seed):
    rng = np.random.default_rng(seed)
    fixed = np.empty((0, 2))
    for point in rng.uniform(-35, 35, (60, 2)):
        if len(fixed) < 14 and (np.hypot(*(fixed - point).T) > R).all():
            fixed = np.vstack([fixed, point])
    reach, park = 30.0, rng.uniform(-5, 5, 2)
    free = [
        point
        for point in rng.uniform(-30, 30, (200, 2)) + park
        if np.hypot(*(point - park)) < reach - 1 and np.hypot(*(fixed - point).T).min() > R + 0.5
    ]
    if len(free) < 2:
        return
    start, goal = free[0], free[1]
    # Gaps about as wide as the grid's pitch cannot be told by the fill.
    gap = np.hypot(*(fixed[:, None] - fixed[None]).transpose(2, 0, 1))
    edge = reach - np.hypot(*(fixed - park).T)
    if (np.abs(gap - 2 * R) < 0.8).any() or (np.abs(edge - R) < 0.8).any():
        return
    found = parted.is_parted(*start, *goal, fixed, R, *park, reach, 163.5)
    assert found == naive.is_parted(start, goal, fixed, R, park, reach, 163.5)


def test_ring_of_robots_parts_inside_from_outside():
    angle = np.arange(6) * np.pi / 3
    ring = 15.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    assert parted.is_parted(0.0, 0.0, 30.0, 5.0, ring, R, 0.0, 0.0, 50.0, 163.5)
    assert not parted.is_parted(0.0, 0.0, 30.0, 5.0, ring[1:], R, 0.0, 0.0, 50.0, 163.5)
    # A chain from edge to edge of the patrol disc.
    wall = np.column_stack([np.zeros(7), np.arange(-3, 4) * 16.0])
    assert parted.is_parted(-20.0, 0.0, 20.0, 3.0, wall, R, 0.0, 0.0, 50.0, 163.5)
    assert not parted.is_parted(-20.0, 0.0, -20.0, 3.0, wall, R, 0.0, 0.0, 50.0, 163.5)


# A robot whose way leads over another that has hardly anywhere to go: with a plan that ends a rounding error after the
# bound, the search for the pair's least duration once went on for ever.
_TIGHT_BOUND_S = 17.017137617342993
_TIGHT_PAIR = np.zeros(2, dtype=planned.ROBOT)
for _name, _values in {
    **{"sx": (108.45, 120.5), "sy": (104.35606115602485, 83.48484892481989)},
    **{"gx": (125.80280661681235, 119.13443971463191), "gy": (77.41301515385823, 83.4572590815885)},
    **{"hx": (1.0, 1.0), "park_x": (108.45, 120.5), "park_y": (104.35606115602485, 83.48484892481989)},
    **{"reach": (50.0, 50.0), "alone": (_TIGHT_BOUND_S, 0.7532417309664029), "is_free": (True, True)},
}.items():
    _TIGHT_PAIR[_name] = _values
# Searches in which it ends are at most six.
_MANY = 60


class _EndlessError(Exception):
    pass


def _least_of_tight_pair(tolerance_s, seed):
    """Least duration that is found, s; _EndlessError after too many searches."""
    n_search, search = 0, repair.repair

    def counted(*args):
        nonlocal n_search
        n_search += 1
        if n_search > _MANY:
            raise _EndlessError
        return search(*args)

    plans = conflicts.stand_still(_TIGHT_PAIR.copy(), np.zeros(2, planned.PLAN))
    plans = plans._replace(robot=plans.robot.view(np.recarray))
    least = getattr(coordinate.least_of_pair, "py_func", coordinate.least_of_pair)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(coordinate, "repair", counted)
        patch.setattr(coordinate, "SAME_DELAY_S", tolerance_s)
        effort, rng = coordinate.Effort(12, 40, 60, 100, 300), np.random.default_rng(seed)
        return least(PHYSICS, plans, rng, 0, 1, _TIGHT_BOUND_S, effort, R - 0.9e-6, 0.0)


@pytest.mark.parametrize("seed", [2, 5, 6])
def test_a_pair_that_ends_a_rounding_error_late_is_at_the_bound(seed):
    assert _least_of_tight_pair(delays.SAME_DELAY_S, seed) == _TIGHT_BOUND_S
    with pytest.raises(_EndlessError):
        _least_of_tight_pair(0.0, seed)
