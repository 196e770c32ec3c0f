"""Kernels of the exact matching of one visit: shortest augmenting paths, and branch and bound over targets too close.

The relaxed problem is an assignment of robots to groups of targets. A group is a clique: targets of which any two are
nearer than the separation, so that at most one of them can be held; at first each target is its own group. Where the
assignment holds two targets of different groups too close to each other, the groups are merged if they form one clique;
otherwise the search branches on one of the two: without it, or without all that are near it. Every relaxed cost is a lower
bound.

Both sides search: a robot looks for a target, or a group that has lost its robot for another one.
"""

# mypy: allow-untyped-defs

from typing import NamedTuple

import numpy as np

from survey_sim.kernel import inlined_kernel, kernel

IDLE = -1
FREE = -2
# Two solutions whose costs are nearer than this are the same (totals reach 1e7, a move of 1 mm costs 1e-8 at power 4).
COST_TOLERANCE = 1e-8
# A group that is closed must not be opened again by a reduced cost that rounding made negative.
ROUNDING = 1e-9


class Pairs(NamedTuple):
    """The problem: who may hold what, at what cost; q robots, n targets, m pairs.

    idle_cost: of a robot without a target; own_first (q + 1,), own_pair (m,): pairs of each robot; first (n + 1,), robot
    (m,): those of each target; target (m,); cost (m,) >= 0; near_first, near: targets too close to each target; xy (n, 2)
    and separation, mm.
    """

    idle_cost: float
    own_first: np.ndarray
    own_pair: np.ndarray
    first: np.ndarray
    robot: np.ndarray
    target: np.ndarray
    cost: np.ndarray
    near_first: np.ndarray
    near: np.ndarray
    xy: np.ndarray
    separation: float


class Matched(NamedTuple):
    """A solution of the relaxed problem.

    u (q,), v (n,): duals of robots and groups (v <= 0, and 0 for a group without a robot); pair (q,): the pair held, `IDLE`
    or `FREE` (not yet solved); holder (n,): robot of each group or -1; group (n,): the group of each target; ring (n,): next
    member of the group, in a ring; shut (n,): targets left out.
    """

    u: np.ndarray
    v: np.ndarray
    pair: np.ndarray
    holder: np.ndarray
    group: np.ndarray
    ring: np.ndarray
    shut: np.ndarray


class Tree(NamedTuple):
    """Room for one search: of groups seen from a robot, or of robots seen from a group.

    label (max(q, n),): distance of what has been seen, inf on entry and on return; by_pair: pair over which it is reached;
    seen (q,), is_done (q,): what has a label, in the order found, and whether that is final; via (q,): robot before it;
    passed, at (q,): robots passed and their distances.
    """

    label: np.ndarray
    by_pair: np.ndarray
    seen: np.ndarray
    is_done: np.ndarray
    via: np.ndarray
    passed: np.ndarray
    at: np.ndarray


@kernel
def _tree(n_robot, n_target):
    n = max(n_robot, n_target)
    return Tree(
        np.full(n, np.inf), np.empty(n, np.int64), np.empty(n_robot, np.int64), np.empty(n_robot, np.bool_),
        np.empty(n_robot, np.int64), np.empty(n_robot, np.int64), np.empty(n_robot),
    )  # fmt: skip


@inlined_kernel
def _nearest(tree, n_seen, limit):
    """Place in `seen` of what is nearest, nearer than the limit, and not done; -1 if there is none."""
    where = -1
    for k in range(n_seen):
        if not tree.is_done[k] and tree.label[tree.seen[k]] < limit:
            limit, where = tree.label[tree.seen[k]], k
    return where


