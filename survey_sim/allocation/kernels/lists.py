"""Who is near whom, and who reaches what, as lists one after another; costs of ways."""

# mypy: allow-untyped-defs

import numpy as np

from survey_sim.kernel import kernel

# Targets and rests keep this much more than the least separation, so that rounding never brings two robots too close.
GUARD_MM = 1e-7


@kernel
def near_lists(x, y, radius):
    """For each point, the points nearer to it than a radius, as lists one after another.

    Parameters
    ----------
    x, y
        (n,) mm.
    radius
        mm; a pair at exactly this distance is not near.

    Returns
    -------
    first
        (n + 1,) where each point's list begins.
    near
        (n_near,) points, in each list ascending.
    """
    n = len(x)
    order = np.argsort(x)
    count = np.zeros(n + 1, np.int64)
    for is_filling in range(2):
        if is_filling:
            for i in range(n):
                count[i + 1] += count[i]
            first = count.copy()
            near = np.empty(count[n], np.int32)
        for a in range(n):
            i = order[a]
            for b in range(a + 1, n):
                j = order[b]
                dx = x[j] - x[i]
                if dx >= radius:
                    break
                dy = y[j] - y[i]
                if dx * dx + dy * dy < radius * radius:
                    if is_filling:
                        near[count[i]] = j
                        near[count[j]] = i
                        count[i] += 1
                        count[j] += 1
                    else:
                        count[i + 1] += 1
                        count[j + 1] += 1
    for i in range(n):
        near[first[i] : first[i + 1]].sort()
    return first, near


@kernel
def near_any(target, first, near, n_target):
    """(n_target,) whether a target is one of those given (n,), or near one by the lists."""
    is_near = np.zeros(n_target, np.bool_)
    for t in target:
        is_near[t] = True
        for k in range(first[t], first[t + 1]):
            is_near[near[k]] = True
    return is_near


@kernel
def near_among(chosen, n_target, first, near):
    """Lists of near targets among those chosen (n,), numbered in their order: (first (n + 1,), near)."""
    number = np.full(n_target, -1, np.int32)
    number[chosen] = np.arange(len(chosen))
    own_first = np.zeros(len(chosen) + 1, np.int64)
    own_near = np.empty(len(near), np.int32)
    n = 0
    for i, t in enumerate(chosen):
        for k in range(first[t], first[t + 1]):
            if number[near[k]] >= 0:
                own_near[n] = number[near[k]]
                n += 1
        own_first[i + 1] = n
    return own_first, own_near[:n].copy()


@kernel
def nearest_squared(xy, places):
    """(n,) square of the distance from each point (n, 2) to the nearest of the places (m, 2); inf if there is none."""
    nearest = np.full(len(xy), np.inf)
    for i in range(len(xy)):
        for j in range(len(places)):
            dx, dy = xy[i, 0] - places[j, 0], xy[i, 1] - places[j, 1]
            nearest[i] = min(nearest[i], dx * dx + dy * dy)
    return nearest


@kernel
def way_costs(start_xy, park_xy, patrol, is_guide, xy, is_for_guide, half_power):
    """(n_robot, n_target) distance^(2 half_power) of each robot from each target; inf for those that it may not take.

    Parameters
    ----------
    start_xy, park_xy, patrol, is_guide
        (n_robot, 2) twice and (n_robot,) twice: a robot takes targets within its patrol disc, of its kind.
    xy, is_for_guide
        (n_target, 2) and (n_target,).
    """
    cost = np.full((len(start_xy), len(xy)), np.inf)
    for r in range(len(start_xy)):
        for t in range(len(xy)):
            dx, dy = xy[t, 0] - park_xy[r, 0], xy[t, 1] - park_xy[r, 1]
            if is_guide[r] == is_for_guide[t] and dx * dx + dy * dy <= patrol[r] * patrol[r]:
                dx, dy = xy[t, 0] - start_xy[r, 0], xy[t, 1] - start_xy[r, 1]
                d2 = dx * dx + dy * dy
                cost[r, t] = d2 * d2 if half_power == 2.0 else d2**half_power
    return cost


@kernel
def reach_lists(robot_xy, patrol, is_guide, xy, is_for_guide, is_served):
    """Robots that reach each target, as lists one after another.

    Parameters
    ----------
    robot_xy, patrol
        (n_robot, 2) centres and (n_robot,) radii of the patrol discs, mm.
    is_guide
        (n_robot,) bool.
    xy
        (n_target, 2) mm.
    is_for_guide, is_served
        (n_target,) bool: served by guide robots and by no other; served at all.

    Returns
    -------
    first, robot
        (n_target + 1,) and (n_pair,): robots of target t are robot[first[t]:first[t + 1]], ascending.
    """
    n_target = len(xy)
    first = np.zeros(n_target + 1, np.int64)
    robot = np.empty(max(16, 16 * n_target), np.int32)
    # Robots of each kind from west to east: only those within the widest reach are looked at.
    by_x = np.argsort(robot_xy[:, 0])
    kinds = (by_x[~is_guide[by_x]], by_x[is_guide[by_x]])
    x = (robot_xy[kinds[0], 0].copy(), robot_xy[kinds[1], 0].copy())
    widest = np.zeros(2)
    for r in range(len(robot_xy)):
        widest[int(is_guide[r])] = np.fmax(widest[int(is_guide[r])], patrol[r])
    n = 0
    for t in range(n_target):
        if is_served[t]:
            kind = int(is_for_guide[t])
            begin = np.searchsorted(x[kind], xy[t, 0] - widest[kind] - GUARD_MM)
            n_before = n
            for k in range(begin, len(x[kind])):
                dx = x[kind][k] - xy[t, 0]
                if dx > widest[kind] + GUARD_MM:
                    break
                r = kinds[kind][k]
                dy = robot_xy[r, 1] - xy[t, 1]
                if dx * dx + dy * dy <= patrol[r] * patrol[r]:
                    if n == len(robot):
                        robot = np.concatenate((robot, np.empty(n, np.int32)))
                    robot[n] = r
                    n += 1
            robot[n_before:n].sort()
        first[t + 1] = n
    return first, robot[:n].copy()
