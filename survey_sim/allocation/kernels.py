"""Kernels on one plate: lists of neighbours, pairs taken in order, crossings, resting places.

They call each other, so they share a module: numba's cache on disk does not notice an edit in another file.
"""

# mypy: allow-untyped-defs

import numpy as np
from numba import njit

# Targets and rests keep this much more than the least separation, so that rounding never brings two robots too close.
GUARD_MM = 1e-7


@njit(cache=True)
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


@njit(cache=True)
def near_any(target, first, near, n_target):
    """(n_target,) whether a target is one of those given (n,), or near one by the lists."""
    is_near = np.zeros(n_target, np.bool_)
    for t in target:
        is_near[t] = True
        for k in range(first[t], first[t + 1]):
            is_near[near[k]] = True
    return is_near


@njit(cache=True)
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


@njit(cache=True)
def nearest_squared(xy, places):
    """(n,) square of the distance from each point (n, 2) to the nearest of the places (m, 2); inf if there is none."""
    nearest = np.full(len(xy), np.inf)
    for i in range(len(xy)):
        for j in range(len(places)):
            dx, dy = xy[i, 0] - places[j, 0], xy[i, 1] - places[j, 1]
            nearest[i] = min(nearest[i], dx * dx + dy * dy)
    return nearest


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
def segments_cross(ax, ay, bx, by, cx, cy, dx, dy):
    """Whether segments a-b and c-d cross; ends that touch do not (a robot may take the place that another leaves)."""
    if max(ax, bx) < min(cx, dx) or max(cx, dx) < min(ax, bx) or max(ay, by) < min(cy, dy) or max(cy, dy) < min(ay, by):
        return False
    c_side = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    d_side = (bx - ax) * (dy - ay) - (by - ay) * (dx - ax)
    a_side = (dx - cx) * (ay - cy) - (dy - cy) * (ax - cx)
    b_side = (dx - cx) * (by - cy) - (dy - cy) * (bx - cx)
    return c_side * d_side < 0.0 and a_side * b_side < 0.0


@njit(cache=True)
def crossings(start_mm, end_mm):
    """Number of pairs of robots whose straight ways cross.

    Parameters
    ----------
    start_mm, end_mm
        (n_robot, 2) mm. A robot that does not move crosses none.
    """
    n = 0
    for i in range(len(start_mm)):
        for j in range(i):
            n += segments_cross(
                start_mm[i, 0], start_mm[i, 1], end_mm[i, 0], end_mm[i, 1],
                start_mm[j, 0], start_mm[j, 1], end_mm[j, 0], end_mm[j, 1],
            )  # fmt: skip
    return n


@njit(cache=True)
def take_in_order(pair_robot, pair_target, limit, first, near, start_xy, xy, shuns_crossings, is_open, held):
    """Go through pairs of robot and target in the order given, and take each one that still can be.

    A pair can be taken while its robot is free, its target is open and, if crossings are shunned, the robot's way crosses
    none that was taken before. A target that is taken closes itself and all that are near it.

    Parameters
    ----------
    pair_robot, pair_target
        (n_pair,) indices, best first.
    limit
        Most pairs to take.
    first, near
        Lists of targets near each target (`near_lists`).
    start_xy, xy
        (n_robot, 2) and (n_target, 2) mm.
    shuns_crossings
        Whether a pair whose way crosses another's is left out.
    is_open
        (n_target,) bool; changed.
    held
        (n_robot,) target of each robot or -1; changed.

    Returns
    -------
        Number of pairs taken.
    """
    n_taken = 0
    for p in range(len(pair_robot)):
        if n_taken >= limit:
            break
        r, t = pair_robot[p], pair_target[p]
        if held[r] >= 0 or not is_open[t]:
            continue
        if shuns_crossings and _crosses_held(r, t, start_xy, xy, held):
            continue
        held[r] = t
        n_taken += 1
        is_open[t] = False
        for k in range(first[t], first[t + 1]):
            is_open[near[k]] = False
    return n_taken


@njit(cache=True)
def _crosses_held(r, t, start_xy, xy, held):
    for q in range(len(held)):
        if q != r and held[q] >= 0:
            u = held[q]
            if segments_cross(
                start_xy[r, 0], start_xy[r, 1], xy[t, 0], xy[t, 1],
                start_xy[q, 0], start_xy[q, 1], xy[u, 0], xy[u, 1],
            ):  # fmt: skip
                return True
    return False


@njit(cache=True)
def place_idle(is_idle, is_live, start_xy, park_xy, patrol, plate_radius, separation, goal_xy):
    """Give every idle robot the legal place nearest to where it stands.

    Legal is: in its patrol disc, on the plate, and no nearer than the separation to any other robot's end. First every
    idle robot that can stay does; the others then go, in order of index, to the nearest place left. That place is where
    the robot stands, or its foot on the circle around one end, or where two circles (ends, patrol disc, plate) meet.

    Parameters
    ----------
    is_idle, is_live
        (n_robot,) bool. A robot that is not live keeps its place.
    start_xy, park_xy, patrol
        (n_robot, 2), (n_robot, 2), (n_robot,) mm.
    plate_radius, separation
        mm.
    goal_xy
        (n_robot, 2) mm; ends of the others given, of idle ones filled in.

    Returns
    -------
        -1, or the first robot for which no legal place exists.
    """
    n = len(is_idle)
    is_placed = np.empty(n, np.bool_)
    for r in range(n):
        is_placed[r] = not (is_idle[r] and is_live[r])
    for r in range(n):
        if not is_live[r]:
            goal_xy[r] = start_xy[r]
        elif is_idle[r] and _is_free(start_xy[r, 0], start_xy[r, 1], r, is_placed, goal_xy, separation):
            goal_xy[r] = start_xy[r]
            is_placed[r] = True
    for r in range(n):
        if not is_placed[r]:
            if not _nearest_place(
                r, start_xy[r, 0], start_xy[r, 1], park_xy, patrol, plate_radius, separation, is_placed, goal_xy
            ):
                return r
            is_placed[r] = True
    return -1


