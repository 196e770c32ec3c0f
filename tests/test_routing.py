"""Routers: every result is legal, whatever the field; what each can and cannot do; the door."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from survey_sim.errors import InputError
from survey_sim.instrument import load_instrument, make_plate
from survey_sim.motion import leg_times_s, make_trajectories
from survey_sim.routing import ROUTERS, HeldUp, RoutedPath, RoutingSettings, UnroutedReason, route, route_at_bound
from survey_sim.simulation import simulate
from tests.fields import chain, random_field
from tests.naive_routing import grid_cells, joint_components, pair_bound_s

ALL = sorted(ROUTERS)


def _plate(park, dead=(), patrol=50.0, plate_radius=163.5):
    places = tuple((float(x), float(y)) for x, y in park)
    overrides = {
        "guides": "none",
        "n_science": len(places),
        "park_positions_mm": places,
        "patrol_radius_mm": patrol,
        "plate_radius_mm": plate_radius,
    }
    return make_plate(load_instrument("paper", overrides), dead)


def _route(plate, start, goal, router="coordinated", theta=None, seed=0, by=route, **more):
    theta = np.zeros(plate.n_robot) if theta is None else theta
    settings_ = RoutingSettings(router=router, **more)
    return by(plate, np.array(start, float), theta, np.array(goal, float), settings_, np.random.default_rng(seed))


def _assert_legal(plate, start, goal, path, theta=None):
    """Nobody too near, nobody outside, everybody at the goal or with a reason at the start."""
    start, goal = np.array(start, float), np.array(goal, float)
    played = simulate(plate, start, np.zeros(plate.n_robot) if theta is None else theta, path.legs)
    assert played.collisions == 0
    assert played.min_separation_mm >= plate.instrument.min_separation_mm - 1e-6
    np.testing.assert_array_equal(played.end_mm, path.end_mm)
    np.testing.assert_array_equal(played.end_mm, np.where((path.reason == 0)[:, None], goal, start))
    assert played.configuration_time_s == pytest.approx(path.configuration_time_s)
    legs = path.legs
    way = make_trajectories(plate.instrument, start, legs)
    robot = np.repeat(np.arange(plate.n_robot), np.diff(way.first))
    centre = np.column_stack([way.x_mm, way.y_mm])
    assert (np.hypot(*centre.T) <= plate.instrument.plate_radius_mm + 1e-6).all()
    assert (np.hypot(*(centre - plate.park_mm[robot]).T) <= plate.patrol_radius_mm[robot] + 1e-6).all()
    assert (np.abs(legs.rotate_deg) <= 45 + 1e-9).all()
    is_axis = (legs.dx_mm == 0) | (legs.dy_mm == 0)
    assert (is_axis | (legs.rotate_deg == 0)).all()
    is_last = np.diff(legs.robot, append=-1) != 0
    length = np.abs(legs.dx_mm) + np.abs(legs.dy_mm)
    assert (length > 0).all()
    np.testing.assert_allclose(legs.precise_mm[is_last], np.minimum(plate.instrument.precise_approach_mm, length[is_last]))
    assert (legs.precise_mm[~is_last] == 0).all()
    rotating, moving = leg_times_s(plate.instrument, legs)
    ends = legs.start_s + rotating + moving
    assert (legs.start_s[1:][~is_last[:-1]] >= ends[:-1][~is_last[:-1]] - 1e-9).all()
    assert plate.is_live[legs.robot].all()


FIGURE_13 = ([[0, 0], [20, 0]], [[45, 0], [32, 0]])


@pytest.mark.parametrize("router", ALL)
def test_unavoidable_pair_of_figure_13(router):
    plate = _plate([[10, 0], [25, 0]])
    path = _route(plate, *FIGURE_13, router)
    _assert_legal(plate, *FIGURE_13, path)
    if router in ("simple-vector", "traffic-light"):
        assert path.reason.tolist() == [UnroutedReason.BLOCKED_STRAIGHT, 0]
    else:
        assert path.reason.tolist() == [0, 0]
    if router == "coordinated":
        # A turns away from nothing: B makes way, and A takes no longer than alone.
        assert path.configuration_time_s == pytest.approx(path.lower_bound_s)


def test_the_pair_that_needs_longer_than_the_bound_is_named():
    """Two that change places hold the path up; a third, far off, does not; at the bound nobody is to blame."""
    start, goal = [[0, 0], [100, 0], [15, 0]], [[15, 0], [90, 0], [0, 0]]
    plate = _plate(start)
    path = _route(plate, start, goal)
    assert path.configuration_time_s > path.lower_bound_s
    assert sorted(path.held_up) == [0, 2]
    assert _route(plate, start, [[0, 0], [90, 0], [15, 0]]).held_up == ()


def test_what_is_not_at_the_bound_is_given_up_with_the_pair_named():
    """As above; to turn around each other takes the two some percent longer; far from help they take much longer."""
    start, goal = [[0, 0], [100, 0], [15, 0]], [[15, 0], [90, 0], [0, 0]]
    whole = _route(_plate(start), start, goal)
    held_up = _route(_plate(start), start, goal, by=route_at_bound)
    assert isinstance(held_up, HeldUp)
    assert sorted(held_up.held_up) == [0, 2]
    assert held_up.lower_bound_s == whole.lower_bound_s < held_up.configuration_time_s
    is_far = whole.configuration_time_s > 1.05 * whole.lower_bound_s
    assert (held_up.configuration_time_s > 1.05 * whole.lower_bound_s) == is_far


@pytest.mark.parametrize("router", ALL)
def test_what_is_at_the_bound_is_the_same_as_if_more_were_looked_for(router):
    """Fields with robots in conflict; other routers give up nothing."""
    plate, n_whole = make_plate(load_instrument("taipan-150")), 0
    for start, goal in chain(plate, 4, 160, np.random.default_rng(5)):
        for a, b in ((start, goal), (start, plate.park_mm)):
            path, found = _route(plate, a, b, router), _route(plate, a, b, router, by=route_at_bound)
            if router == "coordinated" and path.held_up:
                assert isinstance(found, HeldUp)
                continue
            assert isinstance(found, RoutedPath)
            n_whole += 1
            for name in ("robot", "start_s", "x_mm", "y_mm", "theta_deg"):
                np.testing.assert_array_equal(getattr(found.legs, name), getattr(path.legs, name))
            assert found.held_up == path.held_up
    assert n_whole > 0


def test_without_a_pair_the_robot_that_comes_last_is_named():
    """Traffic light plans robot 0 first; robot 1, whose way crosses its line and is nearly as long, waits and comes last."""
    start = [[0, 0], [30, 30]]
    plate = _plate(start, patrol=70.0)
    path = _route(plate, start, [[60, 0], [30, -29.5]], "traffic-light")
    assert path.configuration_time_s > path.lower_bound_s
    assert path.held_up == (1,)
    assert _route(plate, start, [[60, 0], [30, 10]], "traffic-light").held_up == ()


@pytest.mark.parametrize("router", ALL)
def test_one_robot_takes_its_time_alone(router):
    plate = _plate([[0, 0], [60, 60]])
    path = _route(plate, plate.park_mm, [[30, 0], [60, 60]], router)
    assert path.lower_bound_s == pytest.approx(15 + 0.02 / 0.3 - 0.01)
    assert path.configuration_time_s == pytest.approx(path.lower_bound_s)


@pytest.mark.parametrize("router", ALL)
def test_nobody_moves(router):
    plate = _plate([[0, 0], [20, 0]])
    path = _route(plate, plate.park_mm, plate.park_mm, router)
    assert len(path.legs) == 0
    assert (path.lower_bound_s, path.configuration_time_s) == (0, 0)


@pytest.mark.parametrize("router", ALL)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_tiny_crowded_plates_are_legal(router, seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    park, start, goal = (_packed(rng, n, 22.0) for _ in range(3))
    dead = (1,) if rng.random() < 0.3 else ()
    if dead:
        goal[0] = start[0]
        if (np.hypot(*(goal[1:] - goal[0]).T) < 9.0).any():
            return
    plate = _plate(park, dead, patrol=60.0, plate_radius=22.0)
    theta = rng.uniform(-180, 180, n)
    path = _route(plate, start, goal, router, theta)
    _assert_legal(plate, start, goal, path, theta)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_two_or_three_robots_with_room_all_arrive(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 4))
    start, goal = _packed(rng, n, 25.0), _packed(rng, n, 25.0)
    plate = _plate(_packed(rng, n, 25.0), patrol=100.0, plate_radius=40.0)
    path = _route(plate, start, goal)
    _assert_legal(plate, start, goal, path)
    assert (path.reason == 0).all()
    # One after another around the crowd would take about this long.
    assert path.configuration_time_s < 3 * (path.lower_bound_s + 20)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_no_pair_is_quicker_than_any_motion_of_two(seed):
    rng = np.random.default_rng(seed)
    start, goal = _packed(rng, 2, 12.0), _packed(rng, 2, 12.0)
    plate = _plate(_packed(rng, 2, 12.0), patrol=100.0, plate_radius=60.0)
    path = _route(plate, start, goal)
    _assert_legal(plate, start, goal, path)
    assert (path.reason == 0).all()
    assert path.configuration_time_s >= pair_bound_s(start, goal, 9.0, 2.0) - 1e-6


def test_two_that_change_places_are_near_the_least_time_of_any_motion():
    """At 9 sqrt(2) mm: each way around is 9 + 9 pi / 2 + 9 mm long in their difference, gone at twice the speed of one."""
    reach = 9 / np.sqrt(2)
    start, goal = np.array([[-reach, 0.0], [reach, 0.0]]), np.array([[reach, 0.0], [-reach, 0.0]])
    assert pair_bound_s(start, goal, 9.0, 2.0) == pytest.approx((18 + 4.5 * np.pi) / 4)
    places = tuple(map(tuple, start.tolist()))
    overrides = {"guides": "none", "n_science": 2, "park_positions_mm": places, "rotation_speed_deg_s": 1e6}
    plate = make_plate(load_instrument("paper", overrides))
    path = _route(plate, start, goal)
    _assert_legal(plate, start, goal, path)
    assert (path.reason == 0).all()
    # The bound of each alone, 6.4 s, cannot be had.
    assert path.lower_bound_s < 6.5
    assert path.configuration_time_s < 1.1 * (18 + 4.5 * np.pi) / 4


@pytest.mark.parametrize(("n", "radius", "pitch"), [(2, 8.0, 2.0), (2, 12.0, 3.0), (3, 12.0, 2.4)])
def test_what_exhaustive_search_reaches_is_reached(n, radius, pitch):
    """Robots on a plate hardly larger than they are: all placements on a grid, and all moves of one robot at a time."""
    cells = grid_cells(radius, pitch)
    component = joint_components(cells, pitch, n, 9.0)
    placements = np.argwhere(component >= 0)
    plate = _plate(cells[placements[0]], patrol=60.0, plate_radius=radius)
    rng = np.random.default_rng(1)
    n_connected = 0
    for _ in range(25):
        a, b = placements[rng.integers(len(placements), size=2)]
        path = _route(plate, cells[a], cells[b])
        _assert_legal(plate, cells[a], cells[b], path)
        if component[tuple(a)] == component[tuple(b)]:
            n_connected += 1
            assert (path.reason == 0).all(), (cells[a].tolist(), cells[b].tolist())
    assert n_connected >= 5


def _packed(rng, n, radius):
    """(n, 2) positions in a disc, at least 9 mm apart."""
    while True:
        kept = np.empty((0, 2))
        for point in rng.uniform(-radius, radius, (400, 2)):
            if np.hypot(*point) <= radius and (np.hypot(*(kept - point).T) >= 9.0).all():
                kept = np.vstack([kept, point])
            if len(kept) == n:
                return kept


@pytest.mark.parametrize("router", ALL)
def test_exact_contact_is_legal(router):
    start, goal = [[0, 0], [9, 0], [0, 9]], [[0, -20], [9, -20], [0, 9]]
    plate = _plate([[0, -10], [12, -10], [0, 9]])
    path = _route(plate, start, goal, router)
    _assert_legal(plate, start, goal, path)
    assert (path.reason == 0).all()


def test_theorem_goals_9_70_apart_never_collide():
    """Robots that start and stop together on lines of least sum d^2 keep ab / sqrt(a^2 + b^2), so nobody is late."""
    rng = np.random.default_rng(4)
    plate = make_plate(load_instrument("paper"))
    sway = 24.1 / 2 - 9.70 / 2
    for _ in range(5):
        angle, radius = rng.uniform(0, 2 * np.pi, plate.n_robot), sway * np.sqrt(rng.random(plate.n_robot))
        goal = plate.park_mm + np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        path = _route(plate, plate.park_mm, goal)
        _assert_legal(plate, plate.park_mm, goal, path)
        assert path.configuration_time_s == pytest.approx(path.lower_bound_s)


def test_chained_matched_fields_all_arrive_near_the_bound():
    plate = make_plate(load_instrument("taipan-150"))
    theta, n_at_bound, n_path = np.zeros(plate.n_robot), 0, 0
    for start, goal in chain(plate, 8, 160, np.random.default_rng(1)):
        out = _route(plate, start, goal, theta=theta)
        _assert_legal(plate, start, goal, out, theta)
        for path, (a, b, angle) in (
            (out, (start, goal, theta)),
            (_route(plate, start, plate.park_mm, theta=theta), (start, plate.park_mm, theta)),
            (_route(plate, plate.park_mm, goal), (plate.park_mm, goal, None)),
        ):
            _assert_legal(plate, a, b, path, angle)
            assert (path.reason == 0).all()
            assert path.configuration_time_s <= 1.10 * path.lower_bound_s + 1e-9
            n_path += 1
            n_at_bound += path.configuration_time_s <= path.lower_bound_s * (1 + 1e-9)
        theta = out.end_theta_deg
    assert n_at_bound >= 0.8 * n_path


@pytest.mark.parametrize("router", ALL)
def test_random_field_is_legal_with_every_router(router):
    plate = make_plate(load_instrument("taipan-150"), dead=(7, 70))
    goal = random_field(plate, plate.park_mm, np.random.default_rng(3)).goal_mm
    path = _route(plate, plate.park_mm, goal, router)
    _assert_legal(plate, plate.park_mm, goal, path)
    if router == "coordinated":
        assert (path.reason == 0).all()


def test_same_stream_same_bytes():
    plate = make_plate(load_instrument("taipan-150"))
    goal = random_field(plate, plate.park_mm, np.random.default_rng(5)).goal_mm
    first, second = (_route(plate, plate.park_mm, goal, seed=8) for _ in range(2))
    for name in ("robot", "start_s", "rotate_deg", "dx_mm", "dy_mm", "x_mm", "y_mm", "theta_deg"):
        assert getattr(first.legs, name).tobytes() == getattr(second.legs, name).tobytes()


@pytest.mark.parametrize("router", ["simple-vector", "traffic-light"])
def test_mirror_and_quarter_turn_change_nothing(router):
    rng = np.random.default_rng(6)
    start, goal = _packed(rng, 5, 30.0), _packed(rng, 5, 30.0)
    times = []
    for turn in (np.eye(2), np.array([[0.0, -1.0], [1.0, 0.0]]), np.diag([1.0, -1.0])):
        plate = _plate(start @ turn.T, patrol=100.0)
        path = _route(plate, start @ turn.T, goal @ turn.T, router)
        times.append((path.configuration_time_s, path.reason.tolist()))
    assert times[1][0] == pytest.approx(times[0][0])
    assert times[2][0] == pytest.approx(times[0][0])
    assert times[0][1] == times[1][1] == times[2][1]


def test_margin_is_kept_where_starts_and_goals_allow():
    start, goal = [[0, 0], [30, -20]], [[40, 0], [30, 20]]
    plate = _plate([[20, 0], [30, 0]])
    plain = _route(plate, start, goal)
    wide = _route(plate, start, goal, margin_mm=2.0)
    for path, least in ((plain, 9.0), (wide, 11.0)):
        assert simulate(plate, np.array(start, float), np.zeros(2), path.legs).min_separation_mm >= least - 1e-6


def test_dead_robots_that_enclose_are_proof_of_unreachable():
    angle = np.arange(6) * np.pi / 3
    ring = 15.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    start = np.vstack([[0, 0], ring])
    goal = np.vstack([[30, 5], ring])
    plate = _plate(start, dead=range(2, 8))
    path = _route(plate, start, goal)
    assert path.reason.tolist() == [UnroutedReason.UNREACHABLE, 0, 0, 0, 0, 0, 0]
    _assert_legal(plate, start, goal, path)
    opened = _plate(start, dead=range(2, 7))
    path = _route(opened, start, goal)
    assert (path.reason == 0).all()
    _assert_legal(opened, start, goal, path)


def test_goal_of_an_unreachable_robot_start_is_a_deadlock():
    angle = np.arange(6) * np.pi / 3
    ring = 15.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    # The last robot wants the place of the enclosed one.
    start = np.vstack([[0, 0], ring, [40, 0]])
    goal = np.vstack([[30, 5], ring, [0, 0]])
    plate = _plate(start, dead=range(2, 8))
    path = _route(plate, start, goal)
    assert path.reason[0] == UnroutedReason.UNREACHABLE
    assert path.reason[-1] in (UnroutedReason.DEADLOCK, UnroutedReason.UNREACHABLE)
    _assert_legal(plate, start, goal, path)


def test_idle_robot_steps_aside_and_comes_back():
    start, goal = [[0, 0], [20, 0]], [[45, 0], [20, 0]]
    plate = _plate([[10, 0], [22, 0]])
    path = _route(plate, start, goal)
    _assert_legal(plate, start, goal, path)
    assert (path.reason == 0).all()
    assert (path.legs.robot == 1).sum() >= 2
    assert path.configuration_time_s == pytest.approx(path.lower_bound_s)


@pytest.mark.parametrize(
    ("start", "goal", "rule", "robots"),
    [
        ([[0, 0], [5, 0], [60, 0]], [[0, 0], [20, 0], [60, 0]], "min_separation", ["robot 1", "robot 2"]),
        ([[0, 0], [20, 0], [60, 0]], [[0, 0], [20, 0], [25, 0]], "min_separation", ["robot 2", "robot 3"]),
        ([[0, 0], [20, 0], [60, 0]], [[51, 0], [20, 0], [60, 0]], "patrol", ["robot 1"]),
        ([[0, 0], [20, 0], [60, 0]], [[0, 0], [20, 0], [60, np.nan]], "finite", ["robot 3"]),
        ([[0, 0], [20, 0], [60, 0]], [[0, 0], [30, 0], [60, 1]], "dead", ["robot 2"]),
    ],
)
def test_bad_input_is_refused_with_robots_and_rule(start, goal, rule, robots):
    plate = _plate([[0, 0], [20, 0], [60, 0]], dead=(2,) if rule == "dead" else ())
    with pytest.raises(InputError, match=rule) as refusal:
        _route(plate, start, goal)
    assert refusal.value.rows == robots


def test_outside_the_plate_is_refused():
    plate = _plate([[150, 0]])
    with pytest.raises(InputError, match="outside the plate"):
        _route(plate, plate.park_mm, [[164, 0]])


def test_wrong_shape_is_refused():
    plate = _plate([[0, 0], [20, 0]])
    with pytest.raises(InputError, match="shape"):
        _route(plate, plate.park_mm[:1], plate.park_mm)


def test_unknown_router_is_refused():
    with pytest.raises(InputError, match="router"):
        RoutingSettings.load({"router": "simple"}, section="routing")