@inlined_kernel
def _search_groups(robot, pairs, now, tree):
    """Shortest alternating path from a free robot to a free group, or to a robot that goes idle.

    Returns
    -------
        Its length, its last robot and that one's new pair (or `IDLE`), and numbers of robots passed and groups seen.
    """
    n_seen = n_passed = 0
    best, end_robot, end_pair = np.inf, -1, IDLE
    r, distance = robot, 0.0
    while True:
        tree.passed[n_passed], tree.at[n_passed] = r, distance
        n_passed += 1
        if distance + pairs.idle_cost - now.u[r] < best:
            best, end_robot, end_pair = distance + pairs.idle_cost - now.u[r], r, IDLE
        for k in range(pairs.own_first[r], pairs.own_first[r + 1]):
            p = pairs.own_pair[k]
            d = distance + pairs.cost[p] - now.u[r]
            if d >= best or now.shut[pairs.target[p]]:
                continue
            g = now.group[pairs.target[p]]
            d -= now.v[g]
            if d >= tree.label[g] - ROUNDING or d >= best:
                continue
            if now.holder[g] < 0:
                best, end_robot, end_pair = d, r, p
                continue
            if tree.label[g] == np.inf:
                tree.seen[n_seen], tree.is_done[n_seen] = g, False
                n_seen += 1
            tree.label[g], tree.by_pair[g], tree.via[now.holder[g]] = d, p, r
        where = _nearest(tree, n_seen, best)
        if where < 0:
            return best, end_robot, end_pair, n_passed, n_seen
        tree.is_done[where] = True
        r, distance = now.holder[tree.seen[where]], tree.label[tree.seen[where]]


@inlined_kernel
def _assign(robot, pairs, now, tree):
    """Bring one free robot into the assignment by a shortest augmenting path."""
    best, r, new, n_passed, n_seen = _search_groups(robot, pairs, now, tree)
    for k in range(n_passed):
        now.u[tree.passed[k]] += best - tree.at[k]
    for k in range(n_seen):
        g = tree.seen[k]
        if tree.is_done[k]:
            now.v[g] -= best - tree.label[g]
        tree.label[g] = np.inf
    while True:
        old = now.pair[r]
        now.pair[r] = new
        if new >= 0:
            now.holder[now.group[pairs.target[new]]] = r
        if r == robot:
            return
        new = tree.by_pair[now.group[pairs.target[old]]]
        r = tree.via[r]


@inlined_kernel
def _see_robots(g, distance, best, n_seen, pairs, now, tree):
    """Label the robots that reach a group's targets; how many have been seen now."""
    t = g
    while True:
        for p in range(pairs.first[t], pairs.first[t + 1] if not now.shut[t] else pairs.first[t]):
            r = pairs.robot[p]
            d = distance + pairs.cost[p] - now.u[r] - now.v[g]
            if now.pair[r] != FREE and d < best and d < tree.label[r] - ROUNDING:
                if tree.label[r] == np.inf:
                    tree.seen[n_seen], tree.is_done[n_seen] = r, False
                    n_seen += 1
                tree.label[r], tree.by_pair[r] = d, p
        t = now.ring[t]
        if t == g:
            return n_seen


@inlined_kernel
def _search_robots(freed, pairs, now, tree):
    """Shortest alternating path from a group without a robot to an idle robot, or to a group that is left for nothing.

    Returns
    -------
        Its length, its last robot (-1: the group had best stay free), and number of robots seen.
    """
    n_seen = 0
    best, end_robot = -now.v[freed], -1
    g, distance = freed, 0.0
    while True:
        n_seen = _see_robots(g, distance, best, n_seen, pairs, now, tree)
        where = _nearest(tree, n_seen, best)
        if where < 0:
            return best, end_robot, n_seen
        tree.is_done[where] = True
        r, distance = tree.seen[where], tree.label[tree.seen[where]]
        if now.pair[r] == IDLE:
            return distance, r, n_seen
        g = now.group[pairs.target[now.pair[r]]]
        if distance - now.v[g] < best:
            best, end_robot = distance - now.v[g], r


