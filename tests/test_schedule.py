"""The schedule as a whole: what its tables promise, on synthetic surveys."""

from functools import cache

import numpy as np
import polars as pl
import pytest

from survey_sim.schedule import ScheduleSettings, make_schedule
from tests.synthetic_schedule import both_surveys


@cache
def small_inputs():
    return both_surveys(n_taipan_tile=60, n_funnelweb_tile=120, n_visit=400, n_held=20)


@cache
def small_schedule():
    settings = ScheduleSettings.load({"start_date": "2016-03-01", "end_date": "2016-05-31"})
    return make_schedule(*small_inputs().arguments(), settings, 7)


def test_pointings_do_not_overlap():
    exposures = small_schedule().exposures
    start_s = exposures["start_mjd"].to_numpy() * 86_400.0
    overhead_s = (
        exposures.select(pl.max_horizontal("slew_s", "configuration_time_s", "readout_s")).to_series().to_numpy() + 48.0
    )
    end_s = start_s + exposures["exposure_s"].to_numpy()
    is_begun = (exposures["status"] != "not-started").to_numpy()[1:]
    gap_s = (start_s[1:] - overhead_s[1:] - end_s[:-1])[is_begun]
    assert len(gap_s) > 100
    assert gap_s.min() > -1e-3


@pytest.mark.parametrize("table", ["exposures", "nights", "target_status"])
def test_same_seed_gives_same_bytes(table):
    settings = ScheduleSettings.load({"start_date": "2016-03-01", "end_date": "2016-05-31"})
    again = make_schedule(*small_inputs().arguments(), settings, 7)
    assert getattr(again, table).equals(getattr(small_schedule(), table))


def test_night_budget_is_within_the_night():
    nights = small_schedule().nights
    left_s = nights["dark_s"] - nights["lost_s"] - nights["exposing_s"] - nights["overhead_s"]
    assert left_s.min() > -1.0
    assert np.isclose(nights["n_exposure"].sum(), len(small_schedule().exposures))
