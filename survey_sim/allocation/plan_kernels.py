"""Kernels of the plan: which targets at which visit, all visits of a tile together.

An item is one wanted visit of one target; the items of a target are near each other (distance 0), so they go to different
visits. A visit holds items no two of which are near, each by a robot of its own: a partial colouring of the graph of near
items in which every colour must also be matched to robots. The search for most value is a tabu search on partial colourings
(Bloechliger & Zufferey 2008, Computers & Operations Research 35, 960), the matchings kept by augmenting paths.
"""

# ruff: noqa: PLR0917
# mypy: allow-untyped-defs

import numpy as np
from numba import njit

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
def _insert(i, v, value, first, near, target, reach_first, reach_robot, is_pair_open, weight, visit_of, robot_of, slot, load,
            must_swap, random, queue, parent, is_seen):  # fmt: skip
    """Bring an item into a visit by an augmenting path.

    Returns
    -------
        -1 if a free robot was found; the item put out to make room (the least valuable in the way); -2 if none can be.
    """
    n_robot = slot.shape[1]
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
def cover(n_step, goal, value, first, near, target, reach_first, reach_robot, is_pair_open, is_shut, capacity, visit_of, robot_of,
          n_robot, state):  # fmt: skip
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
    visit_of, robot_of
        (n_item,) the assignment or -1; changed to the best found.
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
    for i in range(n_item):
        v = visit_of[i]
        if v >= 0:
            slot[v, robot_of[i]] = i
            load[v] += 1
            total += value[i]
            for k in range(first[i], first[i + 1]):
                weight[near[k], v] += value[i]
        elif reach_first[target[i] + 1] > reach_first[target[i]]:
            waiting[n_waiting] = i
            n_waiting += 1
    best, best_visit, best_robot = total, visit_of.copy(), robot_of.copy()
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
            best_robot[:] = robot_of
    visit_of[:] = best_visit
    robot_of[:] = best_robot
    return best
