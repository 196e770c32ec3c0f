"""The schedule as a whole: what its tables promise, on synthetic surveys."""

from functools import cache

import numpy as np
import polars as pl
import pytest
from astropy import units as u
from astropy.coordinates import AltAz, EarthLocation, SkyCoord, get_body, get_sun
from astropy.time import Time
from astropy.utils import iers

from survey_sim import tables
from survey_sim.errors import InputError
from survey_sim.schedule import Configuration, Programme, ScheduleSettings, make_schedule
from tests.synthetic_schedule import Inputs, both_surveys, crowded_surveys, join, one_survey

AUTUMN = {"start_date": "2016-03-01", "end_date": "2016-05-31"}
VISIT = ["survey", "tile_id", "visit_id"]
CALIBRATION_S = 48.0


@cache
def autumn_inputs():
    return both_surveys(n_taipan_tile=60, n_funnelweb_tile=120, n_visit=800, n_held=20)


@cache
def autumn():
    return make_schedule(*autumn_inputs().arguments(), ScheduleSettings.load(AUTUMN), 7)


def run(inputs, seed=7, allocation_reasons=None, **changes):
    settings = ScheduleSettings.load(AUTUMN | changes)
    return make_schedule(*inputs.arguments(), settings, seed, allocation_reasons=allocation_reasons)


def small(ra_deg=(150.0, 160.0), dec_deg=(-30.0, -30.0), visits_of_tile=2, exposure_s=600.0, **changes):
    """One survey of a few tiles, five targets a visit."""
    parts = [one_survey("any", "stars", np.array(ra_deg), np.array(dec_deg), visits_of_tile, 5, **changes)]
    return join(parts, [Programme("stars", "any", exposure_s)])


def observed(schedule):
    return schedule.exposures.filter(pl.col("status") == "observed")


# Time


def test_pointings_follow_each_other():
    exposures = autumn().exposures
    assert set(exposures["status"]) == {"observed", "interrupted", "not-started"}
    start_s = exposures["start_mjd"].to_numpy() * 86_400.0
    paid_s = exposures.select(pl.max_horizontal("slew_s", "configuration_time_s", "readout_s")).to_series() + CALIBRATION_S
    free_s = start_s[1:] - paid_s.to_numpy()[1:] - (start_s + exposures["exposure_s"].to_numpy())[:-1]
    # Cloud that stops a pointing before its shutter opens frees the telescope before that.
    is_begun = (exposures["status"] != "not-started").to_numpy()[:-1]
    assert free_s[is_begun].min() > -1e-3
    assert (np.diff(start_s) > 0).all()


def test_times_of_a_night_fit_into_it():
    nights = autumn().nights
    left_s = nights["dark_s"] - nights["lost_s"] - nights["exposing_s"] - nights["overhead_s"]
    assert left_s.min() > -1.0
    assert nights["n_exposure"].sum() == len(autumn().exposures)
    assert nights["exposing_s"].sum() == pytest.approx(autumn().exposures["exposure_s"].sum())


def test_full_exposure_is_that_of_the_survey():
    full = observed(autumn()).group_by("survey").agg(pl.col("exposure_s").unique())
    assert dict(full.iter_rows()) == {"funnelweb": [180.0], "taipan": [1800.0]}


def test_one_night_in_thirty_is_engineering():
    clear = {"weather": {"mean_loss_frac": 0.0}}
    nights = run(autumn_inputs(), **clear).nights
    is_engineering = (nights["evening_mjd"].floor() % 30 == 0).to_numpy()
    assert is_engineering.sum() == 3
    assert not nights["n_exposure"].to_numpy()[is_engineering].any()
    every = run(autumn_inputs(), engineering_every_nights=0, **clear).nights
    assert every["n_exposure"].to_numpy()[is_engineering].any()


# Limits, again by astropy


@pytest.fixture
def _no_network():
    with iers.conf.set_temp("auto_download", False), iers.conf.set_temp("auto_max_age", None):
        yield


