"""Kernels of the exact matching of one visit: shortest augmenting paths, and branch and bound over targets too close.

The relaxed problem is an assignment of robots to groups of targets. A group is a clique: targets of which any two are
nearer than the separation, so that at most one of them can be held; at first each target is its own group. Where the
assignment holds two targets of different groups too close to each other, the groups are merged if they form one clique;
otherwise the search branches on one of the two: without it, or without all that are near it. Every relaxed cost is a lower
bound.

State of the relaxed problem, as flat arrays: `u` (n_robot,) and `v` (n_target,) duals of robots and groups (v <= 0, and 0
for a group without a robot); `pair` (n_robot,) index of the pair held, `IDLE` or `FREE` (not yet solved); `holder`
(n_target,) robot of each group or -1; `group` (n_target,) the group of each target; `ring` (n_target,) next member of the
group, in a ring; `shut` (n_target,) targets left out.
"""

# ruff: noqa: PLR0912, PLR0915
# mypy: allow-untyped-defs

import numpy as np
from numba import njit

IDLE = -1
FREE = -2
# Two solutions whose costs are nearer than this are the same (totals reach 1e7, a move of 1 mm costs 1e-8 at power 4).
COST_TOLERANCE = 1e-8
# A group that is closed must not be opened again by a reduced cost that rounding made negative.
ROUNDING = 1e-9


@njit(cache=True)
def _pairs_by_robot(n_robot, reach_robot, cost):
    """Pairs of each robot, cheapest first: (first (n_robot + 1,), pair (n_pair,))."""
    first = np.zeros(n_robot + 1, np.int64)
    for r in reach_robot:
        first[r + 1] += 1
    for r in range(n_robot):
        first[r + 1] += first[r]
    filled = first[:-1].copy()
    pair = np.empty(len(reach_robot), np.int32)
    for p in range(len(reach_robot)):
        pair[filled[reach_robot[p]]] = p
        filled[reach_robot[p]] += 1
    for r in range(n_robot):
        own = pair[first[r] : first[r + 1]]
        own[:] = own[np.argsort(cost[own])]
    return first, pair


@njit(cache=True)
def _assign(robot, idle_cost, own_first, own_pair, pair_target, cost, u, v, pair, holder, group, shut, label, by_pair):
    """Bring one free robot into the assignment by a shortest augmenting path; `label` is inf on entry and on return."""
    n_robot = len(u)
    via_robot = np.empty(n_robot, np.int64)
    column = np.empty(n_robot, np.int64)
    is_done = np.zeros(n_robot, np.bool_)
    scanned = np.empty(n_robot, np.int64)
    at = np.empty(n_robot)
    n_column = n_scanned = 0
    best, end_group, end_robot = np.inf, -1, -1
    r, distance = robot, 0.0
    while True:
        scanned[n_scanned], at[n_scanned] = r, distance
        n_scanned += 1
        if distance + idle_cost - u[r] < best:
            best, end_group, end_robot = distance + idle_cost - u[r], -1, r
        for k in range(own_first[r], own_first[r + 1]):
            p = own_pair[k]
            if distance + cost[p] - u[r] >= best:
                break
            if shut[pair_target[p]]:
                continue
            g = group[pair_target[p]]
            d = distance + cost[p] - u[r] - v[g]
            if d >= label[g] - ROUNDING or d >= best:
                continue
            if holder[g] < 0:
                best, end_group = d, g
                end_pair, end_robot = p, r
                continue
            if label[g] == np.inf:
                column[n_column] = g
                n_column += 1
            label[g] = d
            by_pair[g] = p
            via_robot[holder[g]] = r
        nearest, where = best, -1
        for k in range(n_column):
            if not is_done[k] and label[column[k]] < nearest:
                nearest, where = label[column[k]], k
        if where < 0:
            break
        is_done[where] = True
        r, distance = holder[column[where]], nearest
    for k in range(n_scanned):
        u[scanned[k]] += best - at[k]
    for k in range(n_column):
        g = column[k]
        if is_done[k]:
            v[g] -= best - label[g]
        label[g] = np.inf
    r = end_robot
    new = IDLE if end_group < 0 else end_pair
    while True:
        old = pair[r]
        pair[r] = new
        if new >= 0:
            holder[group[pair_target[new]]] = r
        if r == robot:
            return
        new = by_pair[group[pair_target[old]]]
        r = via_robot[r]


