"""Compiled loop of one night. All kernels that call each other are here: the compiler's cache does not notice an edit in
another file.
"""

# Kernels take flat arrays and untyped scalars, and are long where splitting them would cost calls.
# ruff: noqa: PLW3301
# mypy: disable-error-code="no-untyped-def"
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from survey_sim.kernel import inner_kernel

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
ByteArray = npt.NDArray[np.uint8]

TWO_PI = 2.0 * np.pi
# Sidereal over mean solar rate (Aoki et al. 1982), and rad of sidereal time in a second.
SIDEREAL_RATE = 1.002_737_909_350_795
DAY_S = 86_400.0
MINUTE_S = 60.0
SIDEREAL_RAD_S = TWO_PI * SIDEREAL_RATE / DAY_S
# Levels of a survey's right to a minute.
NONE, FILLS, TAKES = 0, 1, 2
# Status of a pointing.
OBSERVED, INTERRUPTED, NOT_STARTED = 0, 1, 2
# Worth is counted in whole parts of a target, so that sums are exact: thirds, fourths, ... of it up to sixteenths.
WHOLE_TARGET = 720_720
# The least airmass over the airmass may exceed 1 by rounding.
ROUNDING = 1e-9
# The Moon's way between the ends of a minute, by which its distance limit is widened: 0.02 deg.
MOON_MARGIN_RAD = 3.5e-4


class Fields(NamedTuple):
    """Tiles as the night sees them; n tiles.

    survey: (n,); first_visit: (n + 1,) places of each tile's visits; direction: (n, 3) of date; ra_rad, dec_rad: (n,)
    of date; window_rad: (n,) largest hour angle at which the field may be observed, < 0 if never; min_airmass: (n,);
    pressure: (n,) factor of worth, see `fields.LookAhead`.
    """

    survey: IntArray
    first_visit: IntArray
    direction: FloatArray
    ra_rad: FloatArray
    dec_rad: FloatArray
    window_rad: FloatArray
    min_airmass: FloatArray
    pressure: FloatArray


class Visits(NamedTuple):
    """Visits in order of survey, tile, visit; m visits.

    tile: (m,); exposure_s, start_to_target_s, park_to_target_s: (m,); first_holding: (m + 1,) places in `target`; target:
    (n_holding,) targets held.
    """

    tile: IntArray
    exposure_s: FloatArray
    start_to_target_s: FloatArray
    park_to_target_s: FloatArray
    first_holding: IntArray
    target: IntArray


class Targets(NamedTuple):
    """Science targets; k targets.

    target_id, programme, wanted: (k,); first_held: (k + 1,) places in `visit`; visit: (n_holding,) visits that hold
    each target.
    """

    target_id: IntArray
    programme: IntArray
    wanted: IntArray
    first_held: IntArray
    visit: IntArray


class Rules(NamedTuple):
    """Settings as numbers; by survey where (n_survey,), by programme where (n_programme,)."""

    calibration_s: FloatArray
    moon_cos_max: FloatArray
    survey_weight: FloatArray
    success_frac: FloatArray
    n_enough: IntArray  # targets that make the completeness wanted
    beyond_wanted_weight: float
    readout_s: float
    slew_rad_s: float
    settle_s: float
    configuration_s: float  # < 0: as routed
    repeat_min_frac: float
    airmass_power: float
    idle_step_s: float
    latitude_rad: float
    success_key: np.uint64


class State(NamedTuple):
    """What changes as visits are observed.

    next_visit: (n,) next visit of each tile; gain: (m, n_programme) parts of targets that a visit would gain; n_observed,
    n_tried, first_night, last_night: (k,); n_complete: (n_programme,).
    """

    next_visit: IntArray
    gain: IntArray
    n_observed: IntArray
    n_tried: IntArray
    first_night: IntArray
    last_night: IntArray
    n_complete: IntArray


class Night(NamedTuple):
    """Sky of the night by minutes, see `sky.Night`."""

    number: int
    sidereal_rad: float
    level: ByteArray
    moon: FloatArray
    is_cloudy: BoolArray