@njit(cache=True)
def _is_free(px, py, robot, is_placed, goal_xy, separation):
    for q in range(len(is_placed)):
        if is_placed[q] and q != robot:
            dx, dy = px - goal_xy[q, 0], py - goal_xy[q, 1]
            if dx * dx + dy * dy < separation * separation:
                return False
    return True


@njit(cache=True)
def _nearest_place(robot, px, py, park_xy, patrol, plate_radius, separation, is_placed, goal_xy):
    """Fill in the nearest legal place of one robot; whether there is one."""
    cx, cy, reach = park_xy[robot, 0], park_xy[robot, 1], patrol[robot]
    circle = np.empty((len(is_placed) + 2, 3))
    m = 0
    for q in range(len(is_placed)):
        if is_placed[q] and q != robot:
            dx, dy = goal_xy[q, 0] - cx, goal_xy[q, 1] - cy
            if dx * dx + dy * dy < (reach + separation) ** 2:
                circle[m, 0], circle[m, 1], circle[m, 2] = goal_xy[q, 0], goal_xy[q, 1], separation + GUARD_MM
                m += 1
    n_end = m
    circle[m, 0], circle[m, 1], circle[m, 2] = cx, cy, reach - GUARD_MM
    circle[m + 1, 0], circle[m + 1, 1], circle[m + 1, 2] = 0.0, 0.0, plate_radius - GUARD_MM
    m += 2
    best = np.inf
    for i in range(m):
        ix, iy, ir = circle[i, 0], circle[i, 1], circle[i, 2]
        distance = np.hypot(px - ix, py - iy)
        ux, uy = (1.0, 0.0) if distance == 0.0 else ((px - ix) / distance, (py - iy) / distance)
        best = _try_place(robot, ix + ir * ux, iy + ir * uy, px, py, circle, n_end, best, goal_xy)
        for j in range(i):
            ex, ey = circle[j, 0] - ix, circle[j, 1] - iy
            d2 = ex * ex + ey * ey
            if d2 == 0.0:
                continue
            along = (d2 + ir * ir - circle[j, 2] ** 2) / (2.0 * d2)
            h2 = ir * ir / d2 - along * along
            if h2 < 0.0:
                continue
            h = np.sqrt(h2)
            for sign in (-1.0, 1.0):
                best = _try_place(
                    robot, ix + along * ex - sign * h * ey, iy + along * ey + sign * h * ex,
                    px, py, circle, n_end, best, goal_xy,
                )  # fmt: skip
    return best < np.inf


@njit(cache=True)
def _try_place(robot, x, y, px, py, circle, n_end, best, goal_xy):
    """Take a place if it is legal and nearer than the best so far (squared distance); the new best."""
    d2 = (x - px) ** 2 + (y - py) ** 2
    if d2 >= best:
        return best
    slack = 0.5 * GUARD_MM
    for k in range(n_end + 2):
        distance = np.hypot(x - circle[k, 0], y - circle[k, 1])
        if k < n_end and distance < circle[k, 2] - slack:
            return best
        if k >= n_end and distance > circle[k, 2] + slack:
            return best
    goal_xy[robot, 0], goal_xy[robot, 1] = x, y
    return d2


@njit(cache=True)
def note_lost(held, is_open, is_science, priority, first, near, reach_first, reach_robot, n_clear, lowest):
    """Keep what tells later why a target was lost: whether it had room, and whom its robots served instead.

    Parameters
    ----------
    held
        (n_robot,) target of each robot or -1 in one visit.
    is_open, is_science, priority
        (n_target,) still wanted; science; 1 to 9.
    first, near, reach_first, reach_robot
        Lists of near targets and of robots in reach.
    n_clear
        (n_target,) visits in which no target near it was held; changed.
    lowest
        (n_target,) least priority that a robot in its reach served in a visit in which it had room; changed.
    """
    is_held = np.zeros(len(is_open), np.bool_)
    for t in held:
        if t >= 0:
            is_held[t] = True
    for t in range(len(is_open)):
        if not is_open[t] or is_held[t]:
            continue
        is_clear = True
        for k in range(first[t], first[t + 1]):
            if is_held[near[k]]:
                is_clear = False
                break
        if not is_clear:
            continue
        n_clear[t] += 1
        for k in range(reach_first[t], reach_first[t + 1]):
            u = held[reach_robot[k]]
            if u < 0:
                lowest[t] = 0
            elif is_science[u]:
                lowest[t] = min(lowest[t], priority[u])


@njit(cache=True)
def pick_apart(candidates, limit, first, near, is_open, is_picked):
    """Pick targets in the order given, none near one picked before; the number picked now.

    Parameters
    ----------
    candidates, limit
        (n,) targets, best first; most to pick.
    first, near
        Lists of near targets.
    is_open, is_picked
        (n_target,) may be picked; picked so far (changed).
    """
    n = 0
    for t in candidates:
        if n >= limit:
            break
        if is_picked[t] or not is_open[t]:
            continue
        is_apart = True
        for k in range(first[t], first[t + 1]):
            if is_picked[near[k]]:
                is_apart = False
                break
        if is_apart:
            is_picked[t] = True
            n += 1
    return n