@njit(cache=True)
def _release(freed, reach_first, reach_robot, pair_target, cost, u, v, pair, holder, group, ring, shut):
    """Bring the dual of a group that has lost its robot back to 0, moving robots into it where that is cheaper."""
    n_robot = len(u)
    label = np.full(n_robot, np.inf)
    by_pair = np.empty(n_robot, np.int64)
    is_done = np.zeros(n_robot, np.bool_)
    touched = np.empty(n_robot, np.int64)
    n_touched = 0
    best, end_robot = -v[freed], -1
    g, distance = freed, 0.0
    while True:
        t = g
        while True:
            if not shut[t]:
                for p in range(reach_first[t], reach_first[t + 1]):
                    r = reach_robot[p]
                    if pair[r] == FREE:
                        continue
                    d = distance + cost[p] - u[r] - v[g]
                    if d < best and d < label[r] and not is_done[r]:
                        if label[r] == np.inf:
                            touched[n_touched] = r
                            n_touched += 1
                        label[r] = d
                        by_pair[r] = p
            t = ring[t]
            if t == g:
                break
        nearest, r = best, -1
        for k in range(n_touched):
            if not is_done[touched[k]] and label[touched[k]] < nearest:
                nearest, r = label[touched[k]], touched[k]
        if r < 0:
            break
        is_done[r] = True
        if pair[r] == IDLE:
            best, end_robot = nearest, r
            break
        g, distance = group[pair_target[pair[r]]], nearest
        if nearest - v[g] < best:
            best, end_robot = nearest - v[g], r
    v[freed] += best
    for k in range(n_touched):
        r = touched[k]
        if is_done[r] and label[r] < best:
            u[r] -= best - label[r]
            if pair[r] >= 0:
                v[group[pair_target[pair[r]]]] += best - label[r]
    if end_robot < 0:
        v[freed] = 0.0
        return
    r = end_robot
    if pair[r] >= 0:
        left = group[pair_target[pair[r]]]
        holder[left] = -1
        v[left] = 0.0
    while True:
        pair[r] = by_pair[r]
        g = group[pair_target[by_pair[r]]]
        old = holder[g]
        holder[g] = r
        if g == freed:
            return
        r = old


@njit(cache=True)
def _shut_out(
    t, idle_cost, own_first, own_pair, reach_first, reach_robot, pair_target, cost, near_first, near, is_near,
    u, v, pair, holder, group, ring, shut, label, by_pair,
):  # fmt: skip
    """Leave out one target, or (if `is_near`) all that are near it, and mend the assignment."""
    out = near[near_first[t] : near_first[t + 1]] if is_near else np.full(1, t, np.int32)
    freed_robot = np.empty(len(out), np.int64)
    freed_group = np.empty(len(out), np.int64)
    n = 0
    for x in out:
        if shut[x]:
            continue
        shut[x] = True
        r = holder[group[x]]
        if r >= 0 and pair_target[pair[r]] == x:
            pair[r] = FREE
            u[r] = 0.0
            holder[group[x]] = -1
            freed_robot[n], freed_group[n] = r, group[x]
            n += 1
    for k in range(n):
        _release(
            freed_group[k], reach_first, reach_robot, pair_target, cost, u, v, pair, holder, group, ring, shut
        )  # fmt: skip
    for k in range(n):
        _assign(
            freed_robot[k], idle_cost, own_first, own_pair, pair_target, cost,
            u, v, pair, holder, group, shut, label, by_pair,
        )  # fmt: skip


@njit(cache=True)
def _held_near(r, pair, pair_target, holder, group, near_first, near):
    """First target held too close to that of robot r, and how many are."""
    first, n = -1, 0
    if pair[r] >= 0:
        t = pair_target[pair[r]]
        for k in range(near_first[t], near_first[t + 1]):
            q = holder[group[near[k]]]
            if q >= 0 and pair_target[pair[q]] == near[k]:
                n += 1
                if first < 0:
                    first = near[k]
    return first, n


@njit(cache=True)
def _is_clique(a, b, ring, xy, separation):
    """Whether two groups are one clique."""
    s = a
    while True:
        t = b
        while True:
            dx, dy = xy[s, 0] - xy[t, 0], xy[s, 1] - xy[t, 1]
            if dx * dx + dy * dy >= separation * separation:
                return False
            t = ring[t]
            if t == b:
                break
        s = ring[s]
        if s == a:
            return True


