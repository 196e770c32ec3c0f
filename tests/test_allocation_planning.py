"""The plan of all visits together: against exhaustion, against its bound, and when things go wrong."""

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from survey_sim.allocation import AllocationSettings, FieldTargets, LostReason, completeness_bound, start_allocation
from survey_sim.instrument import load_instrument, make_plate
from tests import naive_allocation as naive
from tests.mock_targets import clustered_xy, field_targets, survey_targets, uniform_xy

PARK = [(0.0, 0.0), (15.0, 0.0), (7.5, 13.0)]


def run(targets, plate, fails=lambda visit: False, **values):
    """All visits of a tile, of which some do not bring any robot to its end."""
    session = start_allocation(targets, plate, AllocationSettings(**values), np.random.default_rng(1))
    position, visits = plate.park_mm, []
    while (visit := session.next_visit(position)) is not None:
        has_arrived = ~np.full(plate.n_robot, bool(fails(visit)))
        session.record(visit, has_arrived)
        position = np.where(has_arrived[:, None], visit.goal_mm, position)
        visits.append(visit)
    return session, visits


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.integers(1, 3))
def test_tiny_plates_are_planned_as_well_as_can_be(seed, n_target, n_visit):
    xy = np.random.default_rng(seed).uniform(-8, 25, (n_target, 2))
    plate = make_plate(load_instrument("paper", {"park_positions_mm": PARK, "patrol_radius_mm": 14.0}))
    session, _ = run(field_targets(xy), plate, visits=n_visit)
    exact = naive.most_complete(np.array(PARK), 14.0, xy, np.ones(n_target), 9.0, n_visit)
    assert session.is_complete.sum() == exact


@pytest.mark.parametrize("n_visit", [5, 8, 10, 12, 15])
@pytest.mark.parametrize("places", [uniform_xy, clustered_xy])
def test_completeness_is_near_the_bound(places, n_visit):
    targets, plate = field_targets(places(1431, 1)), make_plate(load_instrument("paper"))
    session, _ = run(targets, plate, visits=n_visit)
    assert session.completeness_frac >= 0.985 * completeness_bound(targets, plate, n_visit)


def test_as_many_visits_as_the_wanted_completeness_needs_and_no_more():
    xy, plate = uniform_xy(600, 2), make_plate(load_instrument("paper"))
    for wanted in (0.3, 0.7):
        table = pl.DataFrame({"target_id": np.arange(600), "x_mm": xy[:, 0], "y_mm": xy[:, 1]})
        targets = FieldTargets.from_table(table, wanted)
        session, visits = run(targets, plate)
        assert session.completeness_frac >= wanted
        assert completeness_bound(targets, plate, len(visits) - 1) < wanted


def test_repeats_fall_in_different_visits():
    targets = field_targets(clustered_xy(200, 3), wanted_visits=np.where(np.arange(200) % 4, 1, 5))
    session, visits = run(targets, make_plate(load_instrument("paper")))
    assert session.is_complete.all()
    for visit in visits:
        held = visit.target[visit.target >= 0]
        assert len(held) == len(set(held))
    total = np.bincount(np.concatenate([v.target[v.target >= 0] for v in visits]), minlength=200)
    np.testing.assert_array_equal(total, targets.wanted_visits)


def test_every_programme_gets_the_completeness_that_it_wants():
    xy, is_star = clustered_xy(900, 2), np.arange(900) % 5 > 0
    columns = {"programme": np.where(is_star, "stars", "galaxies").tolist(), "wanted_visits": np.where(is_star, 1, 5)}
    table = pl.DataFrame({"target_id": np.arange(900), "x_mm": xy[:, 0], "y_mm": xy[:, 1], **columns})
    wanted = {"stars": 0.5, "galaxies": 0.7}
    session, _ = run(FieldTargets.from_table(table, wanted), make_plate(load_instrument("paper")))
    assert session.is_complete[is_star].mean() >= wanted["stars"]
    assert session.is_complete[~is_star].mean() >= wanted["galaxies"]


def test_a_part_of_a_target_is_worth_nothing():
    """One robot, three visits: the target of five visits cannot be completed, so the three others are."""
    plate = make_plate(load_instrument("paper", {"park_positions_mm": [(0.0, 0.0)]}))
    targets = field_targets([(0.0, 0.0), (20.0, 0.0), (0.0, 20.0), (20.0, 20.0)], wanted_visits=[5, 1, 1, 1])
    session, _ = run(targets, plate, visits=3)
    assert session.is_complete.tolist() == [False, True, True, True]