class Course(NamedTuple):
    """How far a night has gone; n tiles.

    candidate: (n,) visit that each tile offers, -1 if none; is_stale: (n,) tiles that must look again for one; is_passed:
    (n,) tiles that did not fit at this moment; weight: (n_programme,) what a target counts; until: (2, n_survey, n_minute)
    ends of the runs of minutes that a survey at least fills, and takes, s; clock: time (NOW) and end of the last readout
    (READ_OUT), s; place: visit of the last pointing (PREVIOUS), -1 with the telescope at the zenith and the robots at park,
    and number of pointings (N_DONE).
    """

    candidate: IntArray
    is_stale: BoolArray
    is_passed: BoolArray
    weight: FloatArray
    until: FloatArray
    clock: FloatArray
    place: IntArray


# Places in a course's `clock` and `place`.
NOW, READ_OUT = 0, 1
PREVIOUS, N_DONE = 0, 1
# Columns of the log of a night.
LOG_VISIT, LOG_START, LOG_SLEW, LOG_CONFIGURATION, LOG_READOUT, LOG_EXPOSURE, LOG_STATUS, LOG_OVERHEAD = range(8)
N_LOG = 8
# Pointings of one night: each takes at least the shortest exposure, or is cut short by a cloudy minute.
MAX_CUT_SHORT = 1_440


@inner_kernel
def wrap(angle):
    """Angle in [-pi, pi), rad."""
    turned = angle + np.pi
    # The remainder, exact in any case; a difference of two angles seldom needs the slow one.
    if TWO_PI <= turned < 2.0 * TWO_PI:
        turned -= TWO_PI
    elif not 0.0 <= turned < TWO_PI:
        turned %= TWO_PI
    return turned - np.pi


@inner_kernel
def uniform(key, target_id, attempt):
    """Number in [0, 1) that depends on its arguments alone (splitmix64: Steele et al. 2014, DOI 10.1145/2714064.2660195)."""
    z = key + np.uint64(target_id) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(attempt) * np.uint64(0xD1B54A32D192ED03)
    for _ in range(2):
        z += np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    return np.float64(z >> np.uint64(11)) * 2.0**-53


@inner_kernel
def configuration_time(visits, visit, previous, constant_s):
    """Time that the robots usually need for a visit after the previous pointing's visit (-1: parked), s.

    From park: the visit's own way. The same visit again: none. The next visit of the same tile: its own way. Any other:
    the longer of the two visits' ways from park (measured: docs/schedule.md). `constant_s` >= 0 replaces all of these.
    """
    if constant_s >= 0.0:
        return constant_s
    if previous < 0:
        return visits.park_to_target_s[visit]
    if previous == visit:
        return 0.0
    if previous == visit - 1 and visits.tile[previous] == visits.tile[visit]:
        return visits.start_to_target_s[visit]
    return max(visits.park_to_target_s[previous], visits.park_to_target_s[visit])


@inner_kernel
def share(n_wanted):
    """Parts of a target that one visit is worth to one that still wants so many: the fewer, the nearer it is to complete."""
    return WHOLE_TARGET // n_wanted if n_wanted > 0 else 0


@njit(cache=True)
def add_gains(visits, targets, n_observed, gain):
    """Add to (m, n_programme) what the targets held at each visit would gain by it, parts of a target."""
    for visit in range(len(visits.tile)):
        for h in range(visits.first_holding[visit], visits.first_holding[visit + 1]):
            target = visits.target[h]
            gain[visit, targets.programme[target]] += share(targets.wanted[target] - n_observed[target])


@njit(cache=True)
def update_weights(rules, state, weight):
    """Set (n_programme,) what a target of each programme counts: 1 until enough are complete; True if any changed."""
    has_changed = False
    for programme in range(len(weight)):
        is_short = state.n_complete[programme] < rules.n_enough[programme]
        new = 1.0 if is_short else rules.beyond_wanted_weight
        has_changed = has_changed or new != weight[programme]
        weight[programme] = new
    return has_changed


@inner_kernel
def visit_worth(state, visit, weight):
    """Weighted parts of targets that a visit would gain."""
    worth = 0.0
    for programme in range(len(weight)):
        worth += weight[programme] * state.gain[visit, programme]
    return worth


@inner_kernel
def _is_worth_repeating(visits, state, visit, repeat_min_frac):
    """Whether enough of what a visit holds still wants it."""
    gain = 0
    for programme in range(state.gain.shape[1]):
        gain += state.gain[visit, programme]
    n_held = visits.first_holding[visit + 1] - visits.first_holding[visit]
    return gain >= repeat_min_frac * n_held * WHOLE_TARGET


