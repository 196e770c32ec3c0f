"""A visit's targets matched again, to robots that stand elsewhere than its allocation supposed."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from survey_sim.allocation.field import BoolArray, close_pair
from survey_sim.allocation.kernels.lists import reach_lists
from survey_sim.allocation.kernels.matching import match_open
from survey_sim.allocation.kernels.resting import place_idle
from survey_sim.allocation.kernels.untangle import untangle
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
    found = match_around(plate, start_mm, end_mm, has_target, travel_power, ())
    return found or (np.where(has_target, np.arange(plate.n_robot), -1), end_mm.copy())


def match_around(
    plate: Plate,
    start_mm: FloatArray,
    end_mm: FloatArray,
    has_target: BoolArray,
    travel_power: float,
    barred: Collection[tuple[int, int]],
    *,
    untangles: bool = False,
) -> tuple[IntArray, FloatArray] | None:
    """The same with some targets barred to some robots; None if one would be lost, or an idle robot finds no room.

    Parameters
    ----------
    barred
        Robots, and the robots whose targets of the visit's own allocation they shall not hold.
    untangles
        Whether robots that would be in each other's way exchange targets besides (`untangle`).
    """
    holder = np.flatnonzero(has_target)
    # The holder itself reaches its target, whatever the rounding; a dead robot reaches nothing.
    farthest = np.hypot(*(end_mm - plate.park_mm).T)
    patrol = np.maximum(plate.patrol_radius_mm, np.where(has_target, farthest * (1.0 + ROUNDING), 0.0))
    xy, is_wanted = end_mm[holder], np.ones(len(holder), dtype=bool)
    reach_first, reach_robot = reach_lists(
        plate.park_mm, np.where(plate.is_live, patrol, np.nan), plate.is_guide, xy, plate.is_guide[holder], is_wanted
    )  # fmt: skip
    is_pair_open = np.ones(len(reach_robot), dtype=bool)
    for robot, other in barred:
        close_pair(reach_first, reach_robot, robot, int(np.searchsorted(holder, other)), is_pair_open)
    near_first, near = np.zeros(len(holder) + 1, dtype=np.int64), np.zeros(0, dtype=np.int32)
    separation = plate.instrument.min_separation_mm
    # A robot without a target costs more than all ways together, so that all targets are held that can be.
    held = match_open(
        is_wanted, is_pair_open, start_mm, plate.park_mm, xy, np.ones(len(holder)), len(holder) + 1.0, travel_power / 2.0,
        0.0, reach_first, reach_robot, near_first, near, separation, 0,
    )  # fmt: skip
    if (held >= 0).sum() < len(holder):
        return None
    if untangles:
        untangle(
            start_mm, start_mm, plate.is_live, xy, travel_power / 2.0, 0.0, reach_first, reach_robot, is_pair_open,
            near_first, near, np.zeros(0, dtype=np.int64), separation, held,
        )  # fmt: skip
    giver = held.copy()
    giver[held >= 0] = holder[held[held >= 0]]
    goal_mm = np.where((giver >= 0)[:, None], end_mm[giver], start_mm)
    stuck = place_idle(
        giver < 0, plate.is_live, start_mm, plate.park_mm, plate.patrol_radius_mm,
        plate.instrument.plate_radius_mm, separation, goal_mm,
    )  # fmt: skip
    return None if stuck >= 0 else (giver, goal_mm)
