"""Kernels of the plan: which targets at which visit, all visits of a tile together.

An item is one wanted visit of one target; the items of a target are near each other (distance 0), so they go to different
visits. A visit holds items no two of which are near, each by a robot of its own: a partial colouring of the graph of near
items in which every colour must also be matched to robots. The search for most value is a tabu search on partial colourings
(Bloechliger & Zufferey 2008, Computers & Operations Research 35, 960), the matchings kept by augmenting paths.
"""

# ruff: noqa: PLR0912, PLR0915
# mypy: allow-untyped-defs

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# Exchanges with a random place, and of tails, that an item tries in a sweep with heat; most sweeps without.
N_RANDOM = 8
N_TAIL = 4
MAX_COLD_SWEEPS = 50
RANDOM_RANGE = 2.0**31
# Worth of items that shut a visit for good.
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


class Cover(NamedTuple):
    """What a search for most value reads, and where it stands; n items, m visits, q robots.

    value, first, near, target, reach_first, reach_robot, is_pair_open: as in `cover`; weight: (n, m) worth of the items in
    each visit that are near an item, `NEVER` where it is shut; visit_of, robot_of: (n,) -1 while an item waits; slot: (m, q)
    item of each robot or -1; load: (m,) items; queue, parent, is_seen: of the augmenting paths. Best moves are looked up
    again only where something changed: gain, n_tie: (n,) most that a waiting item brings, and visits that bring as much;
    again: (n,) step from which that is no longer known.
    """

    value: IntArray
    first: IntArray
    near: npt.NDArray[np.int32]
    target: IntArray
    reach_first: IntArray
    reach_robot: npt.NDArray[np.int32]
    is_pair_open: BoolArray
    weight: IntArray
    visit_of: IntArray
    robot_of: IntArray
    slot: IntArray
    load: IntArray
    queue: IntArray
    parent: IntArray
    is_seen: BoolArray
    gain: IntArray
    n_tie: IntArray
    again: IntArray


class Course(NamedTuple):
    """Where a search may not go yet, and what a full visit costs.

    tabu: (n, m) step until which an item does not return to a visit unless that gives the best of all; closed: (n, m) step
    until which a visit is closed to an item whatever it promises (robots in reach are held, which the gain leaves out);
    least: (m,) worth of the least item in a full visit, 0 in others; waiting: (n,) items without a visit, the first so many.
    """

    tabu: IntArray
    closed: IntArray
    least: IntArray
    waiting: IntArray


@njit(cache=True)
def _weigh(s, i, v, worth):
    """Count the worth of item i, now in visit v or (negative) out of it, for all that are near it."""
    for k in range(s.first[i], s.first[i + 1]):
        s.weight[s.near[k], v] += worth
        s.again[s.near[k]] = 0


@njit(cache=True)
def _remove(s, i):
    """Take an item out of its visit."""
    v = s.visit_of[i]
    s.slot[v, s.robot_of[i]] = -1
    s.visit_of[i] = -1
    s.robot_of[i] = -1
    s.load[v] -= 1
    s.again[i] = 0
    _weigh(s, i, v, -s.value[i])


@njit(cache=True)
def _insert(s, i, v, least, random):
    """Bring an item into a visit by an augmenting path.

    Returns
    -------
        -1 if a free robot was found; else the item put out to make room: the least valuable in the way, if it is worth no
        more than `least`; -2 if there is none.
    """
    s.is_seen[:] = False
    s.queue[0] = i
    n_queue, at, end = 1, 0, -1
    out = -1
    while at < n_queue and end < 0:
        x = s.queue[at]
        at += 1
        begin, n = s.reach_first[s.target[x]], s.reach_first[s.target[x] + 1] - s.reach_first[s.target[x]]
        shift = random % n if n else 0
        for k in range(shift, shift + n):
            p = begin + (k if k < n else k - n)
            r = s.reach_robot[p]
            if s.is_seen[r] or not s.is_pair_open[p]:
                continue
            s.is_seen[r] = True
            s.parent[r] = x
            y = s.slot[v, r]
            if y < 0:
                end = r
                break
            s.queue[n_queue] = y
            n_queue += 1
            if s.value[y] <= least:
                least, out = s.value[y], y
    gone = -1
    if end < 0:
        if out < 0:
            return -2
        end, gone = s.robot_of[out], out
        _remove(s, out)
    r = end
    while True:
        x = s.parent[r]
        before = s.robot_of[x]
        s.slot[v, r] = x
        s.robot_of[x] = r
        if x == i:
            break
        r = before
    s.visit_of[i] = v
    s.load[v] += 1
    _weigh(s, i, v, s.value[i])
    return gone


