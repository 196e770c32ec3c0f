"""The exact matching of one visit: against exhaustion, and against known optima."""

from pathlib import Path
from unittest import mock

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from survey_sim.allocation import AllocationSettings, matching, start_allocation
from survey_sim.allocation.field import make_field
from survey_sim.allocation.kernels.matching import match_apart
from survey_sim.instrument import load_instrument, make_plate
from tests import naive_allocation as naive
from tests.mock_targets import field_targets, survey_targets, uniform_xy

ANCHOR_PARKS = pl.read_csv(Path(__file__).parent / "data" / "anchor_parks.csv").rows()
# Targets allocated and their total travel, mm, for three seeds each, by a mixed-integer programme (SciPy, HiGHS).
EXACT = {
    150: [(123, 1762.3), (123, 1914.1), (125, 2127.1)],
    300: [(156, 1591.4), (156, 1544.2), (156, 2104.1)],
    600: [(156, 940.7), (156, 984.9), (156, 924.1)],
    1500: [(156, 611.6), (156, 612.9), (156, 567.4)],
}


def plate_of(parks, patrol_mm=50.0, plate_radius_mm=163.5):
    overrides = {"park_positions_mm": parks, "patrol_radius_mm": patrol_mm, "plate_radius_mm": plate_radius_mm}
    return make_plate(load_instrument("paper", overrides))


def one_visit(targets, plate, **values):
    session = start_allocation(targets, plate, AllocationSettings(visits=1, **values), np.random.default_rng(1))
    return session.next_visit(plate.park_mm)


@pytest.mark.parametrize("n_target", EXACT)
def test_the_known_optima_seed_by_seed(n_target):
    plate = plate_of(ANCHOR_PARKS, 49.5, 166.5)
    for seed, (count, travel_mm) in enumerate(EXACT[n_target], start=1):
        visit = one_visit(field_targets(uniform_xy(n_target, seed, 166.5)), plate, algorithm="matching", travel_power=1)
        is_held = visit.target >= 0
        assert is_held.sum() == count
        assert visit.travel_mm[is_held].sum() == pytest.approx(travel_mm, abs=0.05)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.sampled_from([1.0, 2.0, 4.0]))
def test_the_best_of_all_visits_is_found(seed, n_target, power):
    rng = np.random.default_rng(seed)
    park = np.array([(0.0, 0.0), (15.0, 0.0), (7.5, 13.0), (22.5, 13.0)])
    xy = rng.uniform(-8, 30, (n_target, 2))
    priority = rng.integers(1, 10, n_target)
    targets, plate = field_targets(xy, priority=priority), plate_of(park.tolist(), 14.0)
    with pytest.MonkeyPatch.context() as patch:
        # Robots to spare would lengthen their ways to be out of each other's.
        patch.setattr("survey_sim.allocation.matching.SPARE_FRAC", 2.0)
        visit = one_visit(targets, plate, algorithm="matching", travel_power=power, min_gain=1)
    value = 1.0 + 0.1 * (priority - 1) / 8.0
    best_value, best_travel = naive.best_visit(park, 14.0, xy, value, 9.0, power)
    if visit is None:
        assert best_value == 0.0
        return
    is_held = visit.target >= 0
    assert value[visit.target[is_held]].sum() == pytest.approx(best_value)
    assert (visit.travel_mm[is_held] ** power).sum() == pytest.approx(best_travel, rel=1e-6)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.sampled_from([1.0, 4.0]), st.sampled_from([0.0, 0.3, 2.0]))
def test_the_best_of_all_visits_with_a_pull_to_park(seed, n_target, power, pull):
    rng = np.random.default_rng(seed)
    park = np.array([(0.0, 0.0), (15.0, 0.0), (7.5, 13.0), (22.5, 13.0)])
    start = park + rng.uniform(-6, 6, 2)
    targets, plate = field_targets(rng.uniform(-8, 30, (n_target, 2))), plate_of(park.tolist(), 14.0)
    values = {"algorithm": "matching", "visits": 1, "travel_power": power, "park_pull": pull}
    # The matching alone: exchanges that keep robots out of each other's way may cost more.
    with mock.patch.object(matching, "SPARE_FRAC", 2.0):
        visit = start_allocation(targets, plate, AllocationSettings(**values), np.random.default_rng(1)).next_visit(start)
    xy = np.column_stack([targets.x_mm, targets.y_mm])
    best_value, best_cost = naive.best_visit(park, 14.0, xy, np.ones(n_target), 9.0, power, start, pull)
    if visit is None:
        assert best_value == 0.0
        return
    is_held = visit.target >= 0
    away = np.hypot(*(xy[visit.target[is_held]] - park[is_held]).T)
    assert is_held.sum() == best_value
    assert (visit.travel_mm[is_held] ** power + pull * away**power).sum() == pytest.approx(best_cost, rel=1e-6)


