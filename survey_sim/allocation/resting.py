"""Where an idle robot may rest instead of the nearest place, so that it is in fewer robots' way."""

from collections.abc import Mapping

import numpy as np

from survey_sim.allocation.field import BoolArray
from survey_sim.allocation.kernels.untangle import tangles_of_places
from survey_sim.allocation.targets import FloatArray
from survey_sim.instrument import Plate

# Places are looked for so far around where the robot stands and around its present resting place, mm, in so many directions.
DISTANCES_MM = (0.0, 2.0, 4.5, 7.0, 9.5, 12.5, 16.0, 20.0)
N_DIRECTION = 12
# Places nearer than this to one tried before are not tried.
APART_MM = 3.0
# As many as are worth trying.
N_PLACE = 4
# Room kept beyond the rules, mm, for rounding.
GUARD_MM = 1e-6


def resting_places(plate: Plate, start_mm: FloatArray, goal_mm: FloatArray, robot: int) -> FloatArray:
    """(n, 2) places where a robot may rest rather than at its goal, those least in others' way first, then the nearest, mm.

    None for a dead one.

    Parameters
    ----------
    start_mm, goal_mm
        (n_robot, 2) where the robots stand, and where they shall end, mm, plate frame.
    """
    turn = 2.0 * np.pi / N_DIRECTION * np.arange(N_DIRECTION)
    ring = np.array(DISTANCES_MM)[:, None, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    around = np.vstack([start_mm[robot] + ring.reshape(-1, 2), goal_mm[robot] + ring.reshape(-1, 2)])
    places = around[[has_room(plate, goal_mm, robot, place) for place in around]]
    separation = plate.instrument.min_separation_mm
    tangle = tangles_of_places(start_mm, plate.park_mm, plate.is_live, goal_mm, separation, robot, places)
    way = np.hypot(*(places - start_mm[robot]).T)
    order = np.lexsort((way, np.round(tangle, 3)))
    known = goal_mm[robot][None]
    for place in places[order[np.isfinite(tangle[order])]]:
        if np.hypot(*(known - place).T).min() >= APART_MM:
            known = np.vstack([known, place])
        if len(known) > N_PLACE:
            break
    return np.ascontiguousarray(known[1:])


def rest(plate: Plate, is_idle: BoolArray, goal_mm: FloatArray, places: Mapping[int, FloatArray]) -> None:
    """Let idle robots rest at these places (by robot, mm), as far as there is room; fills in `goal_mm` (n_robot, 2)."""
    for robot, place_mm in places.items():
        if is_idle[robot] and has_room(plate, goal_mm, robot, place_mm):
            goal_mm[robot] = place_mm


def has_room(plate: Plate, goal_mm: FloatArray, robot: int, place_mm: FloatArray) -> bool:
    """Whether a live robot may end at a place (2,), mm, while all others end at their goals (n_robot, 2)."""
    apart = np.hypot(*(goal_mm - place_mm).T)
    apart[robot] = np.inf
    instrument = plate.instrument
    return bool(
        plate.is_live[robot]
        and apart.min() >= instrument.min_separation_mm + GUARD_MM
        and np.hypot(*place_mm) <= instrument.plate_radius_mm - GUARD_MM
        and np.hypot(*(place_mm - plate.park_mm[robot])) <= plate.patrol_radius_mm[robot] - GUARD_MM
    )
