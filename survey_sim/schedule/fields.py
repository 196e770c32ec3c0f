"""Fields over the site: when each can be observed tonight, and how pressed its time is from tonight to the last night."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from survey_sim.schedule.ephemeris import Ephemeris
from survey_sim.schedule.kernels import Fields, Rules, State, sum_open, update_weights, work_left
from survey_sim.schedule.problem import Problem
from survey_sim.schedule.settings import SKY_STATES, ScheduleSettings, SkyState, SurveyRule
from survey_sim.schedule.sky import N_LST_BIN, Night, time_by_bin

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


def make_fields(problem: Problem, ephemeris: Ephemeris, night: Night, rules: Sequence[SurveyRule]) -> Fields:
    """All tiles for one night, under no pressure; see `kernels.Fields`."""
    direction = ephemeris.directions(problem.tile_icrs, night.evening_mjd + 0.5)
    dec_rad = np.arcsin(np.clip(direction[:, 2], -1.0, 1.0))
    latitude_rad = np.radians(ephemeris.site.latitude_deg)
    with np.errstate(divide="ignore"):
        min_airmass = 1.0 / np.maximum(np.cos(dec_rad - latitude_rad), 0.0)
    return Fields(
        survey=problem.tile_survey,
        first_visit=problem.first_visit,
        direction=direction,
        ra_rad=np.arctan2(direction[:, 1], direction[:, 0]),
        dec_rad=dec_rad,
        window_rad=observing_window(dec_rad, problem, latitude_rad, rules),
        min_airmass=min_airmass,
        pressure=np.ones(len(dec_rad)),
    )


def observing_window(dec_rad: FloatArray, problem: Problem, latitude_rad: float, rules: Sequence[SurveyRule]) -> FloatArray:
    """(n_tile,) largest hour angle, rad, within the limits of airmass and hour angle of each tile's survey; -1: never."""
    sin_alt_min = 1.0 / np.array([rule.airmass_max for rule in rules])[problem.tile_survey]
    limit = np.radians([rule.hour_angle_max_deg for rule in rules])[problem.tile_survey]
    across = np.cos(latitude_rad) * np.cos(dec_rad)
    cos_ha = (sin_alt_min - np.sin(latitude_rad) * np.sin(dec_rad)) / np.maximum(across, 1e-12)
    window = np.minimum(np.arccos(np.clip(cos_ha, -1.0, 1.0)), limit)
    return np.where(cos_ha < 1.0, window, -1.0)