@pytest.mark.usefixtures("_no_network")
@pytest.mark.parametrize("at", [0.0, 0.5, 1.0])
def test_exposures_keep_the_limits(at):
    settings = ScheduleSettings.load(AUTUMN)
    exposures = autumn().exposures.join(autumn_inputs().tiles, on=["survey", "tile_id"], maintain_order="left")
    assert len(exposures) > 700
    mjd = exposures["start_mjd"].to_numpy() + at * exposures["exposure_s"].to_numpy() / 86_400.0
    time = Time(mjd, format="mjd", scale="utc")
    place = EarthLocation.from_geodetic(settings.site.longitude_deg, settings.site.latitude_deg, settings.site.height_m)
    frame = AltAz(obstime=time, location=place)
    moon = get_body("moon", time, place).transform_to(frame)
    field = SkyCoord(exposures["ra_deg"].to_numpy() * u.deg, exposures["dec_deg"].to_numpy() * u.deg).transform_to(frame)
    sun_alt_deg = get_sun(time).transform_to(frame).alt.deg
    apart_deg = field.separation(moon).deg

    is_taipan = (exposures["survey"] == "taipan").to_numpy()
    assert sun_alt_deg[is_taipan].max() < -18.0 + 0.01
    assert sun_alt_deg.max() < -12.0 + 0.01
    assert field.secz.max() < 2.0 + 0.002
    is_up = moon.alt.deg > 0.01
    assert apart_deg[is_up & is_taipan].min() > 30.0 - 0.01
    assert apart_deg[is_up & ~is_taipan].min() > 20.0 - 0.01
    lit_frac = lit_at_midnight(exposures["start_mjd"].to_numpy(), settings)
    assert not (is_taipan & is_up & (lit_frac > 0.5)).any()
    if at == 0.5:
        np.testing.assert_allclose(exposures["airmass"], field.secz, rtol=5e-4)
        np.testing.assert_allclose(exposures["moon_alt_deg"], moon.alt.deg, atol=0.01)
        np.testing.assert_allclose(exposures["moon_sep_deg"], apart_deg, atol=0.01)


def lit_at_midnight(mjd, settings):
    """Lit share of the Moon at each night's local mean midnight."""
    to_local = settings.site.longitude_deg / 360.0
    time = Time(np.floor(mjd + to_local - 0.5) + 1.0 - to_local, format="mjd", scale="utc")
    sun, moon = get_body("sun", time), get_body("moon", time)
    elongation = sun.separation(moon)
    angle = np.arctan2(sun.distance * np.sin(elongation), moon.distance - sun.distance * np.cos(elongation))
    return (1.0 + np.cos(angle).value) / 2.0


@pytest.mark.usefixtures("_no_network")
def test_dark_time_is_that_between_the_twilights():
    nights = autumn().nights[::30]
    site = ScheduleSettings().site
    place = EarthLocation.from_geodetic(site.longitude_deg, site.latitude_deg, site.height_m)
    for night in nights.iter_rows(named=True):
        time = Time(night["evening_mjd"] + np.arange(8_640) / 8_640.0, format="mjd", scale="utc")
        altitude_deg = get_sun(time).transform_to(AltAz(obstime=time, location=place)).alt.deg
        assert night["dark_s"] == pytest.approx(10.0 * (altitude_deg < -12.0).sum(), abs=25.0)


def test_fields_stay_within_the_hour_angle():
    schedule = run(small(), surveys={"any": {"hour_angle_max_deg": 15.0, "airmass_max": 5.0}})
    assert len(schedule.exposures)
    assert schedule.exposures["airmass"].max() < 1.05


# What is taken, and what it costs


def test_visits_of_a_tile_are_taken_in_order():
    taken = observed(autumn()).unique(VISIT, keep="first", maintain_order=True)
    order = taken.with_columns(place=pl.int_range(pl.len()).over("survey", "tile_id"))
    assert (order["visit_id"] == order["place"]).all()


