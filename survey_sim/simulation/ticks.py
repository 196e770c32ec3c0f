"""Ticks from legs: every leg cut at every instant at which some robot starts one (Goodwin et al. 2014, Figure 12).

In a tick each robot turns, then goes along its x axis, then along its y axis, from a known state to a known state; the
next tick starts when the last has ended. Played ticks are the played legs.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from survey_sim.instrument import Instrument
from survey_sim.motion import FloatArray, IntArray, Legs, leg_times_s, wrap_deg

# A leg that ends this close to the start of a tick ends with the tick before: rounding, not motion.
SAME_INSTANT_S = 1e-9


@dataclass(frozen=True)
class Ticks:
    """Moves of all robots, sorted by (tick, robot); a robot without a move in a tick waits.

    Attributes
    ----------
    tick
        (n_move,) int32, from 0.
    start_s
        (n_move,) when the tick starts, s from the start of the path.
    robot
        (n_move,) int32, index into the plate's arrays.
    dtheta_deg, dx_mm, dy_mm, precise_mm
        (n_move,) the instruction: turn, go along the robot's own x, then y; the last `precise_mm` slowly.
    x_mm, y_mm, theta_deg
        (n_move,) the state the move ends in.
    """

    tick: IntArray
    start_s: FloatArray
    robot: IntArray
    dtheta_deg: FloatArray
    dx_mm: FloatArray
    dy_mm: FloatArray
    precise_mm: FloatArray
    x_mm: FloatArray
    y_mm: FloatArray
    theta_deg: FloatArray

    def __len__(self) -> int:
        return len(self.tick)


def make_ticks(instrument: Instrument, legs: Legs) -> Ticks:
    """Cut the legs of one path into ticks."""
    cut_s, tick_of_leg = np.unique(legs.start_s, return_inverse=True)
    rotating, moving = leg_times_s(instrument, legs)
    end_s = legs.start_s + rotating + moving
    n_part = np.maximum(np.searchsorted(cut_s, end_s - SAME_INSTANT_S) - tick_of_leg, 1)
    row = np.repeat(np.arange(len(legs)), n_part)
    part = np.arange(len(row)) - np.repeat(np.cumsum(n_part) - n_part, n_part)
    tick = tick_of_leg[row] + part
    is_last = part == n_part[row] - 1
    begun = _progress(instrument, legs, row, cut_s[tick] - legs.start_s[row])
    until_s = np.where(is_last, np.inf, np.append(cut_s, np.inf)[tick + 1] - legs.start_s[row])
    ended = _progress(instrument, legs, row, until_s)
    x, y = _place(legs, row, ended)
    order = np.lexsort((legs.robot[row], tick))
    columns: tuple[np.ndarray, ...] = (
        tick.astype(np.int32),
        cut_s[tick],
        legs.robot[row],
        ended[0] - begun[0],
        ended[1] - begun[1],
        ended[2] - begun[2],
        ended[3] - begun[3],
        np.where(is_last, legs.x_mm[row], x),
        np.where(is_last, legs.y_mm[row], y),
        np.where(is_last, legs.theta_deg[row], wrap_deg(legs.theta_deg[row] - legs.rotate_deg[row] + ended[0])),
    )
    return Ticks(*(column[order] for column in columns))


def legs_from_ticks(ticks: Ticks) -> Legs:
    """The moves of ticks as legs, to be played."""
    order = np.lexsort((ticks.tick, ticks.robot))
    robot = ticks.robot[order]
    leg = np.arange(len(robot)) - np.searchsorted(robot, robot)
    columns = ("start_s", "dtheta_deg", "dx_mm", "dy_mm", "precise_mm", "x_mm", "y_mm", "theta_deg")
    return Legs(robot, leg.astype(np.int16), *(getattr(ticks, name)[order] for name in columns))


def _progress(
    instrument: Instrument, legs: Legs, row: npt.NDArray[np.intp], after_s: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Turn, dx, dy and precise travel done `after_s` from the start of the legs in `row`."""
    rotate, dx, dy, precise = legs.rotate_deg[row], legs.dx_mm[row], legs.dy_mm[row], legs.precise_mm[row]
    turn_s = np.abs(rotate) / instrument.rotation_speed_deg_s
    turned = np.copysign(np.minimum(np.abs(rotate), after_s * instrument.rotation_speed_deg_s), rotate)
    coarse = np.abs(dx) + np.abs(dy) - precise
    coarse_s = coarse / instrument.coarse_speed_mm_s
    coarse_done = np.clip((after_s - turn_s) * instrument.coarse_speed_mm_s, 0.0, coarse)
    precise_done = np.clip((after_s - turn_s - coarse_s) * instrument.precise_speed_mm_s, 0.0, precise)
    done = coarse_done + precise_done
    dx_done = np.copysign(np.minimum(done, np.abs(dx)), dx)
    dy_done = np.copysign(np.maximum(done - np.abs(dx), 0.0), dy)
    return turned, dx_done, dy_done, precise_done


def _place(legs: Legs, row: npt.NDArray[np.intp], done: tuple[FloatArray, ...]) -> tuple[FloatArray, FloatArray]:
    """Position inside a leg: from its end back along what remains."""
    cosine, sine = np.cos(np.radians(legs.theta_deg[row])), np.sin(np.radians(legs.theta_deg[row]))
    left_x, left_y = legs.dx_mm[row] - done[1], legs.dy_mm[row] - done[2]
    return legs.x_mm[row] - cosine * left_x + sine * left_y, legs.y_mm[row] - sine * left_x - cosine * left_y
