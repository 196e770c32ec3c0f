"""Allocation of one tile: the door, the rules of each algorithm, and what holds for all of them."""

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from survey_sim.allocation import ALGORITHMS, AllocationSettings, FieldTargets, LostReason, start_allocation
from survey_sim.errors import InputError
from survey_sim.instrument import load_instrument, make_plate
from tests.mock_targets import clustered_xy, field_targets, survey_targets


def table(x_mm, y_mm, **columns):
    return pl.DataFrame({"target_id": np.arange(len(x_mm)), "x_mm": x_mm, "y_mm": y_mm, **columns})


def small_plate(parks, patrol_mm=50.0, dead=(), guides=()):
    """Plate with science robots at the places given, mm, and guides of 10 mm patrol."""
    overrides = {"park_positions_mm": parks, "patrol_radius_mm": patrol_mm}
    if guides:
        overrides |= {"guide_places_mm": guides, "guides": "centroids"}
    return make_plate(load_instrument("paper", overrides), dead)


def run(targets, plate, **settings):
    """All visits of a tile whose robots all arrive."""
    session = start_allocation(targets, plate, AllocationSettings(**settings), np.random.default_rng(1))
    position, visits = plate.park_mm, []
    while (visit := session.next_visit(position)) is not None:
        session.record(visit, np.ones(plate.n_robot, bool))
        position = visit.goal_mm
        visits.append(visit)
    return session, visits


@pytest.mark.parametrize(
    ("columns", "rule", "rows"),
    [
        ({"target_id": [1, 1, 2]}, "duplicate", [0, 1]),
        ({"x_mm": [0.0, float("nan"), 1.0]}, "NaN", [1]),
        ({"y_mm": [0.0, 1.0, None]}, "NaN", [2]),
        ({"kind": ["science", "sciense", "sky"]}, "unknown kind", [1]),
        ({"kind": [0, 7, 3]}, "unknown code", [1]),
        ({"priority": [0, 1, 10]}, "outside", [0, 2]),
        ({"priority": [1.5, 1.0, 2.0]}, "whole", [0]),
        ({"wanted_visits": [1, 0, 1]}, "less than 1", [1]),
    ],
)
def test_bad_targets_are_refused_with_rows_and_rule(columns, rule, rows):
    good = {"target_id": [1, 2, 3], "x_mm": [0.0, 1.0, 2.0], "y_mm": [0.0, 1.0, 2.0]}
    with pytest.raises(InputError, match=rule) as failure:
        FieldTargets.from_table(pl.DataFrame(good | columns))
    assert failure.value.rows == rows


def test_a_target_outside_the_plate_is_set_aside():
    targets = FieldTargets.from_table(table([0.0, 500.0], [5.0, 0.0]))
    session, visits = run(targets, small_plate([(0.0, 0.0)]), algorithm="cda-basic")
    assert len(visits) == 1
    assert session.completeness_frac == 1.0
    assert session.lost_reasons().tolist() == [LostReason.NONE, LostReason.OUT_OF_REACH]


def test_basic_takes_the_closest_pair_first():
    # Robot 1 is nearer to target 0 than robot 0 is, so robot 0 must go to the farther target 1.
    plate = small_plate([(0.0, 0.0), (30.0, 0.0)])
    targets = FieldTargets.from_table(table([16.0, 10.0], [0.0, -30.0]))
    _, visits = run(targets, plate, algorithm="cda-basic")
    assert visits[0].target.tolist() == [1, 0]


def test_basic_leaves_targets_near_a_taken_one_for_the_next_visit():
    plate = small_plate([(0.0, 0.0), (24.1, 0.0)])
    targets = FieldTargets.from_table(table([10.0, 15.0], [0.0, 0.0]))
    _, visits = run(targets, plate, algorithm="cda-basic")
    assert [sorted(visit.target.tolist()) for visit in visits] == [[-1, 1], [-1, 0]]
    assert all(visit.start == "park" for visit in visits)


def test_advanced_takes_no_crossing_ways():
    # Both closest pairs would cross: (robot 0 -> target 1) is taken, robot 1 must then not cross it.
    plate = small_plate([(0.0, 0.0), (20.0, 0.0)])
    targets = FieldTargets.from_table(table([15.0, 2.0], [20.0, 21.0]))
    _, visits = run(targets, plate, algorithm="cda-advanced")
    assert all(visit.crossings == 0 for visit in visits)


