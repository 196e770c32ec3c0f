"""What the schedule came to: worked by hand."""

import polars as pl
import pytest

from survey_sim.schedule import make_completeness, make_time_budget

# Evenings of 2016-12-31 and 2017-01-01, a little after 2 h UTC.
EVENINGS_MJD = (57753.1, 57754.1)


def nights(**columns):
    """Two nights of 10,000 s, one in each year."""
    values = {"dark_s": [10_000.0] * 2, "lost_s": [0.0] * 2, "engineering_s": [0.0] * 2, "exposing_s": [0.0] * 2}
    values |= {"overhead_s": [0.0] * 2, "night": [0, 1], "evening_mjd": EVENINGS_MJD}
    return pl.DataFrame(values | columns)


def pointing(night=0, survey="a", slew_s=0.0, readout_s=0.0, configuration_time_s=0.0, overhead_s=0.0, exposure_s=0.0):
    return dict(locals())


def budget(exposures, **columns):
    schema = {"night": pl.Int32, "survey": pl.String}
    table = make_time_budget(pl.DataFrame(exposures, schema_overrides=schema), nights(**columns))
    return {row[:3]: row[3] for row in table.iter_rows()}


def test_what_goes_on_at_once_is_counted_once():
    spent = budget([pointing(readout_s=60.0, slew_s=80.0, configuration_time_s=95.0, overhead_s=143.0, exposure_s=600.0)])
    own = {activity: time_s for (year, survey, activity), time_s in spent.items() if (year, survey) == (2016, "a")}
    assert own == {"exposing": 600.0, "reading": 60.0, "slewing": 20.0, "configuring": 15.0, "calibrating": 48.0}


def test_robots_within_the_readout_cost_nothing():
    spent = budget([pointing(readout_s=60.0, slew_s=30.0, configuration_time_s=25.0, overhead_s=108.0)])
    assert spent[2016, "a", "configuring"] == 0.0
    assert spent[2016, "a", "slewing"] == 0.0


def test_pointing_that_cloud_stopped_costs_what_it_took():
    spent = budget([pointing(readout_s=60.0, slew_s=80.0, configuration_time_s=95.0, overhead_s=70.0)])
    parts = [spent[2016, "a", activity] for activity in ("reading", "slewing", "configuring", "calibrating")]
    assert parts == [60.0, 10.0, 0.0, 0.0]


def test_years_and_what_nobody_used():
    exposures = [pointing(), pointing(night=1, exposure_s=700.0, overhead_s=100.0)]
    spent = budget(
        exposures, lost_s=[4_000.0, 0.0], engineering_s=[6_000.0, 0.0], exposing_s=[0.0, 700.0], overhead_s=[0.0, 100.0]
    )
    assert spent[2016, None, "weather"] == 4_000.0
    assert spent[2016, None, "engineering"] == 6_000.0
    assert spent[2016, None, "idle"] == 0.0
    assert spent[2017, "a", "exposing"] == 700.0
    assert spent[2017, None, "idle"] == 9_200.0
    assert sum(spent.values()) == pytest.approx(20_000.0)


def test_no_pointing_and_no_night():
    none = pl.DataFrame([pointing()], schema_overrides={"night": pl.Int32}).clear()
    assert set(make_time_budget(none, nights())["activity"]) == {"weather", "engineering", "idle"}
    assert make_time_budget(none, nights().clear()).is_empty()


def science(n=4):
    """Two targets in one cell of the sky and two in another; the last has no magnitude."""
    return pl.DataFrame(
        {
            "target_id": range(n),
            "programme": ["p"] * n,
            "survey": ["a"] * n,
            "mag": [10.0, 10.49, 10.5, None],
            "priority": [5, 5, 9, 9],
            "_healpix_29": [0, 1, 4**23, 4**23 + 1],
            "ra_deg": [192.85948, 12.85948, 192.85948, 192.85948],
            "dec_deg": [26.12825, -26.12825, 27.12825 - 85.0, 27.12825 - 84.0],
        }
    )


def status(reasons):
    return pl.DataFrame({"target_id": range(len(reasons)), "reason": reasons}, schema_overrides={"reason": pl.String})


def test_completeness_in_bins():
    ends = nights(completeness_frac_p=[0.25, 0.5])
    table = make_completeness(science(), status([None, "not-scheduled", None, "no-season"]), ends)
    found = {
        (quantity, low): (n, done)
        for quantity, low, n, done in table.select("quantity", "low", "n_target", "n_complete").iter_rows()
    }
    assert found["all", None] == (4, 2)
    assert found["year", 2016.0] == (4, 1)
    assert found["year", 2017.0] == (4, 2)
    assert (found["mag", 10.0], found["mag", 10.5]) == ((2, 1), (1, 1))
    assert (found["priority", 5.0], found["priority", 9.0]) == ((2, 1), (2, 1))
    assert (found["latitude", 80.0], found["latitude", 0.0]) == ((2, 1), (2, 1))
    # Two in a cell of 0.839 square degrees: 2.38 a square degree.
    assert [key for key in found if key[0] == "density"] == [("density", 2.0)]
    assert found["density", 2.0] == (4, 2)


def test_completeness_without_targets():
    assert make_completeness(science().clear(), status([]), nights(completeness_frac_p=[0.0, 0.0])).is_empty()
