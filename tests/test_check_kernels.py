"""Least distances in closed form against dense sampling and against search; crossings against a plain loop."""

from math import cos, hypot, inf, radians, sin, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from survey_sim.check.kernels import count_crossings, least_separations
from tests import naive_check as naive
from tests.hand_run import crosses

State = tuple[float, float, float]
SEPARATION = 9.0


def solve(
    starts: list[State], legs: list[list[dict]], limit: float = SEPARATION
) -> tuple[float, int, list[tuple[int, int, float, float]]]:
    """The kernel's least distance, number of near pairs, and the pairs, of one path; legs need only their instructions."""
    rows = []
    for start, own in zip(starts, legs, strict=True):
        x, y, theta = start
        for leg in own:
            theta += leg["rotate_deg"]
            c, s = cos(radians(theta)), sin(radians(theta))
            x, y = x + c * leg["dx_mm"] - s * leg["dy_mm"], y + s * leg["dx_mm"] + c * leg["dy_mm"]
            instruction = [leg["dx_mm"], leg["dy_mm"], leg["precise_mm"]]
            rows.append([leg["start_s"], abs(leg["rotate_deg"]) / naive.TURNING, *instruction, c, s, x, y])
    first_leg = np.cumsum([0, *map(len, legs)])
    near = np.full((10, 4), np.nan)
    start_mm = np.array(starts).reshape(-1, 3)[:, :2].copy()
    first_row = np.array([0, len(starts)])
    speeds = (naive.COARSE, naive.PRECISE)
    least, n_near = least_separations(1, first_row, start_mm, first_leg, np.array(rows).reshape(-1, 9), *speeds, limit, near)
    pairs = [(int(i), int(j), d, t) for i, j, d, t in near if np.isfinite(d)]
    return float(least[0, 0]), int(n_near[0, 0]), pairs


def going(dx: float, dy: float = 0.0, *, start: float = 0.0, turn: float = 0.0, precise: float = 0.0) -> dict:
    """One leg."""
    return {"start_s": start, "rotate_deg": turn, "dx_mm": dx, "dy_mm": dy, "precise_mm": precise}


def test_robots_that_stand() -> None:
    assert solve([(0, 0, 0), (3, 4, 0), (30, 0, 0)], [[], [], []]) == (5.0, 1, [(0, 1, 5.0, 0.0)])


def test_fewer_than_two_robots() -> None:
    assert solve([(0, 0, 0)], [[going(3.0)]]) == (inf, 0, [])
    assert solve([], []) == (inf, 0, [])


def test_robots_that_meet_head_on() -> None:
    least, _, pairs = solve([(0, 0, 0), (20, 0, 180)], [[going(20.0)], [going(20.0)]])
    assert least == pytest.approx(0.0, abs=1e-12)
    assert pairs[0][3] == pytest.approx(5.0)


def test_robots_that_pass_at_right_angles() -> None:
    """Both reach the crossing of their lines at 5 s and 6 s: nearest between them."""
    least, n_near, _ = solve([(-10, 0, 0), (0, -12, 90)], [[going(20.0)], [going(20.0)]])
    assert least == pytest.approx(sqrt(2.0))
    assert n_near == 1


def test_pair_at_exactly_the_limit_is_no_collision() -> None:
    starts, legs = [(-10, 0, 0), (0, 9, 0)], [[going(20.0)], []]
    assert solve(starts, legs, 9.0)[:2] == (9.0, 0)
    assert solve(starts, legs, np.nextafter(9.0, 10.0))[:2] == (9.0, 1)


def test_waiting_makes_the_difference() -> None:
    start = [(-20.0, 0.0, 0.0), (0.0, -20.0, 90.0)]
    assert solve(start, [[going(40.0)], [going(40.0)]])[0] == pytest.approx(0.0, abs=1e-9)
    assert solve(start, [[going(40.0)], [going(40.0, start=20.0)]])[0] == pytest.approx(20.0)


def test_turn_and_precise_approach_take_time() -> None:
    """A robot that turns by 35 deg for 1 s and goes its last 0.6 mm in 2 s, while another passes its end."""
    slow = going(2.6, turn=35.0, precise=0.6)
    goal = (2.6 * cos(radians(35)), 2.6 * sin(radians(35)))
    for t, place in ((1.0, 0.0), (2.0, 2.0), (3.0, 2.3), (4.0, 2.6)):
        x, y = goal[0] / 2.6 * place, goal[1] / 2.6 * place
        assert naive.position((0, 0, 0), [slow], t) == pytest.approx((x, y))
    # The other goes along y = -9 and is below the first's start after 1 s, when that has just turned.
    other = (-2.0, -9.0, 0.0)
    assert solve([(0, 0, 0), other], [[slow], [going(30.0)]])[0] == pytest.approx(
        naive.least_distance((0, 0, 0), [slow], other, [going(30.0)]), abs=1e-9
    )


