"""The ways of robots through all visits of a plan made shorter, by exchanges between visits and robots."""

# mypy: allow-untyped-defs

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from survey_sim.allocation.kernels.random import draw, next_random
from survey_sim.kernel import inner_kernel, kernel

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# Exchanges with a random place, and of tails, that an item tries in a sweep with heat; most sweeps without.
N_RANDOM = 8
N_TAIL = 4
MAX_COLD_SWEEPS = 50
RANDOM_RANGE = 2.0**31
# Counts as so many near items where a visit is shut to an item.
SHUT = 1 << 20

# An item of `shorten`: place, mm; worth, kin and delay; its visit and robot, -1 while it waits; what it costs where it is,
# the moves to and from it and its distance from park; robots that reach it, from `reach` on; items near it, from `near` on.
# After the n items come the starts of the robots, which have a place alone.
ITEM = np.dtype(
    [("x", "f8"), ("y", "f8"), ("value", "i8"), ("kin", "i8"), ("delay", "f8"), ("visit", "i8"), ("robot", "i8"),
     ("own", "f8"), ("reach", "i8"), ("n_reach", "i8"), ("near", "i8"), ("n_near", "i8")]
)  # fmt: skip
# A robot in a visit: the item it holds or -1; those that it holds before (n + robot for its start) and after (-1 for none);
# cost of the distances from park of all that it holds from this visit on.
PLACE = np.dtype([("item", "i8"), ("before", "i8"), ("after", "i8"), ("pull", "f8")])
# Park of a robot, mm; the sweep in which its way was last changed.
ROBOT = np.dtype([("x", "f8"), ("y", "f8"), ("changed", "i8")])


class Rules(NamedTuple):
    """What `shorten` may do, for n items, m visits, q robots.

    is_in_reach: (n, q) pairs that may be used; reach_robot, near: lists of which items say their parts; n_near: (n, m) items
    of a visit too close to an item, `SHUT` more where it is shut; room: (m,) items that a visit has room for.
    """

    is_in_reach: BoolArray
    reach_robot: npt.NDArray[np.int32]
    near: npt.NDArray[np.int32]
    n_near: npt.NDArray[np.int32]
    room: IntArray


class Costs(NamedTuple):
    """Costs of ways: P / 2, weight of the distance from park; heat that forgives losses, least gain that counts."""

    half_power: float
    park_pull: float
    heat: float
    least: float


@kernel
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
            k = m if m < n_wanted else draw(m + 1, state)
            if k < n_wanted:
                drawn[i, k] = j
            m += 1
    return drawn


@inner_kernel
def _power(dx, dy, half_power):
    d2 = dx * dx + dy * dy
    return d2 * d2 if half_power == 2.0 else d2**half_power


@inner_kernel
def _move(i, j, item, costs):
    """Cost of the move between two items; none if there is no second."""
    return 0.0 if j < 0 else _power(item[i].x - item[j].x, item[i].y - item[j].y, costs.half_power)


@inner_kernel
def _pull(i, r, item, robot, costs):
    """Cost of item i's distance from the park of robot r; none if there is no item."""
    if i < 0 or costs.park_pull == 0.0:
        return 0.0
    return costs.park_pull * _power(item[i].x - robot[r].x, item[i].y - robot[r].y, costs.half_power)


@inner_kernel
def _link(r, item, place, robot, costs):
    """Note what a robot holds before and after each visit, and what that costs."""
    n_visit = len(place)
    last = len(item) - len(robot) + r
    for v in range(n_visit):
        place[v, r].before = last
        if place[v, r].item >= 0:
            last = place[v, r].item
    last, pull = -1, 0.0
    for v in range(n_visit - 1, -1, -1):
        i = place[v, r].item
        own = _pull(i, r, item, robot, costs)
        pull += own
        place[v, r].after, place[v, r].pull = last, pull
        if i >= 0:
            item[i].own = own + _move(place[v, r].before, i, item, costs) + _move(i, last, item, costs)
            last = i


@inner_kernel
def _count_near(i, v, by, item, near, n_near):
    """Count item i in visit v (-1 = none) for all items near it."""
    if v >= 0:
        for k in range(item[i].near, item[i].near + item[i].n_near):
            n_near[near[k], v] += by


@inner_kernel
def _may_exchange(a, b, w, s, separation, item, rules):
    """Whether item a and b, or the empty place (-1) of a visit w and robot s, may change places; w < 0: b waits."""
    v, r = item[a].visit, item[a].robot
    if w < 0:
        if item[b].value < item[a].value or item[a].kin != item[b].kin or item[a].kin < 0:
            return False
    elif s != r and not rules.is_in_reach[a, s]:
        return False
    if b >= 0 and s != r and not rules.is_in_reach[b, r]:
        return False
    if w == v:
        return True
    if b < 0:
        return rules.room[w] > 0 and rules.n_near[a, w] == 0
    dx, dy = item[a].x - item[b].x, item[a].y - item[b].y
    is_close = dx * dx + dy * dy < separation * separation
    return rules.n_near[b, v] <= is_close and (w < 0 or rules.n_near[a, w] <= is_close)


