"""A visit's targets matched again, to robots that stand elsewhere than its allocation supposed."""

from __future__ import annotations

import numpy as np

from survey_sim.allocation.field import BoolArray
from survey_sim.allocation.kernels import place_idle, way_costs
from survey_sim.allocation.targets import FloatArray, IntArray
from survey_sim.instrument import Plate

# A robot's reach is widened by so much, relatively, where its own target lies beyond it by rounding.
ROUNDING = 1e-12


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
    # The holder itself reaches its target, whatever the rounding.
    farthest = np.hypot(*(end_mm - plate.park_mm).T)[taker]
    patrol = np.maximum(plate.patrol_radius_mm[taker], np.where(has_target[taker], farthest * (1.0 + ROUNDING), 0.0))
    cost = way_costs(
        start_mm[taker], plate.park_mm[taker], patrol, plate.is_guide[taker],
        end_mm[holder], plate.is_guide[holder], travel_power / 2.0,
    )  # fmt: skip
    rows, columns = linear_sum_assignment(cost)
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
