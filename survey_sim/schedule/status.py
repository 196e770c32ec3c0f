"""Tables out: pointings, nights, what became of each target, and what the user should know."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import polars as pl

from survey_sim.schedule import kernels
from survey_sim.schedule.ephemeris import Ephemeris
from survey_sim.schedule.fields import LookAhead
from survey_sim.schedule.kernels import State
from survey_sim.schedule.problem import Problem
from survey_sim.schedule.settings import ScheduleSettings
from survey_sim.schedule.sky import Night
from survey_sim.tables import conform

FloatArray = npt.NDArray[np.float64]

# How an exposure went, in the order of the kernels' codes.
EXPOSURE_STATUS = ("observed", "interrupted", "not-started")
# Why a target is not complete; a later one goes before an earlier one.
REASONS = (
    "not-scheduled",  # there was no time for (all of) its visits
    "exposure-failed",  # exposed as often as wanted, but not with success each time
    "no-season",  # its field is never up in the time that its survey may have, within the dates
    "never-visible",  # its field is never within the limits of airmass and hour angle at this site
    "not-allocated",  # fewer visits hold it than it wants, for a reason that the allocation may give
)
_NOT_SCHEDULED, _EXPOSURE_FAILED, _NO_SEASON, _NEVER_VISIBLE, _NOT_ALLOCATED = range(len(REASONS))


def exposures_table(
    problem: Problem, ephemeris: Ephemeris, nights: Sequence[Night], logs: Sequence[FloatArray]
) -> pl.DataFrame:
    """Table `exposures` of the logs of all nights; airmass and Moon from the ephemeris, at mid-exposure."""
    frames = [_sky_of_log(problem, ephemeris, *pair) for pair in zip(nights, logs, strict=True)]
    log = np.concatenate([*logs, np.empty((0, kernels.N_LOG))])
    sky = np.concatenate([*frames, np.empty((0, 4))])
    status = np.array(EXPOSURE_STATUS)[log[:, kernels.LOG_STATUS].astype(np.int64)]
    table = problem.visit_table[log[:, kernels.LOG_VISIT].astype(np.int64)].with_columns(
        exposure_id=np.arange(len(log)),
        night=np.repeat(np.arange(len(nights)), [len(one) for one in logs]),
        start_mjd=sky[:, 0],
        slew_s=log[:, kernels.LOG_SLEW],
        configuration_time_s=log[:, kernels.LOG_CONFIGURATION],
        readout_s=log[:, kernels.LOG_READOUT],
        overhead_s=log[:, kernels.LOG_OVERHEAD],
        exposure_s=log[:, kernels.LOG_EXPOSURE],
        airmass=sky[:, 1],
        moon_alt_deg=sky[:, 2],
        moon_sep_deg=sky[:, 3],
        status=pl.Series(status, dtype=pl.String),
    )
    return conform(table, "exposures")


def nights_table(
    problem: Problem, nights: Sequence[Night], logs: Sequence[FloatArray], n_complete: npt.NDArray[np.int64]
) -> pl.DataFrame:
    """Table `nights`; `n_complete` (n_night, n_programme) targets complete after each night."""
    columns = {
        "night": np.arange(len(nights)),
        "evening_mjd": np.array([night.evening_mjd for night in nights], dtype=np.float64),
        "dark_s": np.array([night.dark_s for night in nights], dtype=np.float64),
        "lost_s": np.array([night.lost_s for night in nights], dtype=np.float64),
        "engineering_s": np.array(
            [(night.dark_s - night.lost_s) * night.is_engineering for night in nights], dtype=np.float64
        ),
        "exposing_s": np.array([log[:, kernels.LOG_EXPOSURE].sum() for log in logs], dtype=np.float64),
        "overhead_s": np.array([log[:, kernels.LOG_OVERHEAD].sum() for log in logs], dtype=np.float64),
        "n_exposure": np.array([len(log) for log in logs], dtype=np.int64),
    }
    for number, programme in enumerate(problem.programmes):
        columns[f"completeness_frac_{programme.name}"] = n_complete[:, number] / max(1, problem.n_target[number])
    return conform(pl.DataFrame(columns), "nights")


def target_status_table(
    problem: Problem, state: State, look_ahead: LookAhead, allocation_reasons: pl.DataFrame | None
) -> pl.DataFrame:
    """Table `target_status`: a row for every science target."""
    targets = problem.targets
    holder = problem.visits.tile[targets.visit]
    code = np.full(len(targets.target_id), _NOT_SCHEDULED)
    code[state.n_tried >= targets.wanted] = _EXPOSURE_FAILED
    code[~_any_of(look_ahead.has_season[holder], targets.first_held)] = _NO_SEASON
    code[~_any_of(look_ahead.is_visible[holder], targets.first_held)] = _NEVER_VISIBLE
    code[np.diff(targets.first_held) < targets.wanted] = _NOT_ALLOCATED
    table = pl.DataFrame(
        {
            "target_id": targets.target_id,
            "survey": _labels([programme.survey for programme in problem.programmes], targets.programme),
            "programme": _labels([programme.name for programme in problem.programmes], targets.programme),
            "n_observed": state.n_observed,
            "first_night": state.first_night,
            "last_night": state.last_night,
            "reason": _labels(REASONS, code),
            "is_complete": state.n_observed >= targets.wanted,
        }
    )
    if allocation_reasons is not None:
        given = allocation_reasons.select("target_id", given="reason")
        table = table.join(given, on="target_id", how="left", maintain_order="left")
        is_given = (pl.col("reason") == REASONS[_NOT_ALLOCATED]) & pl.col("given").is_not_null()
        table = table.with_columns(pl.when(is_given).then("given").otherwise("reason").alias("reason")).drop("given")
    nights = [pl.when(pl.col(name) >= 0).then(name).alias(name) for name in ("first_night", "last_night")]
    reason = pl.when(~pl.col("is_complete")).then("reason").alias("reason")
    return conform(table.with_columns(*nights, reason).drop("is_complete"), "target_status")


def find_warnings(
    problem: Problem, settings: ScheduleSettings, nights: Sequence[Night], look_ahead: LookAhead
) -> tuple[str, ...]:
    """Sentences on what keeps the schedule from doing anything, or part of it."""
    found = []
    if not nights:
        found.append(f"no night from {settings.start_date} to {settings.end_date}: nothing is observed")
    if not len(problem.visit_table):
        found.append("no visit to schedule: nothing is observed")
    for programme, n_target in zip(problem.programmes, problem.n_target, strict=True):
        if not n_target:
            found.append(f"programme {programme.name} has no target: its completeness is given as 0")
    dark_s, lost_s = sum(night.dark_s for night in nights), sum(night.lost_s for night in nights)
    if nights and dark_s == 0.0:
        found.append(f"it is never dark at latitude {settings.site.latitude_deg} deg between these dates")
    elif nights and lost_s >= dark_s:
        found.append("cloud takes all of the time: nothing is observed")
    has_visits = np.diff(problem.first_visit) > 0
    for survey, name in enumerate(problem.surveys):
        of_survey = has_visits & (problem.tile_survey == survey)
        n_unseen = int((of_survey & ~look_ahead.is_visible).sum())
        if n_unseen:
            found.append(
                f"survey {name}: {n_unseen} of {of_survey.sum()} tiles are never within its limits of airmass and hour "
                f"angle at latitude {settings.site.latitude_deg} deg"
            )
        n_out = int((of_survey & look_ahead.is_visible & ~look_ahead.has_season).sum())
        if nights and n_out:
            found.append(f"survey {name}: {n_out} of {of_survey.sum()} tiles are not up in the time that it may have")
    return tuple(found)


def _sky_of_log(problem: Problem, ephemeris: Ephemeris, night: Night, log: FloatArray) -> FloatArray:
    """(n, 4) start (MJD), airmass, altitude of the Moon and its distance (deg) of a night's pointings, at mid-exposure."""
    if not len(log):
        return np.empty((0, 4))
    start_mjd = night.start_mjd + log[:, kernels.LOG_START] / kernels.DAY_S
    mjd = start_mjd + 0.5 * log[:, kernels.LOG_EXPOSURE] / kernels.DAY_S
    sidereal_rad = night.sidereal_rad + kernels.SIDEREAL_RAD_S * kernels.DAY_S * (mjd - night.start_mjd)
    tile = problem.visits.tile[log[:, kernels.LOG_VISIT].astype(np.int64)]
    direction = ephemeris.directions(problem.tile_icrs[tile], night.evening_mjd + 0.5)
    moon = ephemeris.moon(mjd, sidereal_rad, night.to_date)
    apart = np.linalg.norm(np.cross(direction, moon), axis=1)
    return np.column_stack(
        [
            start_mjd,
            1.0 / ephemeris.sin_altitude(direction, sidereal_rad),
            np.degrees(np.arcsin(ephemeris.sin_altitude(moon, sidereal_rad))),
            np.degrees(np.arctan2(apart, (direction * moon).sum(axis=1))),
        ]
    )


def _labels(labels: Sequence[str], code: npt.NDArray[np.int64]) -> pl.Series:
    return pl.Series(labels, dtype=pl.String).gather(code)


def _any_of(flag: npt.NDArray[np.bool_], first: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """(n,) whether any item of each owner has the flag."""
    total = np.concatenate([[0], np.cumsum(flag)])
    return np.asarray(total[first[1:]] > total[first[:-1]])
