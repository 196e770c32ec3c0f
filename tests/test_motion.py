"""Legs and their physics: hand-worked cases, and invariants of turning."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from survey_sim.instrument import load_instrument
from survey_sim.motion import alone, alone_time_s, leg_times_s, make_legs, make_trajectories, turn_onto_line, wrap_deg

INSTRUMENT = load_instrument("taipan-150")
# 0.02 mm at 0.3 mm/s rather than 2 mm/s.
APPROACH_EXTRA_S = 0.02 / 0.3 - 0.02 / 2.0


def _legs(start, theta, goal, is_turned):
    start, goal = np.array([start], dtype=float), np.array([goal], dtype=float)
    robot = np.zeros(1, dtype=np.int32)
    return make_legs(INSTRUMENT, start, np.array([theta]), robot, np.zeros(1), goal, np.array([is_turned]))


def test_straight_along_own_axis_takes_no_turn():
    legs = _legs([0, 0], 0.0, [0, -10], True)
    assert legs.rotate_deg[0] == 0
    assert (legs.dx_mm[0], legs.dy_mm[0]) == (0, -10)
    assert legs.precise_mm[0] == INSTRUMENT.precise_approach_mm
    assert np.sum(leg_times_s(INSTRUMENT, legs)) == pytest.approx(5 + APPROACH_EXTRA_S)


def test_turned_diagonal_is_45_deg():
    legs = _legs([0, 0], 0.0, [10, 10], True)
    assert abs(legs.rotate_deg[0]) == pytest.approx(45)
    rotating, moving = leg_times_s(INSTRUMENT, legs)
    assert rotating[0] == pytest.approx(45 / 35)
    assert moving[0] == pytest.approx(np.sqrt(200) / 2 + APPROACH_EXTRA_S)


def test_not_turned_goes_x_then_y_of_its_own_frame():
    legs = _legs([1, 1], 90.0, [3, 4], False)
    assert legs.rotate_deg[0] == 0
    assert (legs.dx_mm[0], legs.dy_mm[0]) == (pytest.approx(3), pytest.approx(-2))
    way = make_trajectories(INSTRUMENT, np.array([[1.0, 1.0]]), legs)
    assert (way.x_mm[3], way.y_mm[3]) == (pytest.approx(1), pytest.approx(4))


def test_short_hop_is_all_precise():
    legs = _legs([0, 0], 0.0, [0.01, 0], True)
    assert legs.precise_mm[0] == pytest.approx(0.01)
    assert leg_times_s(INSTRUMENT, legs)[1][0] == pytest.approx(0.01 / 0.3)


def test_only_the_last_leg_is_precise_and_theta_carries_over():
    start, theta = np.zeros((2, 2)), np.array([10.0, 0.0])
    robot = np.array([0, 0, 1], dtype=np.int32)
    way = np.array([[5.0, 0.0], [5.0, 9.0], [-3.0, 0.0]])
    legs = make_legs(INSTRUMENT, start, theta, robot, np.array([0.0, 9.0, 0.0]), way, np.ones(3, dtype=bool))
    assert legs.leg.tolist() == [0, 1, 0]
    assert legs.precise_mm.tolist() == [0, 0.02, 0.02]
    assert legs.rotate_deg.tolist() == [pytest.approx(-10), pytest.approx(0), 0]
    assert legs.dy_mm[1] == 9
    assert legs.dx_mm[2] == -3


def test_alone_is_the_quicker_of_turned_and_not_turned():
    start, theta = np.zeros((3, 2)), np.full(3, 20.0)
    goal = np.array([[2.0, 0.0], [40.0, 0.0], [0.0, 0.0]])
    alone_s = alone_time_s(INSTRUMENT, start, theta, goal)
    a = np.radians(20)
    assert alone_s[0] == pytest.approx(2 * (np.cos(a) + np.sin(a)) / 2 + APPROACH_EXTRA_S)
    assert alone_s[1] == pytest.approx(20 / 35 + 20 + APPROACH_EXTRA_S)
    assert alone_s[2] == 0


def test_alone_ends_as_the_legs_of_the_quicker_way_do():
    rng = np.random.default_rng(4)
    start = rng.uniform(-20.0, 20.0, (200, 2))
    goal = start + rng.normal(0.0, 3.0, start.shape)
    theta = rng.uniform(-180.0, 180.0, 200)
    goal[:5] = start[:5]
    time_s, end_deg = alone(INSTRUMENT, start, theta, goal)
    moves = np.arange(5, 200, dtype=np.int32)
    ways = []
    for is_turned in (True, False):
        flags = np.full(len(moves), is_turned)
        legs = make_legs(INSTRUMENT, start, theta, moves, np.zeros(len(moves)), goal[moves], flags)
        ways.append((sum(leg_times_s(INSTRUMENT, legs)), legs.theta_deg))
    is_turned = ways[0][0] <= ways[1][0]
    assert 20 < is_turned.sum() < 180
    for found, of_ways in ((time_s, [way[0] for way in ways]), (end_deg, [way[1] for way in ways])):
        np.testing.assert_allclose(found[moves], np.where(is_turned, *of_ways), atol=1e-9)
    assert (end_deg[:5] == theta[:5]).all()


def test_no_legs_is_a_path_too():
    empty = np.zeros(0)
    legs = make_legs(
        INSTRUMENT, np.zeros((2, 2)), np.zeros(2), empty.astype(np.int32), empty, empty.reshape(0, 2), empty.astype(bool)
    )
    assert len(legs) == 0
    assert make_trajectories(INSTRUMENT, np.zeros((2, 2)), legs).first.tolist() == [0, 1, 2]


@given(st.floats(-720, 720), st.floats(-50, 50), st.floats(-50, 50))
def test_turn_puts_an_axis_on_the_line(theta, x, y):
    turn = turn_onto_line(np.array([theta]), np.array([x]), np.array([y]))[0]
    assert -45 <= turn <= 45
    heading = np.radians(theta + turn)
    along = max(abs(x * np.cos(heading) + y * np.sin(heading)), abs(y * np.cos(heading) - x * np.sin(heading)))
    assert along == pytest.approx(np.hypot(x, y), abs=1e-9)


@given(st.floats(-1e4, 1e4))
def test_wrapped_angle_is_the_same_angle(angle):
    wrapped = float(wrap_deg(np.array([angle]))[0])
    assert -180 <= wrapped < 180
    assert np.cos(np.radians(wrapped)) == pytest.approx(np.cos(np.radians(angle)), abs=1e-9)


@given(
    st.lists(st.tuples(st.floats(-30, 30), st.floats(-30, 30), st.booleans()), min_size=1, max_size=5),
    st.floats(-180, 179),
)
def test_trajectory_of_any_legs_ends_where_they_say_and_when(points, theta):
    start = np.zeros((1, 2))
    way = np.array([point[:2] for point in points])
    is_turned = np.array([point[2] for point in points])
    robot, start_s = np.zeros(len(way), dtype=np.int32), np.arange(len(way)) * 100.0
    legs = make_legs(INSTRUMENT, start, np.array([theta]), robot, start_s, way, is_turned)
    knots = make_trajectories(INSTRUMENT, start, legs)
    assert (np.diff(knots.t_s) >= -1e-12).all()
    speed = np.hypot(np.diff(knots.x_mm), np.diff(knots.y_mm)) - INSTRUMENT.coarse_speed_mm_s * np.diff(knots.t_s)
    assert speed.max() < 1e-9
    assert knots.t_s[-1] == pytest.approx(start_s[-1] + np.sum(leg_times_s(INSTRUMENT, legs), axis=0)[-1])
    # The instruction alone, from the state before, gives the state after.
    heading = np.radians(legs.theta_deg)
    before = np.vstack([start, way[:-1]])
    x = before[:, 0] + np.cos(heading) * legs.dx_mm - np.sin(heading) * legs.dy_mm
    y = before[:, 1] + np.sin(heading) * legs.dx_mm + np.cos(heading) * legs.dy_mm
    np.testing.assert_allclose(np.column_stack([x, y]), way, atol=1e-9)
