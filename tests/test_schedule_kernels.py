"""Kernels of the schedule: a night worked by hand, and random nights against plain loops."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from survey_sim.schedule import kernels
from survey_sim.schedule.nightly import observe_night
from survey_sim.schedule.robots import Configuration, UsualChain
from tests import naive_schedule

FILLS, TAKES = kernels.FILLS, kernels.TAKES


def make_rules(**changes):
    values = {
        "calibration_s": np.array([40.0]),
        "moon_cos_max": np.array([np.cos(np.radians(30.0))]),
        "survey_weight": np.array([1.0]),
        "success_frac": np.array([1.0]),
        "n_enough": np.array([100]),
        "beyond_wanted_weight": 0.1,
        "readout_s": 60.0,
        "slew_rad_s": np.radians(1.0),
        "settle_s": 10.0,
        "configuration_s": -1.0,
        "repeat_min_frac": 0.2,
        "airmass_power": 0.0,
        "idle_step_s": 120.0,
        "latitude_rad": 0.0,
        "success_key": np.uint64(1),
    }
    return kernels.Rules(**(values | changes))


def make_targets(wanted, programme, visits):
    """Targets with the visits that hold each of them."""
    holder = np.repeat(np.arange(len(visits.tile)), np.diff(visits.first_holding))
    order = np.argsort(visits.target, kind="stable")
    counts = np.bincount(visits.target, minlength=len(wanted))
    first_held = np.concatenate([[0], np.cumsum(counts)])
    return kernels.Targets(np.arange(len(wanted)), np.array(programme), np.array(wanted), first_held, holder[order])


def make_state(fields, visits, targets, n_programme=1):
    n_target = len(targets.wanted)
    gain = np.zeros((len(visits.tile), n_programme), dtype=np.int64)
    zeros = np.zeros(n_target, dtype=np.int64)
    kernels.add_gains(visits, targets, zeros, gain)
    return kernels.State(
        fields.first_visit[:-1].copy(),
        gain,
        zeros,
        zeros.copy(),
        zeros - 1,
        zeros - 1,
        np.zeros(n_programme, dtype=np.int64),
    )


def make_night(level, is_cloudy, moon=None, sidereal_rad=0.0):
    moon = np.full((len(is_cloudy) + 1, 3), np.nan) if moon is None else moon
    return kernels.Night(0, sidereal_rad, np.array(level, dtype=np.uint8), moon, np.array(is_cloudy))


def run(night, fields, visits, targets, rules, state, chain=None):
    return observe_night(night, fields, visits, targets, rules, state, chain or UsualChain())


@pytest.fixture
def two_tiles():
    """On the equator, seen from it: tile 0 at RA 0 with visits of 3 and 2 targets, tile 1 at RA 2 deg with one of 2."""
    ra_rad = np.radians([0.0, 2.0])
    fields = kernels.Fields(
        survey=np.array([0, 0]),
        first_visit=np.array([0, 2, 3]),
        direction=np.column_stack([np.cos(ra_rad), np.sin(ra_rad), np.zeros(2)]),
        ra_rad=ra_rad,
        dec_rad=np.zeros(2),
        window_rad=np.full(2, 1.0),
        min_airmass=np.ones(2),
        pressure=np.ones(2),
    )
    visits = kernels.Visits(
        tile=np.array([0, 0, 1]),
        exposure_s=np.full(3, 600.0),
        start_to_target_s=np.array([30.0, 25.0, 45.0]),
        park_to_target_s=np.array([30.0, 35.0, 45.0]),
        first_holding=np.array([0, 3, 5, 7]),
        target=np.arange(7),
    )
    return fields, visits, make_targets(np.ones(7, dtype=int), np.zeros(7, dtype=int), visits)


def test_night_worked_by_hand(two_tiles):
    fields, visits, targets = two_tiles
    state = make_state(fields, visits, targets)
    log = run(make_night([[TAKES] * 60], [False] * 60), fields, visits, targets, make_rules(), state)
    assert log[:, kernels.LOG_VISIT].tolist() == [0, 1, 2]
    # Zenith to tile 0: 10 s of settling, 30 s of robots; then 40 s of lamps.
    assert log[0] == pytest.approx([0, 70.0, 10.0, 30.0, 0.0, 600.0, kernels.OBSERVED, 70.0])
    # Same tile, next visit: 60 s of readout outlast 25 s of robots.
    assert log[1] == pytest.approx([1, 770.0, 0.0, 25.0, 60.0, 600.0, kernels.OBSERVED, 100.0])
    # The other tile: the longer of 35 s and 45 s from park, and the slew (2 s + 10 s), within the readout.
    assert log[2] == pytest.approx([2, 1470.0, 12.0, 45.0, 60.0, 600.0, kernels.OBSERVED, 100.0])
    assert state.n_observed.tolist() == [1] * 7
    assert state.n_complete.tolist() == [7]
    assert not state.gain.any()


def test_cloud_interrupts_and_the_visit_is_repeated_where_the_robots_stand(two_tiles):
    fields, visits, targets = two_tiles
    state = make_state(fields, visits, targets)
    is_cloudy = np.arange(60) == 10
    log = run(make_night([[TAKES] * 60], is_cloudy), fields, visits, targets, make_rules(), state)
    assert log[0] == pytest.approx([0, 70.0, 10.0, 30.0, 0.0, 530.0, kernels.INTERRUPTED, 70.0])
    # Readout ended under the cloud; robots and telescope stay: lamps only.
    assert log[1] == pytest.approx([0, 700.0, 0.0, 0.0, 0.0, 600.0, kernels.OBSERVED, 40.0])


def test_cloud_before_the_shutter_opens(two_tiles):
    fields, visits, targets = two_tiles
    is_cloudy = np.arange(60) == 1
    state = make_state(fields, visits, targets)
    log = run(make_night([[TAKES] * 60], is_cloudy), fields, visits, targets, make_rules(), state)
    assert log[0] == pytest.approx([0, 70.0, 10.0, 30.0, 0.0, 0.0, kernels.NOT_STARTED, 60.0])
    assert log[1, kernels.LOG_START] == pytest.approx(160.0)


def test_constant_configuration_replaces_routes(two_tiles):
    fields, visits, targets = two_tiles
    state = make_state(fields, visits, targets)
    log = run(make_night([[TAKES] * 60], [False] * 60), fields, visits, targets, make_rules(configuration_s=300.0), state)
    assert log[:, kernels.LOG_CONFIGURATION].tolist() == [300.0] * 3
    assert log[:, kernels.LOG_START].tolist() == pytest.approx([340.0, 1280.0, 2220.0])


class Scripted:
    """Robots of one night that take what a script says, by the visits so far and the one asked for."""

    is_known = True

    def __init__(self, times, lost=()):
        self.times, self.lost, self.been, self.asked = times, np.array(lost, dtype=np.int64), (), []

    def configure(self, visit, usual_s, free_s):
        self.asked.append((*self.been, visit))
        return Configuration(self.times.get((*self.been, visit), usual_s), self.lost)

    def go(self, visit):
        self.been = (*self.been, visit)


def test_pointing_pays_what_robots_really_take(two_tiles):
    fields, visits, targets = two_tiles
    state = make_state(fields, visits, targets)
    robots = Scripted({(0,): 20.0, (0, 1): 95.0, (0, 1, 2): 70.5})
    log = run(make_night([[TAKES] * 60], [False] * 60), fields, visits, targets, make_rules(), state, robots)
    assert log[:, kernels.LOG_CONFIGURATION].tolist() == [20.0, 95.0, 70.5]
    assert log[:, kernels.LOG_START].tolist() == pytest.approx([60.0, 795.0, 1505.5])
    assert robots.been == (0, 1, 2)


def test_visit_that_does_not_fit_after_all_is_passed_over_until_time_goes_on(two_tiles):
    fields, visits, targets = two_tiles
    state = make_state(fields, visits, targets)
    # 30 minutes: three exposures fit, but not after 20 minutes of robots.
    robots = Scripted({(0,): 1200.0, (2, 0): 1200.0})
    log = run(make_night([[TAKES] * 30], [False] * 30), fields, visits, targets, make_rules(), state, robots)
    assert log[:, kernels.LOG_VISIT].tolist() == [2]
    assert robots.asked[:3] == [(0,), (2,), (2, 0)]
    assert robots.asked.count((2, 0)) > 1
    assert state.n_observed.tolist() == [0] * 5 + [1, 1]


def test_targets_that_no_robot_reached_are_not_observed(two_tiles):
    fields, visits, targets = two_tiles
    state = make_state(fields, visits, targets)
    robots = Scripted({}, lost=[1, 5])
    log = run(make_night([[TAKES] * 40], [False] * 40), fields, visits, targets, make_rules(), state, robots)
    assert log[:, kernels.LOG_VISIT].tolist() == [0, 1, 2]
    assert state.n_observed.tolist() == [1, 0, 1, 1, 1, 0, 1]
    assert state.n_tried.tolist() == state.n_observed.tolist()
    # What was lost is still wanted: one of three, one of two.
    assert state.gain[:, 0].tolist() == [kernels.WHOLE_TARGET, 0, kernels.WHOLE_TARGET]


def test_time_that_a_survey_takes_goes_before_time_it_fills(two_tiles):
    fields, visits, targets = two_tiles
    fields = fields._replace(survey=np.array([0, 1]))
    rules = make_rules(calibration_s=np.full(2, 40.0), moon_cos_max=np.ones(2), survey_weight=np.array([100.0, 1.0]))
    level = [[FILLS] * 60, [TAKES] * 30 + [0] * 30]
    log = run(make_night(level, [False] * 60), fields, visits, targets, rules, make_state(fields, visits, targets))
    assert log[:, kernels.LOG_VISIT].tolist() == [2, 0, 1]


def test_field_near_the_moon_waits(two_tiles):
    fields, visits, targets = two_tiles
    moon = np.full((61, 3), np.nan)
    moon[:21] = [0.0, 0.0, 1.0]
    moon[21:41] = [np.cos(0.1), 0.0, np.sin(0.1)]
    state = make_state(fields, visits, targets)
    log = run(make_night([[TAKES] * 60], [False] * 60, moon), fields, visits, targets, make_rules(), state)
    begun = log[:, kernels.LOG_START]
    ends = begun + log[:, kernels.LOG_EXPOSURE]
    assert len(log) == 2
    assert ends[0] <= 21 * 60.0
    assert begun[1] >= 41 * 60.0


def test_failed_targets_bring_their_visit_back(two_tiles):
    fields, visits, targets = two_tiles
    state = make_state(fields, visits, targets)
    rules = make_rules(success_frac=np.array([0.5]), repeat_min_frac=0.0)
    log = run(make_night([[TAKES] * 960], [False] * 960), fields, visits, targets, rules, state)
    assert len(log) > 3
    assert (state.n_observed >= 1).all()
    assert state.n_tried.sum() > 7


def test_nothing_succeeds_with_probability_zero(two_tiles):
    fields, visits, targets = two_tiles
    state = make_state(fields, visits, targets)
    rules = make_rules(success_frac=np.array([0.0]))
    run(make_night([[TAKES] * 60], [False] * 60), fields, visits, targets, rules, state)
    assert state.n_observed.sum() == 0
    assert state.n_tried.sum() > 0


def test_draws_are_uniform_and_independent():
    draws = np.array(
        [[kernels.uniform(np.uint64(5), target, attempt) for attempt in range(1, 21)] for target in range(2_000)]
    )
    counts = np.histogram(draws, bins=20, range=(0.0, 1.0))[0]
    assert np.abs(counts - 2_000).max() < 5 * np.sqrt(2_000)
    assert np.abs(np.corrcoef(draws.T) - np.eye(20)).max() < 0.12
    assert abs(np.corrcoef(draws[:-1].ravel(), draws[1:].ravel())[0, 1]) < 0.02


def random_problem(rng):
    n_tile, n_survey, n_programme, n_minute = int(rng.integers(1, 6)), 2, 3, int(rng.integers(1, 300))
    n_visit_of = rng.integers(0, 4, n_tile)
    n_visit = int(n_visit_of.sum())
    n_held = rng.integers(0, 5, n_visit)
    n_target = 8
    held = np.concatenate([np.sort(rng.choice(n_target, n, replace=False)) for n in n_held] + [[]]).astype(np.int64)
    tile = np.repeat(np.arange(n_tile), n_visit_of)
    times = rng.uniform(5.0, 90.0, (2, n_visit))
    visits = kernels.Visits(tile, rng.uniform(100.0, 1500.0, n_visit), *times, np.append(0, np.cumsum(n_held)), held)
    ra_rad, dec_rad = rng.uniform(-0.8, 0.8, n_tile), rng.uniform(-1.2, 0.5, n_tile)
    latitude_rad = -0.55
    fields = kernels.Fields(
        survey=rng.integers(0, n_survey, n_tile),
        first_visit=np.append(0, np.cumsum(n_visit_of)),
        direction=np.column_stack([np.cos(dec_rad) * np.cos(ra_rad), np.cos(dec_rad) * np.sin(ra_rad), np.sin(dec_rad)]),
        ra_rad=ra_rad,
        dec_rad=dec_rad,
        window_rad=rng.choice([-1.0, 0.3, 0.8, 1.1], n_tile, p=[0.1, 0.3, 0.3, 0.3]),
        min_airmass=1.0 / np.cos(dec_rad - latitude_rad),
        pressure=rng.uniform(0.1, 2.0, n_tile),
    )
    targets = make_targets(rng.integers(0, 4, n_target), rng.integers(0, n_programme, n_target), visits)
    moon = rng.normal(size=3) + 0.01 * np.arange(n_minute + 1)[:, None] * rng.normal(size=3)
    moon /= np.linalg.norm(moon, axis=1, keepdims=True)
    moon[: rng.integers(0, n_minute + 1)] = np.nan
    pieces = np.sort(rng.integers(0, n_minute + 1, (n_survey, 3)), axis=1)
    level = np.array([rng.integers(0, 3, 4)[np.searchsorted(cuts, np.arange(n_minute), side="right")] for cuts in pieces])
    is_cloudy = (rng.random(n_minute // 10 + 1) < 0.3).repeat(10)[:n_minute]
    night = make_night(level, is_cloudy, moon, rng.uniform(0.0, 2 * np.pi) if rng.random() < 0.3 else 0.0)
    rules = make_rules(
        calibration_s=rng.uniform(0.0, 60.0, n_survey),
        moon_cos_max=np.cos(rng.uniform(0.0, 1.0, n_survey)),
        survey_weight=rng.uniform(0.5, 2.0, n_survey),
        success_frac=np.ones(n_programme),
        n_enough=rng.integers(0, 4, n_programme),
        beyond_wanted_weight=rng.choice([0.0, 0.1, 1.0]),
        configuration_s=-1.0 if rng.random() < 0.8 else 50.0,
        repeat_min_frac=0.23,
        airmass_power=rng.choice([0.0, 1.0, 2.5]),
        latitude_rad=latitude_rad,
    )
    return night, fields, visits, targets, rules


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_night_agrees_with_plain_loops(seed):
    night, fields, visits, targets, rules = random_problem(np.random.default_rng(seed))
    state = make_state(fields, visits, targets, n_programme=3)
    log = run(night, fields, visits, targets, rules, state)
    expected, n_observed = naive_schedule.observe_night(night, fields, visits, targets, rules)
    np.testing.assert_allclose(log[:, : kernels.LOG_OVERHEAD].reshape(-1, 7), np.array(expected).reshape(-1, 7), atol=1e-6)
    assert state.n_observed.tolist() == n_observed.tolist()
    wanted = targets.wanted
    complete = [((n_observed >= wanted) & (wanted > 0) & (targets.programme == p)).sum() for p in range(3)]
    assert state.n_complete.tolist() == complete