def test_usual_configuration_time_depends_on_the_last_pointing():
    paths = autumn_inputs().paths
    times = dict(zip(paths.select(*VISIT, "path").rows(), paths["configuration_time_s"], strict=True))
    seen, previous, night = set(), None, None
    for row in autumn().exposures.iter_rows(named=True):
        visit = row["survey"], row["tile_id"], row["visit_id"]
        previous = previous if row["night"] == night else None
        if previous is None:
            case, expected = "first", times[*visit, "park_to_target"]
        elif previous == visit:
            case, expected = "again", 0.0
        elif previous == (*visit[:2], visit[2] - 1):
            case, expected = "next", times[*visit, "start_to_target"]
        else:
            case, expected = "other", max(times[*previous, "park_to_target"], times[*visit, "park_to_target"])
        assert row["configuration_time_s"] == expected
        seen.add(case)
        previous, night = visit, row["night"]
    assert seen == {"first", "again", "next", "other"}


class ForgetfulRobots:
    """Robots whose times follow from all visits since the night began, and are not known before they are asked for.

    What is learned of nights thought ahead is known `n_late` nights later; None: nobody thinks ahead.
    """

    def __init__(self, n_late, most_s=200.0, lost=lambda way: ()):
        self.n_late, self.most_s, self.lost = n_late, most_s, lost
        self.known, self.nights, self.n_begun, self.n_told = set(), [], 0, 0

    def begin_night(self, *, is_exact):
        self.n_begun += 1
        return ForgetfulChain(self, is_exact)

    def prepare(self, nights):
        if self.n_late is None:
            return
        waiting = []
        for night in nights:
            waiting.append(tuple(night.been))
            if len(waiting) > self.n_late:
                self._learn(waiting.pop(0))
                yield
        for been in waiting:
            self._learn(been)

    def _learn(self, been):
        self.known |= {been[: n + 1] for n in range(len(been))}

    def accept(self, night):
        self.nights.append(night.been)

    def way(self, way):
        rng = np.random.default_rng([len(way), *way])
        return Configuration(rng.uniform(0.0, self.most_s), np.array(self.lost(way), dtype=np.int64))


class ForgetfulChain:
    def __init__(self, robots, must_be_exact):
        self.robots, self.must_be_exact, self.been = robots, must_be_exact, []

    @property
    def is_known(self):
        return all(tuple(self.been[: n + 1]) in self.robots.known for n in range(len(self.been)))

    def configure(self, visit, usual_s, free_s):
        way = (*self.been, visit)
        if way in self.robots.known:
            return self.robots.way(way)
        if not self.must_be_exact:
            return Configuration(usual_s, np.empty(0, dtype=np.int64))
        self.robots.n_told += 1
        return self.robots.way(way)

    def go(self, visit):
        self.been.append(visit)


def lost_now_and_then(way):
    """The second visit of a night loses half of its targets, one time in three."""
    if len(way) != 2 or way[-1] % 3:
        return ()
    inputs = autumn_inputs()
    visit = inputs.visits.sort(VISIT).select(VISIT).row(way[-1], named=True)
    return inputs.holdings.filter(**visit)["target_id"].sort()[::2].to_list()


@pytest.mark.parametrize("lost", [lambda way: (), lost_now_and_then])
def test_nights_thought_ahead_end_as_those_told_one_by_one(lost):
    settings = ScheduleSettings.load(AUTUMN | {"end_date": "2016-03-20", "telescope": {"readout_s": 20.0}})
    made, robots = {}, {}
    for n_late in (None, 0, 6, 100):
        robots[n_late] = ForgetfulRobots(n_late, lost=lost)
        made[n_late] = make_schedule(*autumn_inputs().arguments(), settings, 7, robots=robots[n_late])
    in_order = made[None]
    assert len(in_order.exposures) > 100
    assert (in_order.exposures["configuration_time_s"] > 60.0).any()
    for n_late in (0, 6, 100):
        for table in ("exposures", "nights", "target_status"):
            assert getattr(made[n_late], table).equals(getattr(in_order, table))
        assert robots[n_late].nights == robots[None].nights
    exact = [robots[None].way(tuple(been[: n + 1])).time_s for been in robots[None].nights for n in range(len(been))]
    assert in_order.exposures["configuration_time_s"].to_list() == exact


