"""Plans: where a robot goes and when, straight between knots.

It stands at its first knot before it and at its last knot after it. Robots and plans are records: kernels that pass them by
pointer run ten times as fast as with a tuple of arrays, whose references are counted at every call. A record must not
outlive its array, so arrays are made by the callers.
"""

# Kernels take flat arrays and untyped scalars, and are long where splitting them would cost calls.
# ruff: noqa: PLR0912, PLR0915, SIM110
# mypy: disable-error-code="no-untyped-def"
from typing import NamedTuple

import numpy as np

from survey_sim.kernel import inner_kernel, kernel

# Legs of a coordinated plan, and of one found step by step on a lattice.
MAX_LEGS = 6
MAX_LATTICE_LEGS = 60


class Physics(NamedTuple):
    """Constants of the instrument that kernels need."""

    coarse: float
    precise: float
    rotation: float
    approach: float
    plate_radius: float


# A robot's task: start and goal, its own x axis at the start (hx, hy), its patrol disc, its time alone, s.
ROBOT = np.dtype(
    [(name, np.float64) for name in ("sx", "sy", "gx", "gy", "hx", "hy", "park_x", "park_y", "reach", "alone")]
    + [("is_free", np.bool_)],
    align=True,
)


def plan_type(max_legs: int) -> np.dtype:
    """Records of plans of up to so many legs.

    Way points (x, y), whether the robot turns onto the line to them, and how long it waits before; the knots that they
    give (kt, kx, ky) and their bounding box (least and greatest x, then y). Leg m starts while the robot stands between
    knots leave[m] and leave[m] + 1; leave[0] is -1, the rest before it all.
    """
    n_knot = 3 * max_legs + 3
    per_leg = [("x", np.float64), ("y", np.float64), ("turned", np.int8), ("wait", np.float64), ("leave", np.int64)]
    knots = [(name, np.float64, (n_knot,)) for name in ("kt", "kx", "ky")]
    return np.dtype(
        [("n_leg", np.int64), ("n_knot", np.int64), ("box", np.float64, (4,))]
        + [(name, kind, (max_legs,)) for name, kind in per_leg]
        + knots,
        align=True,
    )


PLAN = plan_type(MAX_LEGS)
LATTICE_PLAN = plan_type(MAX_LATTICE_LEGS)


@kernel
def set_tasks(robots, start, goal, hx, hy, park, reach, alone, is_fixed):
    """Fill in robots (ROBOT) from arrays of their values; goals of fixed ones are their starts."""
    for i in range(len(robots)):
        _set_task(robots[i], start[i], start[i] if is_fixed[i] else goal[i], hx[i], hy[i], park[i])
        robots[i].reach, robots[i].is_free = reach[i], not is_fixed[i]
        robots[i].alone = 0.0 if is_fixed[i] else alone[i]


@inner_kernel
def _set_task(robot, start, goal, hx, hy, park):
    robot.sx, robot.sy = start[0], start[1]
    robot.gx, robot.gy = goal[0], goal[1]
    robot.hx, robot.hy = hx, hy
    robot.park_x, robot.park_y = park[0], park[1]


@inner_kernel
def leg_options(phys, hx, hy, ex, ey, is_last):
    """Seconds of one leg along (ex, ey), turned and not turned, for a robot whose own x axis lies along (hx, hy)."""
    along, across = abs(hx * ex + hy * ey), abs(hx * ey - hy * ex)
    straight, square = np.sqrt(ex * ex + ey * ey), along + across
    turn_s = np.degrees(np.arctan2(min(along, across), max(along, across))) / phys.rotation
    turned_s, square_s = turn_s + straight / phys.coarse, square / phys.coarse
    if is_last:
        late = 1.0 / phys.precise - 1.0 / phys.coarse
        turned_s += min(phys.approach, straight) * late
        square_s += min(phys.approach, square) * late
    return turned_s, square_s


@inner_kernel
def turned_heading(hx, hy, ex, ey):
    """Where the own x axis of a robot points once that or its own y axis lies along (ex, ey), by the least turn.

    Between two axes it is the one that motion.turn_onto_line takes.
    """
    along, across = hx * ex + hy * ey, hx * ey - hy * ex
    length = np.sqrt(ex * ex + ey * ey)
    if length == 0.0:
        return hx, hy
    if abs(along) > abs(across) or (abs(along) == abs(across) and along * across < 0.0):
        length = np.copysign(length, along)
        return ex / length, ey / length
    length = np.copysign(length, across)
    return ey / length, -ex / length


@inner_kernel
def build_knots(phys, robot, plan, n_leg):
    """Knots of a plan's way points; returns the time at the end, infinite if a corner leaves the patrol."""
    return build_knots_from(phys, robot, plan, n_leg, robot.sx, robot.sy)


