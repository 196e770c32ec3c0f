"""Legs played as they are written: times of every robot, and how near they come to each other."""

# mypy: disable-error-code="no-untyped-def"
from dataclasses import dataclass

import numpy as np
from numba import njit

from survey_sim.instrument import Plate
from survey_sim.motion import FloatArray, Legs, leg_times_s, make_trajectories

# Separations down to this much below min_separation_mm are no collision (design tolerance).
SEPARATION_TOLERANCE_MM = 1e-6
# The paper's filter: without the 5 % of robots that are last.
FILTERED_SHARE = 0.95


@dataclass(frozen=True)
class SimulatedPath:
    """What playing one path shows.

    Attributes
    ----------
    rotating_s, moving_s, waiting_s
        (n_robot,) each robot's seconds from the start of the path until it comes to rest; 0 for one that does not move.
    end_mm, end_theta_deg
        (n_robot, 2) mm and (n_robot,) deg.
    configuration_time_s, configuration_time_p95_s
        When all, and 95 %, of the robots that move have come to rest.
    configuration_time_median_s
        Median of the times at which they do.
    ticks
        Number of ticks.
    collisions
        Pairs that are nearer than the separation at some instant.
    min_separation_mm
        Least distance of any two robots over the whole path, in closed form; infinite for a single robot.
    """

    rotating_s: FloatArray
    moving_s: FloatArray
    waiting_s: FloatArray
    end_mm: FloatArray
    end_theta_deg: FloatArray
    configuration_time_s: float
    configuration_time_p95_s: float
    configuration_time_median_s: float
    ticks: int
    collisions: int
    min_separation_mm: float


def simulate(plate: Plate, start_mm: FloatArray, start_theta_deg: FloatArray, legs: Legs) -> SimulatedPath:
    """Play the legs of one path without error.

    Parameters
    ----------
    start_mm, start_theta_deg
        (n_robot, 2) mm and (n_robot,) deg at the start, all robots of the plate.
    legs
        Sorted by (robot, leg).
    """
    rotating, moving = leg_times_s(plate.instrument, legs)
    own_s = _own_times(plate.n_robot, legs.robot, legs.start_s, rotating, moving)
    last = legs.last
    mover = legs.robot[last]
    end_mm, end_theta = np.array(start_mm, dtype=np.float64), np.array(start_theta_deg, dtype=np.float64)
    end_mm[mover, 0], end_mm[mover, 1] = legs.x_mm[last], legs.y_mm[last]
    end_theta[mover] = legs.theta_deg[last]
    arrival_s = np.sort((legs.start_s + rotating + moving)[last])
    collisions, least = separations(plate, start_mm, legs, plate.instrument.min_separation_mm - SEPARATION_TOLERANCE_MM)
    return SimulatedPath(
        rotating_s=own_s[0],
        moving_s=own_s[1],
        waiting_s=own_s[2],
        end_mm=end_mm,
        end_theta_deg=end_theta,
        configuration_time_s=float(arrival_s.max(initial=0.0)),
        configuration_time_p95_s=_when_at_rest(arrival_s, FILTERED_SHARE),
        configuration_time_median_s=_median(arrival_s),
        ticks=len(np.unique(legs.start_s)),
        collisions=collisions,
        min_separation_mm=least,
    )


def separations(plate: Plate, start_mm: FloatArray, legs: Legs, limit_mm: float) -> tuple[int, float]:
    """Number of pairs that come nearer than `limit_mm`, and the least distance of all pairs at all instants, mm."""
    way = make_trajectories(plate.instrument, np.asarray(start_mm, dtype=np.float64), legs)
    return least_separation(way.t_s, way.x_mm, way.y_mm, way.first, limit_mm)


def _when_at_rest(arrival_s: FloatArray, share: float) -> float:
    """When `share` of the movers, rounded up to a robot, have arrived (times ascend); 0 if nobody moves."""
    if len(arrival_s) == 0:
        return 0.0
    n_needed = int(np.ceil(share * len(arrival_s) - 1e-9))
    return float(arrival_s[max(n_needed, 1) - 1])


def _median(ascending: FloatArray) -> float:
    """Median of times that ascend; 0 if there are none."""
    n = len(ascending)
    return float((ascending[(n - 1) // 2] + ascending[n // 2]) / 2.0) if n else 0.0


@njit(cache=True)
def _own_times(n_robot, robot, start_s, rotating_s, moving_s):
    """(3, n_robot) seconds that each robot turns, travels and waits until it comes to rest."""
    own_s = np.zeros((3, n_robot))
    for k in range(len(robot)):
        r = robot[k]
        own_s[0, r] += rotating_s[k]
        own_s[1, r] += moving_s[k]
        rest_s = start_s[k] + rotating_s[k] + moving_s[k]
        own_s[2, r] = max(0.0, rest_s - own_s[0, r] - own_s[1, r])
    return own_s


@njit(cache=True)
def least_separation(t, x, y, first, limit):
    """Pairs nearer than `limit`, and the least distance, of trajectories given by knots (`motion.Trajectories`)."""
    n = len(first) - 1
    box = np.empty((n, 4))
    for i in range(n):
        a, b = first[i], first[i + 1]
        box[i, 0], box[i, 1] = x[a:b].min(), x[a:b].max()
        box[i, 2], box[i, 3] = y[a:b].min(), y[a:b].max()
    least2 = np.inf
    limit2 = limit * limit
    n_near = 0
    for i in range(n):
        for j in range(i):
            gap_x = max(0.0, box[i, 0] - box[j, 1], box[j, 0] - box[i, 1])
            gap_y = max(0.0, box[i, 2] - box[j, 3], box[j, 2] - box[i, 3])
            if gap_x * gap_x + gap_y * gap_y >= max(least2, limit2):
                continue
            d2 = _pair_least2(t, x, y, first[i], first[i + 1] - 1, first[j], first[j + 1] - 1)
            least2 = min(least2, d2)
            if limit > 0.0 and d2 < limit2:
                n_near += 1
    return n_near, np.sqrt(least2)


@njit(cache=True)
def _pair_least2(t, x, y, a, a_last, b, b_last):
    """Least squared distance of two trajectories: between events both go straight, so their difference does too."""
    ex, ey = x[a] - x[b], y[a] - y[b]
    least2 = ex * ex + ey * ey
    while a < a_last or b < b_last:
        ta = t[a + 1] if a < a_last else np.inf
        tb = t[b + 1] if b < b_last else np.inf
        event = min(ta, tb)
        fx = _at(t, x, a, a_last, event) - _at(t, x, b, b_last, event)
        fy = _at(t, y, a, a_last, event) - _at(t, y, b, b_last, event)
        ux, uy = fx - ex, fy - ey
        uu = ux * ux + uy * uy
        s = 1.0
        if uu > 0.0:
            s = min(1.0, max(0.0, -(ex * ux + ey * uy) / uu))
        cx, cy = ex + s * ux, ey + s * uy
        least2 = min(least2, cx * cx + cy * cy)
        ex, ey = fx, fy
        if ta <= event:
            a += 1
        if tb <= event:
            b += 1
    return least2


@njit(cache=True)
def _at(t, z, k, k_last, when):
    """Coordinate at `when`, which lies between knots k and k + 1 (or after the last)."""
    if k >= k_last:
        return z[k_last]
    span = t[k + 1] - t[k]
    if when >= t[k + 1] or span <= 0.0:
        return z[k + 1]
    return z[k] + (z[k + 1] - z[k]) * max(0.0, (when - t[k]) / span)