@inner_kernel
def next_candidate(fields, visits, state, tile, weight, repeat_min_frac):
    """Visit that a tile offers; -1 if none.

    Its visits in order, those that nobody wants left out; when all are done, the one worth most again, if enough of
    what it holds still lacks a success.
    """
    end = fields.first_visit[tile + 1]
    while state.next_visit[tile] < end:
        visit = state.next_visit[tile]
        for programme in range(len(weight)):
            if state.gain[visit, programme] > 0:
                return visit
        state.next_visit[tile] += 1
    best, best_worth = -1, 0.0
    for visit in range(fields.first_visit[tile], end):
        worth = visit_worth(state, visit, weight)
        if worth > best_worth and _is_worth_repeating(visits, state, visit, repeat_min_frac):
            best, best_worth = visit, worth
    return best


@njit(cache=True)
def work_left(tile_survey, first_visit, visits, state, weight, overhead_s, repeat_min_frac, out):
    """Fill (n,) seconds that the visits left in each tile, new or to be repeated, would take with the usual overhead."""
    for tile in range(len(out)):
        out[tile] = 0.0
        for visit in range(first_visit[tile], first_visit[tile + 1]):
            is_wanted = visit >= state.next_visit[tile] or _is_worth_repeating(visits, state, visit, repeat_min_frac)
            if is_wanted and visit_worth(state, visit, weight) > 0.0:
                out[tile] += visits.exposure_s[visit] + overhead_s[tile_survey[tile]]


@njit(cache=True)
def sum_open(is_open, tile_survey, by_survey):
    """(n,) sum over the bins open to each tile, (n, n_bin) shares, of its survey's column of (n_bin, n_survey)."""
    total = np.zeros(len(tile_survey))
    for tile in range(len(tile_survey)):
        for part in range(is_open.shape[1]):
            total[tile] += is_open[tile, part] * by_survey[part, tile_survey[tile]]
    return total


@njit(cache=True)
def credit(visits, targets, state, visit, night, success_frac, key, lost, is_stale):
    """Count a good exposure: draw the success of each target but those lost, and note which tiles' offers that alters."""
    for h in range(visits.first_holding[visit], visits.first_holding[visit + 1]):
        target = visits.target[h]
        if (lost == target).any():
            continue
        programme = targets.programme[target]
        state.n_tried[target] += 1
        if uniform(key, targets.target_id[target], state.n_tried[target]) >= success_frac[programme]:
            continue
        state.n_observed[target] += 1
        if state.first_night[target] < 0:
            state.first_night[target] = night
        state.last_night[target] = night
        n_wanted = targets.wanted[target] - state.n_observed[target]
        change = share(n_wanted) - share(n_wanted + 1)
        for g in range(targets.first_held[target], targets.first_held[target + 1]):
            state.gain[targets.visit[g], programme] += change
            is_stale[visits.tile[targets.visit[g]]] = True
        if n_wanted == 0:
            state.n_complete[programme] += 1


@njit(cache=True)
def _ends_of_runs(level, least, out):
    """Fill (n_survey, n_minute) end, s, of the run of minutes at or above a level that each minute is in; 0 outside."""
    n_survey, n_minute = level.shape
    for survey in range(n_survey):
        end = 0.0
        for minute in range(n_minute - 1, -1, -1):
            if level[survey, minute] < least:
                end = 0.0
            elif end == 0.0:
                end = (minute + 1) * MINUTE_S
            out[survey, minute] = end


@inner_kernel
def _first_cloud(is_cloudy, start_s, end_s):
    """When cloud first comes within a span, s; the span's end if it does not."""
    for minute in range(int(start_s / MINUTE_S), min(len(is_cloudy), int(np.ceil(end_s / MINUTE_S)))):
        if is_cloudy[minute]:
            return max(start_s, minute * MINUTE_S)
    return end_s


@njit(cache=True)
def _offer(fields, visits, rules, state, course):
    """Renew what each stale tile offers, -1 if nothing; gives the tiles that offer a visit."""
    active = np.empty(len(course.candidate), dtype=np.int64)
    n_active = 0
    for tile in range(len(course.candidate)):
        if course.is_stale[tile] and fields.window_rad[tile] > 0.0:
            course.candidate[tile] = next_candidate(fields, visits, state, tile, course.weight, rules.repeat_min_frac)
        course.is_stale[tile] = False
        if course.candidate[tile] >= 0:
            active[n_active] = tile
            n_active += 1
    return active[:n_active]