@inner_kernel
def _turn_gain(a, b, v, w, r, item, place, costs):
    """What is gained if a robot changes what it holds in visits v and w (b, or nothing), of which none lies between them."""
    if b < 0:
        return 0.0
    first, second, u, x = (a, b, v, w) if v < w else (b, a, w, v)
    before, after = place[u, r].before, place[x, r].after
    gain = _move(before, first, item, costs) + _move(second, after, item, costs)
    return gain - _move(before, second, item, costs) - _move(first, after, item, costs)


@inner_kernel
def _exchange_gain(a, b, w, s, spare, item, place, robot, costs):
    """What is gained by an exchange (`_may_exchange`); some value below -spare, as soon as it must be less than that."""
    v, r = item[a].visit, item[a].robot
    gain = item[a].own
    if w >= 0:
        before, after = place[w, s].before, place[w, s].after
        if s == r and a in (before, after):
            return _turn_gain(a, b, v, w, r, item, place, costs)
        gain += item[b].own if b >= 0 else _move(before, after, item, costs)
        gain -= _move(before, a, item, costs) + _move(a, after, item, costs)
        if gain <= -spare:
            return gain
        gain -= _pull(a, s, item, robot, costs)
    p, q = place[v, r].before, place[v, r].after
    if b < 0:
        return gain - _move(p, q, item, costs)
    gain -= _move(p, b, item, costs) + _move(b, q, item, costs)
    return gain if gain <= -spare else gain - _pull(b, r, item, robot, costs)


@inner_kernel
def _exchange(a, b, w, s, sweep, item, place, robot, rules, costs):
    """Make item a change places with b, or with nothing."""
    v, r = item[a].visit, item[a].robot
    place[v, r].item = b
    item[a].visit, item[a].robot = w, s
    if b >= 0:
        item[b].visit, item[b].robot = v, r
    if w >= 0:
        place[w, s].item = a
        robot[s].changed = sweep
        if s != r:
            _link(s, item, place, robot, costs)
    _link(r, item, place, robot, costs)
    robot[r].changed = sweep
    if w != v:
        _count_near(a, v, -1, item, rules.near, rules.n_near)
        _count_near(a, w, 1, item, rules.near, rules.n_near)
        if b >= 0:
            _count_near(b, v, 1, item, rules.near, rules.n_near)
            _count_near(b, w, -1, item, rules.near, rules.n_near)
        else:
            rules.room[v] += 1
            rules.room[w] -= 1


@inner_kernel
def _is_taken(gain, costs, state):
    """Whether an exchange that brings so much is made: if it gains, or loses no more than a random part of the heat."""
    return gain > costs.least or (costs.heat > 0.0 and gain + costs.heat * (next_random(state) / RANDOM_RANGE) > costs.least)


@inner_kernel
def _try_places(a, candidates, sweep, separation, item, place, robot, rules, costs, state):
    """Exchange an item with its candidates, within its robot's way, and with places in reach: all, or with heat some.

    Returns
    -------
        Whether anything was exchanged.
    """
    n_visit, n_reach, n_candidate = len(place), item[a].n_reach, len(candidates)
    n_try = n_candidate + n_visit + (N_RANDOM if costs.heat > 0.0 else n_reach * n_visit)
    has_changed, w, p = False, -1, -1
    for c in range(n_try):
        v, r = item[a].visit, item[a].robot
        if c < n_candidate:
            b = candidates[c]
            if b < 0:
                continue
            w, s = item[b].visit, item[b].robot
        else:
            w = w + 1 if c > n_candidate else 0
            if c < n_candidate + n_visit:
                s = r
            elif costs.heat > 0.0:
                w, s = draw(n_visit, state), rules.reach_robot[item[a].reach + draw(n_reach, state)]
            else:
                if w == n_visit:
                    w, p = 0, p + 1
                s = rules.reach_robot[item[a].reach + p]
            b = place[w, s].item
        if b == a or (v == w and r == s) or not _may_exchange(a, b, w, s, separation, item, rules):
            continue
        sooner = (v - w) * (item[a].delay - (item[b].delay if b >= 0 else 0.0)) if w >= 0 else 0.0
        gain = sooner + _exchange_gain(a, b, w, s, sooner + costs.heat, item, place, robot, costs)
        if gain + costs.heat <= costs.least or not _is_taken(gain, costs, state):
            continue
        _exchange(a, b, w, s, sweep, item, place, robot, rules, costs)
        has_changed = True
        if w < 0:
            break
    return has_changed


