"""The plan: which targets at which visit, all visits of a tile together.

An item is one wanted visit of one target; the items of a target are near each other (distance 0), so they go to different
visits. A visit holds items no two of which are near, each by a robot of its own: a partial colouring of the graph of near
items in which every colour must also be matched to robots. The search for most value is a tabu search on partial colourings
(Bloechliger & Zufferey 2008, Computers & Operations Research 35, 960), the matchings kept by augmenting paths.
"""

# mypy: allow-untyped-defs

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from survey_sim.allocation.kernels.random import draw, next_random
from survey_sim.kernel import inlined_kernel, kernel

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# Worth of items that shut a visit for good.
NEVER = np.int64(1) << 40


@kernel
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

    value, first, near, target, reach_first, reach_robot, is_pair_open, place: as in `cover`; weight: (n, m) worth of the
    items in each visit that are near an item, `NEVER` where it is shut; visit_of, robot_of: (n,) -1 while an item waits;
    slot: (m, q) item of each robot or -1; load: (m,) items; queue, parent, is_seen: of the augmenting paths. Best moves
    are looked up again only where something changed: gain, n_tie: (n,) most that a waiting item brings, and visits that
    bring as much; again: (n,) step from which that is no longer known.
    """

    value: IntArray
    first: IntArray
    near: npt.NDArray[np.int32]
    target: IntArray
    reach_first: IntArray
    reach_robot: npt.NDArray[np.int32]
    is_pair_open: BoolArray
    place: IntArray
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


@inlined_kernel
def _weigh(s, i, v, worth):
    """Count the worth of item i, now in visit v or (negative) out of it, for all that are near it."""
    for k in range(s.first[i], s.first[i + 1]):
        s.weight[s.near[k], v] += worth
        s.again[s.near[k]] = 0


@inlined_kernel
def _remove(s, i):
    """Take an item out of its visit."""
    v = s.visit_of[i]
    s.slot[v, s.robot_of[i]] = -1
    s.visit_of[i] = -1
    s.robot_of[i] = -1
    s.load[v] -= 1
    s.again[i] = 0
    _weigh(s, i, v, -s.value[i])


@inlined_kernel
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
        at_first = s.place[v] + s.target[x]
        begin, n = s.reach_first[at_first], s.reach_first[at_first + 1] - s.reach_first[at_first]
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


@inlined_kernel
def _one_of_least(s, i, v, state):
    """One of the least valuable items in a visit, i excepted, at random."""
    n, least = 0, NEVER
    for r in range(s.slot.shape[1]):
        j = s.slot[v, r]
        if j >= 0 and j != i and s.value[j] <= least:
            n = n + 1 if s.value[j] == least else 1
            least = s.value[j]
    left = draw(n, state)
    r = -1
    while left >= 0:
        r += 1
        j = s.slot[v, r]
        left -= j >= 0 and j != i and s.value[j] == least
    return s.slot[v, r]


@kernel
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
            if s.value[i] <= 0 or s.visit_of[i] >= 0 or (not is_new and wish[i] < 0):
                continue  # what is worth nothing would not keep its neighbours out
            tried[:] = False
            while True:
                v = -1 if is_new else wish[i]
                for u in range(n_visit if is_new else 0):
                    if not tried[u] and s.weight[i, u] == 0 and s.load[u] < capacity[u]:
                        v = u if v < 0 or s.load[u] < s.load[v] else v
                if v < 0 or tried[v] or s.weight[i, v] > 0 or s.load[v] >= capacity[v]:
                    break
                tried[v] = True
                if _insert(s, i, v, -1, next_random(state)) == -1:
                    total += s.value[i]
                    break
    return total


@inlined_kernel
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


@inlined_kernel
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
    left = draw(n_most, state)
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


@inlined_kernel
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


@inlined_kernel
def _put_out(c, i, v, until, n_waiting, state):
    """Let an item that has left a visit wait, and keep it from that visit for some steps after `until`."""
    c.tabu[i, v] = until + 8 + draw(10, state)
    c.waiting[n_waiting] = i
    return n_waiting + 1


@inlined_kernel
def _make_move(s, c, i, v, step, capacity, n_waiting, state):
    """Bring a waiting item into a visit, and put out what is in its way.

    Returns
    -------
        What is gained by it, and number of items that wait.
    """
    gain = np.int64(0)
    if s.weight[i, v] > 0:
        for k in range(s.first[i], s.first[i + 1]):
            j = s.near[k]
            if s.visit_of[j] == v:
                _remove(s, j)
                gain -= s.value[j]
                n_waiting = _put_out(c, j, v, step, n_waiting, state)
    is_full = s.load[v] >= capacity
    gone = _insert(s, i, v, s.value[i], next_random(state))
    if gone == -1 and is_full:
        gone = _one_of_least(s, i, v, state)
        _remove(s, gone)
    if gone == -2:
        c.closed[i, v] = step + 50
        s.again[i] = 0
        c.waiting[n_waiting] = i
        return gain, n_waiting + 1
    gain += s.value[i]
    if gone >= 0:
        gain -= s.value[gone]
        n_waiting = _put_out(c, gone, v, step, n_waiting, state)
        if not is_full:
            c.closed[gone, v] = c.tabu[gone, v]
    return gain, n_waiting


@inlined_kernel
def _is_reached(s, i):
    """Whether any robot of any tile reaches an item."""
    for v in range(len(s.place)):
        t = s.place[v] + s.target[i]
        if s.reach_first[t + 1] > s.reach_first[t]:
            return True
    return False


@kernel
def cover(
    n_step, goal, value, first, near, target, reach_first, reach_robot, is_pair_open, place, is_shut,
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
        (n_item,) whole-number worth, of items that are left out 0; lists of near items; target of each item.
    reach_first, reach_robot, is_pair_open
        Robots that reach each target, of one tile or of one after another; (n_pair,) pairs that may be used.
    place
        (n_visit,) where the lists of a visit's tile begin in `reach_first`: target t has the list place[v] + t.
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
        value, first, near, target, reach_first, reach_robot, is_pair_open, place,
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
        if visit_of[i] < 0 and value[i] > 0 and _is_reached(s, i):
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
        gain, n_waiting = _make_move(s, c, i, v, step, capacity[v], n_waiting, state)
        total += gain
        _set_least(s, c, v, s.load[v] >= capacity[v], n_waiting)
        if total > best:
            best, last = total, step
            best_visit[:] = visit_of
    visit_of[:] = best_visit
    return best
