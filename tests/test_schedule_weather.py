"""Cloud: its mean, its memory, and that it depends on its own settings and the date alone."""

from datetime import date, timedelta

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from survey_sim.schedule.settings import Weather
from survey_sim.schedule.weather import make_weather

FIRST = date(2016, 1, 1)


@pytest.fixture(scope="module")
def many_years():
    return np.stack([make_weather(FIRST, 1_827, Weather(), seed) for seed in range(12)])


@pytest.mark.parametrize("mean", [0.1, 0.4, 0.7])
def test_mean_loss(mean):
    weather = make_weather(FIRST, 20_000, Weather(mean_loss_frac=mean), 3)
    assert weather.mean() == pytest.approx(mean, abs=0.02)


def test_mean_is_the_same_at_all_hours(many_years):
    assert many_years.mean() == pytest.approx(0.40, abs=0.015)
    assert np.ptp(many_years.mean(axis=(0, 1))) < 0.03


def test_cloud_lasts_within_the_night_and_from_night_to_night(many_years):
    by_night = many_years[:, :, 24].astype(float)

    def correlation(before, after):
        return np.corrcoef(before.ravel(), after.ravel())[0, 1]

    one_night = correlation(by_night[:, :-1], by_night[:, 1:])
    assert 0.2 < one_night < 0.4
    assert abs(correlation(by_night[:, :-10], by_night[:, 10:])) < 0.05
    half_hour = correlation(many_years[:, :, 23], many_years[:, :, 24])
    six_hours = correlation(many_years[:, :, 12], many_years[:, :, 24])
    assert half_hour > six_hours > one_night


def test_there_are_clear_cloudy_and_mixed_nights(many_years):
    night = many_years[:, :, 14:34].mean(axis=2)
    assert 0.3 < (night == 0).mean() < 0.5
    assert 0.15 < (night == 1).mean() < 0.3
    assert 0.2 < ((night > 0) & (night < 1)).mean() < 0.5


@settings(max_examples=20, deadline=None)
@given(later=st.integers(0, 300), n_night=st.integers(1, 20), seed=st.integers(0, 2**63))
def test_weather_of_a_date_does_not_depend_on_the_first_night(later, n_night, seed):
    long = make_weather(FIRST, later + n_night, Weather(), seed)
    assert (long[later:] == make_weather(FIRST + timedelta(days=later), n_night, Weather(), seed)).all()


def test_extremes():
    assert not make_weather(FIRST, 50, Weather(mean_loss_frac=0.0), 1).any()
    assert make_weather(FIRST, 50, Weather(mean_loss_frac=1.0), 1).all()
    assert make_weather(FIRST, 0, Weather(), 1).shape == (0, 48)
    forgetful = make_weather(FIRST, 2_000, Weather(night_memory_days=0.0, hour_memory_h=0.0, night_share_frac=0.0), 1)
    assert abs(np.corrcoef(forgetful[:, 5], forgetful[:, 6])[0, 1]) < 0.07


def test_seeds_differ():
    assert (make_weather(FIRST, 30, Weather(), 1) != make_weather(FIRST, 30, Weather(), 2)).any()