@njit(cache=True)
def _one_of_least(s, i, v, state):
    """One of the least valuable items in a visit, i excepted, at random."""
    n, least = 0, NEVER
    for r in range(s.slot.shape[1]):
        j = s.slot[v, r]
        if j >= 0 and j != i and s.value[j] <= least:
            n = n + 1 if s.value[j] == least else 1
            least = s.value[j]
    left = _random(state) % n
    r = -1
    while left >= 0:
        r += 1
        j = s.slot[v, r]
        left -= j >= 0 and j != i and s.value[j] == least
    return s.slot[v, r]


@njit(cache=True)
def _fill_up(s, wish, capacity, state):
    """Keep what can be kept of the visits wished for, then put the most valuable and crowded items in the emptiest visits.

    Gives the value of all.
    """
    n_item, n_visit = s.weight.shape
    total = np.int64(0)
    tried = np.empty(n_visit, np.bool_)
    order = np.argsort(-(s.value * n_item + (s.first[1:] - s.first[:-1])), kind="mergesort")
    for is_new in range(2):
        for i in order:
            if s.visit_of[i] >= 0 or (not is_new and wish[i] < 0):
                continue
            tried[:] = False
            while True:
                v = -1 if is_new else wish[i]
                for u in range(n_visit if is_new else 0):
                    if not tried[u] and s.weight[i, u] == 0 and s.load[u] < capacity[u]:
                        v = u if v < 0 or s.load[u] < s.load[v] else v
                if v < 0 or tried[v] or s.weight[i, v] > 0 or s.load[v] >= capacity[v]:
                    break
                tried[v] = True
                if _insert(s, i, v, -1, _random(state)) == -1:
                    total += s.value[i]
                    break
    return total


@njit(cache=True)
def _promise(worth, weight, least, tabu, closed, step, to_beat):
    """What an item brings in a visit, `-NEVER` if it may not go there, and the step until which that holds."""
    if weight >= NEVER:
        return -NEVER, NEVER
    if closed > step:
        return -NEVER, closed
    d = worth - (weight if weight > 0 else least)
    if tabu <= step:
        return d, NEVER
    if d <= 0:  # brings no best of all
        return -NEVER, tabu
    return (d if d > to_beat else -NEVER), step + 1


@njit(cache=True)
def _best_move(
    waiting, n_waiting, value, weight, least, tabu, closed, step, to_beat, gain, n_tie, again, state
):  # fmt: skip
    """Place in `waiting` and visit of a move that brings most, one of all such at random; (-1, -1) if there is none.

    What each item brings is looked up where it is not known: `gain`, `n_tie`, `again` as in `Cover`.
    """
    n_visit = len(least)
    most, n_most = -NEVER, 0
    for k in range(n_waiting):
        i = waiting[k]
        if again[i] <= step:
            best, n, known = -NEVER, 0, NEVER
            for v in range(n_visit):
                d, until = _promise(value[i], weight[i, v], least[v], tabu[i, v], closed[i, v], step, to_beat)
                known = min(known, until)
                if d > best:
                    best, n = d, 1
                elif d == best and d > -NEVER:
                    n += 1
            gain[i], n_tie[i], again[i] = best, n, known
        if gain[i] > most:
            most, n_most = gain[i], n_tie[i]
        elif gain[i] == most:
            n_most += n_tie[i]
    if most < -NEVER // 2:
        return -1, -1
    left = _random(state) % n_most
    k = 0
    while gain[waiting[k]] < most or left >= n_tie[waiting[k]]:
        left -= n_tie[waiting[k]] if gain[waiting[k]] == most else 0
        k += 1
    i, v = waiting[k], -1
    while left >= 0:
        v += 1
        d, _ = _promise(value[i], weight[i, v], least[v], tabu[i, v], closed[i, v], step, to_beat)
        left -= d == most
    return k, v