@inlined_kernel
def _release(freed, pairs, now, tree):
    """Bring the dual of a group that has lost its robot back to 0, moving robots into it where that is cheaper."""
    best, r, n_seen = _search_robots(freed, pairs, now, tree)
    now.v[freed] += best
    for k in range(n_seen):
        q = tree.seen[k]
        if tree.is_done[k] and tree.label[q] < best:
            now.u[q] -= best - tree.label[q]
            if now.pair[q] >= 0:
                now.v[now.group[pairs.target[now.pair[q]]]] += best - tree.label[q]
        tree.label[q] = np.inf
    if r < 0:
        now.v[freed] = 0.0
        return
    if now.pair[r] >= 0:
        left = now.group[pairs.target[now.pair[r]]]
        now.holder[left] = -1
        now.v[left] = 0.0
    while True:
        now.pair[r] = tree.by_pair[r]
        g = now.group[pairs.target[tree.by_pair[r]]]
        r, now.holder[g] = now.holder[g], r
        if g == freed:
            return


@kernel
def _shut_out(t, is_near, pairs, now, tree):
    """Leave out one target, or (if `is_near`) all that are near it, and mend the assignment."""
    out = pairs.near[pairs.near_first[t] : pairs.near_first[t + 1]] if is_near else np.full(1, t, np.int32)
    freed_robot = np.empty(len(out), np.int64)
    freed_group = np.empty(len(out), np.int64)
    n = 0
    for x in out:
        if now.shut[x]:
            continue
        now.shut[x] = True
        r = now.holder[now.group[x]]
        if r >= 0 and pairs.target[now.pair[r]] == x:
            now.pair[r] = FREE
            now.u[r] = 0.0
            now.holder[now.group[x]] = -1
            freed_robot[n], freed_group[n] = r, now.group[x]
            n += 1
    for k in range(n):
        _release(freed_group[k], pairs, now, tree)
    for k in range(n):
        _assign(freed_robot[k], pairs, now, tree)


@inlined_kernel
def _held_near(r, pairs, now):
    """First target held too close to that of robot r, and how many are."""
    first, n = -1, 0
    if now.pair[r] >= 0:
        t = pairs.target[now.pair[r]]
        for k in range(pairs.near_first[t], pairs.near_first[t + 1]):
            q = now.holder[now.group[pairs.near[k]]]
            if q >= 0 and pairs.target[now.pair[q]] == pairs.near[k]:
                n += 1
                if first < 0:
                    first = pairs.near[k]
    return first, n


@inlined_kernel
def _is_clique(a, b, pairs, now):
    """Whether two groups are one clique."""
    s = a
    while True:
        t = b
        while True:
            dx, dy = pairs.xy[s, 0] - pairs.xy[t, 0], pairs.xy[s, 1] - pairs.xy[t, 1]
            if dx * dx + dy * dy >= pairs.separation * pairs.separation:
                return False
            t = now.ring[t]
            if t == b:
                break
        s = now.ring[s]
        if s == a:
            return True


@inlined_kernel
def _merge(a, b, now):
    """Make one group of two that have robots; gives the robot that is freed by it."""
    if now.v[b] < now.v[a]:
        a, b = b, a
    q = now.holder[b]
    now.holder[b] = -1
    now.v[b] = 0.0
    t = b
    while True:
        now.group[t] = a
        t = now.ring[t]
        if t == b:
            break
    now.ring[a], now.ring[b] = now.ring[b], now.ring[a]
    now.pair[q] = FREE
    now.u[q] = 0.0
    return q


@inlined_kernel
def _settle(pairs, now, tree):
    """Merge groups until no two held targets that could be of one clique are too close; the target to branch on, or -1."""
    while True:
        branch, most, has_merged = -1, 0, False
        for r in range(len(now.pair)):
            other, n = _held_near(r, pairs, now)
            if n == 0:
                continue
            a, b = now.group[pairs.target[now.pair[r]]], now.group[other]
            if _is_clique(a, b, pairs, now):
                _assign(_merge(a, b, now), pairs, now, tree)
                has_merged = True
            elif n > most:
                branch, most = pairs.target[now.pair[r]], n
        if not has_merged:
            return branch


