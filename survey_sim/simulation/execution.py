"""Legs played with errors of execution, and the metrology loop that ends a configuration.

A robot goes the distances it is told, at a speed that is off by a share of its own and one of each leg; slip turns each
leg's travel by a small angle, which leaves an error of position. Three ways to play a path:

- `open-loop`: every leg starts at its planned time (or when the one before has ended);
- `resync`: tick by tick, the next when all robots have ended the last;
- `keep-order`: as open loop, but a robot waits for those that should pass a place before it (an action dependency graph,
  after Hoenig et al. 2019, over pieces of the paths).

Afterwards the camera measures, and robots off their places by more than the tolerance are corrected, round after round
(Goodwin et al. 2014, section 5).
"""

# mypy: disable-error-code="no-untyped-def"
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import njit
from pydantic import Field

from survey_sim.instrument import Instrument, Plate
from survey_sim.motion import KNOTS_PER_LEG, FloatArray, IntArray, Legs, Trajectories, make_trajectories
from survey_sim.settings import Settings
from survey_sim.simulation.play import SEPARATION_TOLERANCE_MM, least_separation
from survey_sim.simulation.ticks import legs_from_ticks, make_ticks

# Pieces into which paths are cut to keep the order of passage, mm: while two robots pass each other the order is kept to
# this much, so the separation is kept to about twice of it.
PIECE_MM = 0.5
# Speeds this far off are faults, not scatter: factors are clipped here.
SLOWEST, FASTEST = 0.5, 1.5


class SimulationSettings(Settings):
    """`[simulation]`: errors of execution, the way of playing, and the metrology loop."""

    mode: Literal["open-loop", "resync", "keep-order"] = "keep-order"
    # Assumed: relative scatter of speed, of each robot and of each of its legs, and of each leg's direction.
    robot_speed_scatter_frac: float = Field(0.0, ge=0, le=0.3)
    leg_speed_scatter_frac: float = Field(0.0, ge=0, le=0.3)
    slip_deg: float = Field(0.0, ge=0, le=20)
    # Assumed: time of one metrology measurement, and its noise on each axis.
    metrology_exposure_s: float = Field(2.0, ge=0)
    metrology_noise_um: float = Field(1.5, ge=0)
    # Lorente et al. 2016: 0.3-0.5 arcsec on the sky are 4.5-7.4 um.
    tolerance_um: float = Field(7.0, gt=0)
    max_rounds: int = Field(20, ge=1)

    @property
    def has_errors(self) -> bool:
        """Whether robots differ from what they are told; without, played paths are the routed ones."""
        return max(self.robot_speed_scatter_frac, self.leg_speed_scatter_frac, self.slip_deg) > 0


@dataclass(frozen=True)
class ExecutedPath:
    """One path played with errors.

    Attributes
    ----------
    moving_time_s
        When the last robot has ended its planned legs.
    metrology_rounds, metrology_time_s
        Corrections made until all are measured within tolerance, and the time of all measurements and corrections.
    configuration_time_s
        Both times together.
    min_separation_mm, collisions, contacts
        Least distance of any two robots, pairs nearer than the separation, and pairs that touch, over all of it.
    error_um
        (n_robot,) true distance from the planned end.
    is_within_tolerance
        Whether the last measurement found all robots within tolerance.
    """

    moving_time_s: float
    metrology_rounds: int
    metrology_time_s: float
    configuration_time_s: float
    min_separation_mm: float
    collisions: int
    contacts: int
    error_um: FloatArray
    is_within_tolerance: bool


@dataclass(frozen=True)
class Pieces:
    """Legs cut into short straight pieces and stands, sorted by (robot, time).

    Attributes
    ----------
    leg
        (n_piece,) row of the leg that a piece is of.
    enter_s, leave_s
        (n_piece,) planned times.
    from_mm, to_mm
        (n_piece, 2) planned positions.
    """

    leg: IntArray
    enter_s: FloatArray
    leave_s: FloatArray
    from_mm: FloatArray
    to_mm: FloatArray


