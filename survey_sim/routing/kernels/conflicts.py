"""Conflicts: every robot has one plan (way points, waits, a start delay); pairs whose plans come too near have weights."""

# Kernels take flat arrays and untyped scalars, and are long where splitting them would cost calls.
# ruff: noqa: PLW3301
# mypy: disable-error-code="no-untyped-def"
from typing import NamedTuple

import numpy as np

from survey_sim.kernel import inner_kernel, kernel
from survey_sim.routing.kernels.planned import PLAN, arrival, coordinate_at, stay

# Weight of a conflict with a robot that cannot move.
WEIGHT_FIXED = 1e6
# Two plans conflict below the planned separation less this, so that a plan that just touches does not.
TOUCH_MM = 1e-8


class Plans(NamedTuple):
    """The tasks of all robots (ROBOT), the plan of each, and the conflicts between plans with the weights of pairs."""

    robot: np.ndarray
    plan: np.ndarray
    conflict: np.ndarray
    n_conflict: np.ndarray
    weight: np.ndarray


@kernel
def stand_still(robots, plans):
    """Plans in which nobody moves."""
    n = len(robots)
    for i in range(n):
        stay(robots[i], plans[i])
    return Plans(
        robots,
        plans,
        np.zeros((n, n), dtype=np.bool_),
        np.zeros(n, dtype=np.int64),
        np.ones((n, n), dtype=np.float32),
    )


@kernel
def copy_plans(source, target):
    """Overwrite the plans and conflicts of `target`; weights are not copied."""
    target.plan[:], target.conflict[:], target.n_conflict[:] = source.plan, source.conflict, source.n_conflict


@inner_kernel
def last_arrival(plans):
    """When the last robot comes to rest, s."""
    latest = 0.0
    for i in range(len(plans.plan)):
        latest = max(latest, arrival(plans.plan[i]))
    return latest


@inner_kernel
def pair_radius(one, other, separation, margin):
    """Separation to plan for a pair: with the margin, as far as their starts and goals allow."""
    if margin == 0.0:
        return separation
    starts = np.hypot(one.sx - other.sx, one.sy - other.sy)
    goals = np.hypot(one.gx - other.gx, one.gy - other.gy)
    return max(separation, min(separation + margin, min(starts, goals)))


@inner_kernel
def closest2(ti, xi, yi, ni, tj, xj, yj, nj, enough2):
    """Least squared distance of two trajectories; any value below `enough2` once it is that near."""
    ex, ey = xi[0] - xj[0], yi[0] - yj[0]
    least2 = ex * ex + ey * ey
    # From the first knot of either on; the other stands until its own.
    a, b, a_last, b_last = -1, -1, ni - 1, nj - 1
    while (a < a_last or b < b_last) and least2 >= enough2:
        ta = ti[a + 1] if a < a_last else np.inf
        tb = tj[b + 1] if b < b_last else np.inf
        event = min(ta, tb)
        fx = coordinate_at(ti, xi, a, a_last, event) - coordinate_at(tj, xj, b, b_last, event)
        fy = coordinate_at(ti, yi, a, a_last, event) - coordinate_at(tj, yj, b, b_last, event)
        ux, uy = fx - ex, fy - ey
        uu = ux * ux + uy * uy
        s = 1.0
        if uu > 0.0:
            s = min(1.0, max(0.0, -(ex * ux + ey * uy) / uu))
        gx, gy = ex + s * ux, ey + s * uy
        least2 = min(least2, gx * gx + gy * gy)
        ex, ey = fx, fy
        if ta <= event:
            a += 1
        if tb <= event:
            b += 1
    return least2


@inner_kernel
def is_near(one, other, r):
    """Whether two plans come nearer than r."""
    r2 = (r - TOUCH_MM) ** 2
    least2 = closest2(one.kt, one.kx, one.ky, one.n_knot, other.kt, other.kx, other.ky, other.n_knot, r2)
    return least2 < r2