@inlined_kernel
def _total(pairs, now):
    total = 0.0
    for p in now.pair:
        total += pairs.idle_cost if p < 0 else pairs.cost[p]
    return total


@kernel
def _copy(now):
    return Matched(
        now.u.copy(), now.v.copy(), now.pair.copy(), now.holder.copy(), now.group.copy(), now.ring.copy(), now.shut.copy()
    )


@kernel
def _relaxed(n_robot, n_target, pairs, tree):
    """The cheapest assignment, each target a group of its own."""
    now = Matched(
        np.full(n_robot, pairs.idle_cost), np.zeros(n_target), np.full(n_robot, IDLE, np.int64),
        np.full(n_target, -1, np.int64), np.arange(n_target), np.arange(n_target), np.zeros(n_target, np.bool_),
    )  # fmt: skip
    if n_target > n_robot:
        has_pair = np.flatnonzero(pairs.own_first[1:] > pairs.own_first[:-1])
        now.u[has_pair], now.pair[has_pair] = 0.0, FREE
        for r in has_pair:
            _assign(r, pairs, now, tree)
        return now
    # Robots are to spare: seen from a target, one that is idle is never far.
    for p in range(len(pairs.cost)):
        now.v[pairs.target[p]] = min(now.v[pairs.target[p]], pairs.cost[p] - pairs.idle_cost)
    for t in range(n_target):
        _release(t, pairs, now, tree)
    return now


@inlined_kernel
def _travel_cost(ax, ay, bx, by, half_power):
    """Distance^P; quick at the usual P = 4."""
    d2 = (ax - bx) ** 2 + (ay - by) ** 2
    return d2 * d2 if half_power == 2.0 else d2**half_power


@kernel
def _pairs_by_robot(n_robot, reach_robot):
    """Pairs of each robot: (first (n_robot + 1,), pair (n_pair,))."""
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
    return first, pair


@kernel
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
    own_first, own_pair = _pairs_by_robot(n_robot, reach_robot)
    pairs = Pairs(
        idle_cost, own_first, own_pair, reach_first, reach_robot, pair_target, cost, near_first, near, xy, separation
    )
    tree = _tree(n_robot, len(xy))
    waiting, waiting_bound = [_relaxed(n_robot, len(xy), pairs, tree)], [-np.inf]
    best, best_pair, n_node, open_bound = np.inf, np.full(n_robot, IDLE, np.int64), 0, np.inf
    while len(waiting) > 0:
        now = waiting.pop()
        if waiting_bound.pop() >= best - COST_TOLERANCE:
            continue
        while True:
            t = _settle(pairs, now, tree)
            bound = _total(pairs, now)
            if bound >= best - COST_TOLERANCE:
                break
            if t < 0:
                best, best_pair = bound, now.pair.copy()
                break
            if n_node >= max_nodes and best < np.inf:
                open_bound = min(open_bound, bound)
                break
            n_node += 1
            other = _copy(now)
            _shut_out(t, False, pairs, now, tree)
            _shut_out(t, True, pairs, other, tree)
            if _total(pairs, other) < _total(pairs, now):
                now, other = other, now
            waiting.append(other)
            waiting_bound.append(_total(pairs, other))
    return best_pair, min(best, open_bound), n_node


@kernel
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


@kernel
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
        cost[p] = _travel_cost(xy[t, 0], xy[t, 1], start_xy[r, 0], start_xy[r, 1], half_power)
        if park_pull > 0.0:
            cost[p] += park_pull * _travel_cost(xy[t, 0], xy[t, 1], park_xy[r, 0], park_xy[r, 1], half_power)
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