def test_high_priorities_are_preferred_and_come_first():
    plate, sooner = make_plate(load_instrument("paper")), []
    for seed in range(4):
        targets = field_targets(uniform_xy(1431, seed), priority=np.random.default_rng(seed).integers(1, 10, 1431))
        session, visits = run(targets, plate, visits=5)
        by_priority = [session.is_complete[targets.priority == p].mean() for p in (1, 5, 9)]
        assert by_priority[0] < by_priority[1] < by_priority[2]
        priority = [targets.priority[visit.target[visit.target >= 0]].mean() for visit in visits]
        sooner.append(priority[0] - priority[-1])
    assert np.mean(sooner) > 0.0


def test_a_visit_that_fails_is_made_up_by_later_ones():
    targets, plate = field_targets(uniform_xy(300, 4)), make_plate(load_instrument("paper"))
    session, visits = run(targets, plate, fails=lambda visit: visit.visit_id == 1)
    assert session.completeness_frac == 1.0
    assert len(visits) >= 3


def test_a_robot_that_failed_a_target_is_not_sent_to_it_again():
    plate = make_plate(load_instrument("paper", {"park_positions_mm": PARK}))
    targets = field_targets([(1.0, 0.0)])
    session, visits = run(targets, plate, fails=lambda visit: True, max_visits=9)
    robots = [int(np.flatnonzero(visit.target == 0)[0]) for visit in visits]
    assert sorted(robots) == [0, 1, 2]
    assert session.lost_reasons().tolist() == [LostReason.UNROUTED]


def test_each_visit_has_its_guides_standards_and_sky():
    targets, plate = survey_targets(clustered_xy(900, 1), 1), make_plate(load_instrument("taipan-150"))
    _, visits = run(targets, plate, visits=6)
    for visit in visits:
        assert visit.counts["science"] == 120
        assert visit.counts["standard"] >= 5
        assert visit.counts["sky"] >= 10
        assert visit.shortfall["sky_region"] == 0


def test_guides_change_so_that_what_they_cover_is_reached():
    """Two guide stars within reach; the science target beside the first is free while the second guides."""
    plate = make_plate(
        load_instrument(
            "paper",
            {"park_positions_mm": [(0.0, 0.0), (40.0, 0.0)], "guides": "centroids", "guide_places_mm": [(20.0, 0.0)]},
        )
    )
    kind = ["science", "science", "guide", "guide"]
    targets = field_targets([(10.0, 0.0), (30.0, 0.0), (15.0, 0.0), (25.0, 0.0)], kind=kind)
    session, visits = run(targets, plate)
    assert session.completeness_frac == 1.0
    assert all(visit.counts["guide"] == 1 for visit in visits)


def test_the_same_seed_gives_the_same_plan():
    targets, plate = field_targets(clustered_xy(400, 5)), make_plate(load_instrument("paper"))
    first, second = (run(targets, plate)[1] for _ in range(2))
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.target, b.target)
        np.testing.assert_array_equal(a.goal_mm, b.goal_mm)


def test_a_pull_to_park_keeps_robots_near_it_and_costs_no_target():
    plate, targets = make_plate(load_instrument("paper")), field_targets(clustered_xy(900, 1))
    found = {}
    for pull in (0.0, 1.0):
        settings = AllocationSettings(visits=7, park_pull=pull)
        session = start_allocation(targets, plate, settings, np.random.default_rng(1))
        position, away = plate.park_mm, []
        while (visit := session.next_visit(position)) is not None:
            session.record(visit, np.ones(plate.n_robot, bool))
            position = visit.goal_mm
            away.append(np.hypot(*(position - plate.park_mm).T))
        found[pull] = (session.is_complete.sum(), np.mean(away))
    assert found[1.0][0] == found[0.0][0]
    assert found[1.0][1] < 0.9 * found[0.0][1]


@pytest.mark.parametrize(
    ("plan", "complete"), [(None, [False, True, True]), ([[1, 1], [0, 0], [0, 0]], [True, False, False])]
)
def test_what_was_planned_goes_before_what_was_not(plan, complete):
    """One robot and two visits: for two targets that want one, or for one that wants both."""
    plate = make_plate(load_instrument("paper", {"park_positions_mm": [(0.0, 0.0)], "patrol_radius_mm": 14.0}))
    targets = field_targets(np.array([(6.0, 0.0), (-6.0, 0.0), (0.0, 10.0)]), wanted_visits=np.array([2, 1, 1]))
    is_planned = None if plan is None else np.array(plan, dtype=bool)
    rng = np.random.default_rng(1)
    session = start_allocation(targets, plate, AllocationSettings(visits=2), rng, plan=is_planned)
    position = plate.park_mm
    while (visit := session.next_visit(position)) is not None:
        session.record(visit, np.ones(1, dtype=bool))
        position = visit.goal_mm
    assert session.is_complete.tolist() == complete