def test_an_idle_robot_steps_aside_just_enough():
    plate = small_plate([(0.0, 0.0), (20.0, 0.0)])
    targets = FieldTargets.from_table(table([15.0], [0.0]))
    session = start_allocation(targets, plate, AllocationSettings(algorithm="cda-basic"), np.random.default_rng(1))
    session._is_pair_open[session.field.reach_robot == 1] = False
    visit = session.next_visit(plate.park_mm)
    assert visit.target.tolist() == [0, -1]
    np.testing.assert_allclose(visit.goal_mm[1], [24.0, 0.0], atol=1e-6)


def test_what_did_not_arrive_is_given_to_another_robot():
    plate = small_plate([(0.0, 0.0), (20.0, 0.0)])
    targets = FieldTargets.from_table(table([5.0], [0.0]))
    session = start_allocation(targets, plate, AllocationSettings(algorithm="cda-basic"), np.random.default_rng(1))
    first = session.next_visit(plate.park_mm)
    session.record(first, np.array([False, True]))
    assert session.lost_reasons().tolist() == [LostReason.UNROUTED]
    assert session.next_visit(plate.park_mm).target.tolist() == [-1, 0]


def test_a_dead_robot_blocks_what_is_near_it():
    plate = small_plate([(0.0, 0.0), (24.1, 0.0)], dead=[1])
    targets = FieldTargets.from_table(table([5.0, 30.0], [0.0, 0.0]))
    session, visits = run(targets, plate, algorithm="cda-basic")
    assert [visit.target.tolist() for visit in visits] == [[-1, 1]]
    assert session.lost_reasons().tolist() == [LostReason.BLOCKED_BY_DEAD, LostReason.NONE]


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("n_target", [0, 1, 40])
def test_degenerate_fields(algorithm, n_target):
    spot = FieldTargets.from_table(table(np.zeros(n_target), np.zeros(n_target)))
    session, visits = run(spot, small_plate([(0.0, 0.0), (24.1, 0.0)]), algorithm=algorithm)
    assert session.completeness_frac == 1.0
    if algorithm != "ideal":
        assert len(visits) == n_target


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_every_robot_dead(algorithm):
    targets = FieldTargets.from_table(table([0.0, 30.0], [5.0, 0.0]))
    session, visits = run(targets, small_plate([(0.0, 0.0), (24.1, 0.0)], dead=[1, 2]), algorithm=algorithm)
    assert visits == []
    assert session.lost_reasons().tolist() == [LostReason.BLOCKED_BY_DEAD] * 2


def assert_legal(visit, targets, plate, start_mm):
    """One robot a target, ends in reach and on the plate, apart from each other, dead robots in place, counts as told."""
    held, n_robot = visit.target, plate.n_robot
    is_held = held >= 0
    assert len(set(held[is_held])) == is_held.sum()
    np.testing.assert_array_equal(visit.goal_mm[is_held], np.column_stack([targets.x_mm, targets.y_mm])[held[is_held]])
    assert ((targets.kind[held[is_held]] == 3) == plate.is_guide[is_held]).all()
    assert not is_held[~plate.is_live].any()
    np.testing.assert_array_equal(visit.goal_mm[~plate.is_live], start_mm[~plate.is_live])
    assert (np.hypot(*(visit.goal_mm - plate.park_mm).T) <= plate.patrol_radius_mm + 1e-6).all()
    assert (np.hypot(*visit.goal_mm.T) <= plate.instrument.plate_radius_mm + 1e-6).all()
    apart = np.hypot(*(visit.goal_mm[:, None] - visit.goal_mm[None]).transpose(2, 0, 1))
    assert apart[~np.eye(n_robot, dtype=bool)].min(initial=np.inf) >= plate.instrument.min_separation_mm - 1e-6
    assert sum(visit.counts.values()) == is_held.sum()
    np.testing.assert_allclose(visit.travel_mm, np.hypot(*(visit.goal_mm - start_mm).T))