def execute(
    plate: Plate, start_mm: FloatArray, legs: Legs, settings: SimulationSettings, rng: np.random.Generator
) -> ExecutedPath:
    """Play one path with errors, then correct what is off.

    Parameters
    ----------
    start_mm
        (n_robot, 2) positions at time 0, mm.
    legs
        Sorted by (robot, leg).
    rng
        Stream of the errors. The same errors are drawn in every mode.
    """
    instrument, start = plate.instrument, np.asarray(start_mm, dtype=np.float64)
    speed, slip = _draw_errors(plate, legs, settings, rng)
    if settings.mode == "resync":
        leg_row, played = _ticks_as_legs(instrument, legs)
        pieces = make_pieces(instrument, start, played)
        leave = _leave_by_tick(played, pieces, speed[leg_row])
        speed, slip, legs = speed[leg_row], slip[leg_row], played
    else:
        pieces = make_pieces(instrument, start, legs)
        duration = (pieces.leave_s - pieces.enter_s) / speed[pieces.leg]
        order_mm = instrument.min_separation_mm if settings.mode == "keep-order" else 0.0
        leave = _leave_in_order(legs, pieces, duration, order_mm)
    planned_end, end = _planned_ends(start, legs), start.copy()
    x_mm, y_mm = _slipped(start, legs, pieces, slip, end)
    moving_time = float(leave.max(initial=0.0))
    knots: list[tuple[np.ndarray, ...]] = [(legs.robot[pieces.leg], leave, x_mm, y_mm)]
    rounds, spent, ok = _correct(instrument, settings, planned_end, end, moving_time, knots, rng)
    way = _trajectories(start, legs, pieces, leave, speed, knots)
    limit = instrument.min_separation_mm - SEPARATION_TOLERANCE_MM
    collisions, least = least_separation(way.t_s, way.x_mm, way.y_mm, way.first, limit)
    contacts, _ = least_separation(way.t_s, way.x_mm, way.y_mm, way.first, instrument.robot_diameter_mm)
    return ExecutedPath(
        moving_time_s=moving_time,
        metrology_rounds=rounds,
        metrology_time_s=spent,
        configuration_time_s=moving_time + spent,
        min_separation_mm=least,
        collisions=collisions,
        contacts=contacts,
        error_um=1e3 * np.hypot(*(end - planned_end).T),
        is_within_tolerance=ok,
    )