@inner_kernel
def _telescope(fields, visits, sidereal, latitude, previous):
    """Hour angle and declination at which the telescope stands after the pointing at a visit (-1: the zenith), rad."""
    if previous < 0:
        return 0.0, latitude
    tile = visits.tile[previous]
    return wrap(sidereal - fields.ra_rad[tile]), fields.dec_rad[tile]


@inner_kernel
def _way(ha, dec, from_ha, from_dec):
    """How far the telescope slews along the axis of the longer way, rad."""
    return max(abs(ha - from_ha), abs(dec - from_dec))


@inner_kernel
def _stays_up(ha, window, to_start, to_end):
    """Whether a field is within its window from start to end, so many s from now, when its hour angle is `ha`, rad."""
    return ha + SIDEREAL_RAD_S * to_start >= -window and ha + SIDEREAL_RAD_S * to_end <= window


@inner_kernel
def _level(until, survey, start, end):
    """Right of a survey to the time from start to end, s, which ends within the night."""
    minute = int(start / MINUTE_S)
    return TAKES if end <= until[1, survey, minute] else FILLS if end <= until[0, survey, minute] else NONE


@inner_kernel
def _is_moonlit(direction, moon, start, end, cos_max):
    """Whether a direction is nearer to the Moon than allowed at start or end, s; never to one that is down (NaN)."""
    for minute in (int(start / MINUTE_S), int(np.ceil(end / MINUTE_S))):
        if direction[0] * moon[minute, 0] + direction[1] * moon[minute, 1] + direction[2] * moon[minute, 2] > cos_max:
            return True
    return False


@njit(cache=True)
def _choose(night, fields, visits, rules, state, course, active):
    """Tile of greatest score now, by the usual configuration times; -1 if none can be observed."""
    sin_lat, cos_lat = np.sin(rules.latitude_rad), np.cos(rules.latitude_rad)
    now, previous = course.clock[NOW], course.place[PREVIOUS]
    sidereal = night.sidereal_rad + SIDEREAL_RAD_S * now
    end_s = len(night.is_cloudy) * MINUTE_S
    readout = max(0.0, course.clock[READ_OUT] - now)
    previous_tile = visits.tile[previous] if previous >= 0 else -1
    from_ha, from_dec = _telescope(fields, visits, sidereal, rules.latitude_rad, previous)
    best, best_level, best_score = -1, NONE, 0.0
    for tile in active:
        ha, window = wrap(sidereal - fields.ra_rad[tile]), fields.window_rad[tile]
        if ha > window or course.is_passed[tile]:
            continue
        visit, survey = course.candidate[tile], fields.survey[tile]
        slew = 0.0
        if tile != previous_tile:
            slew = _way(ha, fields.dec_rad[tile], from_ha, from_dec) / rules.slew_rad_s + rules.settle_s
        configuration = configuration_time(visits, visit, previous, rules.configuration_s)
        start = now + max(slew, max(configuration, readout)) + rules.calibration_s[survey]
        end = start + visits.exposure_s[visit]
        if end > end_s or not _stays_up(ha, window, start - now, end - now):
            continue
        level = _level(course.until, survey, start, end)
        if level == NONE or level < best_level:
            continue
        worth = visit_worth(state, visit, course.weight) * rules.survey_weight[survey] * fields.pressure[tile]
        # Even at its least airmass it would not be the best.
        if level == best_level and worth * (1.0 + ROUNDING) / (end - now) <= best_score:
            continue
        cos_ha = np.cos(ha + SIDEREAL_RAD_S * (0.5 * (start + end) - now))
        sin_alt = sin_lat * np.sin(fields.dec_rad[tile]) + cos_lat * np.cos(fields.dec_rad[tile]) * cos_ha
        score = worth * (fields.min_airmass[tile] * sin_alt) ** rules.airmass_power / (end - now)
        if score <= 0.0 or (level == best_level and score <= best_score):
            continue
        if not _is_moonlit(fields.direction[tile], night.moon, start, end, rules.moon_cos_max[survey]):
            best, best_level, best_score = tile, level, score
    return best


@njit(cache=True)
def begin_night(night, fields, rules, state):
    """The course of a night before its first pointing."""
    n_tile, n_minute = len(fields.survey), len(night.is_cloudy)
    until = np.zeros((2, len(rules.calibration_s), n_minute))
    _ends_of_runs(night.level, FILLS, until[0])
    _ends_of_runs(night.level, TAKES, until[1])
    weight = np.empty(len(rules.n_enough))
    update_weights(rules, state, weight)
    return Course(
        np.full(n_tile, -1, dtype=np.int64),
        np.ones(n_tile, dtype=np.bool_),
        np.zeros(n_tile, dtype=np.bool_),
        weight,
        until,
        np.zeros(2),
        np.array([-1, 0]),
    )


