"""Physics of one leg, and where robots are on the way.

A leg: at `start_s` turn in place by `rotate_deg`, then go `dx_mm` along the robot's own x axis, then `dy_mm` along its own
y axis, at the coarse speed; the last `precise_mm` of the travel go at the precise speed. A robot goes either turned (one
of its four axes on the line, so at most 45 deg of turning, Goodwin et al. 2014 section 1.3) or without turning, x then y.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

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
    wrapped = np.mod(angle_deg + 180.0, 360.0) - 180.0
    return np.where(wrapped >= 180.0, -180.0, wrapped)


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
    step = goal_mm - start_mm
    turn = np.abs(turn_onto_line(theta_deg, step[:, 0], step[:, 1]))
    straight = np.hypot(step[:, 0], step[:, 1])
    axes = straight * (np.cos(np.radians(turn)) + np.sin(np.radians(turn)))
    turned_s = turn / instrument.rotation_speed_deg_s + _travel_s(instrument, straight, _approach(instrument, straight))
    return np.minimum(turned_s, _travel_s(instrument, axes, _approach(instrument, axes)))


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
    robot = np.asarray(robot, dtype=np.int32)
    n_leg = len(robot)
    is_first = np.diff(robot, prepend=-1) != 0
    first_row = np.flatnonzero(is_first)
    leg = np.arange(n_leg) - np.repeat(first_row, np.diff(first_row, append=n_leg))
    from_mm = np.where(is_first[:, None], start_mm[robot], np.roll(way_mm, 1, axis=0)) if n_leg else way_mm
    step = way_mm - from_mm
    rotate, theta = np.zeros(n_leg), np.zeros(n_leg)
    now = start_theta_deg.astype(np.float64, copy=True)
    for k in range(int(leg.max(initial=-1)) + 1):
        rows = np.flatnonzero(leg == k)
        turn = turn_onto_line(now[robot[rows]], step[rows, 0], step[rows, 1])
        rotate[rows] = np.where(is_turned[rows], turn, 0.0)
        theta[rows] = now[robot[rows]] = wrap_deg(now[robot[rows]] + rotate[rows])
    dx, dy = _body_axes(step, theta, is_turned)
    is_last = np.roll(is_first, -1)
    precise = np.where(is_last, _approach(instrument, np.abs(dx) + np.abs(dy)), 0.0)
    return Legs(robot, leg.astype(np.int16), start_s, rotate, dx, dy, precise, way_mm[:, 0], way_mm[:, 1], theta)


def make_trajectories(instrument: Instrument, start_mm: FloatArray, legs: Legs) -> Trajectories:
    """Where every robot is at any time of a path; a robot without legs has one knot.

    Parameters
    ----------
    start_mm
        (n_robot, 2) mm, the positions at time 0.
    """
    n_robot, n_leg = len(start_mm), len(legs)
    rotating, moving = leg_times_s(instrument, legs)
    is_first = np.diff(legs.robot, prepend=-1) != 0
    end = np.column_stack([legs.x_mm, legs.y_mm])
    begin = np.where(is_first[:, None], start_mm[legs.robot], np.roll(end, 1, axis=0)) if n_leg else end
    along_x, along_y = np.abs(legs.dx_mm), np.abs(legs.dy_mm)
    length = along_x + along_y
    slow_from = length - legs.precise_mm
    breaks = np.sort(np.column_stack([along_x, slow_from]), axis=1)
    t = np.empty((n_leg, KNOTS_PER_LEG))
    t[:, 0], t[:, 1] = legs.start_s, legs.start_s + rotating
    slow = np.maximum(breaks - slow_from[:, None], 0.0)
    t[:, 2:4] = t[:, 1:2] + (breaks - slow) / instrument.coarse_speed_mm_s + slow / instrument.precise_speed_mm_s
    t[:, 4] = t[:, 1] + moving
    share_x = np.minimum(breaks, along_x[:, None]) * np.sign(legs.dx_mm)[:, None]
    share_y = np.maximum(breaks - along_x[:, None], 0.0) * np.sign(legs.dy_mm)[:, None]
    cosine, sine = np.cos(np.radians(legs.theta_deg))[:, None], np.sin(np.radians(legs.theta_deg))[:, None]
    x, y = np.empty_like(t), np.empty_like(t)
    x[:, :2], y[:, :2] = begin[:, :1], begin[:, 1:]
    x[:, 2:4] = begin[:, :1] + cosine * share_x - sine * share_y
    y[:, 2:4] = begin[:, 1:] + sine * share_x + cosine * share_y
    x[:, 4], y[:, 4] = legs.x_mm, legs.y_mm
    return _by_robot(n_robot, start_mm, legs.robot, t, x, y)


def _by_robot(
    n_robot: int, start_mm: FloatArray, robot: IntArray, t: FloatArray, x: FloatArray, y: FloatArray
) -> Trajectories:
    """Knots of legs, with one at time 0 before each robot's first."""
    n_own = np.bincount(robot, minlength=n_robot) * KNOTS_PER_LEG + 1
    first = np.concatenate([[0], np.cumsum(n_own)])
    own_row = np.arange(len(robot)) - np.searchsorted(robot, robot)
    knot = first[robot][:, None] + 1 + KNOTS_PER_LEG * own_row[:, None] + np.arange(KNOTS_PER_LEG)
    out_t, out_x, out_y = np.zeros(first[-1]), np.empty(first[-1]), np.empty(first[-1])
    out_x[first[:-1]], out_y[first[:-1]] = start_mm[:, 0], start_mm[:, 1]
    out_t[knot], out_x[knot], out_y[knot] = t, x, y
    return Trajectories(out_t, out_x, out_y, first)


def _body_axes(step: FloatArray, theta_deg: FloatArray, is_turned: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Steps in the robot's frame; a turned robot goes along the one axis that lies on the line."""
    cosine, sine = np.cos(np.radians(theta_deg)), np.sin(np.radians(theta_deg))
    dx = cosine * step[:, 0] + sine * step[:, 1]
    dy = cosine * step[:, 1] - sine * step[:, 0]
    length = np.hypot(step[:, 0], step[:, 1])
    is_along_x = np.abs(dx) >= np.abs(dy)
    dx_turned = np.where(is_along_x, np.copysign(length, dx), 0.0)
    dy_turned = np.where(is_along_x, 0.0, np.copysign(length, dy))
    return np.where(is_turned, dx_turned, dx), np.where(is_turned, dy_turned, dy)


def _approach(instrument: Instrument, length_mm: FloatArray) -> FloatArray:
    return np.minimum(instrument.precise_approach_mm, length_mm)


def _travel_s(instrument: Instrument, length_mm: FloatArray, precise_mm: FloatArray) -> FloatArray:
    return (length_mm - precise_mm) / instrument.coarse_speed_mm_s + precise_mm / instrument.precise_speed_mm_s
