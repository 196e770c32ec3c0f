"""Nights as the telescope sees them: minute by minute, who may observe, the Moon, and cloud."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta

import numpy as np
import numpy.typing as npt

from survey_sim.schedule.ephemeris import Ephemeris
from survey_sim.schedule.kernels import FILLS, MINUTE_S, NONE, SIDEREAL_RATE, TAKES
from survey_sim.schedule.settings import ASTRONOMICAL_TWILIGHT_DEG, SKY_STATES, Moonlight, ScheduleSettings, SurveyRule
from survey_sim.schedule.weather import STEP_S

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
ByteArray = npt.NDArray[np.uint8]

_N_MINUTE_DAY = 1_440
_DARK, _GREY, _BRIGHT, _TWILIGHT = range(len(SKY_STATES))
# Bins of local sidereal time in which time is counted ahead.
N_LST_BIN = 24


@dataclass(frozen=True)
class Night:
    """One night between the twilights of the survey that observes nearest to the Sun; n minutes, whole ones.

    Attributes
    ----------
    evening_mjd
        Local mean noon before it, UTC.
    start_mjd
        Start of its first minute, UTC.
    sidereal_rad
        Local apparent sidereal time at `start_mjd`.
    to_date
        (3, 3) matrix from ICRS to the true equator and equinox of date.
    state
        (n,) state of the sky, place in `SKY_STATES`.
    level
        (n_survey, n) right of each survey to the minute: NONE, FILLS, TAKES; the lesser of its two ends'.
    moon
        (n + 1, 3) unit vectors to the Moon from the site, of date, at the ends of the minutes; NaN while it is down.
    is_cloudy
        (n,) cloud.
    dark_s, lost_s
        Time between the twilights (to the second, not the minute), and how much of it is cloudy.
    is_engineering
        Given to engineering: nothing is observed.
    """

    evening_mjd: float
    start_mjd: float
    sidereal_rad: float
    to_date: FloatArray
    state: ByteArray
    level: ByteArray
    moon: FloatArray
    is_cloudy: BoolArray
    dark_s: float
    lost_s: float
    is_engineering: bool

    @property
    def n_minute(self) -> int:
        """Whole minutes between the twilights."""
        return len(self.state)


def make_nights(
    ephemeris: Ephemeris, is_cloudy: BoolArray, rules: Sequence[SurveyRule], settings: ScheduleSettings
) -> list[Night]:
    """All nights, in order.

    Parameters
    ----------
    is_cloudy
        (n_night, 48) from `make_weather`.
    rules
        Rule of each survey.
    """
    return [_make_night(ephemeris, night, is_cloudy[night], rules, settings) for night in range(settings.n_night)]


def time_by_bin(nights: Sequence[Night]) -> FloatArray:
    """(n_night + 1, 24, 4) seconds by sidereal time and state of the sky, from each night on to the last one."""
    seconds = np.zeros((len(nights) + 1, N_LST_BIN, len(SKY_STATES)))
    for row, night in enumerate(nights):
        if night.is_engineering:
            continue
        turn = night.sidereal_rad / (2.0 * np.pi) + (np.arange(night.n_minute) + 0.5) / _N_MINUTE_DAY * SIDEREAL_RATE
        bins = (turn % 1.0 * N_LST_BIN).astype(np.int64) * len(SKY_STATES) + night.state
        counts = np.bincount(bins, minlength=N_LST_BIN * len(SKY_STATES))
        seconds[row] = counts.reshape(N_LST_BIN, -1) * MINUTE_S
    return np.cumsum(seconds[::-1], axis=0)[::-1]


def _make_night(
    ephemeris: Ephemeris, night: int, cloudy_steps: BoolArray, rules: Sequence[SurveyRule], settings: ScheduleSettings
) -> Night:
    evening_mjd = ephemeris.noon_mjd(settings.start_date + timedelta(days=night))
    mjd = evening_mjd + np.arange(_N_MINUTE_DAY + 1) / _N_MINUTE_DAY
    midnight_mjd = evening_mjd + 0.5
    to_date = ephemeris.to_date(midnight_mjd)
    turn = ephemeris.sidereal_rad(midnight_mjd) + 2.0 * np.pi * SIDEREAL_RATE * (mjd - midnight_mjd)
    sun_alt_deg = np.degrees(np.arcsin(ephemeris.sin_altitude(ephemeris.sun(mjd, turn, to_date), turn)))

    limit_deg = max((rule.twilight_deg for rule in rules), default=ASTRONOMICAL_TWILIGHT_DEG)
    dark_minutes_s = MINUTE_S * _share_below(sun_alt_deg, limit_deg)
    is_cloudy = np.repeat(cloudy_steps, int(STEP_S / MINUTE_S))
    first, end = _longest_run(dark_minutes_s >= MINUTE_S)
    edges = slice(first, end + 1)
    moon = ephemeris.moon(mjd[edges], turn[edges], to_date)
    moon_alt_deg = np.degrees(np.arcsin(ephemeris.sin_altitude(moon, turn[edges])))
    lit_frac = ephemeris.moon_lit_frac(midnight_mjd)
    state = sky_state(sun_alt_deg[edges], moon_alt_deg, lit_frac, settings.moonlight)
    level = np.array([_levels(rule, state, sun_alt_deg[edges]) for rule in rules], dtype=np.uint8)
    level = level.reshape(len(rules), len(state))
    every = settings.engineering_every_nights
    return Night(
        evening_mjd=evening_mjd,
        start_mjd=float(mjd[first]),
        sidereal_rad=float(turn[first] % (2.0 * np.pi)),
        to_date=to_date,
        state=state[:-1],
        level=np.ascontiguousarray(np.minimum(level[:, :-1], level[:, 1:])),
        moon=np.where((moon_alt_deg > settings.moonlight.up_alt_deg)[:, None], moon, np.nan),
        is_cloudy=is_cloudy[first:end],
        dark_s=float(dark_minutes_s.sum()),
        lost_s=float(dark_minutes_s[is_cloudy].sum()),
        is_engineering=every > 0 and int(np.floor(evening_mjd)) % every == 0,
    )


def sky_state(sun_alt_deg: FloatArray, moon_alt_deg: FloatArray, lit_frac: float, moonlight: Moonlight) -> ByteArray:
    """(n,) state of the sky, place in `SKY_STATES`: twilight first, then by the Moon's altitude and phase."""
    lit = _GREY if lit_frac <= moonlight.grey_max_frac else _BRIGHT
    state = np.where(moon_alt_deg > moonlight.up_alt_deg, lit, _DARK)
    return np.where(sun_alt_deg > ASTRONOMICAL_TWILIGHT_DEG, _TWILIGHT, state).astype(np.uint8)


