"""A visit's targets matched again, to robots that stand elsewhere than its allocation supposed."""

from __future__ import annotations

import numpy as np

from survey_sim.allocation.field import BoolArray
from survey_sim.allocation.kernels import place_idle
from survey_sim.allocation.targets import FloatArray, IntArray
from survey_sim.instrument import Plate


def match_again(
    plate: Plate, start_mm: FloatArray, end_mm: FloatArray, has_target: BoolArray, travel_power: float
) -> tuple[IntArray, FloatArray]:
    """Who goes where from where the robots stand, to hold the very targets of a visit.

    Exact: of all ways to give every target of the visit to a live robot of its kind in reach, the one of least sum of
    travel^travel_power. Idle robots rest at the legal place nearest to where they stand. Where one finds none, the visit's
    own allocation is kept, which has room for all.

    Parameters
    ----------
    start_mm
        (n_robot, 2) where the robots stand.
    end_mm, has_target
        (n_robot, 2) and (n_robot,) the visit's own allocation: where each robot ends, and whether that is a target.

    Returns
    -------
    giver
        (n_robot,) robot whose target of the visit's own allocation each robot goes to; -1: it has none.
    goal_mm
        (n_robot, 2) where each robot shall end.
    """
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415 - 0.2 s that the command line's help need not pay

    taker, holder = np.flatnonzero(plate.is_live), np.flatnonzero(has_target)
    target_mm = end_mm[holder]
    park_distance = np.hypot(*(target_mm[None] - plate.park_mm[taker, None]).transpose(2, 0, 1))
    travel = np.hypot(*(target_mm[None] - start_mm[taker, None]).transpose(2, 0, 1))
    # The holder itself reaches its target, whatever the rounding.
    is_open = (park_distance <= plate.patrol_radius_mm[taker, None]) | (taker[:, None] == holder[None])
    is_open &= plate.is_guide[taker, None] == plate.is_guide[holder][None]
    rows, columns = linear_sum_assignment(np.where(is_open, travel**travel_power, np.inf))
    giver = np.full(plate.n_robot, -1)
    giver[taker[rows]] = holder[columns]
    goal_mm = np.where((giver >= 0)[:, None], end_mm[giver], start_mm)
    stuck = place_idle(
        giver < 0, plate.is_live, start_mm, plate.park_mm, plate.patrol_radius_mm,
        plate.instrument.plate_radius_mm, plate.instrument.min_separation_mm, goal_mm,
    )  # fmt: skip
    if stuck >= 0:
        return np.where(has_target, np.arange(plate.n_robot), -1), end_mm.copy()
    return giver, goal_mm
