"""Physics of one leg, and where robots are on the way.

A leg: at `start_s` turn in place by `rotate_deg`, then go `dx_mm` along the robot's own x axis, then `dy_mm` along its own
y axis, at the coarse speed; the last `precise_mm` of the travel go at the precise speed. A robot goes either turned (one
of its four axes on the line, so at most 45 deg of turning, Goodwin et al. 2014 section 1.3) or without turning, x then y.
"""

# mypy: disable-error-code="no-untyped-def"
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt
from numba import njit

from survey_sim.instrument import Instrument

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]
BoolArray = npt.NDArray[np.bool_]

# Knots that a leg adds to a trajectory: start, end of turn, two breaks of speed or direction, end.
KNOTS_PER_LEG = 5


@dataclass(frozen=True)
class Legs:
    """Legs of many robots on one path, sorted by (robot, leg).

    Attributes
    ----------
    robot
        (n_leg,) int32, index into the plate's arrays.
    leg
        (n_leg,) int16, 0 for a robot's first.
    start_s
        (n_leg,) when it begins to turn, s from the start of the path.
    rotate_deg, dx_mm, dy_mm, precise_mm
        (n_leg,) the instruction: turn, then travel along the robot's own x and y axes (after the turn), of which the last
        `precise_mm` are slow.
    x_mm, y_mm, theta_deg
        (n_leg,) the state it ends in, mm in the plate frame, deg in [-180, 180).
    """

    robot: IntArray
    leg: npt.NDArray[np.int16]
    start_s: FloatArray
    rotate_deg: FloatArray
    dx_mm: FloatArray
    dy_mm: FloatArray
    precise_mm: FloatArray
    x_mm: FloatArray
    y_mm: FloatArray
    theta_deg: FloatArray

    def __len__(self) -> int:
        return len(self.robot)

    def take(self, rows: npt.NDArray) -> "Legs":
        """The legs at these rows (indices or a mask), in their order."""
        return Legs(*(getattr(self, field.name)[rows] for field in fields(self)))

    @property
    def last(self) -> npt.NDArray[np.int64]:
        """(n_mover,) place of the last leg of each robot that has legs."""
        ends = np.flatnonzero(self.robot[1:] != self.robot[:-1])
        return np.append(ends, len(self) - 1) if len(self) else ends

    def starting_at(self, start_s: FloatArray) -> "Legs":
        """The same legs, each starting when told."""
        return replace(self, start_s=start_s)


@dataclass(frozen=True)
class Trajectories:
    """Robot centres against time, straight and even between knots.

    A robot stands at its first knot before it, at its last knot after it.

    Attributes
    ----------
    t_s, x_mm, y_mm
        (n_knot,) knots robot by robot, times not descending within a robot.
    first
        (n_robot + 1,) knots of robot i are first[i] to first[i + 1] - 1.
    """

    t_s: FloatArray
    x_mm: FloatArray
    y_mm: FloatArray
    first: npt.NDArray[np.int64]


def wrap_deg(angle_deg: FloatArray) -> FloatArray:
    """Angle in [-180, 180), deg."""
    wrapped: FloatArray = np.mod(angle_deg + 180.0, 360.0) - 180.0
    return wrapped - 360.0 * (wrapped >= 180.0)  # rounding