def _levels(rule: SurveyRule, state: ByteArray, sun_alt_deg: FloatArray) -> ByteArray:
    """(n,) level of a survey at each end of a minute."""
    by_state = [TAKES if name in rule.takes else FILLS if name in rule.fills else NONE for name in SKY_STATES]
    return np.where(sun_alt_deg <= rule.twilight_deg, np.array(by_state, dtype=np.uint8)[state], NONE).astype(np.uint8)


def _share_below(altitude_deg: FloatArray, limit_deg: float) -> FloatArray:
    """(n,) share of each minute spent at or below the limit, linear between its (n + 1) ends."""
    above = np.maximum(altitude_deg - limit_deg, 0.0)
    below = np.maximum(limit_deg - altitude_deg, 0.0)
    total_below, total_above = below[:-1] + below[1:], above[:-1] + above[1:]
    total = total_below + total_above
    return np.divide(total_below, total, out=np.ones_like(total), where=total > 0)


def _longest_run(is_dark: BoolArray) -> tuple[int, int]:
    """First and past-the-last place of the longest run of dark minutes; (0, 0) if there is none."""
    steps = np.diff(np.concatenate([[0], is_dark.astype(np.int8), [0]]))
    starts, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
    if not len(starts):
        return 0, 0
    longest = int(np.argmax(ends - starts))
    return int(starts[longest]), int(ends[longest])
