"""Playing legs: times, closed-form separation, ticks, errors of execution and the metrology loop."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from survey_sim.instrument import load_instrument, make_plate
from survey_sim.motion import make_legs
from survey_sim.routing import RoutingSettings, route
from survey_sim.simulation import SimulationSettings, execute, legs_from_ticks, make_ticks, simulate
from survey_sim.simulation.execution import make_pieces
from tests import naive_routing as naive
from tests.fields import matched_field

APPROACH_EXTRA_S = 0.02 / 0.3 - 0.02 / 2.0
MODES = ("open-loop", "resync", "keep-order")


def _plate(park):
    places = tuple((float(x), float(y)) for x, y in park)
    return make_plate(load_instrument("paper", {"n_science": len(places), "park_positions_mm": places}))


def _legs(plate, start, rows):
    """Legs from (robot, start_s, x, y, is_turned) rows."""
    robot, start_s, x, y, turned = (np.array(column) for column in zip(*rows, strict=True))
    way = np.column_stack([x, y]).astype(float)
    theta = np.zeros(plate.n_robot)
    return make_legs(plate.instrument, start, theta, robot, start_s.astype(float), way, turned.astype(bool))


@pytest.fixture(scope="module")
def routed():
    """A routed matched field: plate, start, legs."""
    plate = make_plate(load_instrument("taipan-150"))
    goal = matched_field(plate, plate.park_mm, 170, np.random.default_rng(2)).goal_mm
    path = route(plate, plate.park_mm, np.zeros(plate.n_robot), goal, RoutingSettings(), np.random.default_rng(0))
    assert (path.reason == 0).all()
    return plate, plate.park_mm, path.legs


def test_times_of_hand_worked_robots():
    plate = _plate([[0, 0], [30, 0], [60, 0]])
    legs = _legs(plate, plate.park_mm, [(0, 0, 0, 10, True), (0, 8, 10, 20, True), (1, 3, 30, 4, True)])
    played = simulate(plate, plate.park_mm, np.zeros(3), legs)
    diagonal = np.sqrt(200) / 2 + APPROACH_EXTRA_S
    assert played.rotating_s == pytest.approx([45 / 35, 0, 0])
    assert played.moving_s == pytest.approx([5 + diagonal, 2 + APPROACH_EXTRA_S, 0])
    assert played.waiting_s == pytest.approx([3, 3, 0])
    assert played.configuration_time_s == pytest.approx(8 + 45 / 35 + diagonal)
    assert played.configuration_time_median_s == pytest.approx((8 + 45 / 35 + diagonal + 5 + APPROACH_EXTRA_S) / 2)
    assert played.configuration_time_p95_s == played.configuration_time_s
    assert played.ticks == 3
    assert played.collisions == 0
    assert abs(played.end_theta_deg[0]) == pytest.approx(45)


def test_p95_leaves_out_the_last_twentieth_of_the_movers():
    park = np.column_stack([np.arange(21) * 12.0 - 120, np.zeros(21)])
    plate = _plate(park)
    legs = _legs(plate, park, [(k, 0, park[k, 0], 2.0 * (k + 1), True) for k in range(20)])
    played = simulate(plate, park, np.zeros(21), legs)
    assert played.configuration_time_p95_s == pytest.approx(19 + APPROACH_EXTRA_S)
    assert played.configuration_time_s == pytest.approx(20 + APPROACH_EXTRA_S)
    assert played.configuration_time_median_s == pytest.approx(10.5 + APPROACH_EXTRA_S)


@pytest.mark.parametrize(("passing_mm", "n"), [(8.999, 1), (9.0, 0), (9.5, 0)])
def test_planted_collisions_are_counted_and_contact_is_none(passing_mm, n):
    plate = _plate([[0, 0], [20, passing_mm], [80, 0]])
    legs = _legs(plate, plate.park_mm, [(0, 0, 40, 0, True)])
    played = simulate(plate, plate.park_mm, np.zeros(3), legs)
    assert played.collisions == n
    assert played.min_separation_mm == pytest.approx(passing_mm, abs=1e-9)


def test_crossing_that_sampling_would_miss():
    # They meet at one instant only, between any two samples.
    plate = _plate([[-30, 0], [0, -30.0]])
    legs = _legs(plate, plate.park_mm, [(0, 0.0, 30, 0, True), (1, 0.0, 0, 30, True)])
    played = simulate(plate, plate.park_mm, np.zeros(2), legs)
    assert played.min_separation_mm == pytest.approx(0, abs=1e-9)
    assert played.collisions == 1


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_separation_is_that_of_dense_sampling(seed):
    rng = np.random.default_rng(seed)
    plate = _plate([[0, 0], [15, 0], [0, 15]])
    rows = []
    for robot in range(3):
        clock = 0.0
        for _ in range(rng.integers(0, 3)):
            clock += rng.uniform(0, 5)
            rows.append((robot, clock, *rng.uniform(-20, 20, 2), rng.random() < 0.5))
            clock += 45.0
    if not rows:
        return
    legs = _legs(plate, plate.park_mm, rows)
    played = simulate(plate, plate.park_mm, np.zeros(3), legs)
    sampled = naive.least_separation(plate.instrument, plate.park_mm, legs, played.configuration_time_s)
    # Two robots close at 4 mm/s at most, so samples are no further off than this.
    step = 4.0 * played.configuration_time_s / 399 / 2
    assert sampled - step - 1e-9 <= played.min_separation_mm <= sampled + 1e-9


def test_time_reversed_straight_lines_have_the_same_separation():
    rng = np.random.default_rng(1)
    park = np.array([[0.0, 0.0], [15.0, 0.0], [0.0, 15.0]])
    plate = _plate(park)
    goal = park + rng.uniform(-3, 3, (3, 2)) + [20, 5]
    there = [(k, 0, *goal[k], True) for k in range(3)]
    least = []
    for start, rows in ((park, there), (goal, [(k, 0, *park[k], True) for k in range(3)])):
        least.append(naive.least_separation(plate.instrument, start, _legs(plate, start, rows), 20))
        played = simulate(plate, start, np.zeros(3), _legs(plate, start, rows))
        assert played.min_separation_mm == pytest.approx(least[-1], abs=0.1)
    # Turns and the precise approach come at one end only, so equal to their length, not exactly.
    assert least[0] == pytest.approx(least[1], abs=3.0)


def test_played_ticks_are_the_played_legs(routed):
    plate, start, legs = routed
    ticks = make_ticks(plate.instrument, legs)
    again = simulate(plate, start, np.zeros(plate.n_robot), legs_from_ticks(ticks))
    played = simulate(plate, start, np.zeros(plate.n_robot), legs)
    assert ticks.tick.max() + 1 == played.ticks
    np.testing.assert_array_equal(again.end_mm, played.end_mm)
    np.testing.assert_allclose(again.rotating_s, played.rotating_s, atol=1e-9)
    np.testing.assert_allclose(again.moving_s, played.moving_s, atol=1e-9)
    assert again.configuration_time_s == pytest.approx(played.configuration_time_s, abs=1e-9)
    assert again.min_separation_mm == pytest.approx(played.min_separation_mm, abs=1e-7)
    ticked = legs_from_ticks(ticks)
    for when in np.linspace(0, played.configuration_time_s, 7):
        for robot in (0, 40, 149, 158):
            here, there = (naive.position(plate.instrument, start, each, robot, when) for each in (legs, ticked))
            assert here == pytest.approx(there, abs=1e-7)


def test_a_tick_ends_before_the_next_begins(routed):
    plate, _, legs = routed
    ticks = make_ticks(plate.instrument, legs)
    starts = np.unique(ticks.start_s)
    moved = np.abs(ticks.dx_mm) + np.abs(ticks.dy_mm)
    seconds = (
        np.abs(ticks.dtheta_deg) / plate.instrument.rotation_speed_deg_s
        + (moved - ticks.precise_mm) / plate.instrument.coarse_speed_mm_s
        + ticks.precise_mm / plate.instrument.precise_speed_mm_s
    )
    following = np.append(starts, np.inf)[ticks.tick + 1]
    assert (ticks.start_s + seconds <= following + 1e-9).all()
    assert len(np.unique(np.stack([ticks.tick, ticks.robot]), axis=1).T) == len(ticks)


def test_tick_states_follow_from_their_instructions():
    plate = _plate([[0, 0], [30, 0]])
    rows = [(0, 0, 10, 6, False), (0, 20, 0, 0, True), (1, 0.5, 30, 8, True), (1, 7, 36, 8, True)]
    ticks = make_ticks(plate.instrument, _legs(plate, plate.park_mm, rows))
    state = {0: (0.0, 0.0, 0.0), 1: (30.0, 0.0, 0.0)}
    for k in range(len(ticks)):
        x, y, theta = state[int(ticks.robot[k])]
        theta += ticks.dtheta_deg[k]
        c, s = np.cos(np.radians(theta)), np.sin(np.radians(theta))
        x, y = x + c * ticks.dx_mm[k] - s * ticks.dy_mm[k], y + s * ticks.dx_mm[k] + c * ticks.dy_mm[k]
        assert (ticks.x_mm[k], ticks.y_mm[k]) == (pytest.approx(x, abs=1e-9), pytest.approx(y, abs=1e-9))
        assert np.cos(np.radians(ticks.theta_deg[k] - theta)) == pytest.approx(1)
        state[int(ticks.robot[k])] = (x, y, theta)


@pytest.mark.parametrize("mode", MODES)
def test_no_error_is_the_plan(routed, mode):
    plate, start, legs = routed
    played = simulate(plate, start, np.zeros(plate.n_robot), legs)
    done = execute(plate, start, legs, SimulationSettings(mode=mode, metrology_noise_um=0), np.random.default_rng(0))
    assert done.moving_time_s == pytest.approx(played.configuration_time_s)
    assert done.min_separation_mm == pytest.approx(played.min_separation_mm, abs=1e-7)
    assert (done.collisions, done.contacts, done.metrology_rounds) == (0, 0, 0)
    assert done.metrology_time_s == SimulationSettings().metrology_exposure_s
    assert done.error_um.max() < 1e-6


@pytest.mark.parametrize("mode", MODES)
def test_pieces_of_any_mode_cover_the_legs(routed, mode):
    plate, start, legs = routed
    pieces = make_pieces(plate.instrument, start, legs)
    travel = np.bincount(pieces.leg, np.hypot(*(pieces.to_mm - pieces.from_mm).T), len(legs))
    np.testing.assert_allclose(travel, np.abs(legs.dx_mm) + np.abs(legs.dy_mm), atol=1e-9)


def test_order_is_kept_where_open_loop_touches():
    # B is to pass just behind A, but A is slow.
    plate = _plate([[0, 0], [20, -20]])
    start = plate.park_mm
    legs = _legs(plate, start, [(0, 0, 40, 0, True), (1, 6.4, 20, 20, True)])
    assert simulate(plate, start, np.zeros(2), legs).collisions == 0
    found = {mode: [] for mode in MODES}
    for seed in range(60):
        for mode in MODES:
            how = SimulationSettings(mode=mode, robot_speed_scatter_frac=0.15)
            found[mode].append(execute(plate, start, legs, how, np.random.default_rng(seed)))
    assert sum(done.contacts for done in found["open-loop"]) > 5
    assert sum(done.contacts for done in found["keep-order"]) == 0
    for kept, free in zip(found["keep-order"], found["open-loop"], strict=True):
        assert kept.moving_time_s >= free.moving_time_s - 1e-9


def test_order_keeping_at_two_percent_never_touches_and_costs_little(routed):
    plate, start, legs = routed
    planned = simulate(plate, start, np.zeros(plate.n_robot), legs).configuration_time_s
    how = SimulationSettings(mode="keep-order", leg_speed_scatter_frac=0.02)
    done = [execute(plate, start, legs, how, np.random.default_rng(seed)) for seed in range(20)]
    assert sum(each.contacts for each in done) == 0
    assert np.mean([each.moving_time_s for each in done]) < 1.1 * planned


def test_metrology_brings_slipped_robots_within_tolerance(routed):
    plate, start, legs = routed
    how = SimulationSettings(slip_deg=0.5)
    done = execute(plate, start, legs, how, np.random.default_rng(1))
    assert done.is_within_tolerance
    assert 1 <= done.metrology_rounds <= how.max_rounds
    # Measured within the tolerance, so truly within it and five times the noise.
    assert done.error_um.max() < how.tolerance_um + 5 * how.metrology_noise_um
    assert done.configuration_time_s == pytest.approx(done.moving_time_s + done.metrology_time_s)
    assert done.metrology_time_s > (done.metrology_rounds + 1) * how.metrology_exposure_s


def test_noise_above_tolerance_never_ends_and_says_so(routed):
    plate, start, legs = routed
    how = SimulationSettings(metrology_noise_um=50, max_rounds=3)
    done = execute(plate, start, legs, how, np.random.default_rng(1))
    assert not done.is_within_tolerance
    assert done.metrology_rounds == 3


def test_same_stream_same_result_and_same_errors_in_every_mode(routed):
    plate, start, legs = routed
    how = SimulationSettings(leg_speed_scatter_frac=0.02, slip_deg=0.2)
    first, second = (execute(plate, start, legs, how, np.random.default_rng(4)) for _ in range(2))
    assert first.error_um.tobytes() == second.error_um.tobytes()
    assert first.configuration_time_s == second.configuration_time_s


def test_empty_path_is_measured_once():
    plate = _plate([[0, 0], [30, 0]])
    empty = np.zeros(0)
    legs = make_legs(
        plate.instrument, plate.park_mm, np.zeros(2), empty.astype(np.int32), empty, empty.reshape(0, 2), empty.astype(bool)
    )
    played = simulate(plate, plate.park_mm, np.zeros(2), legs)
    assert (played.configuration_time_s, played.configuration_time_p95_s, played.ticks) == (0, 0, 0)
    assert played.min_separation_mm == 30
    for mode in MODES:
        done = execute(plate, plate.park_mm, legs, SimulationSettings(mode=mode), np.random.default_rng(0))
        assert done.moving_time_s == 0
