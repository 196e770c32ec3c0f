"""The upper bounds of completeness hold, and are near what can be reached."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from survey_sim.allocation import AllocationSettings, completeness_bound, fast_bounds, ideal_completeness, make_field
from survey_sim.instrument import load_instrument, make_plate
from tests import naive_allocation as naive
from tests.mock_targets import clustered_xy, field_targets

PARK = [(0.0, 0.0), (15.0, 0.0), (7.5, 13.0)]


def tiny_plate(dead=()):
    return make_plate(load_instrument("paper", {"park_positions_mm": PARK, "patrol_radius_mm": 14.0}), dead)


@settings(deadline=None, max_examples=80)
@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.integers(1, 3), st.booleans())
def test_no_allocation_beats_the_bound(seed, n_target, n_visit, has_repeats):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-8, 25, (n_target, 2))
    wanted = rng.integers(1, 3 if has_repeats else 2, n_target)
    targets, plate = field_targets(xy, wanted_visits=wanted), tiny_plate()
    exact = naive.most_complete(np.array(PARK), 14.0, xy, wanted, 9.0, n_visit) / n_target
    linear = completeness_bound(targets, plate, n_visit)
    fast = completeness_bound(targets, plate, n_visit, method="fast")
    assert exact <= linear + 1e-9
    assert exact <= fast + 1e-9
    assert exact <= ideal_completeness(targets, plate, n_visit)[-1] + 1e-9


def test_fast_bounds_are_those_of_each_number_of_visits():
    targets = field_targets(clustered_xy(600, 2), wanted_visits=np.where(np.arange(600) % 3, 1, 4))
    plate = make_plate(load_instrument("paper"), [3, 40])
    expected = [completeness_bound(targets, plate, n, method="fast") for n in range(1, 9)]
    assert fast_bounds(make_field(targets, plate, AllocationSettings.load({})), 8).tolist() == expected
    assert len(set(expected)) > 4


def test_the_linear_bound_is_tighter_than_the_fast_one():
    targets, plate = field_targets(clustered_xy(1431, 1)), make_plate(load_instrument("paper"))
    for n_visit in (5, 10, 15):
        linear = completeness_bound(targets, plate, n_visit)
        assert linear <= completeness_bound(targets, plate, n_visit, method="fast")
        assert linear <= ideal_completeness(targets, plate, n_visit)[-1]


def test_a_five_ring_holds_two_at_a_time():
    """An odd cycle that no clique sees: five targets, neighbours too close, at most two a visit."""
    angle = 2 * np.pi * np.arange(5) / 5
    ring = 7.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    parks = [(0.0, 0.0), (10.0, 0.0), (0.0, 10.0), (-10.0, 0.0), (0.0, -10.0)]
    plate = make_plate(load_instrument("paper", {"park_positions_mm": parks}))
    assert [completeness_bound(field_targets(ring), plate, n) for n in (1, 2, 3)] == pytest.approx([0.4, 0.8, 1.0])


def test_what_is_done_and_what_is_reserved_count():
    targets, plate = field_targets([(0.0, 0.0), (15.0, 0.0), (7.5, 13.0)]), tiny_plate()
    assert completeness_bound(targets, plate, 1, n_reserved=2) == pytest.approx(1 / 3)
    assert completeness_bound(targets, plate, 1, n_reserved=2, n_done=[1, 0, 0]) == pytest.approx(2 / 3)
    assert completeness_bound(targets, tiny_plate(dead=[1, 2, 3]), 5) == 0.0


def test_no_targets_are_all_complete():
    assert completeness_bound(field_targets(np.empty((0, 2))), tiny_plate(), 3) == 1.0
    assert ideal_completeness(field_targets(np.empty((0, 2))), tiny_plate(), 2).tolist() == [1.0, 1.0]