def make_pieces(instrument: Instrument, start_mm: FloatArray, legs: Legs) -> Pieces:
    """Cut legs into pieces no longer than `PIECE_MM`; the turn of a leg is a stand of its own."""
    way = make_trajectories(instrument, start_mm, legs)
    # The first knot of each robot is where it starts; then come the knots of its legs.
    is_own = np.ones(len(way.t_s), dtype=bool)
    is_own[way.first[:-1]] = False
    t, x, y = (z[is_own].reshape(-1, KNOTS_PER_LEG) for z in (way.t_s, way.x_mm, way.y_mm))
    t0, t1 = t[:, :-1].ravel(), t[:, 1:].ravel()
    p0 = np.column_stack([x[:, :-1].ravel(), y[:, :-1].ravel()])
    p1 = np.column_stack([x[:, 1:].ravel(), y[:, 1:].ravel()])
    n_part = np.where(t1 > t0, np.maximum(np.ceil(np.hypot(*(p1 - p0).T) / PIECE_MM - 1e-9), 1), 0).astype(np.int64)
    whole = np.repeat(np.arange(len(t0)), n_part)
    part = np.arange(len(whole)) - np.repeat(np.cumsum(n_part) - n_part, n_part)
    share = np.column_stack([part, part + 1]) / n_part[whole][:, None]
    enter, leave = (t0[whole] + (t1 - t0)[whole] * share[:, k] for k in (0, 1))
    from_mm, to_mm = (p0[whole] + (p1 - p0)[whole] * share[:, k : k + 1] for k in (0, 1))
    return Pieces((whole // (KNOTS_PER_LEG - 1)).astype(np.int32), enter, leave, from_mm, to_mm)


def _draw_errors(
    plate: Plate, legs: Legs, settings: SimulationSettings, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Speed factor and slip angle (rad) of every leg."""
    robot_part = settings.robot_speed_scatter_frac * rng.standard_normal(plate.n_robot)
    leg_part = settings.leg_speed_scatter_frac * rng.standard_normal(len(legs))
    speed = np.clip(1.0 + robot_part[legs.robot] + leg_part, SLOWEST, FASTEST)
    return speed, np.radians(settings.slip_deg * rng.standard_normal(len(legs)))


def _ticks_as_legs(instrument: Instrument, legs: Legs) -> tuple[IntArray, Legs]:
    """Ticks as legs, and the row of the leg that each is a part of."""
    played = legs_from_ticks(make_ticks(instrument, legs))
    rank = np.lexsort((np.concatenate([legs.start_s, played.start_s]), np.concatenate([legs.robot, played.robot])))
    is_leg = rank < len(legs)
    row = np.empty(len(rank), dtype=np.int64)
    # In the sorted order a leg comes just before the ticks that start with or after it.
    row[rank] = np.cumsum(is_leg) - 1
    return row[len(legs) :].astype(np.int32), played


def _leave_by_tick(played: Legs, pieces: Pieces, speed: FloatArray) -> FloatArray:
    """When pieces are left if each tick starts once all moves of the one before have ended."""
    since = pieces.leave_s - played.start_s[pieces.leg]
    taken = since / speed[pieces.leg]
    tick_s, tick = np.unique(played.start_s, return_inverse=True)
    longest = np.zeros(len(tick_s))
    np.maximum.at(longest, tick[pieces.leg], taken)
    begun = np.concatenate([[tick_s[0] if len(tick_s) else 0.0], np.cumsum(longest)])[: len(tick_s)]
    return begun[tick[pieces.leg]] + taken


def _leave_in_order(legs: Legs, pieces: Pieces, duration: FloatArray, order_mm: float) -> FloatArray:
    is_first = np.diff(pieces.leg, prepend=-1) != 0
    not_before = np.where(is_first, legs.start_s[pieces.leg], -np.inf)
    robot = legs.robot[pieces.leg]
    order = np.argsort(pieces.enter_s, kind="stable")
    return leave_in_order(
        robot, order, pieces.enter_s, pieces.leave_s, pieces.from_mm, pieces.to_mm, duration, not_before, order_mm
    )


def _planned_ends(start_mm: FloatArray, legs: Legs) -> FloatArray:
    last = np.flatnonzero(np.diff(legs.robot, append=-1) != 0)
    end = start_mm.copy()
    end[legs.robot[last]] = np.column_stack([legs.x_mm[last], legs.y_mm[last]])
    return end


def _slipped(
    start_mm: FloatArray, legs: Legs, pieces: Pieces, slip: FloatArray, end_mm: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Where pieces really end: each piece's step turned by its leg's slip, summed; `end_mm` is set to the ends."""
    step = pieces.to_mm - pieces.from_mm
    cosine, sine = np.cos(slip[pieces.leg]), np.sin(slip[pieces.leg])
    off = np.column_stack([(cosine - 1) * step[:, 0] - sine * step[:, 1], sine * step[:, 0] + (cosine - 1) * step[:, 1]])
    robot = legs.robot[pieces.leg]
    total = np.cumsum(off, axis=0)
    first = np.searchsorted(robot, robot)
    before = np.where(first[:, None] > 0, total[first - 1], 0.0)
    really = pieces.to_mm + total - before
    last = np.flatnonzero(np.diff(robot, append=-1) != 0)
    end_mm[robot[last]] = really[last]
    return really[:, 0], really[:, 1]


def _correct(
    instrument: Instrument,
    settings: SimulationSettings,
    wanted_mm: FloatArray,
    end_mm: FloatArray,
    now_s: float,
    knots: list[tuple[np.ndarray, ...]],
    rng: np.random.Generator,
) -> tuple[int, float, bool]:
    """Measure and correct until all are within tolerance; moves `end_mm`, adds knots, returns rounds, time and success."""
    begun_s, n = now_s, len(end_mm)
    for correction in range(settings.max_rounds + 1):
        now_s += settings.metrology_exposure_s
        measured = end_mm + 1e-3 * settings.metrology_noise_um * rng.standard_normal((n, 2))
        off = np.flatnonzero(np.hypot(*(measured - wanted_mm).T) > 1e-3 * settings.tolerance_um)
        if len(off) == 0:
            return correction, now_s - begun_s, True
        if correction == settings.max_rounds:
            break
        # In whole precise steps along the plate's axes; the robot's own are as good.
        step = np.rint((wanted_mm - measured)[off] / instrument.precise_step_mm) * instrument.precise_step_mm
        knots.append((off, np.full(len(off), now_s), end_mm[off, 0].copy(), end_mm[off, 1].copy()))
        slip = np.radians(settings.slip_deg * rng.standard_normal(len(off)))
        end_mm[off, 0] += np.cos(slip) * step[:, 0] - np.sin(slip) * step[:, 1]
        end_mm[off, 1] += np.sin(slip) * step[:, 0] + np.cos(slip) * step[:, 1]
        took = np.abs(step).sum(axis=1) / instrument.precise_speed_mm_s
        knots.append((off, now_s + took, end_mm[off, 0].copy(), end_mm[off, 1].copy()))
        now_s += float(took.max())
    return settings.max_rounds, now_s - begun_s, False


def _trajectories(
    start_mm: FloatArray,
    legs: Legs,
    pieces: Pieces,
    leave: FloatArray,
    speed: FloatArray,
    knots: list[tuple[np.ndarray, ...]],
) -> Trajectories:
    """Real trajectories: of each piece the knot where it begins moving and the one where it ends, then the corrections."""
    robot = legs.robot[pieces.leg]
    duration = (pieces.leave_s - pieces.enter_s) / speed[pieces.leg]
    _, _, x_mm, y_mm = knots[0]
    is_first = np.diff(robot, prepend=-1) != 0
    from_x = np.where(is_first, start_mm[robot, 0], np.roll(x_mm, 1))
    from_y = np.where(is_first, start_mm[robot, 1], np.roll(y_mm, 1))
    everybody = np.arange(len(start_mm))
    parts: list[tuple[np.ndarray, ...]] = [(everybody, np.zeros(len(start_mm)), start_mm[:, 0], start_mm[:, 1])]
    parts += [(robot, leave - duration, from_x, from_y), *knots]
    whose, t, x, y = (np.concatenate([part[k] for part in parts]) for k in range(4))
    rank = np.concatenate([np.full(len(part[0]), k) for k, part in enumerate(parts)])
    # At equal times the end of one piece comes before the start of the next; equal knots do no harm in any order.
    order = np.lexsort((rank, t, whose))
    first = np.concatenate([[0], np.cumsum(np.bincount(whose, minlength=len(start_mm)))])
    return Trajectories(t[order], x[order], y[order], first)


@njit(cache=True)
def leave_in_order(robot, order, enter, leave, from_mm, to_mm, duration, not_before, order_mm):
    """When each piece is left, if robots wait for those planned to pass nearer than `order_mm` before them (0: none).

    Pieces are sorted by robot, then time; `order` sorts them by planned entry, in which what must come before does.
    """
    n = len(robot)
    left = np.zeros(n)
    n_robot = robot.max() + 1 if n > 0 else 0
    first = np.zeros(n_robot + 1, dtype=np.int64)
    box = np.zeros((n_robot, 4))
    box[:, 0], box[:, 1], box[:, 2], box[:, 3] = np.inf, -np.inf, np.inf, -np.inf
    for k in range(n):
        i = robot[k]
        first[i + 1] += 1
        box[i, 0], box[i, 1] = min(box[i, 0], from_mm[k, 0], to_mm[k, 0]), max(box[i, 1], from_mm[k, 0], to_mm[k, 0])
        box[i, 2], box[i, 3] = min(box[i, 2], from_mm[k, 1], to_mm[k, 1]), max(box[i, 3], from_mm[k, 1], to_mm[k, 1])
    first = np.cumsum(first)
    # Of each robot, the pieces planned to be left by now: entries come in order, so these only advance.
    n_left = first[:-1].copy()
    r2 = order_mm * order_mm
    for q in order:
        j = robot[q]
        begin = max(0.0, not_before[q])
        if q > first[j]:
            begin = max(begin, left[q - 1])
        x0, x1 = min(from_mm[q, 0], to_mm[q, 0]) - order_mm, max(from_mm[q, 0], to_mm[q, 0]) + order_mm
        y0, y1 = min(from_mm[q, 1], to_mm[q, 1]) - order_mm, max(from_mm[q, 1], to_mm[q, 1]) + order_mm
        for i in range(n_robot if order_mm > 0.0 else 0):
            if i == j or box[i, 0] > x1 or box[i, 1] < x0 or box[i, 2] > y1 or box[i, 3] < y0:
                continue
            while n_left[i] < first[i + 1] and leave[n_left[i]] <= enter[q] + 1e-9:
                n_left[i] += 1
            p = n_left[i] - 1
            while p >= first[i] and left[p] > begin:
                if _gap2(from_mm[p], to_mm[p], from_mm[q], to_mm[q]) < r2:
                    begin = left[p]
                    break
                p -= 1
        left[q] = begin + duration[q]
    return left


@njit(cache=True)
def _gap2(a, b, c, d):
    """Squared distance of two short segments that do not cross: from the ends of each to the other."""
    return min(_point_gap2(a, c, d), _point_gap2(b, c, d), _point_gap2(c, a, b), _point_gap2(d, a, b))


@njit(cache=True)
def _point_gap2(p, a, b):
    ux, uy, ex, ey = b[0] - a[0], b[1] - a[1], p[0] - a[0], p[1] - a[1]
    uu = ux * ux + uy * uy
    s = min(1.0, max(0.0, (ex * ux + ey * uy) / uu)) if uu > 0.0 else 0.0
    return (ex - s * ux) ** 2 + (ey - s * uy) ** 2