def turn_onto_line(theta_deg: FloatArray, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Least turn that puts one of the robot's axes on the line along (x_mm, y_mm), deg in [-45, 45)."""
    return np.mod(np.degrees(np.arctan2(y_mm, x_mm)) - theta_deg + 45.0, 90.0) - 45.0


def alone_time_s(instrument: Instrument, start_mm: FloatArray, theta_deg: FloatArray, goal_mm: FloatArray) -> FloatArray:
    """Time from start to goal with nobody in the way: the quicker of turned and not turned, 0 where goal is start.

    Parameters
    ----------
    start_mm, goal_mm
        (n, 2) mm, plate frame.
    theta_deg
        (n,) orientation at the start, deg.

    Returns
    -------
        (n,) s, rotation and the precise approach included.
    """
    _, turned_s, square_s = _direct(instrument, theta_deg, goal_mm - start_mm)
    return np.minimum(turned_s, square_s)


def alone(
    instrument: Instrument, start_mm: FloatArray, theta_deg: FloatArray, goal_mm: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """`alone_time_s`, and the orientation that each robot ends with, (n,) deg."""
    turn, turned_s, square_s = _direct(instrument, theta_deg, goal_mm - start_mm)
    is_turned = (turned_s <= square_s) & (goal_mm != start_mm).any(axis=1)
    return np.minimum(turned_s, square_s), np.where(is_turned, wrap_deg(theta_deg + turn), theta_deg)


def _direct(instrument: Instrument, theta_deg: FloatArray, step_mm: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Turn onto the line of each step (n, 2), deg, and the time that the step takes turned, and not turned, s; each (n,)."""
    turn = turn_onto_line(theta_deg, step_mm[:, 0], step_mm[:, 1])
    size_deg = np.abs(turn)
    straight = np.hypot(step_mm[:, 0], step_mm[:, 1])
    axes = straight * (np.cos(np.radians(size_deg)) + np.sin(np.radians(size_deg)))
    turned_s = size_deg / instrument.rotation_speed_deg_s + _travel_s(instrument, straight, _approach(instrument, straight))
    return turn, turned_s, _travel_s(instrument, axes, _approach(instrument, axes))


def leg_times_s(instrument: Instrument, legs: Legs) -> tuple[FloatArray, FloatArray]:
    """Seconds that each leg turns, and seconds that it travels; both (n_leg,)."""
    length = np.abs(legs.dx_mm) + np.abs(legs.dy_mm)
    return np.abs(legs.rotate_deg) / instrument.rotation_speed_deg_s, _travel_s(instrument, length, legs.precise_mm)


def make_legs(
    instrument: Instrument,
    start_mm: FloatArray,
    start_theta_deg: FloatArray,
    robot: IntArray,
    start_s: FloatArray,
    way_mm: FloatArray,
    is_turned: BoolArray,
) -> Legs:
    """Legs through way points; the last of each robot ends with the precise approach.

    Parameters
    ----------
    start_mm, start_theta_deg
        (n_robot, 2) mm and (n_robot,) deg, the state of every robot at time 0.
    robot, start_s, way_mm, is_turned
        (n_leg,), (n_leg,), (n_leg, 2), (n_leg,): whose leg, when it starts, where it ends, and whether the robot turns onto
        the line or goes x then y as it stands. Sorted by robot, then in the order of travel.
    """
    robot = np.ascontiguousarray(robot, dtype=np.int32)
    way = np.ascontiguousarray(way_mm, dtype=np.float64)
    leg, instruction, theta = _instructions(
        np.ascontiguousarray(start_mm, dtype=np.float64), np.ascontiguousarray(start_theta_deg, dtype=np.float64),
        robot, way, np.ascontiguousarray(is_turned, dtype=np.bool_), instrument.precise_approach_mm,
    )  # fmt: skip
    rotate, dx, dy, precise = instruction
    return Legs(robot, leg, start_s, rotate, dx, dy, precise, way[:, 0].copy(), way[:, 1].copy(), theta)


def make_trajectories(instrument: Instrument, start_mm: FloatArray, legs: Legs) -> Trajectories:
    """Where every robot is at any time of a path; a robot without legs has one knot.

    Parameters
    ----------
    start_mm
        (n_robot, 2) mm, the positions at time 0.
    """
    rotating, moving = leg_times_s(instrument, legs)
    go_s = legs.start_s + rotating
    knots = _knots(
        np.ascontiguousarray(start_mm, dtype=np.float64), legs.robot, legs.start_s, go_s, go_s + moving,
        legs.dx_mm, legs.dy_mm, legs.precise_mm, legs.x_mm, legs.y_mm, legs.theta_deg,
        instrument.coarse_speed_mm_s, instrument.precise_speed_mm_s,
    )  # fmt: skip
    return Trajectories(*knots)


# The same, of single angles in kernels.
_wrap = njit(cache=True)(wrap_deg)
_turn = njit(cache=True)(turn_onto_line)


@njit(cache=True)
def _instructions(start_xy, start_theta, robot, way, is_turned, approach):
    """Of legs through way points: leg (n_leg,), (rotate_deg, dx_mm, dy_mm, precise_mm) (4, n_leg), theta_deg (n_leg,)."""
    n_leg = len(robot)
    leg, made, theta = np.zeros(n_leg, np.int16), np.zeros((4, n_leg)), np.empty(n_leg)
    for k in range(n_leg):
        r = robot[k]
        is_next = k > 0 and robot[k - 1] == r
        leg[k] = leg[k - 1] + 1 if is_next else 0
        x, y = (way[k - 1, 0], way[k - 1, 1]) if is_next else (start_xy[r, 0], start_xy[r, 1])
        before = theta[k - 1] if is_next else start_theta[r]
        ux, uy = way[k, 0] - x, way[k, 1] - y
        if is_turned[k]:
            made[0, k] = _turn(before, ux, uy)
        theta[k] = _wrap(before + made[0, k])
        cosine, sine = np.cos(np.radians(theta[k])), np.sin(np.radians(theta[k]))
        dx, dy = cosine * ux + sine * uy, cosine * uy - sine * ux
        if is_turned[k]:  # along the one axis that lies on the line
            length = np.hypot(ux, uy)
            dx, dy = (np.copysign(length, dx), 0.0) if abs(dx) >= abs(dy) else (0.0, np.copysign(length, dy))
        made[1, k], made[2, k] = dx, dy
        if k == n_leg - 1 or robot[k + 1] != r:
            made[3, k] = min(approach, abs(dx) + abs(dy))
    return leg, made, theta


@njit(cache=True)
def _knots(start_xy, robot, turn_s, go_s, end_s, dx, dy, precise, end_x, end_y, theta, fast, slow):
    """`Trajectories` of legs that turn, go and end at these times; `fast` and `slow` are the speeds, mm/s."""
    n_robot, n_leg = len(start_xy), len(robot)
    first = np.ones(n_robot + 1, np.int64)
    first[0] = 0
    for k in range(n_leg):
        first[robot[k] + 1] += KNOTS_PER_LEG
    for r in range(n_robot):
        first[r + 1] += first[r]
    t, x, y = np.zeros(first[n_robot]), np.empty(first[n_robot]), np.empty(first[n_robot])
    for r in range(n_robot):
        x[first[r]], y[first[r]] = start_xy[r, 0], start_xy[r, 1]
    knot = 0
    for k in range(n_leg):
        knot = knot + KNOTS_PER_LEG if k > 0 and robot[k - 1] == robot[k] else first[robot[k]]
        along_x, along_y = abs(dx[k]), abs(dy[k])
        slow_from = along_x + along_y - precise[k]
        cosine, sine = np.cos(np.radians(theta[k])), np.sin(np.radians(theta[k]))
        t[knot + 1], x[knot + 1], y[knot + 1] = turn_s[k], x[knot], y[knot]
        t[knot + 2], x[knot + 2], y[knot + 2] = go_s[k], x[knot], y[knot]
        for n, way in enumerate((min(along_x, slow_from), max(along_x, slow_from))):
            late = max(way - slow_from, 0.0)
            own_x = np.copysign(min(way, along_x), dx[k])
            own_y = np.copysign(max(way - along_x, 0.0), dy[k])
            t[knot + 3 + n] = go_s[k] + (way - late) / fast + late / slow
            x[knot + 3 + n] = x[knot] + cosine * own_x - sine * own_y
            y[knot + 3 + n] = y[knot] + sine * own_x + cosine * own_y
        t[knot + 5], x[knot + 5], y[knot + 5] = end_s[k], end_x[k], end_y[k]
    return t, x, y, first


def _approach(instrument: Instrument, length_mm: FloatArray) -> FloatArray:
    return np.minimum(instrument.precise_approach_mm, length_mm)


def _travel_s(instrument: Instrument, length_mm: FloatArray, precise_mm: FloatArray) -> FloatArray:
    return (length_mm - precise_mm) / instrument.coarse_speed_mm_s + precise_mm / instrument.precise_speed_mm_s
