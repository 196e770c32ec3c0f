"""Sun, Moon, sidereal time and fields over the site: true altitudes (no refraction), good to 0.01 deg.

Directions are taken to the true equator and equinox of date by the IAU 2006/2000A matrix (ERFA), once a night; fields
and Sun with annual aberration, the Moon with its parallax. UT1 is taken as UTC (0.9 s at most: 0.004 deg), polar
motion is left out.
"""

from dataclasses import dataclass
from datetime import date
from typing import TYPE_CHECKING

import erfa
import numpy as np
import numpy.typing as npt

from survey_sim.schedule.kernels import DAY_S
from survey_sim.schedule.settings import Site

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

FloatArray = npt.NDArray[np.float64]

MJD_ZERO = 2_400_000.5
# Coarse grid of the spline, days: the Moon goes 3.3 deg in a step, the cubic is good to 0.01 arcsec.
_GRID_STEP_D = 0.25
_WGS84 = 1
# TT - UTC since 2017-01-01 (IERS Bulletin C); a few seconds wrong elsewhen: the Moon goes 0.5 arcsec in one.
_TT_UTC_D = 69.184 / DAY_S


def mjd_of(day: date) -> int:
    """Modified Julian date of the day's 0 h."""
    return day.toordinal() - date(1858, 11, 17).toordinal()


@dataclass(frozen=True)
class Ephemeris:
    """Sun and Moon by spline, for a span of days at a site.

    Attributes
    ----------
    site
        Where the telescope stands.
    sun_au, moon_au
        Splines of MJD (UTC) to geocentric ICRS vectors, au; the Sun's with aberration.
    earth_c
        Spline of MJD to the Earth's barycentric velocity, units of c.
    """

    site: Site
    sun_au: "CubicSpline"
    moon_au: "CubicSpline"
    earth_c: "CubicSpline"

    @property
    def site_au(self) -> FloatArray:
        """Site from the Earth's centre: distance from its axis and height over its equator, au."""
        longitude, latitude = np.radians([self.site.longitude_deg, self.site.latitude_deg])
        x, y, z = erfa.gd2gc(_WGS84, longitude, latitude, self.site.height_m)
        return np.array([np.hypot(x, y), z]) / erfa.DAU

    def noon_mjd(self, day: date) -> float:
        """Local mean noon of a day, UTC, MJD."""
        longitude = (self.site.longitude_deg + 180.0) % 360.0 - 180.0
        return mjd_of(day) + 0.5 - longitude / 360.0

    def sidereal_rad(self, mjd: FloatArray | float) -> FloatArray:
        """Local apparent sidereal time, rad in [0, 2 pi)."""
        utc = np.asarray(mjd, dtype=np.float64)
        turn = erfa.gst06a(MJD_ZERO, utc, MJD_ZERO, utc + _TT_UTC_D)
        return np.asarray((turn + np.radians(self.site.longitude_deg)) % (2.0 * np.pi))

    def to_date(self, mjd: float) -> FloatArray:
        """(3, 3) matrix from ICRS to the true equator and equinox of date."""
        return np.asarray(erfa.pnm06a(MJD_ZERO, mjd + _TT_UTC_D))

    def directions(self, icrs: FloatArray, mjd: float) -> FloatArray:
        """(n, 3) apparent unit vectors of date of (n, 3) ICRS ones: aberration, precession, nutation."""
        seen = icrs + self.earth_c(mjd)
        return (seen / np.linalg.norm(seen, axis=1, keepdims=True)) @ self.to_date(mjd).T

    def sun(self, mjd: FloatArray, sidereal_rad: FloatArray, to_date: FloatArray) -> FloatArray:
        """(n, 3) unit vectors of the Sun of date, as seen from the site."""
        return _topocentric(self.sun_au(mjd) @ to_date.T, self.site_au, sidereal_rad)

    def moon(self, mjd: FloatArray, sidereal_rad: FloatArray, to_date: FloatArray) -> FloatArray:
        """(n, 3) unit vectors of the Moon of date, as seen from the site."""
        return _topocentric(self.moon_au(mjd) @ to_date.T, self.site_au, sidereal_rad)

    def sin_altitude(self, direction: FloatArray, sidereal_rad: FloatArray) -> FloatArray:
        """(n,) sines of the true altitude of (n, 3) directions of date."""
        latitude = np.radians(self.site.latitude_deg)
        towards_meridian = direction[:, 0] * np.cos(sidereal_rad) + direction[:, 1] * np.sin(sidereal_rad)
        return np.clip(np.sin(latitude) * direction[:, 2] + np.cos(latitude) * towards_meridian, -1.0, 1.0)

    def moon_lit_frac(self, mjd: float) -> float:
        """Lit share of the Moon's disc (Meeus 1998, chapter 48), from the Earth's centre."""
        sun, moon = self.sun_au(mjd), self.moon_au(mjd)
        cos_elongation = float(sun @ moon / np.linalg.norm(sun) / np.linalg.norm(moon))
        across = np.linalg.norm(sun) * np.sqrt(1.0 - cos_elongation**2)
        phase_angle = np.arctan2(across, np.linalg.norm(moon) - np.linalg.norm(sun) * cos_elongation)
        return float((1.0 + np.cos(phase_angle)) / 2.0)


def make_ephemeris(site: Site, first: date, last: date) -> Ephemeris:
    """Ephemeris from the noon before `first` to the noon after `last`, or after `first` if that is later.

    References
    ----------
    ERFA epv00 (Sun: 13 arcsec at worst in a century, here below 0.1) and moon98 (Meeus 1998, chapter 47: 10 arcsec).
    """
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - 0.2 s that the command line's help need not pay

    mjd = np.arange(mjd_of(first) - 2.0, mjd_of(max(first, last)) + 3.0 + _GRID_STEP_D, _GRID_STEP_D)
    heliocentric, barycentric = erfa.epv00(MJD_ZERO, mjd + _TT_UTC_D)
    earth_c = barycentric["v"] * (erfa.DAU / DAY_S / erfa.CMPS)
    sun = -heliocentric["p"]
    sun = sun + np.linalg.norm(sun, axis=1, keepdims=True) * earth_c
    moon = erfa.moon98(MJD_ZERO, mjd + _TT_UTC_D)["p"]
    return Ephemeris(site, CubicSpline(mjd, sun), CubicSpline(mjd, moon), CubicSpline(mjd, earth_c))


def _topocentric(vector_au: FloatArray, site_au: FloatArray, sidereal_rad: FloatArray) -> FloatArray:
    """(n, 3) unit vectors of date from the site, of (n, 3) geocentric ones."""
    across, up = site_au
    site = np.column_stack([across * np.cos(sidereal_rad), across * np.sin(sidereal_rad), np.full(len(sidereal_rad), up)])
    seen = vector_au - site
    return np.asarray(seen / np.linalg.norm(seen, axis=1, keepdims=True))