@njit(cache=True)
def _set_least(s, c, v, is_full, n_waiting):
    """Note the least item in a full visit, and which items that alters the promise of."""
    least = np.int64(0)
    if is_full:
        least = NEVER
        for r in range(s.slot.shape[1]):
            if s.slot[v, r] >= 0:
                least = min(least, s.value[s.slot[v, r]])
    if least != c.least[v]:
        c.least[v] = least
        for k in range(n_waiting):
            if s.weight[c.waiting[k], v] == 0:
                s.again[c.waiting[k]] = 0


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
    wish = visit_of.copy()
    visit_of[:] = -1
    s = Cover(
        value, first, near, target, reach_first, reach_robot, is_pair_open,
        np.zeros((n_item, n_visit), np.int64), visit_of, np.full(n_item, -1, np.int64),
        np.full((n_visit, n_robot), -1, np.int64), np.zeros(n_visit, np.int64),
        np.empty(n_robot + 1, np.int64), np.empty(n_robot, np.int64), np.empty(n_robot, np.bool_),
        np.zeros(n_item, np.int64), np.zeros(n_item, np.int64), np.zeros(n_item, np.int64),
    )  # fmt: skip
    c = Course(
        np.zeros((n_item, n_visit), np.int64), np.zeros((n_item, n_visit), np.int64),
        np.zeros(n_visit, np.int64), np.empty(n_item, np.int64),
    )  # fmt: skip
    for i in range(n_item):
        for v in range(n_visit):
            if is_shut[target[i], v] or capacity[v] == 0:
                s.weight[i, v] = NEVER
    total = _fill_up(s, wish, capacity, state)
    n_waiting = 0
    for i in range(n_item):
        if visit_of[i] < 0 and value[i] > 0 and reach_first[target[i] + 1] > reach_first[target[i]]:
            c.waiting[n_waiting] = i
            n_waiting += 1
    for v in range(n_visit):
        _set_least(s, c, v, s.load[v] >= capacity[v], n_waiting)
    best, best_visit = total, visit_of.copy()
    step, last = 0, 0
    while n_waiting > 0 and best < goal and step - last < n_step:
        step += 1
        place, v = _best_move(
            c.waiting, n_waiting, value, s.weight, c.least, c.tabu, c.closed, step, best - total,
            s.gain, s.n_tie, s.again, state,
        )  # fmt: skip
        if place < 0:
            continue
        i = c.waiting[place]
        n_waiting -= 1
        c.waiting[place] = c.waiting[n_waiting]
        if s.weight[i, v] > 0:
            for k in range(first[i], first[i + 1]):
                j = near[k]
                if visit_of[j] == v:
                    _remove(s, j)
                    total -= value[j]
                    c.tabu[j, v] = step + 8 + _random(state) % 10
                    c.waiting[n_waiting] = j
                    n_waiting += 1
        is_full = s.load[v] >= capacity[v]
        gone = _insert(s, i, v, value[i], _random(state))
        if gone == -1 and is_full:
            gone = _one_of_least(s, i, v, state)
            _remove(s, gone)
        if gone == -2:
            c.waiting[n_waiting] = i
            n_waiting += 1
            c.closed[i, v] = step + 50
            s.again[i] = 0
        else:
            total += value[i]
            if gone >= 0:
                total -= value[gone]
                c.tabu[gone, v] = step + 8 + _random(state) % 10
                if not is_full:
                    c.closed[gone, v] = c.tabu[gone, v]
                c.waiting[n_waiting] = gone
                n_waiting += 1
        _set_least(s, c, v, s.load[v] >= capacity[v], n_waiting)
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
def _chain(r, slot, before, after):
    """Note for each visit the item that a robot holds before and after it; before the first, its start (n_item + robot)."""
    n_visit = len(slot)
    last = before[0, r]
    for v in range(n_visit):
        before[v, r] = last
        if slot[v, r] >= 0:
            last = slot[v, r]
    last = -1
    for v in range(n_visit - 1, -1, -1):
        after[v, r] = last
        if slot[v, r] >= 0:
            last = slot[v, r]


@njit(cache=True)
def _move(i, j, xy, half_power):
    """Cost of the move between two items; none if there is no second."""
    if j < 0:
        return 0.0
    dx, dy = xy[i, 0] - xy[j, 0], xy[i, 1] - xy[j, 1]
    d2 = dx * dx + dy * dy
    return d2 * d2 if half_power == 2.0 else d2**half_power


@njit(cache=True)
def _pull(i, r, xy, park_xy, half_power, park_pull):
    """Cost of item i's distance from the park of robot r; none if there is no item."""
    if i < 0 or park_pull == 0.0:
        return 0.0
    dx, dy = xy[i, 0] - park_xy[r, 0], xy[i, 1] - park_xy[r, 1]
    d2 = dx * dx + dy * dy
    return park_pull * (d2 * d2 if half_power == 2.0 else d2**half_power)


@njit(cache=True)
def _tail_pull(r, s, v, slot, xy, park_xy, half_power, park_pull):
    """What is gained in distance from park if two robots exchange all that they hold from visit v on."""
    gain = 0.0
    for w in range(v, slot.shape[0]):
        i, j = slot[w, r], slot[w, s]
        gain += _pull(i, r, xy, park_xy, half_power, park_pull) - _pull(i, s, xy, park_xy, half_power, park_pull)
        gain += _pull(j, s, xy, park_xy, half_power, park_pull) - _pull(j, r, xy, park_xy, half_power, park_pull)
    return gain


