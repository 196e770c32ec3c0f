"""Who is near whom, and who reaches what, as lists one after another; costs of ways."""

# mypy: allow-untyped-defs

import numpy as np

from survey_sim.kernel import inlined_kernel, kernel

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
    by_x, by_y = x[order], y[order]
    first = np.zeros(n + 1, np.int64)
    for is_filling in range(2):
        if is_filling:
            for i in range(n):
                first[i + 1] += first[i]
            end = first.copy()
            found = np.empty(first[n], np.int32)
        for a in range(n):
            for b in range(a + 1, n):
                dx = by_x[b] - by_x[a]
                if dx >= radius:
                    break
                dy = by_y[b] - by_y[a]
                if dx * dx + dy * dy < radius * radius:
                    i, j = order[a], order[b]
                    if is_filling:
                        found[end[i]] = j
                        found[end[j]] = i
                        end[i] += 1
                        end[j] += 1
                    else:
                        first[i + 1] += 1
                        first[j + 1] += 1
    # Who is near is near the other too: points taken in their order are added to each list in their order.
    near = np.empty(first[n], np.int32)
    end[:] = first
    for i in range(n):
        for k in range(first[i], first[i + 1]):
            j = found[k]
            near[end[j]] = i
            end[j] += 1
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
def sum_near(worth, first, near):
    """(n_target,) sum of `worth` (n_target,) over the targets near each target, by the lists."""
    total = np.zeros(len(worth))
    for t in range(len(worth)):
        for k in range(first[t], first[t + 1]):
            total[t] += worth[near[k]]
    return total


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


@inlined_kernel
def _reached(x, y, is_guided, robot_xy, reach, is_guide, hit):
    """Note in `hit` the places of the targets, from west to east, that a robot reaches; gives their number.

    Without a branch at each: no processor could foretell it, which took most of the time.
    """
    n = 0
    if reach >= 0.0:  # of a dead robot it is NaN
        begin = np.searchsorted(x, robot_xy[0] - reach - GUARD_MM)
        for k in range(begin, np.searchsorted(x, robot_xy[0] + reach + GUARD_MM)):
            dx, dy = x[k] - robot_xy[0], y[k] - robot_xy[1]
            hit[n] = k
            n += (dx * dx + dy * dy <= reach * reach) & (is_guided[k] == is_guide)
    return n


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
    served = np.flatnonzero(is_served)
    served = served[np.argsort(xy[served, 0])]
    x, y, is_guided = xy[served, 0], xy[served, 1], is_for_guide[served]
    hit = np.empty(len(x) + 1, np.int64)
    first = np.zeros(n_target + 1, np.int64)
    # Robots taken in their order are added to each target's list in their order.
    for is_filling in range(2):
        if is_filling:
            for t in range(n_target):
                first[t + 1] += first[t]
            end = first.copy()
            robot = np.empty(first[n_target], np.int32)
        for r in range(len(robot_xy)):
            for k in range(_reached(x, y, is_guided, robot_xy[r], patrol[r], is_guide[r], hit)):
                t = served[hit[k]]
                if is_filling:
                    robot[end[t]] = r
                    end[t] += 1
                else:
                    first[t + 1] += 1
    return first, robot