def test_nights_that_go_as_was_thought_are_thought_of_once():
    """All ways end while the CCD is read, so that nothing depends on them."""
    settings = ScheduleSettings.load(AUTUMN | {"end_date": "2016-03-20", "telescope": {"readout_s": 900.0}})
    robots = ForgetfulRobots(6, most_s=5.0)
    made = make_schedule(*autumn_inputs().arguments(), settings, 7, robots=robots)
    assert len(made.exposures) > 50
    assert robots.n_begun <= 2 * settings.n_night + 6
    assert robots.n_told <= 2


def test_constant_configuration_needs_no_path():
    inputs = small()
    inputs = Inputs(inputs.visits, inputs.paths.clear(), inputs.tiles, inputs.targets, inputs.holdings, inputs.programmes)
    schedule = run(inputs, configuration_s=300.0)
    assert set(schedule.exposures["configuration_time_s"]) == {300.0}
    with pytest.raises(InputError, match=r"paths: no start_to_target"):
        run(inputs)


def test_survey_that_only_fills_gets_what_is_left():
    rule = {"takes": ["dark", "grey", "bright"]}
    alone = run(
        autumn_inputs(), surveys={"taipan": rule, "funnelweb": {"takes": [], "fills": ["dark"], "twilight_deg": -18}}
    )
    assert set(alone.exposures["survey"]) == {"taipan", "funnelweb"}
    shared = run(
        autumn_inputs(), surveys={"taipan": rule, "funnelweb": {"takes": ["dark"], "fills": [], "twilight_deg": -18}}
    )
    counts = [len(observed(one).filter(pl.col("survey") == "funnelweb")) for one in (alone, shared)]
    assert counts[0] < counts[1]


# What becomes of the targets


def test_status_and_completeness_follow_from_the_exposures():
    inputs, schedule = autumn_inputs(), autumn()
    seen = observed(schedule).select("night", *VISIT).join(inputs.holdings, on=VISIT)
    counted = seen.group_by("target_id").agg(
        n_observed=pl.len(), first_night=pl.col("night").min(), last_night=pl.col("night").max()
    )
    expected = inputs.targets.select("target_id", "programme", "wanted_visits").join(counted, on="target_id", how="left")
    expected = expected.with_columns(pl.col("n_observed").fill_null(0)).sort("target_id")
    status = schedule.target_status
    for column in ("target_id", "programme", "n_observed", "first_night", "last_night"):
        assert status[column].to_list() == expected[column].to_list()
    is_complete = expected["n_observed"] >= expected["wanted_visits"]
    assert (status["reason"].is_null() == is_complete).all()
    assert set(status["reason"].drop_nulls()) <= {"not-scheduled", "no-season", "never-visible"}

    # A target is complete from the night of its last wanted visit on.
    nth = seen.sort("night").with_columns(nth=pl.int_range(1, pl.len() + 1).over("target_id"))
    done = nth.join(inputs.targets.select("target_id", "programme", "wanted_visits"), on="target_id")
    done = done.filter(pl.col("nth") == pl.col("wanted_visits"))
    for programme in ("stars", "galaxies"):
        nights = np.sort(done.filter(pl.col("programme") == programme)["night"].to_numpy())
        n_target = (inputs.targets["programme"] == programme).sum()
        frac = np.searchsorted(nights, schedule.nights["night"].to_numpy(), side="right") / n_target
        np.testing.assert_allclose(schedule.nights[f"completeness_frac_{programme}"], frac)


def test_failed_targets_are_taken_again():
    schedule = run(small(), success_frac={"stars": 0.5}, repeat_min_frac=0.0)
    assert schedule.target_status["reason"].is_null().all()
    assert len(observed(schedule)) > 4
    never = run(small(), success_frac={"stars": 0.0})
    assert set(never.target_status["reason"]) == {"exposure-failed"}