@dataclass(frozen=True)
class LookAhead:
    """Time left to each tile, and who else wants it.

    Attributes
    ----------
    problem
        What it was made of.
    window_rad
        (n_tile,) largest hour angle in the middle of the schedule, rad; -1: the field is never within the limits.
    is_open
        (n_tile, 24) share of each bin of sidereal time in which the field is within its window.
    states
        (n_survey, 4) 1 for the states of the sky that a survey takes (or fills, if it takes none), else 0.
    allowed_states
        (n_survey, 4) the same for those that it takes or fills.
    time_s
        (n_night + 1, 24, 4) time from each night on, were all of it clear, s.
    overhead_s
        (n_survey,) usual overhead of an exposure, s.
    is_on
        Whether pressure counts; if not, it is 1 for all.
    """

    problem: Problem
    window_rad: FloatArray
    is_open: FloatArray
    states: FloatArray
    allowed_states: FloatArray
    time_s: FloatArray
    overhead_s: FloatArray
    is_on: bool

    @classmethod
    def of(
        cls,
        problem: Problem,
        ephemeris: Ephemeris,
        nights: Sequence[Night],
        rules: Sequence[SurveyRule],
        settings: ScheduleSettings,
    ) -> Self:
        """Look-ahead over all nights."""
        direction = problem.tile_icrs
        if nights:
            direction = ephemeris.directions(direction, nights[len(nights) // 2].evening_mjd)
        window_rad = observing_window(
            np.arcsin(np.clip(direction[:, 2], -1.0, 1.0)), problem, np.radians(ephemeris.site.latitude_deg), rules
        )
        first = [rule.takes or rule.fills for rule in rules]
        allowed = [rule.takes + rule.fills for rule in rules]
        readout_s = settings.telescope.readout_s
        return cls(
            problem=problem,
            window_rad=window_rad,
            is_open=_share_open(np.arctan2(direction[:, 1], direction[:, 0]), window_rad),
            states=_state_flags(first),
            allowed_states=_state_flags(allowed),
            time_s=time_by_bin(nights),
            overhead_s=np.array([readout_s + rule.calibration_s for rule in rules], dtype=np.float64),
            is_on=settings.is_looking_ahead,
        )

    @property
    def is_visible(self) -> BoolArray:
        """(n_tile,) whether the field is ever within the limits of airmass and hour angle."""
        return self.window_rad > 0.0

    @property
    def has_season(self) -> BoolArray:
        """(n_tile,) whether it is so in time that its survey takes or fills."""
        return self._of_tiles(self.time_s[0] @ self.allowed_states.T) > 0.0

    def _of_tiles(self, by_survey: FloatArray) -> FloatArray:
        """(n_tile,) sum over the bins open to each tile of a (24, n_survey) quantity."""
        return np.asarray(sum_open(self.is_open, self.problem.tile_survey, by_survey))

    def pressure(self, night: int, state: State, numbers: Rules) -> FloatArray:
        """(n_tile,) pressure on each tile's time from a night on: hours wanted / hours left, shared with its rivals.

        A tile spreads its work over the bins open to it in proportion to their time; the load of a bin is all work spread
        on it over its time; the pressure is the mean load of a tile's bins, weighted by time. 1 where no time is left: such
        a field is only ever observed in time that nobody takes.
        """
        problem = self.problem
        if not self.is_on:
            return np.ones(len(problem.tile_survey))
        work_s = np.empty(len(problem.tile_survey))
        weight = np.empty(len(problem.programmes))
        update_weights(numbers, state, weight)
        work_left(
            problem.tile_survey,
            problem.first_visit,
            problem.visits,
            state,
            weight,
            self.overhead_s,
            numbers.repeat_min_frac,
            work_s,
        )
        left_s = self._of_tiles(self.time_s[night] @ self.states.T)
        spread = np.divide(work_s, left_s, out=np.zeros_like(work_s), where=left_s > 0)
        load = np.zeros((N_LST_BIN, len(SKY_STATES)))
        for survey, states in enumerate(self.states):
            of_survey = problem.tile_survey == survey
            load += (spread[of_survey] @ self.is_open[of_survey])[:, None] * states
        pressed = self._of_tiles((load * self.time_s[night]) @ self.states.T)
        return np.divide(pressed, left_s, out=np.ones_like(left_s), where=left_s > 0)


def _state_flags(states_of_survey: Sequence[Sequence[SkyState]]) -> FloatArray:
    """(n_survey, 4) 1 for the states named, else 0."""
    flags = [[float(state in states) for state in SKY_STATES] for states in states_of_survey]
    return np.array(flags).reshape(-1, len(SKY_STATES))


def _share_open(ra_rad: FloatArray, window_rad: FloatArray) -> FloatArray:
    """(n_tile, 24) share of each bin of sidereal time within each tile's window of hour angle."""
    n_part = 4
    sidereal = (np.arange(N_LST_BIN * n_part) + 0.5) / (N_LST_BIN * n_part) * 2.0 * np.pi
    ha = (sidereal - ra_rad[:, None] + np.pi) % (2.0 * np.pi) - np.pi
    is_open = np.abs(ha) <= window_rad[:, None]
    return np.asarray(is_open.reshape(-1, N_LST_BIN, n_part).mean(axis=2))
