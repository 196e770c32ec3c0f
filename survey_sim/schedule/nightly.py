"""The schedule: night after night, which visit next.

What is observed next is what would be lost by waiting. At every moment of clear sky each tile offers its next visit,
and the one of greatest

    worth x pressure x (least airmass / airmass)^p / time

goes. Worth: the parts of targets that the visit gains; a target that still wants n visits counts 1/n, so that what is begun
is finished, and little once its programme has the completeness wanted. Time: what the telescope pays for it, overhead and
exposure. Airmass: at mid-exposure, against the least that the field ever has. Pressure is the look-ahead: hours wanted /
hours left in which the field can still be observed, over the bins of sidereal time and sky state that are open to it, from
tonight to the last night, shared with all other fields that want the same bins. So fields with short or crowded seasons go
first, and where there is not time enough for all, the richest visits do.

Greedy within the night, deterministic, and without knowledge of the weather to come.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import polars as pl

from survey_sim.errors import InputError, did_you_mean
from survey_sim.schedule import kernels
from survey_sim.schedule.ephemeris import make_ephemeris
from survey_sim.schedule.fields import LookAhead, make_fields
from survey_sim.schedule.kernels import Rules, observe_night
from survey_sim.schedule.problem import Problem, initial_state, make_problem
from survey_sim.schedule.settings import SURVEY_RULES, Programme, ScheduleSettings, SurveyRule
from survey_sim.schedule.sky import make_nights
from survey_sim.schedule.status import exposures_table, find_warnings, nights_table, target_status_table
from survey_sim.schedule.weather import make_weather

FloatArray = npt.NDArray[np.float64]

# Key of the targets' successes among the streams of a run.
_STREAM_SUCCESS = 2


@dataclass(frozen=True)
class Schedule:
    """Tables of the schedule, as `schema` declares them, and what the user should know."""

    exposures: pl.DataFrame
    nights: pl.DataFrame
    target_status: pl.DataFrame
    warnings: tuple[str, ...]


def make_schedule(
    visits: pl.DataFrame,
    paths: pl.DataFrame,
    tiles: pl.DataFrame,
    targets: pl.DataFrame,
    holdings: pl.DataFrame,
    programmes: Sequence[Programme],
    settings: ScheduleSettings,
    seed: int,
    *,
    allocation_reasons: pl.DataFrame | None = None,
) -> Schedule:
    """Observe the visits of all surveys on one telescope, from the first night to the last.

    Parameters
    ----------
    visits, paths, tiles, targets
        Frames of the schema; of `targets`, the rows of kind science count. `paths` may be empty if
        `settings.configuration_s` is a number.
    holdings
        Frame survey, tile_id, visit_id, target_id: science targets that a robot really holds at each visit.
    programmes
        One for each programme of `targets`.
    seed
        Of the weather and of the targets' successes.
    allocation_reasons
        Frame target_id, reason: why targets did not get (all) their fibres; default "not-allocated".

    Raises
    ------
    InputError
        Tables that do not fit each other; rules or probabilities for a survey or programme that there is not.

    Notes
    -----
    Visits of a tile are taken in order, since each is configured from the one before. The robots' configuration runs
    while the CCD reads out and the telescope slews: a pointing pays the longest of the three, then its calibration, then
    the exposure. Configuration times by `kernels.configuration_time`; every night begins with all robots at park. An
    exposure that cloud interrupts, or keeps from starting, does not count, and its visit stays on the list with its
    robots in place. Targets of a good exposure succeed by `settings.success_frac`; those that fail bring their visits
    back, see `repeat_min_frac`.
    """
    _check_names(programmes, settings)
    is_routed = settings.configuration_s == "routed"
    problem = make_problem(visits, paths, tiles, targets, holdings, programmes, is_routed=is_routed)
    rules = [settings.rule(survey) for survey in problem.surveys]
    ephemeris = make_ephemeris(settings.site, settings.start_date, settings.end_date)
    is_cloudy = make_weather(settings.start_date, settings.n_night, settings.weather, seed)
    nights = make_nights(ephemeris, is_cloudy, rules, settings)
    look_ahead = LookAhead.of(problem, ephemeris, nights, rules, settings)
    numbers = _numbers(problem, rules, settings, seed)
    state = initial_state(problem)
    shortest_s = min((programme.exposure_s for programme in problem.programmes), default=kernels.DAY_S)
    log = np.empty((int(kernels.DAY_S / shortest_s) + kernels.MAX_CUT_SHORT, kernels.N_LOG))
    logs, complete = [], np.zeros((len(nights), len(problem.programmes)), dtype=np.int64)
    for number, night in enumerate(nights):
        n_log = 0
        if not night.is_engineering:
            fields = make_fields(problem, ephemeris, night, rules, look_ahead.pressure(number, state, numbers))
            sky = kernels.Night(number, night.sidereal_rad, night.level, night.moon, night.is_cloudy)
            n_log = observe_night(sky, fields, problem.visits, problem.targets, numbers, state, log)
        logs.append(log[:n_log].copy())
        complete[number] = state.n_complete
    return Schedule(
        exposures=exposures_table(problem, ephemeris, nights, logs),
        nights=nights_table(problem, nights, logs, complete),
        target_status=target_status_table(problem, state, look_ahead, allocation_reasons),
        warnings=find_warnings(problem, settings, nights, look_ahead),
    )


def _check_names(programmes: Sequence[Programme], settings: ScheduleSettings) -> None:
    """Rules and probabilities must name surveys and programmes that there are."""
    surveys = {programme.survey for programme in programmes} | SURVEY_RULES.keys()
    names = {programme.name for programme in programmes}
    for key, given, known, what in (
        ("surveys", settings.surveys, surveys, "survey"),
        ("success_frac", settings.success_frac, names, "programme"),
    ):
        for name in given.keys() - known:
            raise InputError(f"names no {what}", place=f"schedule.{key}.{name}", remedy=did_you_mean(name, known))


def _numbers(problem: Problem, rules: Sequence[SurveyRule], settings: ScheduleSettings, seed: int) -> Rules:
    """Settings as the kernels want them."""
    stream = np.random.SeedSequence(seed, spawn_key=(_STREAM_SUCCESS,))
    moon_limit_rad = np.radians([rule.moon_separation_min_deg for rule in rules])
    wanted = np.array([programme.completeness_wanted_frac for programme in problem.programmes])
    return Rules(
        calibration_s=np.array([rule.calibration_s for rule in rules], dtype=np.float64),
        moon_cos_max=np.cos(np.minimum(moon_limit_rad + kernels.MOON_MARGIN_RAD, np.pi)),
        survey_weight=np.array([rule.weight for rule in rules], dtype=np.float64),
        success_frac=np.array([settings.success_frac.get(p.name, 1.0) for p in problem.programmes], dtype=np.float64),
        n_enough=np.ceil(wanted * problem.n_target - 1e-9).astype(np.int64),
        beyond_wanted_weight=settings.beyond_wanted_weight,
        readout_s=settings.telescope.readout_s,
        slew_rad_s=float(np.radians(settings.telescope.slew_rate_deg_s)),
        settle_s=settings.telescope.settle_s,
        configuration_s=-1.0 if settings.configuration_s == "routed" else settings.configuration_s,
        repeat_min_frac=settings.repeat_min_frac,
        airmass_power=settings.airmass_power,
        idle_step_s=settings.idle_step_s,
        latitude_rad=float(np.radians(settings.site.latitude_deg)),
        success_key=stream.generate_state(1, np.uint64)[0],
    )