@settings(deadline=None, max_examples=8)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["cda-basic", "cda-advanced", "matching", "plan"]))
def test_every_visit_is_legal_whatever_arrives(seed, algorithm):
    """Clustered science with all that holds a fibre, dead robots, and one robot in ten that does not get there."""
    rng = np.random.default_rng(seed)
    plate = make_plate(load_instrument("taipan-150"), dead=rng.choice(np.arange(1, 160), 6, replace=False).tolist())
    targets = survey_targets(clustered_xy(int(rng.integers(0, 700)), seed), seed)
    session = start_allocation(targets, plate, AllocationSettings(algorithm=algorithm, visits=4), rng)
    position = plate.park_mm
    before = session.n_done.copy()
    while (visit := session.next_visit(position)) is not None:
        start = plate.park_mm if visit.start == "park" else position
        assert_legal(visit, targets, plate, start)
        has_arrived = rng.random(plate.n_robot) < 0.9
        session.record(visit, has_arrived)
        gained = np.bincount(visit.target[(visit.target >= 0) & has_arrived], minlength=targets.n_target)
        np.testing.assert_array_equal(session.n_done, before + gained)
        before = session.n_done.copy()
        position = visit.goal_mm
    assert (session.n_done[targets.is_science] <= targets.wanted_visits[targets.is_science]).all()
    is_lost = targets.is_science & ~session.is_complete
    np.testing.assert_array_equal(session.lost_reasons() != LostReason.NONE, is_lost)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_the_order_of_rows_does_not_matter(algorithm):
    xy, order = clustered_xy(300, 7), np.random.default_rng(1).permutation(300)
    columns = pl.DataFrame({"target_id": np.arange(300) * 3, "x_mm": xy[:, 0], "y_mm": xy[:, 1]})
    plate = make_plate(load_instrument("paper"))
    runs = [
        run(FieldTargets.from_table(rows), plate, algorithm=algorithm, visits=3)[1] for rows in (columns, columns[order])
    ]
    for a, b in zip(*runs, strict=True):
        np.testing.assert_array_equal(a.target, b.target)


def test_a_tile_goes_on_from_what_was_done_before():
    targets = field_targets([(5.0, 0.0), (30.0, 0.0)])
    plate = small_plate([(0.0, 0.0), (24.1, 0.0)])
    session = start_allocation(targets, plate, AllocationSettings(), np.random.default_rng(1), n_done=[1, 0])
    assert session.completeness_frac == 0.5
    visit = session.next_visit(plate.park_mm)
    assert visit.target.tolist() == [-1, 1]


def test_reasons_tell_a_pair_from_a_crowd_and_priority_from_fibres():
    plate = small_plate([(0.0, 0.0), (60.0, 0.0)], patrol_mm=20.0)
    pair, crowd = [(0.0, 0.0), (2.0, 0.0)], [(60.0, 0.0), (62.0, 0.0), (61.0, 1.0)]
    session, _ = run(field_targets(pair + crowd), plate, algorithm="matching", visits=1)
    lost = session.lost_reasons()
    assert sorted(lost[:2].tolist()) == [LostReason.NONE, LostReason.TOO_CLOSE_PAIR]
    assert sorted(lost[2:].tolist()) == [LostReason.NONE, LostReason.CROWDED, LostReason.CROWDED]
    alone = small_plate([(0.0, 0.0)], patrol_mm=20.0)
    for priority, reason in ((1, LostReason.LOW_PRIORITY), (9, LostReason.NO_FIBRE_LEFT)):
        targets = field_targets([(0.0, 0.0), (15.0, 0.0)], priority=[9, priority])
        session, _ = run(targets, alone, algorithm="matching", visits=1)
        assert sorted(session.lost_reasons().tolist()) == [LostReason.NONE, reason]


def test_reasons_are_spelt_as_in_the_tables():
    assert LostReason.OUT_OF_REACH.label == "out-of-reach"
    assert LostReason.NO_FIBRE_LEFT.label == "no-fibre-left"


def test_a_visit_must_be_recorded_before_the_next():
    plate = small_plate([(0.0, 0.0)])
    session = start_allocation(field_targets([(1.0, 0.0)]), plate, AllocationSettings(), np.random.default_rng(1))
    session.next_visit(plate.park_mm)
    with pytest.raises(RuntimeError, match="record"):
        session.next_visit(plate.park_mm)