@st.composite
def robots(draw: st.DrawFn) -> tuple[State, list[dict]]:
    """A robot near the others, with up to three legs of either kind."""
    place = st.floats(-12, 12)
    start = (draw(place), draw(place), draw(st.floats(-180, 179)))
    legs: list[dict] = []
    end = 0.0
    for _ in range(draw(st.integers(0, 3))):
        dx, dy = draw(st.floats(-15, 15)), draw(st.floats(-15, 15))
        turn = draw(st.floats(-45, 45)) if draw(st.booleans()) else 0.0
        if turn:
            dx, dy = (dx, 0.0) if draw(st.booleans()) else (0.0, dy)
        length = abs(dx) + abs(dy)
        precise = draw(st.sampled_from([0.0, 0.02, 1.0, length / 2, length]))
        legs.append(going(dx, dy, start=end + draw(st.floats(0, 3)), turn=turn, precise=min(precise, length)))
        end = naive.leg_end_s(legs[-1])
    return start, legs


@settings(max_examples=150, deadline=None)
@given(st.lists(robots(), min_size=2, max_size=3))
def test_least_distance_against_dense_sampling(field: list[tuple[State, list[dict]]]) -> None:
    starts, legs = [robot[0] for robot in field], [robot[1] for robot in field]
    least, n_near, _ = solve(starts, legs)
    end = max((naive.leg_end_s(own[-1]) for own in legs if own), default=0.0)
    step = max(end / 400, 1e-3)
    sampled, n_sampled = inf, 0
    times = np.append(np.arange(0.0, end, step), end)
    places = [np.array([naive.position(start, own, t) for t in times]) for start, own in field]
    for i in range(len(field)):
        for j in range(i):
            distance = np.hypot(*(places[i] - places[j]).T).min()
            sampled = min(sampled, distance)
            n_sampled += distance < SEPARATION
    # Robots near each other at 4 mm/s at most: between samples they cannot come much nearer.
    assert least <= sampled + 1e-9
    assert least >= sampled - 2 * naive.COARSE * step
    assert n_near >= n_sampled


@settings(max_examples=150, deadline=None)
@given(st.lists(robots(), min_size=2, max_size=4))
def test_least_distance_against_search(field: list[tuple[State, list[dict]]]) -> None:
    starts, legs = [robot[0] for robot in field], [robot[1] for robot in field]
    least, n_near, pairs = solve(starts, legs)
    distances = {
        (j, i): naive.least_distance(starts[j], legs[j], starts[i], legs[i]) for i in range(len(field)) for j in range(i)
    }
    assert least == pytest.approx(min(distances.values()), abs=1e-6)
    clear = {pair for pair, d in distances.items() if abs(d - SEPARATION) > 1e-6}
    assert {(i, j) for i, j, *_ in pairs} & clear == {pair for pair in clear if distances[pair] < SEPARATION}
    assert n_near == len(pairs)
    for i, j, d, t in pairs:
        (xi, yi), (xj, yj) = naive.position(starts[i], legs[i], t), naive.position(starts[j], legs[j], t)
        assert hypot(xi - xj, yi - yj) == pytest.approx(d, abs=1e-6)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(*[st.integers(-5, 5)] * 4), min_size=0, max_size=6))
def test_crossings_against_plain_loop(lines: list[tuple[int, int, int, int]]) -> None:
    ends = np.array(lines, dtype=np.float64).reshape(-1, 4)
    first_row = np.array([0, len(lines)])
    segments = [((a, b), (c, d)) for a, b, c, d in lines]
    wanted = sum(crosses(*segments[i], *segments[j]) for i in range(len(lines)) for j in range(i))
    assert count_crossings(first_row, ends[:, :2].copy(), ends[:, 2:].copy()).tolist() == [wanted]


def test_crossings_of_visits_apart() -> None:
    start = np.array([[0.0, 0.0], [0.0, 1.0], [0.0, 0.0], [5.0, 5.0]])
    end = np.array([[1.0, 1.0], [1.0, 0.0], [1.0, 1.0], [6.0, 6.0]])
    assert count_crossings(np.array([0, 2, 4]), start, end).tolist() == [1, 0]
