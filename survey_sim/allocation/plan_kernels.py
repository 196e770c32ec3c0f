"""Kernels of the plan: which targets at which visit, all visits of a tile together.

An item is one wanted visit of one target; the items of a target are near each other (distance 0), so they go to different
visits. A visit holds items no two of which are near, each by a robot of its own: a partial colouring of the graph of near
items in which every colour must also be matched to robots. The search for most value is a tabu search on partial colourings
(Bloechliger & Zufferey 2008, Computers & Operations Research 35, 960), the matchings kept by augmenting paths.
"""

# ruff: noqa: PLR0912, PLR0915
# mypy: allow-untyped-defs

import numpy as np
from numba import njit

N_RANDOM = 8
N_TAIL = 4
NEVER = np.int64(1) << 40


@njit(cache=True)
def _random(state):
    """Next of a stream of random numbers, 0 to 2^31 (xorshift64*; Vigna 2016, ACM TOMS 42, 30)."""
    x = state[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    state[0] = x
    return np.int64((x * np.uint64(2685821657736338717)) >> np.uint64(33))


@njit(cache=True)
def make_items(copies, near_first, near):
    """Items of targets: (target (n_item,), near_first (n_item + 1,), near (n_near,)); `copies` (n_target,) items of each."""
    n_target = len(copies)
    begin = np.zeros(n_target + 1, np.int64)
    for t in range(n_target):
        begin[t + 1] = begin[t] + copies[t]
    n_item = begin[n_target]
    target = np.empty(n_item, np.int64)
    first = np.zeros(n_item + 1, np.int64)
    for t in range(n_target):
        n = max(0, copies[t] - 1)
        for k in range(near_first[t], near_first[t + 1]):
            n += copies[near[k]]
        for i in range(begin[t], begin[t + 1]):
            target[i] = t
            first[i + 1] = first[i] + n
    item_near = np.empty(first[n_item], np.int32)
    for i in range(n_item):
        t, m = target[i], first[i]
        for j in range(begin[t], begin[t + 1]):
            if j != i:
                item_near[m] = j
                m += 1
        for k in range(near_first[t], near_first[t + 1]):
            for j in range(begin[near[k]], begin[near[k] + 1]):
                item_near[m] = j
                m += 1
    return target, first, item_near


@njit(cache=True)
def _remove(i, value, first, near, weight, visit_of, robot_of, slot, load):
    """Take an item out of its visit."""
    v = visit_of[i]
    slot[v, robot_of[i]] = -1
    visit_of[i] = -1
    robot_of[i] = -1
    load[v] -= 1
    for k in range(first[i], first[i + 1]):
        weight[near[k], v] -= value[i]


@njit(cache=True)
def _insert(
    i, v, value, first, near, target, reach_first, reach_robot, is_pair_open, weight, visit_of, robot_of, slot, load,
    must_swap, random, queue, parent, is_seen,
):  # fmt: skip
    """Bring an item into a visit by an augmenting path.

    Returns
    -------
        -1 if a free robot was found; the item put out to make room (the least valuable in the way); -2 if none can be.
    """
    is_seen[:] = False
    queue[0] = i
    n_queue, at, end = 1, 0, -1
    least, out = value[i], -1
    shift = random
    while at < n_queue and end < 0:
        x = queue[at]
        at += 1
        t = target[x]
        a, n = reach_first[t], reach_first[t + 1] - reach_first[t]
        for k in range(n):
            p = a + (k + shift) % n
            r = reach_robot[p]
            if is_seen[r] or not is_pair_open[p]:
                continue
            is_seen[r] = True
            parent[r] = x
            y = slot[v, r]
            if y < 0:
                if must_swap:
                    continue
                end = r
                break
            queue[n_queue] = y
            n_queue += 1
            if value[y] <= least:
                least, out = value[y], y
    gone = -1
    if end < 0:
        if out < 0:
            return -2
        end, gone = robot_of[out], out
        _remove(out, value, first, near, weight, visit_of, robot_of, slot, load)
    r = end
    while True:
        x = parent[r]
        before = robot_of[x]
        slot[v, r] = x
        robot_of[x] = r
        if x == i:
            break
        r = before
    visit_of[i] = v
    load[v] += 1
    for k in range(first[i], first[i + 1]):
        weight[near[k], v] += value[i]
    return gone


@njit(cache=True)
def cover(
    n_step, goal, value, first, near, target, reach_first, reach_robot, is_pair_open, is_shut,
    capacity, visit_of, n_robot, state,
):  # fmt: skip
    """Most value of items in all visits together, by tabu search from the assignment given.

    Parameters
    ----------
    n_step
        Moves after the last improvement before the search ends.
    goal
        Value at which it ends at once.
    value, first, near, target
        (n_item,) whole-number worth; lists of near items; target of each item.
    reach_first, reach_robot, is_pair_open
        Robots that reach each target; (n_pair,) pairs that may be used.
    is_shut
        (n_target, n_visit) targets that a visit cannot take.
    capacity
        (n_visit,) most items of each visit.
    visit_of
        (n_item,) the visit of each item or -1, as far as it can be kept; changed to the best found.
    n_robot, state
        Number of robots; (1,) uint64 state of the random stream, not 0.

    Returns
    -------
        Value of the best assignment.
    """
    n_item, n_visit = len(value), len(capacity)
    slot = np.full((n_visit, n_robot), -1, np.int64)
    load = np.zeros(n_visit, np.int64)
    weight = np.zeros((n_item, n_visit), np.int64)
    tabu = np.zeros((n_item, n_visit), np.int64)
    waiting = np.empty(n_item, np.int64)
    queue, parent = np.empty(n_robot + 1, np.int64), np.empty(n_robot, np.int64)
    is_seen = np.empty(n_robot, np.bool_)
    n_waiting = 0
    total = np.int64(0)
    for i in range(n_item):
        for v in range(n_visit):
            if is_shut[target[i], v] or capacity[v] == 0:
                weight[i, v] = NEVER
    wish = visit_of.copy()
    visit_of[:] = -1
    robot_of = np.full(n_item, -1, np.int64)
    for i in range(n_item):
        v = wish[i]
        if v >= 0 and weight[i, v] == 0 and load[v] < capacity[v]:
            gone = _insert(
                i, v, value, first, near, target, reach_first, reach_robot, is_pair_open, weight, visit_of, robot_of,
                slot, load, False, 0, queue, parent, is_seen,
            )  # fmt: skip
            if gone != -2:
                total += value[i]
            if gone >= 0:
                total -= value[gone]
    for i in range(n_item):
        if visit_of[i] < 0 and reach_first[target[i] + 1] > reach_first[target[i]]:
            waiting[n_waiting] = i
            n_waiting += 1
    best, best_visit = total, visit_of.copy()
    step, last = 0, 0
    least = np.zeros(n_visit, np.int64)
    while n_waiting > 0 and best < goal and step - last < n_step:
        step += 1
        for v in range(n_visit):
            least[v] = 0
            if load[v] >= capacity[v]:
                least[v] = NEVER
                for r in range(n_robot):
                    if slot[v, r] >= 0:
                        least[v] = min(least[v], value[slot[v, r]])
        gain, n_tie, place, visit = -NEVER, 0, -1, -1
        for k in range(n_waiting):
            i = waiting[k]
            for v in range(n_visit):
                w = weight[i, v]
                d = value[i] - (w if w > 0 else least[v])
                if d < gain:
                    continue
                if tabu[i, v] > step and total + d <= best:
                    continue
                if d > gain:
                    gain, n_tie, place, visit = d, 1, k, v
                else:
                    n_tie += 1
                    if _random(state) % n_tie == 0:
                        place, visit = k, v
        if place < 0 or gain < -NEVER // 2:
            continue
        i, v = waiting[place], visit
        n_waiting -= 1
        waiting[place] = waiting[n_waiting]
        if weight[i, v] > 0:
            for k in range(first[i], first[i + 1]):
                j = near[k]
                if visit_of[j] == v:
                    _remove(j, value, first, near, weight, visit_of, robot_of, slot, load)
                    total -= value[j]
                    tabu[j, v] = step + 8 + _random(state) % 10
                    waiting[n_waiting] = j
                    n_waiting += 1
        gone = _insert(
            i, v, value, first, near, target, reach_first, reach_robot, is_pair_open, weight, visit_of, robot_of, slot, load,
            load[v] >= capacity[v], _random(state), queue, parent, is_seen,
        )  # fmt: skip
        if gone == -2:
            waiting[n_waiting] = i
            n_waiting += 1
            tabu[i, v] = step + 50
        else:
            total += value[i]
            if gone >= 0:
                total -= value[gone]
                tabu[gone, v] = step + 8 + _random(state) % 10
                waiting[n_waiting] = gone
                n_waiting += 1
        if total > best:
            best, last = total, step
            best_visit[:] = visit_of
    visit_of[:] = best_visit
    return best


@njit(cache=True)
def sample_within(xy, radius, n_wanted, state):
    """For each point, points drawn from those within a radius: (n, n_wanted) indices, -1 where there are fewer."""
    n = len(xy)
    drawn = np.full((n, n_wanted), -1, np.int32)
    order = np.argsort(xy[:, 0])
    begin = 0
    for a in range(n):
        i = order[a]
        while xy[order[begin], 0] < xy[i, 0] - radius:
            begin += 1
        m = 0
        for b in range(begin, n):
            j = order[b]
            if xy[j, 0] > xy[i, 0] + radius:
                break
            if j == i or (xy[j, 0] - xy[i, 0]) ** 2 + (xy[j, 1] - xy[i, 1]) ** 2 > radius * radius:
                continue
            k = m if m < n_wanted else _random(state) % (m + 1)
            if k < n_wanted:
                drawn[i, k] = j
            m += 1
    return drawn


@njit(cache=True)
def _way_cost(r, slot, xy, start_xy, half_power):
    """Sum of travel^P of one robot through all visits; where it holds nothing it stays."""
    cost = 0.0
    x, y = start_xy[r, 0], start_xy[r, 1]
    for v in range(slot.shape[0]):
        i = slot[v, r]
        if i >= 0:
            d2 = (xy[i, 0] - x) ** 2 + (xy[i, 1] - y) ** 2
            cost += d2 * d2 if half_power == 2.0 else d2**half_power
            x, y = xy[i, 0], xy[i, 1]
    return cost


@njit(cache=True)
def _swap_tails(r, s, v, slot):
    """Exchange all that two robots hold from visit v on."""
    for w in range(v, slot.shape[0]):
        slot[w, r], slot[w, s] = slot[w, s], slot[w, r]


@njit(cache=True)
def _can_swap_tails(r, s, v, slot, target, is_in_reach):
    for w in range(v, slot.shape[0]):
        if slot[w, r] >= 0 and not is_in_reach[s, target[slot[w, r]]]:
            return False
        if slot[w, s] >= 0 and not is_in_reach[r, target[slot[w, s]]]:
            return False
    return True


@njit(cache=True)
def _count_near(i, v, by, first, near, n_near):
    for k in range(first[i], first[i + 1]):
        n_near[near[k], v] += by


@njit(cache=True)
def shorten(
    n_sweep, hot, cold, half_power, start_xy, xy, separation, value, delay, first, near, target,
    reach_first, reach_robot, is_pair_open, is_shut, capacity, candidates, slot, visit_of, robot_of, state,
):  # fmt: skip
    """Exchange items between visits and robots while that shortens the robots' ways through all visits.

    An item changes places with one near it (in any visit, with any robot, or waiting and worth as much), or goes to
    another visit of its robot or another robot of its visit that holds nothing there.
    """
    n_visit, n_robot = slot.shape
    n_item = len(xy)
    n_near = np.zeros((n_item, n_visit), np.int32)
    load = np.zeros(n_visit, np.int64)
    for i in range(n_item):
        for v in range(n_visit):
            if is_shut[target[i], v]:
                n_near[i, v] += 1 << 20
        if visit_of[i] >= 0:
            _count_near(i, visit_of[i], 1, first, near, n_near)
            load[visit_of[i]] += 1
    is_in_reach = np.zeros((n_robot, len(reach_first) - 1), np.bool_)
    for t in range(len(reach_first) - 1):
        for p in range(reach_first[t], reach_first[t + 1]):
            is_in_reach[reach_robot[p], t] = is_pair_open[p]
    way = np.empty(n_robot)
    for r in range(n_robot):
        way[r] = _way_cost(r, slot, xy, start_xy, half_power)
    changed = np.zeros(n_robot, np.int64)
    n_moves = 0
    for sweep in range(1, n_sweep + 100):
        has_changed = False
        heat = 0.0
        if sweep <= n_sweep:
            heat = hot * (cold / hot) ** ((sweep - 1.0) / max(1.0, n_sweep - 1.0))
        for a in range(n_item):
            if visit_of[a] < 0 or (heat == 0.0 and sweep > n_sweep + 1 and changed[robot_of[a]] < sweep - 1):
                continue
            n_reach = reach_first[target[a] + 1] - reach_first[target[a]]
            n_tries = N_RANDOM if heat > 0.0 else n_reach * n_visit
            for c in range(candidates.shape[1] + n_visit + n_tries):
                v, r = visit_of[a], robot_of[a]
                if c < candidates.shape[1]:
                    b = candidates[a, c]
                    if b < 0:
                        continue
                    w, s = visit_of[b], robot_of[b]
                    if w < 0 and value[b] < value[a]:
                        continue
                elif c < candidates.shape[1] + n_visit:
                    w, s = c - candidates.shape[1], r
                    b = slot[w, s]
                    if w == v:
                        continue
                else:
                    t = target[a]
                    k = c - candidates.shape[1] - n_visit
                    if heat > 0.0:
                        k = _random(state) % (n_reach * n_visit)
                    s = reach_robot[reach_first[t] + k // n_visit]
                    w = k % n_visit
                    b = slot[w, s]
                    if b == a or (b < 0 and s == r):
                        continue
                if w != v:
                    if b < 0 and load[w] >= capacity[w]:
                        continue
                    close = 0
                    if b >= 0 and (xy[a, 0] - xy[b, 0]) ** 2 + (xy[a, 1] - xy[b, 1]) ** 2 < separation * separation:
                        close = 1
                    if w >= 0 and n_near[a, w] - close > 0:
                        continue
                    if b >= 0 and n_near[b, v] - close > 0:
                        continue
                if s != r:
                    if s >= 0 and not is_in_reach[s, target[a]]:
                        continue
                    if b >= 0 and not is_in_reach[r, target[b]]:
                        continue
                slot[v, r] = b
                if w >= 0:
                    slot[w, s] = a
                new_r = _way_cost(r, slot, xy, start_xy, half_power)
                gain = way[r] - new_r
                new_s = 0.0
                if s >= 0 and s != r:
                    new_s = _way_cost(s, slot, xy, start_xy, half_power)
                    gain += way[s] - new_s
                if w >= 0:
                    gain += (v - w) * (delay[a] - (delay[b] if b >= 0 else 0.0))
                if heat > 0.0 and gain < 0.0:
                    gain += heat * (_random(state) / 2147483648.0)
                if gain <= 1e-9 * way[r]:
                    slot[v, r] = a
                    if w >= 0:
                        slot[w, s] = b
                    continue
                way[r] = new_r
                changed[r] = sweep
                if s >= 0 and s != r:
                    way[s] = new_s
                    changed[s] = sweep
                if w != v:
                    _count_near(a, v, -1, first, near, n_near)
                    if w >= 0:
                        _count_near(a, w, 1, first, near, n_near)
                    if b < 0:
                        load[v] -= 1
                        load[w] += 1
                    else:
                        _count_near(b, v, 1, first, near, n_near)
                        if w >= 0:
                            _count_near(b, w, -1, first, near, n_near)
                visit_of[a], robot_of[a] = w, s
                if b >= 0:
                    visit_of[b], robot_of[b] = v, r
                has_changed = True
                n_moves += 1
                if w < 0:
                    break
            v, r, t = visit_of[a], robot_of[a], target[a]
            if v < 0:
                continue
            n_reach = reach_first[t + 1] - reach_first[t]
            for k in range(n_reach if heat == 0.0 else N_TAIL):
                s = reach_robot[reach_first[t] + (k if heat == 0.0 else _random(state) % n_reach)]
                r = robot_of[a]
                if s == r or not _can_swap_tails(r, s, v, slot, target, is_in_reach):
                    continue
                _swap_tails(r, s, v, slot)
                new_r = _way_cost(r, slot, xy, start_xy, half_power)
                new_s = _way_cost(s, slot, xy, start_xy, half_power)
                gain = way[r] + way[s] - new_r - new_s
                if heat > 0.0 and gain < 0.0:
                    gain += heat * (_random(state) / 2147483648.0)
                if gain <= 1e-9 * way[r]:
                    _swap_tails(r, s, v, slot)
                    continue
                for w in range(v, n_visit):
                    if slot[w, r] >= 0:
                        robot_of[slot[w, r]] = r
                    if slot[w, s] >= 0:
                        robot_of[slot[w, s]] = s
                way[r], way[s] = new_r, new_s
                changed[r] = changed[s] = sweep
                has_changed = True
                n_moves += 1
        if heat == 0.0 and not has_changed:
            break
    return n_moves