def test_repeats_end_where_too_few_have_failed():
    schedule = run(small(), success_frac={"stars": 0.0}, repeat_min_frac=1.0)
    assert len(observed(schedule)) > 4
    schedule = run(small(wanted=2), success_frac={"stars": 0.0}, repeat_min_frac=1.0)
    assert len(observed(schedule)) == 4


def test_success_of_a_target_does_not_depend_on_the_nights():
    early = run(small(), success_frac={"stars": 0.5}, repeat_min_frac=1.0)
    late = run(small(), success_frac={"stars": 0.5}, repeat_min_frac=1.0, start_date="2016-03-20")
    assert early.exposures["start_mjd"][0] != late.exposures["start_mjd"][0]
    assert early.target_status["n_observed"].equals(late.target_status["n_observed"])


def test_programme_that_has_enough_stops_where_the_rest_is_worth_nothing():
    inputs = small(visits_of_tile=10)
    enough = Inputs(*inputs.arguments()[:5], (Programme("stars", "any", 600.0, 0.5),))
    assert 0.5 <= run(enough, beyond_wanted_weight=0.0).nights["completeness_frac_stars"][-1] < 0.8
    assert run(enough).nights["completeness_frac_stars"][-1] == 1.0


def test_field_that_is_up_in_fill_time_only_has_a_season():
    rule = {"takes": ["twilight"], "fills": ["dark"], "hour_angle_max_deg": 15.0, "twilight_deg": -17.5}
    status = run(small(ra_deg=(200.0, 210.0)), surveys={"any": rule}, end_date="2016-03-10").target_status
    assert status["reason"].is_null().all()


def test_looking_ahead_saves_what_waiting_would_lose():
    inputs = crowded_surveys(n_visit=1_250, wanted=1, n_held=4, n_tile=(170, 100))
    four_months = {"start_date": "2016-02-01", "end_date": "2016-05-31"}
    ahead, blind = (run(inputs, seed=1, is_looking_ahead=is_on, **four_months).nights for is_on in (True, False))
    for programme in ("stars", "galaxies"):
        assert ahead[f"completeness_frac_{programme}"][-1] > blind[f"completeness_frac_{programme}"][-1]
    assert ahead["completeness_frac_galaxies"][-1] > blind["completeness_frac_galaxies"][-1] + 0.05


def test_targets_without_enough_fibres_keep_the_allocators_reason():
    inputs = small(wanted=2)
    holdings = inputs.holdings.filter(pl.col("target_id") > 1)
    short = Inputs(*inputs.arguments()[:4], holdings, inputs.programmes)
    reasons = pl.DataFrame({"target_id": [0, 3], "reason": ["crowded", "low-priority"]})
    status = run(short, allocation_reasons=reasons).target_status
    assert status["reason"].to_list()[:4] == ["crowded", "not-allocated", None, None]


def test_tables_fit_the_schema():
    for table in ("exposures", "nights", "target_status"):
        frame = getattr(autumn(), table)
        assert tables.conform(frame, table).equals(frame)


def test_same_seed_gives_the_same_tables_and_row_order_does_not_matter():
    inputs = autumn_inputs()
    mixed = [frame.sample(fraction=1.0, shuffle=True, seed=3) for frame in inputs.arguments()[:5]]
    again = run(Inputs(*mixed, inputs.programmes))
    for table in ("exposures", "nights", "target_status"):
        assert getattr(again, table).equals(getattr(autumn(), table))


def test_weather_does_not_depend_on_what_is_observed():
    other = run(small(), surveys={"any": {"twilight_deg": -12}}, engineering_every_nights=0)
    assert other.nights["lost_s"].equals(autumn().nights["lost_s"])
    assert (
        not run(small(), seed=8, surveys={"any": {"twilight_deg": -12}}).nights["lost_s"].equals(autumn().nights["lost_s"])
    )


# Edges


def check_nothing_observed(schedule, n_night=92):
    assert len(schedule.exposures) == 0
    assert len(schedule.nights) == n_night
    assert schedule.warnings


