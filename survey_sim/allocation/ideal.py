"""The ideal positioner: no separation, no limit of reach (Goodwin et al. 2014, Figure 7)."""

import numpy as np
from scipy.optimize import linear_sum_assignment

from survey_sim.allocation.field import Field, VisitRequest
from survey_sim.allocation.targets import FieldTargets, FloatArray, IntArray
from survey_sim.instrument import Plate


def choose_ideal(field: Field, request: VisitRequest) -> IntArray:
    """Every live science robot takes a new science target, the highest priorities first; nothing else is placed.

    Its ends may be nearer than the separation: a yardstick, not a configuration to route.
    """
    held = np.full(field.plate.n_robot, -1, dtype=np.int64)
    robots = np.flatnonzero(field.plate.is_live & ~field.plate.is_guide)
    wanted = np.flatnonzero(request.is_open & field.targets.is_science)
    best = wanted[np.argsort(-field.value[wanted], kind="stable")][: len(robots)]
    apart = request.start_mm[robots, None] - field.xy_mm[None, best]
    row, column = linear_sum_assignment((apart**2).sum(axis=2) ** (field.settings.travel_power / 2.0))
    held[robots[row]] = best[column]
    return held


def ideal_completeness(targets: FieldTargets, plate: Plate, n_visits: int) -> FloatArray:
    """Greatest completeness after each visit if every live science robot served a new target at every one.

    Returns
    -------
        (n_visits,) complete science targets / science targets on the plate; targets that want few visits come first.
    """
    is_counted = targets.is_science & targets.is_on_plate(plate.instrument.plate_radius_mm)
    wanted = np.sort(targets.wanted_visits[is_counted])
    visit = np.arange(1, n_visits + 1)
    if not len(wanted):
        return np.ones(n_visits)
    by_fibres = np.searchsorted(np.cumsum(wanted), visit * plate.n_science_live, side="right")
    by_repeats = np.searchsorted(wanted, visit, side="right")
    return np.minimum(by_fibres, by_repeats) / len(wanted)
