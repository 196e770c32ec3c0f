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

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import polars as pl

from survey_sim.errors import InputError, did_you_mean
from survey_sim.schedule import kernels
from survey_sim.schedule.ephemeris import Ephemeris, make_ephemeris
from survey_sim.schedule.fields import LookAhead, make_fields
from survey_sim.schedule.kernels import Rules, State
from survey_sim.schedule.problem import Problem, initial_state, make_problem
from survey_sim.schedule.robots import Chain, Robots, UsualRobots
from survey_sim.schedule.settings import SURVEY_RULES, Programme, ScheduleSettings, SurveyRule
from survey_sim.schedule.sky import Night, make_nights
from survey_sim.schedule.status import exposures_table, find_warnings, nights_table, target_status_table
from survey_sim.schedule.weather import make_weather

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Key of the targets' successes among the streams of a run.
_STREAM_SUCCESS = 2
# Nights thought ahead at most; their fields are kept.
MOST_AHEAD = 256

Sky = tuple[kernels.Night, kernels.Fields]


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
    robots: Robots | None = None,
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
    robots
        Who knows how long the robots really take; by default every configuration takes the usual time, see
        `kernels.configuration_time`.

    Raises
    ------
    InputError
        Tables that do not fit each other; rules or probabilities for a survey or programme that there is not.

    Notes
    -----
    Visits of a tile are taken in order. The robots' configuration runs while the CCD reads out and the telescope slews: a
    pointing pays the longest of the three, then its calibration, then the exposure. The choice is made with the usual
    configuration times; the chosen visit then pays what `robots` really take, or is passed over for the moment if it does
    not fit so. Every night begins with all robots at park. An exposure that cloud interrupts, or keeps from starting, does
    not count, and its visit stays on the list. Targets of a good exposure succeed by `settings.success_frac`, those that no
    robot reached excepted; those that fail bring their visits back, see `repeat_min_frac`.
    """
    _check_names(programmes, settings)
    is_routed = settings.configuration_s == "routed"
    problem = make_problem(visits, paths, tiles, targets, holdings, programmes, is_routed=is_routed)
    rules = [settings.rule(survey) for survey in problem.surveys]
    ephemeris = make_ephemeris(settings.site, settings.start_date, settings.end_date)
    is_cloudy = make_weather(settings.start_date, settings.n_night, settings.weather, seed)
    nights = make_nights(ephemeris, is_cloudy, rules, settings)
    look_ahead = LookAhead.of(problem, ephemeris, nights, rules, settings)
    survey = _Survey(problem, ephemeris, nights, rules, look_ahead, _numbers(problem, rules, settings, seed))
    calendar = _Calendar(survey, robots or UsualRobots())
    calendar.run()
    return Schedule(
        exposures=exposures_table(problem, ephemeris, nights, calendar.logs),
        nights=nights_table(problem, nights, calendar.logs, calendar.complete),
        target_status=target_status_table(problem, calendar.state, look_ahead, allocation_reasons),
        warnings=find_warnings(problem, settings, nights, look_ahead),
    )


@dataclass(frozen=True)
class _Survey:
    """All that the nights need; see `make_schedule`."""

    problem: Problem
    ephemeris: Ephemeris
    nights: Sequence[Night]
    rules: Sequence[SurveyRule]
    look_ahead: LookAhead
    numbers: Rules

    def sky(self, number: int) -> Sky | None:
        """A night and its fields, whatever was observed before; None if nothing is."""
        night = self.nights[number]
        if night.is_engineering:
            return None
        sky = kernels.Night(number, night.sidereal_rad, night.level, night.moon, night.is_cloudy)
        return sky, make_fields(self.problem, self.ephemeris, night, self.rules)

    def observe_night(self, number: int, sky: Sky | None, state: State, chain: Chain) -> FloatArray:
        """Observe a night, see `observe_night`."""
        if sky is None:
            return np.empty((0, kernels.N_LOG))
        night, fields = sky
        fields = fields._replace(pressure=self.look_ahead.pressure(number, state, self.numbers))
        return observe_night(night, fields, self.problem.visits, self.problem.targets, self.numbers, state, chain)


class _Calendar:
    """The nights in order, and those thought ahead.

    A night is observed twice. First ahead of its turn, with estimates of what is not known of the robots, so that their ways
    are found while other nights are decided; then in its turn, with nothing estimated: what is made is that of night after
    night in order. Where other visits are taken than was thought, the nights after it are thought of again.

    Parameters
    ----------
    survey, robots
        What is observed, and who knows how long the robots take.

    Attributes
    ----------
    state
        After the nights that had their turn.
    logs, complete
        Of these: log of each night, and (n_night, n_programme) targets of each programme complete after it.
    """

    def __init__(self, survey: _Survey, robots: Robots) -> None:
        self._survey, self._robots = survey, robots
        self.state = initial_state(survey.problem)
        self.logs: list[FloatArray] = []
        self.complete = np.zeros((len(survey.nights), len(survey.problem.programmes)), dtype=np.int64)
        self._ahead: State | None = None
        self._thought: deque[tuple[Chain, FloatArray]] = deque()
        self._skies: dict[int, Sky | None] = {}

    def run(self) -> None:
        """Observe all nights."""
        while (n_done := len(self.logs)) < len(self._survey.nights):
            for _ in self._robots.prepare(self._think_ahead()):
                self._observe_known()
            self._observe_known()
            if len(self.logs) == n_done:  # nobody thinks ahead
                self._observe_next()

    def _think_ahead(self) -> Iterator[Chain]:
        """Nights as they are thought to go, each thought of when it is asked for."""
        while len(self._thought) < MOST_AHEAD and (number := len(self.logs) + len(self._thought)) < len(self._survey.nights):
            if self._ahead is None:
                self._ahead = State(*(array.copy() for array in self.state))
            chain = self._robots.begin_night(is_exact=False)
            log = self._survey.observe_night(number, self._sky(number), self._ahead, chain)
            self._thought.append((chain, log))
            yield chain
            self._observe_known()

    def _observe_known(self) -> None:
        """Observe the nights whose turn it is, as long as their ways, as they were thought to go, are known."""
        while self._thought and self._thought[0][0].is_known:
            self._observe_next()

    def _observe_next(self) -> None:
        """Observe the night whose turn it is."""
        number, chain = len(self.logs), self._robots.begin_night(is_exact=True)
        log = self._survey.observe_night(number, self._sky(number), self.state, chain)
        self.logs.append(log)
        self.complete[number] = self.state.n_complete
        self._skies.pop(number)
        self._robots.accept(chain)
        thought = self._thought.popleft()[1] if self._thought else None
        taken = [kernels.LOG_VISIT, kernels.LOG_STATUS]
        if thought is None or not np.array_equal(thought[:, taken], log[:, taken]):
            self._thought.clear()
            self._ahead = None

    def _sky(self, number: int) -> Sky | None:
        if number not in self._skies:
            self._skies[number] = self._survey.sky(number)
        return self._skies[number]


def observe_night(
    night: kernels.Night,
    fields: kernels.Fields,
    visits: kernels.Visits,
    targets: kernels.Targets,
    rules: Rules,
    state: State,
    chain: Chain,
) -> FloatArray:
    """Observe one night; gives the log of its pointings, (n, N_LOG). `state` and `chain` go on."""
    exposed_s = visits.exposure_s[visits.exposure_s > 0.0]
    most = int(kernels.DAY_S / exposed_s.min(initial=kernels.DAY_S)) + kernels.MAX_CUT_SHORT
    log = np.empty((most, kernels.N_LOG))
    course = kernels.begin_night(night, fields, rules, state)
    while (tile := kernels.next_tile(night, fields, visits, rules, state, course)) >= 0:
        visit = int(course.candidate[tile])
        usual_s = kernels.configuration_time(visits, visit, course.place[kernels.PREVIOUS], rules.configuration_s)
        way = chain.configure(visit, usual_s, max(kernels.waits(night, fields, visits, rules, course, tile)))
        lost = np.searchsorted(targets.target_id, way.lost)
        if kernels.point(night, fields, visits, targets, rules, state, course, tile, way.time_s, lost, log):
            chain.go(visit)
    return log[: course.place[kernels.N_DONE]]


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