def test_least_travel_is_not_pulled_unless_asked():
    assert AllocationSettings(travel_power=1).used_park_pull == 0.0
    assert AllocationSettings(travel_power=1, park_pull=0.4).used_park_pull == 0.4
    assert AllocationSettings(park_pull=0.0).used_park_pull == 0.0
    assert AllocationSettings(algorithm="matching").used_park_pull == 0.0
    assert AllocationSettings(algorithm="matching", park_pull=0.4).used_park_pull == 0.4
    assert AllocationSettings().used_park_pull > 0.0


def test_the_bound_of_the_search_holds_when_it_is_cut_short():
    plate = plate_of(ANCHOR_PARKS, 49.5, 166.5)
    field = make_field(field_targets(uniform_xy(300, 3, 166.5)), plate, AllocationSettings())
    target = field.pair_target()
    travel = np.hypot(*(field.xy_mm[target] - plate.park_mm[field.reach_robot]).T)
    found = []
    for max_nodes in (0, 5, 1000):
        pair, bound, _ = match_apart(
            plate.n_robot, 1e5, field.reach_first, field.reach_robot, target, travel,
            field.near_first, field.near, field.xy_mm, 9.0, max_nodes,
        )  # fmt: skip
        found.append((travel[pair].sum(), bound))
    exact = found[-1][0]
    assert found[-1][1] == pytest.approx(exact)
    assert all(bound <= exact + 1e-6 <= cost + 2e-6 for cost, bound in found)


def test_least_travel_crosses_nothing_where_reach_is_no_limit():
    plate = plate_of(ANCHOR_PARKS, 400.0, 166.5)
    for seed in range(5):
        assert one_visit(field_targets(uniform_xy(400, seed)), plate, algorithm="matching", travel_power=1).crossings == 0


def test_minima_are_met_by_giving_up_the_least_valuable_science():
    plate = plate_of([(0.0, 0.0), (30.0, 0.0)], 20.0)
    kind, priority = ["science", "science", "sky"], [9, 1, 1]
    targets = field_targets([(1.0, 0.0), (31.0, 0.0), (15.0, 5.0)], kind=kind, priority=priority)
    visit = one_visit(targets, plate, algorithm="matching", min_sky=1, wanted_sky=1, sky_regions=1)
    assert visit.target.tolist() == [0, 2]
    assert visit.shortfall == {"standard": 5, "sky": 0, "guide": 0, "sky_region": 0}


def test_guides_are_served_by_guide_robots_alone():
    plate = make_plate(load_instrument("taipan-150"))
    visit = one_visit(survey_targets(uniform_xy(600, 1), 1), plate, algorithm="matching")
    targets = survey_targets(uniform_xy(600, 1), 1)
    is_held = visit.target >= 0
    assert ((targets.kind[visit.target[is_held]] == 3) == plate.is_guide[is_held]).all()
    assert visit.counts["standard"] == 10
    assert visit.counts["sky"] == 20


def _exchange_session(algorithm="matching", **values):
    """Two robots with two targets between them, and a third far off with its own."""
    plate = plate_of([(0.0, 0.0), (30.0, 0.0), (0.0, 100.0)])
    targets = field_targets([(5.0, 0.0), (25.0, 0.0), (0.0, 105.0)])
    settings_ = AllocationSettings.load({"algorithm": algorithm, "visits": 2, **values})
    session = start_allocation(targets, plate, settings_, np.random.default_rng(1))
    return session, session.next_visit(plate.park_mm)


