"""Sun, Moon, sidereal time and fields against astropy, without its network."""

from datetime import date

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import AltAz, EarthLocation, SkyCoord, get_body, get_sun
from astropy.time import Time
from astropy.utils import iers

from survey_sim.geometry import unit_vectors
from survey_sim.schedule.ephemeris import make_ephemeris, mjd_of
from survey_sim.schedule.settings import Site

TOLERANCE_DEG = 0.01


@pytest.fixture(autouse=True)
def _no_network():
    with iers.conf.set_temp("auto_download", False), iers.conf.set_temp("auto_max_age", None):
        yield


@pytest.fixture(scope="module")
def ephemeris():
    return make_ephemeris(Site(), date(2016, 1, 1), date(2020, 12, 31))


def site_of(ephemeris):
    site = ephemeris.site
    return EarthLocation.from_geodetic(site.longitude_deg, site.latitude_deg, site.height_m)


def altitude_deg(ephemeris, direction, sidereal_rad):
    return np.degrees(np.arcsin(ephemeris.sin_altitude(direction, sidereal_rad)))


# Over the whole span, at all hours.
DATES_MJD = 57_388.13 + np.linspace(0.0, 1_826.0, 23)


@pytest.mark.parametrize("body", ["sun", "moon"])
def test_altitude_and_direction_of_sun_and_moon(ephemeris, body):
    for mjd in DATES_MJD:
        time = Time(mjd, format="mjd", scale="utc")
        frame = AltAz(obstime=time, location=site_of(ephemeris))
        seen = (get_sun(time) if body == "sun" else get_body("moon", time, site_of(ephemeris))).transform_to(frame)
        sidereal_rad = ephemeris.sidereal_rad(np.array([mjd]))
        direction = getattr(ephemeris, body)(np.array([mjd]), sidereal_rad, ephemeris.to_date(mjd))
        assert altitude_deg(ephemeris, direction, sidereal_rad)[0] == pytest.approx(seen.alt.deg, abs=TOLERANCE_DEG)


def test_altitude_of_fields(ephemeris):
    sky = SkyCoord([10.0, 120.0, 250.0, 300.0] * u.deg, [-80.0, -31.0, 5.0, 25.0] * u.deg)
    for mjd in DATES_MJD:
        frame = AltAz(obstime=Time(mjd, format="mjd", scale="utc"), location=site_of(ephemeris))
        direction = ephemeris.directions(unit_vectors(sky.ra.deg, sky.dec.deg), mjd)
        sidereal_rad = np.repeat(ephemeris.sidereal_rad(mjd), len(sky))
        expected = sky.transform_to(frame).alt.deg
        np.testing.assert_allclose(altitude_deg(ephemeris, direction, sidereal_rad), expected, atol=TOLERANCE_DEG)


def test_lit_share_of_the_moon(ephemeris):
    for mjd in DATES_MJD:
        time = Time(mjd, format="mjd", scale="utc")
        sun, moon = get_body("sun", time), get_body("moon", time)
        elongation = sun.separation(moon)
        angle = np.arctan2(sun.distance * np.sin(elongation), moon.distance - sun.distance * np.cos(elongation))
        assert ephemeris.moon_lit_frac(mjd) == pytest.approx((1.0 + np.cos(angle).value) / 2.0, abs=1e-4)


def test_noon_is_of_the_sites_own_calendar_day(ephemeris):
    noon_mjd = ephemeris.noon_mjd(date(2016, 1, 1))
    assert mjd_of(date(2016, 1, 1)) == 57_388
    assert noon_mjd == pytest.approx(57_388.5 - 149.0712 / 360.0)
    west = make_ephemeris(Site(longitude_deg=289.5), date(2016, 1, 1), date(2016, 1, 2))
    assert west.noon_mjd(date(2016, 1, 1)) == pytest.approx(57_388.5 + 70.5 / 360.0)