@inner_kernel
def build_knots_from(phys, robot, plan, n_leg, x0, y0):
    """The same from (x0, y0), with the heading that the robot has at its start."""
    kt, kx, ky = plan.kt, plan.kx, plan.ky
    hx, hy = robot.hx, robot.hy
    kt[0], kx[0], ky[0] = 0.0, x0, y0
    plan.leave[0] = -1
    n, t = 1, 0.0
    for m in range(n_leg):
        x1, y1 = plan.x[m], plan.y[m]
        ex, ey = x1 - x0, y1 - y0
        t += plan.wait[m]
        along, across = hx * ex + hy * ey, hx * ey - hy * ex
        if plan.turned[m]:
            least, most = min(abs(along), abs(across)), max(abs(along), abs(across))
            # Which axis lies on the line, and so the corners of later legs, would hang on rounding.
            if most - least < 1e-9 * most and _goes_square(plan, m + 1, n_leg):
                return np.inf
            t += np.degrees(np.arctan2(least, most)) / phys.rotation
            hx, hy = turned_heading(hx, hy, ex, ey)
            cx, cy, a, b = x1, y1, np.sqrt(ex * ex + ey * ey), 0.0
        else:
            cx, cy, a, b = x0 + hx * along, y0 + hy * along, abs(along), abs(across)
            if not is_inside(phys, robot, cx, cy):
                return np.inf
        if m == 0:
            kt[0] = t
        else:
            plan.leave[m] = n - 1
            kt[n], kx[n], ky[n] = t, x0, y0
            n += 1
        slow_from = a + b - (min(phys.approach, a + b) if m == n_leg - 1 else 0.0)
        if a > 0.0:
            if 0.0 < slow_from < a:
                t += slow_from / phys.coarse
                kt[n], kx[n], ky[n] = t, x0 + (cx - x0) * (slow_from / a), y0 + (cy - y0) * (slow_from / a)
                n += 1
                t += (a - slow_from) / phys.precise
            else:
                t += a / (phys.coarse if slow_from >= a else phys.precise)
            kt[n], kx[n], ky[n] = t, cx, cy
            n += 1
        if b > 0.0:
            if a < slow_from < a + b:
                t += (slow_from - a) / phys.coarse
                f = (slow_from - a) / b
                kt[n], kx[n], ky[n] = t, cx + (x1 - cx) * f, cy + (y1 - cy) * f
                n += 1
                t += (a + b - slow_from) / phys.precise
            else:
                t += b / (phys.precise if slow_from <= a else phys.coarse)
            kt[n], kx[n], ky[n] = t, x1, y1
            n += 1
        x0, y0 = x1, y1
    plan.n_leg, plan.n_knot = n_leg, n
    box = plan.box
    box[0], box[1], box[2], box[3] = np.inf, -np.inf, np.inf, -np.inf
    for k in range(n):
        box[0], box[1] = min(box[0], kx[k]), max(box[1], kx[k])
        box[2], box[3] = min(box[2], ky[k]), max(box[3], ky[k])
    return t


@inner_kernel
def _goes_square(plan, leg, n_leg):
    """Whether the plan has a leg without a turn from this one on."""
    for m in range(leg, n_leg):
        if not plan.turned[m]:
            return True
    return False


@inner_kernel
def delay_from(plan, leg, delay):
    """The plan is late by `delay` from one of its legs on."""
    if delay > 0.0 and plan.n_leg > 0:
        plan.wait[leg] += delay
        for k in range(plan.leave[leg] + 1, plan.n_knot):
            plan.kt[k] += delay


@inner_kernel
def is_inside(phys, robot, x, y):
    """Whether a centre at (x, y) is on the plate and in the robot's patrol disc."""
    tolerance = 1e-7
    plate, patrol = phys.plate_radius + tolerance, robot.reach + tolerance
    return x * x + y * y <= plate * plate and (x - robot.park_x) ** 2 + (y - robot.park_y) ** 2 <= patrol * patrol


@inner_kernel
def stay(robot, plan):
    """A plan without legs."""
    plan.n_leg, plan.n_knot, plan.leave[0] = 0, 1, -1
    plan.kt[0], plan.kx[0], plan.ky[0] = 0.0, robot.sx, robot.sy
    plan.box[0] = plan.box[1] = robot.sx
    plan.box[2] = plan.box[3] = robot.sy


@inner_kernel
def arrival(plan):
    """When the robot comes to rest, s."""
    return plan.kt[plan.n_knot - 1]


@inner_kernel
def coordinate_at(t, z, k, last, when):
    """Coordinate at `when`, between knots k and k + 1; -1 and `last` are the rests."""
    if k < 0:
        return z[0]
    if k >= last or when <= t[k]:
        return z[min(k, last)]
    if when >= t[k + 1]:
        return z[k + 1]
    return z[k] + (z[k + 1] - z[k]) * ((when - t[k]) / (t[k + 1] - t[k]))


@kernel
def list_legs(phys, plans):
    """Legs of all plans, robot by robot: whose (n_leg,), when they start, s, where they end (n_leg, 2), whether turned."""
    n_leg = 0
    for i in range(len(plans.plan)):
        n_leg += plans.plan[i].n_leg
    robot, start_s = np.empty(n_leg, np.int32), np.empty(n_leg)
    way, is_turned = np.empty((n_leg, 2)), np.empty(n_leg, np.bool_)
    first = 0
    for i in range(len(plans.plan)):
        n_leg = plans.plan[i].n_leg
        robot[first : first + n_leg] = i
        _list_legs(phys, plans.robot[i], plans.plan[i], first, start_s, way, is_turned)
        first += n_leg
    return robot, start_s, way, is_turned


@inner_kernel
def _list_legs(phys, robot, plan, first, start_s, way, is_turned):
    t, hx, hy, x, y = 0.0, robot.hx, robot.hy, robot.sx, robot.sy
    for m in range(plan.n_leg):
        t += plan.wait[m]
        start_s[first + m], is_turned[first + m] = t, plan.turned[m] != 0
        ex, ey = plan.x[m] - x, plan.y[m] - y
        turned_s, square_s = leg_options(phys, hx, hy, ex, ey, m == plan.n_leg - 1)
        t += turned_s if plan.turned[m] else square_s
        if plan.turned[m]:
            hx, hy = turned_heading(hx, hy, ex, ey)
        x, y = plan.x[m], plan.y[m]
        way[first + m, 0], way[first + m, 1] = x, y