@njit(cache=True)
def _settle(
    idle_cost, own_first, own_pair, pair_target, cost, near_first, near, xy, separation,
    u, v, pair, holder, group, ring, shut, label, by_pair,
):  # fmt: skip
    """Merge groups until no two held targets that could be of one clique are too close; the target to branch on, or -1."""
    n_robot = len(u)
    while True:
        branch, most, has_merged = -1, 0, False
        for r in range(n_robot):
            other, n = _held_near(r, pair, pair_target, holder, group, near_first, near)
            if n == 0:
                continue
            a, b = group[pair_target[pair[r]]], group[other]
            if not _is_clique(a, b, ring, xy, separation):
                if n > most:
                    branch, most = pair_target[pair[r]], n
                continue
            if v[b] < v[a]:
                a, b = b, a
            q = holder[b]
            holder[b] = -1
            v[b] = 0.0
            t = b
            while True:
                group[t] = a
                t = ring[t]
                if t == b:
                    break
            ring[a], ring[b] = ring[b], ring[a]
            pair[q] = FREE
            u[q] = 0.0
            _assign(q, idle_cost, own_first, own_pair, pair_target, cost, u, v, pair, holder, group, shut, label, by_pair)
            has_merged = True
        if not has_merged:
            return branch


@njit(cache=True)
def _total(pair, cost, idle_cost):
    total = 0.0
    for p in pair:
        total += idle_cost if p < 0 else cost[p]
    return total


@njit(cache=True)
def match_apart(
    n_robot, idle_cost, reach_first, reach_robot, pair_target, cost,
    near_first, near, xy, separation, max_nodes,
):  # fmt: skip
    """Cheapest set of pairs in which no robot or target is used twice and no two targets are too close.

    Parameters
    ----------
    n_robot, idle_cost
        Number of robots; what a robot without a target costs.
    reach_first, reach_robot, pair_target
        Robots that reach each target, and the target of each pair (n_pair,).
    cost
        (n_pair,) what a pair costs (>= 0).
    near_first, near
        Lists of the targets too close to each target.
    xy, separation
        (n_target, 2) and the least distance, mm.
    max_nodes
        Branchings after which the best solution so far is taken.

    Returns
    -------
    best_pair
        (n_robot,) pair of each robot or -1.
    bound
        Lower bound of the cost over all solutions.
    n_node
        Number of branchings.
    """
    n_target = len(xy)
    own_first, own_pair = _pairs_by_robot(n_robot, reach_robot, cost)
    u, v = np.zeros(n_robot), np.zeros(n_target)
    pair = np.full(n_robot, FREE, np.int64)
    holder = np.full(n_target, -1, np.int64)
    group, ring = np.arange(n_target), np.arange(n_target)
    shut = np.zeros(n_target, np.bool_)
    label, by_pair = np.full(n_target, np.inf), np.empty(n_target, np.int64)
    for r in range(n_robot):
        _assign(r, idle_cost, own_first, own_pair, pair_target, cost, u, v, pair, holder, group, shut, label, by_pair)

    waiting = [(u.copy(), v.copy(), pair.copy(), holder.copy(), group.copy(), ring.copy(), shut.copy())]
    waiting_bound = [-np.inf]
    best, best_pair, n_node, open_bound = np.inf, np.full(n_robot, IDLE, np.int64), 0, np.inf
    while len(waiting) > 0:
        u, v, pair, holder, group, ring, shut = waiting.pop()
        if waiting_bound.pop() >= best - COST_TOLERANCE:
            continue
        while True:
            t = _settle(
                idle_cost, own_first, own_pair, pair_target, cost, near_first, near, xy, separation,
                u, v, pair, holder, group, ring, shut, label, by_pair,
            )  # fmt: skip
            bound = _total(pair, cost, idle_cost)
            if bound >= best - COST_TOLERANCE:
                break
            if t < 0:
                best, best_pair = bound, pair.copy()
                break
            if n_node >= max_nodes and best < np.inf:
                open_bound = min(open_bound, bound)
                break
            n_node += 1
            other = (u.copy(), v.copy(), pair.copy(), holder.copy(), group.copy(), ring.copy(), shut.copy())
            _shut_out(
                t, idle_cost, own_first, own_pair, reach_first, reach_robot, pair_target, cost,
                near_first, near, False, u, v, pair, holder, group, ring, shut, label, by_pair,
            )  # fmt: skip
            _shut_out(
                t, idle_cost, own_first, own_pair, reach_first, reach_robot, pair_target, cost,
                near_first, near, True, other[0], other[1], other[2], other[3], other[4], other[5], other[6], label, by_pair,
            )  # fmt: skip
            here, there = _total(pair, cost, idle_cost), _total(other[2], cost, idle_cost)
            if there < here:
                waiting.append((u, v, pair, holder, group, ring, shut))
                waiting_bound.append(here)
                u, v, pair, holder, group, ring, shut = other
            else:
                waiting.append(other)
                waiting_bound.append(there)
    return best_pair, min(best, open_bound), n_node


