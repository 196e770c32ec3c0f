"""Settings of the schedule: rules by survey, and errors at the door."""

import pytest

from survey_sim.errors import InputError
from survey_sim.schedule import ScheduleSettings


def test_known_surveys_have_their_rules_and_changes_keep_the_rest():
    rule = ScheduleSettings.load({"surveys": {"funnelweb": {"airmass_max": 2.3}}}).rule("funnelweb")
    assert rule.airmass_max == 2.3
    assert rule.takes == ("bright", "twilight")
    assert rule.twilight_deg == -12.0
    assert ScheduleSettings().rule("taipan").takes == ("dark", "grey")
    assert ScheduleSettings().rule("another").takes == ("dark", "grey", "bright")


def test_settings_come_back_from_their_own_dump():
    settings = ScheduleSettings.load({"configuration_s": 300, "surveys": {"x": {"takes": ["dark"]}}})
    assert ScheduleSettings.load(settings.model_dump(mode="json")) == settings


@pytest.mark.parametrize(
    ("values", "place"),
    [
        ({"surveys": {"taipan": {"takes": ["dark", "gray"]}}}, "surveys.taipan.takes"),
        ({"surveys": {"taipan": {"takes": ["dark"], "fills": ["dark"]}}}, "schedule"),
        ({"surveys": {"taipan": 3}}, "surveys.taipan"),
        ({"surveys": 3}, "surveys"),
        ({"airmas_power": 1}, "airmas_power"),
        ({"weather": {"mean_loss_frac": 1.4}}, "weather.mean_loss_frac"),
        ({"configuration_s": "fast"}, "configuration_s"),
        ({"start_date": "2016-13-01"}, "start_date"),
    ],
)
def test_faults_name_their_key(values, place):
    with pytest.raises(InputError, match=place):
        ScheduleSettings.load(values, section="schedule")


def test_nights_are_counted_from_evening_to_evening():
    assert ScheduleSettings().n_night == 1_827
    assert ScheduleSettings.load({"start_date": "2016-01-02", "end_date": "2016-01-01"}).n_night == 0