def test_no_night():
    schedule = run(small(), end_date="2015-02-28")
    check_nothing_observed(schedule, n_night=0)
    assert set(schedule.target_status["reason"]) == {"no-season"}
    assert "no night" in schedule.warnings[0]


def test_field_that_the_site_never_sees():
    schedule = run(small(dec_deg=(-30.0, 70.0)))
    status = schedule.target_status
    assert set(status["reason"][5:]) == {None, "never-visible"}
    assert status["reason"].null_count() == 10
    assert "1 of 2 tiles are never" in schedule.warnings[0]


def test_site_that_never_sees_any_field():
    schedule = run(small(), site={"latitude_deg": 85.0})
    check_nothing_observed(schedule)
    assert set(schedule.target_status["reason"]) == {"never-visible"}


def test_field_out_of_season():
    schedule = run(small(ra_deg=(150.0, 0.0)), end_date="2016-03-20")
    assert set(schedule.target_status["reason"]) == {None, "no-season"}
    assert "not up in the time that it may have" in schedule.warnings[0]


def test_weather_that_loses_everything():
    schedule = run(small(), weather={"mean_loss_frac": 1.0})
    check_nothing_observed(schedule)
    assert set(schedule.target_status["reason"]) == {"not-scheduled"}
    assert schedule.nights["lost_s"].equals(schedule.nights["dark_s"])
    assert "cloud" in schedule.warnings[0]


@pytest.mark.parametrize("latitude_deg", [-90.0, 90.0, -75.0])
def test_polar_sites(latitude_deg):
    for dates in (
        {"start_date": "2016-06-01", "end_date": "2016-06-10"},
        {"start_date": "2016-12-20", "end_date": "2016-12-30"},
    ):
        schedule = run(small(dec_deg=(-80.0, -70.0)), site={"latitude_deg": latitude_deg}, **dates)
        dark_s = schedule.nights["dark_s"].to_numpy()
        is_winter = (dates["start_date"] == "2016-06-01") == (latitude_deg < 0)
        assert (dark_s > 40_000.0).all() if is_winter else (dark_s == 0.0).all()
        assert schedule.warnings or len(schedule.exposures)


def test_no_visit_no_target_no_tile_no_programme():
    inputs = small()
    visits, paths, tiles, targets, holdings, programmes = inputs.arguments()
    none = visits.clear(), paths.clear(), tiles, targets, holdings.clear(), programmes
    schedule = run(Inputs(*none))
    check_nothing_observed(schedule)
    assert set(schedule.target_status["reason"]) == {"not-allocated"}
    schedule = run(Inputs(visits, paths, tiles, targets.clear(), holdings.clear(), programmes))
    check_nothing_observed(schedule)
    assert schedule.nights["completeness_frac_stars"].to_list() == [0.0] * 92
    check_nothing_observed(run(Inputs(*(frame.clear() for frame in inputs.arguments()[:5]), programmes)))
    check_nothing_observed(run(Inputs(*(frame.clear() for frame in inputs.arguments()[:5]), ())))


@pytest.mark.parametrize(
    ("table", "change", "rule"),
    [
        ("visits", lambda f: f.filter(pl.col("visit_id") != 0), "not 0, 1, 2"),
        ("tiles", lambda f: f.head(1), "does not have"),
        ("targets", lambda f: f.with_columns(programme=pl.lit("star")), "no programme 'star'"),
        ("targets", lambda f: f.head(3), "not among the science targets"),
        ("holdings", lambda f: f.with_columns(visit_id=9), "not among visits"),
    ],
)
def test_tables_that_do_not_fit_each_other(table, change, rule):
    inputs = small()
    broken = Inputs(**{**vars(inputs), table: change(getattr(inputs, table))})
    with pytest.raises(InputError, match=rule):
        run(broken)


def test_names_that_nobody_has():
    with pytest.raises(InputError, match=r"schedule.success_frac.star: .*\n.*did you mean 'stars'"):
        run(small(), success_frac={"star": 0.5})
    with pytest.raises(InputError, match=r"schedule.surveys.taipen"):
        run(small(), surveys={"taipen": {}})