@njit(cache=True)
def next_tile(night, fields, visits, rules, state, course):
    """Let the night go on, through cloud and with nothing to observe, to its next pointing: its tile; -1: it is over.

    At every moment of clear sky the visit of greatest

        worth x pressure x (least airmass / airmass)^power / (overhead + exposure)

    is chosen, among the visits that fit wholly into the survey's time, the field's window and its distance from the
    Moon; time that a survey takes goes before time that it only fills. Equal visits: the first in order. Times are
    seconds from the night's first minute.
    """
    active = _offer(fields, visits, rules, state, course)
    while course.clock[NOW] < len(night.is_cloudy) * MINUTE_S and len(active):
        minute = int(course.clock[NOW] / MINUTE_S)
        if night.is_cloudy[minute]:
            course.clock[NOW] = (minute + 1) * MINUTE_S
        else:
            tile = _choose(night, fields, visits, rules, state, course, active)
            if tile >= 0:
                return tile
            course.clock[NOW] += rules.idle_step_s
        course.is_passed[:] = False
    return -1


@njit(cache=True)
def waits(night, fields, visits, rules, course, tile):
    """Seconds until the telescope could be at a tile, and until the last exposure is read, from now."""
    now, previous = course.clock[NOW], course.place[PREVIOUS]
    sidereal = night.sidereal_rad + SIDEREAL_RAD_S * now
    slew = 0.0
    if previous < 0 or visits.tile[previous] != tile:
        ha, dec = wrap(sidereal - fields.ra_rad[tile]), fields.dec_rad[tile]
        from_ha, from_dec = _telescope(fields, visits, sidereal, rules.latitude_rad, previous)
        slew = _way(ha, dec, from_ha, from_dec) / rules.slew_rad_s + rules.settle_s
    return slew, max(0.0, course.clock[READ_OUT] - now)


@njit(cache=True)
def point(night, fields, visits, targets, rules, state, course, tile, configuration, lost, log):
    """Point at a tile's visit, if it fits with the time that its configuration really takes, s; whether it does.

    One that does not is passed over until time goes on. `lost`: targets that no robot holds after all. The pointing is
    written to the next row of `log` (enough rows, N_LOG).
    """
    now, visit, survey = course.clock[NOW], course.candidate[tile], fields.survey[tile]
    ha = wrap(night.sidereal_rad + SIDEREAL_RAD_S * now - fields.ra_rad[tile])
    slew, readout = waits(night, fields, visits, rules, course, tile)
    start = now + max(slew, max(configuration, readout)) + rules.calibration_s[survey]
    end = start + visits.exposure_s[visit]
    if (
        end > len(night.is_cloudy) * MINUTE_S
        or not _stays_up(ha, fields.window_rad[tile], start - now, end - now)
        or _level(course.until, survey, start, end) == NONE
        or _is_moonlit(fields.direction[tile], night.moon, start, end, rules.moon_cos_max[survey])
    ):
        course.is_passed[tile] = True
        return False
    stop = _first_cloud(night.is_cloudy, now, end)
    status = OBSERVED if stop == end else INTERRUPTED if stop > start else NOT_STARTED
    row = log[course.place[N_DONE]]
    row[LOG_VISIT] = visit
    row[LOG_START] = start
    row[LOG_SLEW] = slew
    row[LOG_CONFIGURATION] = configuration
    row[LOG_READOUT] = readout
    row[LOG_EXPOSURE] = visits.exposure_s[visit] if status == OBSERVED else max(0.0, stop - start)
    row[LOG_STATUS] = status
    row[LOG_OVERHEAD] = min(stop, start) - now
    course.place[N_DONE] += 1
    course.place[PREVIOUS] = visit
    course.clock[NOW] = stop
    course.is_passed[:] = False
    if status != NOT_STARTED:
        course.clock[READ_OUT] = stop + rules.readout_s
    if status == OBSERVED:
        success_frac, key = rules.success_frac, rules.success_key
        credit(visits, targets, state, visit, night.number, success_frac, key, lost, course.is_stale)
        if visit == state.next_visit[tile]:
            state.next_visit[tile] += 1
        course.is_stale[tile] = True
        if update_weights(rules, state, course.weight):
            course.is_stale[:] = True
    return True