@inner_kernel
def conflict_score(weight, t, x, y, n, other, r):
    """Score of a conflict of this trajectory with another plan: half its weight however slight, all of it if they meet."""
    depth = 1.0 - np.sqrt(closest2(t, x, y, n, other.kt, other.kx, other.ky, other.n_knot, 0.0)) / r
    return weight * (0.5 + 0.5 * max(0.0, depth))


@inner_kernel
def pair_weight(robots, weight, j):
    """Weight of a conflict with robot j, of a row of weights."""
    return weight[j] if robots[j].is_free else WEIGHT_FIXED


@inner_kernel
def set_plan(plans, i, plan, separation, margin):
    """Give robot i this plan, and find its conflicts."""
    plans.plan[i] = plan
    find_conflicts(plans.robot, plans.plan, plans.conflict, plans.n_conflict, i, len(plans.plan), separation, margin)


@inner_kernel
def find_conflicts(robots, plan, conflict, n_conflict, i, n, separation, margin):
    """Conflicts of robot i with the robots before n."""
    widest = separation + margin
    own, me = plan[i], robots[i]
    x0, x1 = own.box[0] - widest, own.box[1] + widest
    y0, y1 = own.box[2] - widest, own.box[3] + widest
    for j in range(n):
        other = plan[j]
        now = False
        if other.box[0] <= x1 and other.box[1] >= x0 and other.box[2] <= y1 and other.box[3] >= y0 and j != i:
            now = is_near(own, other, pair_radius(me, robots[j], separation, margin))
        if now != conflict[i, j]:
            conflict[i, j] = conflict[j, i] = now
            step = 1 if now else -1
            n_conflict[i] += step
            n_conflict[j] += step


@inner_kernel
def find_near(phys, robots, plan, conflict, i, duration, separation, margin, near):
    """Robots that robot i may meet on any way that takes it no longer than `duration`; those in conflict with it first."""
    far = 0.5 * duration * phys.coarse + separation + margin
    me = robots[i]
    x, y = 0.5 * (me.sx + me.gx), 0.5 * (me.sy + me.gy)
    n_near, n_conflict = 0, 0
    for j in range(len(robots)):
        box = plan[j].box
        if j == i or box[0] > x + far or box[1] < x - far or box[2] > y + far or box[3] < y - far:
            continue
        near[n_near] = j
        if conflict[i, j]:
            near[n_near], near[n_conflict] = near[n_conflict], j
            n_conflict += 1
        n_near += 1
    return n_near


@inner_kernel
def present_score(plans, i, separation, margin):
    """Score of the conflicts of robot i as planned."""
    robots, plan, weight = plans.robot, plans.plan, plans.weight[i]
    me, own = robots[i], plan[i]
    total = 0.0
    for j in range(len(robots)):
        if plans.conflict[i, j]:
            r = pair_radius(me, robots[j], separation, margin)
            heavy = pair_weight(robots, weight, j)
            total += conflict_score(heavy, own.kt, own.kx, own.ky, own.n_knot, plan[j], r)
    return total


@kernel
def ground(plans, i, separation, margin):
    """Robot i stays where it starts, for good."""
    scratch = np.zeros(1, PLAN)
    _ground(plans.robot[i], scratch[0])
    set_plan(plans, i, scratch[0], separation, margin)


@inner_kernel
def _ground(robot, plan):
    robot.gx, robot.gy, robot.is_free, robot.alone = robot.sx, robot.sy, False, 0.0
    stay(robot, plan)


@kernel
def ground_worst(plans, separation, margin):
    """Ground the free robot with most conflicts, of those the one with least slack; returns it, -1 if none is left."""
    worst = -1
    for i in range(len(plans.robot)):
        if plans.robot[i].is_free and plans.n_conflict[i] > 0:
            more = worst < 0 or plans.n_conflict[i] > plans.n_conflict[worst]
            if more or (plans.n_conflict[i] == plans.n_conflict[worst] and plans.robot[i].alone > plans.robot[worst].alone):
                worst = i
    if worst >= 0:
        ground(plans, worst, separation, margin)
    return worst