@njit(cache=True)
def _links(i, before, after, xy, half_power):
    """Cost of a robot's moves to and from item i, or of the one past it if it holds nothing (-1)."""
    if i < 0:
        return _move(before, after, xy, half_power)
    return _move(before, i, xy, half_power) + _move(i, after, xy, half_power)


@njit(cache=True)
def _own_gain(r, v, w, slot, before, xy, half_power):
    """How much shorter a robot's way is if it changes what it holds in two visits."""
    gain = 0.0
    for sign in (1.0, -1.0):
        last = before[0, r]
        for u in range(slot.shape[0]):
            if slot[u, r] >= 0:
                gain += sign * _move(last, slot[u, r], xy, half_power)
                last = slot[u, r]
        slot[v, r], slot[w, r] = slot[w, r], slot[v, r]
    return gain


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
    """Count item i in visit v (-1 = none) for all items near it."""
    if v >= 0:
        for k in range(first[i], first[i + 1]):
            n_near[near[k], v] += by


@njit(cache=True)
def shorten(
    n_sweep, hot, cold, half_power, park_pull, start_xy, park_xy, xy, separation, value, kin, delay, first, near, target,
    reach_first, reach_robot, is_pair_open, is_shut, capacity, candidates, slot, visit_of, robot_of, state,
):  # fmt: skip
    """Exchange items between visits and robots while that makes the robots' ways through all visits cheaper.

    An item changes places with one of its candidates (which may be waiting, if it is of its kin and worth as much), or with
    what a robot holds in some visit, be it nothing; or two robots exchange all that they hold from some visit on. Sweeps
    over all items take losses up to a random part of a heat that falls from hot to cold; then sweeps without heat go on
    until nothing is gained.

    Parameters
    ----------
    n_sweep, hot, cold
        Sweeps with heat; the first and the last heat, mm^P.
    half_power, park_pull
        P / 2; weight of the distance from a robot's park to what it holds, beside that of its way.
    start_xy, park_xy, xy, separation
        (n_robot, 2) where the robots start, and their parks, and (n_item, 2) the items, mm; mm.
    value, kin, delay
        (n_item,) worth; a waiting item may replace one of the same kin (not -1); what each visit later costs, mm^P.
    first, near, target, reach_first, reach_robot, is_pair_open, is_shut, capacity
        As in `cover`.
    candidates
        (n_item, n_candidate) items to exchange with, or -1.
    slot, visit_of, robot_of
        (n_visit, n_robot) item held, (n_item,) visit and robot, -1 for none; changed.
    state
        (1,) state of the random stream.
    """
    n_visit, n_robot = slot.shape
    n_item, n_candidate = candidates.shape
    n_near = np.zeros((n_item, n_visit), np.int32)
    load = np.zeros(n_visit, np.int64)
    for i in range(n_item):
        for v in range(n_visit):
            if is_shut[target[i], v]:
                n_near[i, v] += 1 << 20
        _count_near(i, visit_of[i], 1, first, near, n_near)
        if visit_of[i] >= 0:
            load[visit_of[i]] += 1
    is_in_reach = np.zeros((n_robot, len(reach_first) - 1), np.bool_)
    for t in range(len(reach_first) - 1):
        for p in range(reach_first[t], reach_first[t + 1]):
            is_in_reach[reach_robot[p], t] = is_pair_open[p]
    xy = np.concatenate((xy, start_xy))
    before, after = np.empty((n_visit, n_robot), np.int64), np.empty((n_visit, n_robot), np.int64)
    for r in range(n_robot if n_visit else 0):
        before[0, r] = n_item + r
        _chain(r, slot, before, after)
    changed = np.zeros(n_robot, np.int64)
    least = 1e-9 * hot
    for sweep in range(1, n_sweep + MAX_COLD_SWEEPS):
        has_changed = False
        heat = hot * (cold / hot) ** ((sweep - 1.0) / max(1.0, n_sweep - 1.0)) if sweep <= n_sweep else 0.0
        for a in range(n_item):
            if visit_of[a] < 0 or (sweep > n_sweep + 1 and changed[robot_of[a]] < sweep - 1):
                continue
            begin = reach_first[target[a]]
            n_reach = reach_first[target[a] + 1] - begin
            n_place = n_reach * n_visit
            n_tries = n_candidate + n_visit + (N_RANDOM if heat > 0.0 else n_place)
            for c in range(n_tries):
                v, r = visit_of[a], robot_of[a]
                if c < n_candidate:
                    b = candidates[a, c]
                    if b < 0:
                        continue
                    w, s = visit_of[b], robot_of[b]
                    if w < 0 and (value[b] < value[a] or kin[a] != kin[b] or kin[a] < 0):
                        continue
                else:
                    k = c - n_candidate
                    if k < n_visit:
                        w, s = k, r
                    else:
                        k = _random(state) % n_place if heat > 0.0 else k - n_visit
                        w, s = k % n_visit, reach_robot[begin + k // n_visit]
                    b = slot[w, s]
                if b == a or (v == w and r == s):
                    continue
                if w != v:
                    if b < 0 and load[w] >= capacity[w]:
                        continue
                    is_close = b >= 0 and (xy[a, 0] - xy[b, 0]) ** 2 + (xy[a, 1] - xy[b, 1]) ** 2 < separation * separation
                    if w >= 0 and n_near[a, w] > is_close:
                        continue
                    if b >= 0 and n_near[b, v] > is_close:
                        continue
                if s != r and ((s >= 0 and not is_in_reach[s, target[a]]) or (b >= 0 and not is_in_reach[r, target[b]])):
                    continue
                if s == r:
                    gain = _own_gain(r, v, w, slot, before, xy, half_power)
                else:
                    p, q = before[v, r], after[v, r]
                    gain = _links(a, p, q, xy, half_power) - _links(b, p, q, xy, half_power)
                    gain += _pull(a, r, xy, park_xy, half_power, park_pull)
                    if w >= 0:
                        p, q = before[w, s], after[w, s]
                        gain += _links(b, p, q, xy, half_power) - _links(a, p, q, xy, half_power)
                        gain += _pull(b, s, xy, park_xy, half_power, park_pull)
                if w >= 0:
                    gain += (v - w) * (delay[a] - (delay[b] if b >= 0 else 0.0))
                if gain + heat <= least:
                    continue
                if s != r:
                    gain -= _pull(b, r, xy, park_xy, half_power, park_pull)
                    if w >= 0:
                        gain -= _pull(a, s, xy, park_xy, half_power, park_pull)
                if gain < 0.0:
                    gain += heat * (_random(state) / RANDOM_RANGE)
                if gain <= least:
                    continue
                slot[v, r] = b
                visit_of[a], robot_of[a] = w, s
                if w >= 0:
                    slot[w, s] = a
                    _chain(s, slot, before, after)
                    changed[s] = sweep
                _chain(r, slot, before, after)
                changed[r] = sweep
                if b >= 0:
                    visit_of[b], robot_of[b] = v, r
                if w != v:
                    _count_near(a, v, -1, first, near, n_near)
                    _count_near(a, w, 1, first, near, n_near)
                    if b >= 0:
                        _count_near(b, v, 1, first, near, n_near)
                        _count_near(b, w, -1, first, near, n_near)
                    else:
                        load[v] -= 1
                        load[w] += 1
                has_changed = True
                if w < 0:
                    break
            v = visit_of[a]
            for k in range(0 if v < 0 else (N_TAIL if heat > 0.0 else n_reach)):
                r, s = robot_of[a], reach_robot[begin + (_random(state) % n_reach if heat > 0.0 else k)]
                if s == r:
                    continue
                i, j = a, slot[v, s] if slot[v, s] >= 0 else after[v, s]
                p, q = before[v, r], before[v, s]
                gain = _move(p, i, xy, half_power) + _move(q, j, xy, half_power)
                gain -= _move(q, i, xy, half_power) + _move(p, j, xy, half_power)
                if park_pull > 0.0:
                    if not _can_swap_tails(r, s, v, slot, target, is_in_reach):
                        continue
                    gain += _tail_pull(r, s, v, slot, xy, park_xy, half_power, park_pull)
                if gain < 0.0:
                    gain += heat * (_random(state) / RANDOM_RANGE)
                if gain <= least or not _can_swap_tails(r, s, v, slot, target, is_in_reach):
                    continue
                for w in range(v, n_visit):
                    i, j = slot[w, r], slot[w, s]
                    slot[w, r], slot[w, s] = j, i
                    if i >= 0:
                        robot_of[i] = s
                    if j >= 0:
                        robot_of[j] = r
                _chain(r, slot, before, after)
                _chain(s, slot, before, after)
                changed[r] = changed[s] = sweep
                has_changed = True
        if sweep > n_sweep and not has_changed:
            break