@njit(cache=True)
def _open_part(is_open, is_pair_open, reach_first, reach_robot, near_first, near):
    """The open targets with their usable pairs and open neighbours, numbered among themselves.

    Returns
    -------
        (full (n_open,) their indices, reach_first, reach_robot, pair_target, near_first, near).
    """
    full = np.flatnonzero(is_open)
    number = np.full(len(is_open), -1, np.int64)
    number[full] = np.arange(len(full))
    own_first, own_near_first = np.zeros(len(full) + 1, np.int64), np.zeros(len(full) + 1, np.int64)
    n_pair = n_near = 0
    for t in full:
        n_pair += reach_first[t + 1] - reach_first[t]
        n_near += near_first[t + 1] - near_first[t]
    robot, target = np.empty(n_pair, np.int32), np.empty(n_pair, np.int32)
    own_near = np.empty(n_near, np.int32)
    n_pair = n_near = 0
    for i, t in enumerate(full):
        for p in range(reach_first[t], reach_first[t + 1]):
            if is_pair_open[p]:
                robot[n_pair], target[n_pair] = reach_robot[p], i
                n_pair += 1
        for k in range(near_first[t], near_first[t + 1]):
            if number[near[k]] >= 0:
                own_near[n_near] = number[near[k]]
                n_near += 1
        own_first[i + 1], own_near_first[i + 1] = n_pair, n_near
    return full, own_first, robot[:n_pair].copy(), target[:n_pair].copy(), own_near_first, own_near[:n_near].copy()


@njit(cache=True)
def match_open(
    is_open, is_pair_open, start_xy, park_xy, xy, value, value_step, half_power, park_pull,
    reach_first, reach_robot, near_first, near, separation, max_nodes,
):  # fmt: skip
    """Targets held in one visit: most value, then least sum of travel^P + park_pull (distance from park)^P.

    Parameters
    ----------
    is_open, is_pair_open
        (n_target,) and (n_pair,) what may be used.
    start_xy, park_xy, xy
        (n_robot, 2) twice and (n_target, 2) mm.
    value, value_step
        (n_target,) worth; what a unit of it costs beside the travel of one robot, whose most is 1.
    half_power, park_pull
        P / 2; weight of the distance from park.
    reach_first, reach_robot, near_first, near, separation, max_nodes
        As in `match_apart`.

    Returns
    -------
        (n_robot,) target of each robot or -1.
    """
    n_robot = len(start_xy)
    full, first, robot, target, own_near_first, own_near = _open_part(
        is_open, is_pair_open, reach_first, reach_robot, near_first, near
    )
    cost = np.empty(len(robot))
    farthest, greatest = 1e-12, 0.0
    for p in range(len(robot)):
        t, r = full[target[p]], robot[p]
        cost[p] = ((xy[t, 0] - start_xy[r, 0]) ** 2 + (xy[t, 1] - start_xy[r, 1]) ** 2) ** half_power
        if park_pull > 0.0:
            cost[p] += park_pull * ((xy[t, 0] - park_xy[r, 0]) ** 2 + (xy[t, 1] - park_xy[r, 1]) ** 2) ** half_power
        farthest = max(farthest, cost[p])
        greatest = max(greatest, value[t])
    for p in range(len(robot)):
        cost[p] = cost[p] / farthest + (greatest - value[full[target[p]]]) * value_step
    pair, _, _ = match_apart(
        n_robot, greatest * value_step, first, robot, target, cost, own_near_first, own_near, xy[full], separation, max_nodes
    )
    held = np.full(n_robot, -1, np.int64)
    for r in range(n_robot):
        if pair[r] >= 0:
            held[r] = full[target[pair[r]]]
    return held