@inner_kernel
def _tail_gain(v, r, s, item, place, robot, is_in_reach, costs):
    """What is gained if two robots exchange all that they hold from visit v on; -inf if they cannot, or it is too little."""
    p, q = place[v, r].before, place[v, s].before
    i = place[v, r].item
    j = place[v, s].item if place[v, s].item >= 0 else place[v, s].after
    gain = place[v, r].pull + place[v, s].pull + _move(p, i, item, costs) + _move(q, j, item, costs)
    gain -= _move(q, i, item, costs) + _move(p, j, item, costs)
    if gain <= -costs.heat:
        return -np.inf
    for w in range(v, len(place)):
        i, j = place[w, r].item, place[w, s].item
        if (i >= 0 and not is_in_reach[i, s]) or (j >= 0 and not is_in_reach[j, r]):
            return -np.inf
        gain -= _pull(i, s, item, robot, costs) + _pull(j, r, item, robot, costs)
    return gain


@inner_kernel
def _try_tails(a, sweep, item, place, robot, rules, costs, state):
    """Exchange all that two robots hold from an item's visit on, as in `_try_places`; whether anything was done."""
    v, n_reach = item[a].visit, item[a].n_reach
    has_changed = False
    for k in range(N_TAIL if costs.heat > 0.0 else n_reach):
        r = item[a].robot
        s = rules.reach_robot[item[a].reach + (draw(n_reach, state) if costs.heat > 0.0 else k)]
        if s == r:
            continue
        gain = _tail_gain(v, r, s, item, place, robot, rules.is_in_reach, costs)
        if gain + costs.heat <= costs.least or not _is_taken(gain, costs, state):
            continue
        for w in range(v, len(place)):
            i, j = place[w, r].item, place[w, s].item
            place[w, r].item, place[w, s].item = j, i
            if i >= 0:
                item[i].robot = s
            if j >= 0:
                item[j].robot = r
        _link(r, item, place, robot, costs)
        _link(s, item, place, robot, costs)
        robot[r].changed = robot[s].changed = sweep
        has_changed = True
    return has_changed


@kernel
def _fill_items(item, start_xy, xy, value, kin, delay, first, target, reach_first, visit_of, robot_of):
    """Fill in the records of items, and of the robots' starts after them."""
    n_item = len(xy)
    for i in range(n_item):
        item[i].x, item[i].y = xy[i]
        item[i].value, item[i].kin, item[i].delay = value[i], kin[i], delay[i]
        item[i].visit, item[i].robot = visit_of[i], robot_of[i]
        item[i].reach, item[i].near = reach_first[target[i]], first[i]
        item[i].n_reach = reach_first[target[i] + 1] - item[i].reach
        item[i].n_near = first[i + 1] - first[i]
    for r in range(len(start_xy)):
        item[n_item + r].x, item[n_item + r].y = start_xy[r]


@kernel
def _rules(n_item, n_robot, item, target, near, reach_robot, is_pair_open, is_shut, capacity):
    """What exchanges may do, as the items stand."""
    rules = Rules(
        np.zeros((n_item, n_robot), np.bool_),
        reach_robot,
        near,
        np.zeros((n_item, len(capacity)), np.int32),
        capacity.copy(),
    )
    for i in range(n_item):
        for p in range(item[i].reach, item[i].reach + item[i].n_reach):
            rules.is_in_reach[i, reach_robot[p]] = is_pair_open[p]
        for v in range(len(capacity)):
            rules.n_near[i, v] += SHUT if is_shut[target[i], v] else 0
        _count_near(i, item[i].visit, 1, item, near, rules.n_near)
        if item[i].visit >= 0:
            rules.room[item[i].visit] -= 1
    return rules


@kernel
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
    (n_visit, n_robot), n_item = slot.shape, len(visit_of)
    item, place, robot = np.zeros(n_item + n_robot, ITEM), np.zeros((n_visit, n_robot), PLACE), np.zeros(n_robot, ROBOT)
    _fill_items(item, start_xy, xy, value, kin, delay, first, target, reach_first, visit_of, robot_of)
    rules = _rules(n_item, n_robot, item, target, near, reach_robot, is_pair_open, is_shut, capacity)
    costs = Costs(half_power, park_pull, hot, 1e-9 * hot)
    for r in range(n_robot):
        robot[r].x, robot[r].y = park_xy[r]
        for v in range(n_visit):
            place[v, r].item = slot[v, r]
        _link(r, item, place, robot, costs)
    for sweep in range(1, n_sweep + MAX_COLD_SWEEPS):
        heat = hot * (cold / hot) ** ((sweep - 1.0) / max(1.0, n_sweep - 1.0)) if sweep <= n_sweep else 0.0
        costs = Costs(half_power, park_pull, heat, costs.least)
        has_changed = False
        for a in range(n_item):
            if item[a].visit < 0 or (sweep > n_sweep + 1 and robot[item[a].robot].changed < sweep - 1):
                continue
            has_changed |= _try_places(
                a, candidates[a], sweep, separation, item, place, robot, rules, costs, state
            )  # fmt: skip
            if item[a].visit >= 0:
                has_changed |= _try_tails(a, sweep, item, place, robot, rules, costs, state)
        if sweep > n_sweep and not has_changed:
            break
    for i in range(n_item):
        visit_of[i], robot_of[i] = item[i].visit, item[i].robot
    for v in range(n_visit):
        for r in range(n_robot):
            slot[v, r] = place[v, r].item