@pytest.mark.parametrize("algorithm", ["matching", "plan"])
def test_a_target_barred_to_its_robot_goes_to_another(algorithm):
    session, visit = _exchange_session(algorithm)
    assert visit.target.tolist() == [0, 1, 2]
    assert session.exchanged(visit, {(0, 0)}, may_lengthen=False) is None
    other = session.exchanged(visit, {(0, 0)}, may_lengthen=True)
    assert other.target.tolist() == [1, 0, 2]
    np.testing.assert_array_equal(other.goal_mm[0], [25.0, 0.0])
    # Both that it could hold: then one would be lost. The third's is in nobody else's reach.
    assert session.exchanged(visit, {(0, 0), (0, 1)}, may_lengthen=True) is None
    assert session.exchanged(visit, {(0, 0), (1, 0)}, may_lengthen=True) is None
    assert session.exchanged(visit, {(2, 2)}, may_lengthen=True) is None
    session.record(other, np.ones(3, dtype=bool))
    assert session.is_complete.all()
    with pytest.raises(RuntimeError, match="between"):
        session.exchanged(other, {(0, 1)}, may_lengthen=True)


@pytest.mark.parametrize("values", [{"algorithm": "cda-basic"}, {"travel_power": 1.0}])
def test_what_has_rules_of_its_own_is_not_exchanged(values):
    session, visit = _exchange_session(**values)
    assert session.exchanged(visit, {(0, 0)}, may_lengthen=True) is None


def test_an_idle_robot_rests_out_of_the_others_way():
    """Robot 1 is in the way where it stands, with a target for robot 0 alone that displaces it; it rests beside its line."""
    plate = plate_of([(0.0, 0.0), (30.0, 0.0)])
    targets = field_targets([(22.0, 0.0)])
    settings_ = AllocationSettings.load({"algorithm": "matching", "visits": 1})
    session = start_allocation(targets, plate, settings_, np.random.default_rng(1))
    visit = session.next_visit(np.array([[0.0, 0.0], [16.0, 0.0]]))
    assert sorted(visit.target.tolist()) == [-1, 0]
    idle = int(np.flatnonzero(visit.target < 0)[0])
    places = session.resting_places(visit, idle)
    assert len(places)
    for place in places:
        rested = session.rested(visit, {idle: place})
        np.testing.assert_array_equal(rested.goal_mm[idle], place)
        np.testing.assert_array_equal(rested.goal_mm[1 - idle], visit.goal_mm[1 - idle])
        assert np.hypot(*(rested.goal_mm[0] - rested.goal_mm[1])) >= 9.0
        assert np.hypot(*(place - plate.park_mm[idle])) <= plate.patrol_radius_mm[idle]
        assert np.hypot(*(place - visit.goal_mm[idle])) >= 3.0
    # Who holds a target keeps it, and a place without room is left alone.
    np.testing.assert_array_equal(session.rested(visit, {1 - idle: places[0]}).goal_mm, visit.goal_mm)
    np.testing.assert_array_equal(session.rested(visit, {idle: visit.goal_mm[1 - idle]}).goal_mm, visit.goal_mm)


@given(seed=st.integers(0, 2**32 - 1), may_lengthen=st.booleans())
@settings(max_examples=25, deadline=None)
def test_exchanges_keep_targets_reach_and_separation(seed, may_lengthen):
    rng = np.random.default_rng(seed)
    plate, targets = (
        make_plate(load_instrument("taipan-150", {"n_science": 40})),
        survey_targets(uniform_xy(60, seed % 99), 1),
    )
    settings_ = AllocationSettings.load({"algorithm": "matching", "wanted_sky": 6, "min_sky": 3, "wanted_standard": 2})
    session = start_allocation(targets, plate, settings_, rng)
    visit = session.next_visit(plate.park_mm)
    robot = int(rng.choice(np.flatnonzero(visit.target >= 0)))
    other = session.exchanged(visit, {(robot, int(visit.target[robot]))}, may_lengthen=may_lengthen)
    if other is None:
        return
    assert other.target[robot] != visit.target[robot]
    fixed = [set(some.target[(some.target >= 0) & ~plate.is_guide].tolist()) for some in (visit, other)]
    assert fixed[0] == fixed[1]
    assert other.counts == visit.counts
    away = np.hypot(*(other.goal_mm - plate.park_mm).T)
    assert (away <= plate.patrol_radius_mm + 1e-9).all()
    apart = np.hypot(*(other.goal_mm[:, None] - other.goal_mm[None]).transpose(2, 0, 1))
    assert apart[~np.eye(len(apart), dtype=bool)].min() >= plate.instrument.min_separation_mm
    if not may_lengthen:
        has_target = other.target >= 0
        assert away[has_target].max() <= np.hypot(*(visit.goal_mm - plate.park_mm)[visit.target >= 0].T).max() + 1e-9
