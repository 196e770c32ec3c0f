"""The ways of robots through all visits of a plan made shorter, by exchanges between visits and robots."""

# mypy: allow-untyped-defs

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from survey_sim.allocation.kernels.random import draw, next_random
from survey_sim.kernel import inlined_kernel, kernel

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# Exchanges with a random place, and of tails, that an item tries in a sweep with heat; most sweeps without.
N_RANDOM = 8
N_TAIL = 4
MAX_COLD_SWEEPS = 50
RANDOM_RANGE = 2.0**31
# Counts as so many near items where a visit is shut to an item.
SHUT = 1 << 20

# An item of `shorten`: place, mm; worth, kin and delay; its visit and robot, -1 while it waits; robots that reach it, from
# `reach` on; items near it, from `near` on; the clock when all its exchanges were last tried without heat.
# After the n items come the starts of the robots, which have a place alone.
ITEM = np.dtype(
    [("x", "f8"), ("y", "f8"), ("value", "i8"), ("kin", "i8"), ("delay", "f8"), ("visit", "i8"), ("robot", "i8"),
     ("reach", "i8"), ("n_reach", "i8"), ("near", "i8"), ("n_near", "i8"), ("tried", "i8")]
)  # fmt: skip
# A robot in a visit: the item it holds or -1; those that it holds before (n + robot for its start) and after (-1 for none),
# and where they are; what the place costs: moves to its item and on, distance from park and delay, or the move past it if
# it is empty; cost of the distances from park of all that the robot holds from this visit on.
PLACE = np.dtype(
    [("item", "i4"), ("before", "i4"), ("after", "i4"), ("before_x", "f8"), ("before_y", "f8"), ("after_x", "f8"),
     ("after_y", "f8"), ("own", "f8"), ("pull", "f8")], align=True
)  # fmt: skip
# Park of a robot, mm; what the dearest of its places costs; the clock when its way was last changed.
ROBOT = np.dtype([("x", "f8"), ("y", "f8"), ("dearest", "f8"), ("changed", "i8")])


class Rules(NamedTuple):
    """What `shorten` may do, for n items, m visits, q robots.

    is_in_reach: (n, q) pairs that may be used; reach_robot, near: lists of which items say their parts; n_near: (n, m) items
    of a visit too close to an item, `SHUT` more where it is shut; room: (m,) items that a visit has room for; clock: (1,)
    exchanges made.
    """

    is_in_reach: BoolArray
    reach_robot: npt.NDArray[np.int32]
    near: npt.NDArray[np.int32]
    n_near: npt.NDArray[np.int32]
    room: IntArray
    clock: IntArray


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
    x, y = xy[order, 0], xy[order, 1]
    begin = 0
    for a in range(n):
        while x[begin] < x[a] - radius:
            begin += 1
        i, m = order[a], 0
        for b in range(begin, n):
            dx, dy = x[b] - x[a], y[b] - y[a]
            if dx > radius:
                break
            if b == a or dx * dx + dy * dy > radius * radius:
                continue
            k = m if m < n_wanted else draw(m + 1, state)
            if k < n_wanted:
                drawn[i, k] = order[b]
            m += 1
    return drawn


@inlined_kernel
def _power(dx, dy, half_power):
    d2 = dx * dx + dy * dy
    return d2 * d2 if half_power == 2.0 else d2**half_power


@inlined_kernel
def _move(i, j, item, costs):
    """Cost of the move between two items; none if there is no second."""
    return 0.0 if j < 0 else _power(item[i].x - item[j].x, item[i].y - item[j].y, costs.half_power)


@inlined_kernel
def _pull(i, r, item, robot, costs):
    """Cost of item i's distance from the park of robot r; none if there is no item."""
    if i < 0 or costs.park_pull == 0.0:
        return 0.0
    return costs.park_pull * _power(item[i].x - robot[r].x, item[i].y - robot[r].y, costs.half_power)


@inlined_kernel
def _link(r, item, place, robot, costs):
    """Note what a robot holds before and after each visit, and what that costs."""
    last = len(item) - len(robot) + r
    for v in range(place.shape[1]):
        here = place[r, v]
        here.before, here.before_x, here.before_y = last, item[last].x, item[last].y
        if here.item >= 0:
            last = here.item
    last, pull, dearest = -1, 0.0, 0.0
    for v in range(place.shape[1] - 1, -1, -1):
        here = place[r, v]
        i = here.item
        here.after = last
        if last >= 0:
            here.after_x, here.after_y = item[last].x, item[last].y
        if i >= 0:
            here.own = _cost_in(i, r, v, item, place, robot, costs)
            pull += _pull(i, r, item, robot, costs)
            last = i
        else:
            here.own = _move(here.before, last, item, costs)
        here.pull = pull
        dearest = max(dearest, here.own)
    robot[r].dearest = dearest


@inlined_kernel
def _moves_in(i, r, v, item, place, costs):
    """Cost of the moves to item i and from it if robot r holds it in visit v."""
    here = place[r, v]
    x, y = item[i].x, item[i].y
    cost = _power(here.before_x - x, here.before_y - y, costs.half_power)
    return cost if here.after < 0 else cost + _power(here.after_x - x, here.after_y - y, costs.half_power)


@inlined_kernel
def _cost_in(i, r, v, item, place, robot, costs):
    """All that item i costs if robot r holds it in visit v."""
    return _moves_in(i, r, v, item, place, costs) + _pull(i, r, item, robot, costs) + v * item[i].delay


@inlined_kernel
def _count_near(i, v, by, item, near, n_near):
    """Count item i in visit v (-1 = none) for all items near it."""
    if v >= 0:
        for k in range(item[i].near, item[i].near + item[i].n_near):
            n_near[near[k], v] += by


@inlined_kernel
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


@inlined_kernel
def _turn_gain(a, b, w, item, place, costs):
    """What is gained if a robot exchanges item a for what it holds in visit w (b, or nothing), with none between them."""
    v, r = item[a].visit, item[a].robot
    if b < 0:
        return (v - w) * item[a].delay
    first, second, u, x = (a, b, v, w) if v < w else (b, a, w, v)
    before, after = place[r, u].before, place[r, x].after
    gain = (v - w) * (item[a].delay - item[b].delay)
    gain += _move(before, first, item, costs) + _move(second, after, item, costs)
    return gain - _move(before, second, item, costs) - _move(first, after, item, costs)


@inlined_kernel
def _place_gain(a, w, s, pull, item, place, robot, costs):
    """What is gained if item a, whose distance from the park of robot s costs `pull`, changes places with what that holds in
    visit w, be it nothing; some value too low to count, as soon as it must be one.
    """
    v, r, b = item[a].visit, item[a].robot, place[s, w].item
    if s == r and a in (place[s, w].before, place[s, w].after):
        return _turn_gain(a, b, w, item, place, costs)
    gain = place[r, v].own + place[s, w].own - pull - w * item[a].delay - _moves_in(a, s, w, item, place, costs)
    if gain + costs.heat <= costs.least:
        return gain
    if b < 0:
        return gain - _move(place[r, v].before, place[r, v].after, item, costs)
    return gain - _cost_in(b, r, v, item, place, robot, costs)


@inlined_kernel
def _waiting_gain(a, b, item, place, robot, costs):
    """What is gained if an item that waits takes the place of item a, its delay set aside."""
    v, r = item[a].visit, item[a].robot
    delay = v * (item[a].delay - item[b].delay)
    return place[r, v].own - delay - _cost_in(b, r, v, item, place, robot, costs)


@inlined_kernel
def _exchange(a, b, w, s, item, place, robot, rules, costs):
    """Make item a change places with b, or with nothing."""
    v, r = item[a].visit, item[a].robot
    rules.clock[0] += 1
    place[r, v].item = b
    item[a].visit, item[a].robot = w, s
    if b >= 0:
        item[b].visit, item[b].robot = v, r
    if w >= 0:
        place[s, w].item = a
        robot[s].changed = rules.clock[0]
        if s != r:
            _link(s, item, place, robot, costs)
    _link(r, item, place, robot, costs)
    robot[r].changed = rules.clock[0]
    if w != v:
        _count_near(a, v, -1, item, rules.near, rules.n_near)
        _count_near(a, w, 1, item, rules.near, rules.n_near)
        if b >= 0:
            _count_near(b, v, 1, item, rules.near, rules.n_near)
            _count_near(b, w, -1, item, rules.near, rules.n_near)
        else:
            rules.room[v] += 1
            rules.room[w] -= 1


@inlined_kernel
def _is_taken(gain, costs, state):
    """Whether an exchange that brings so much is made: if it gains, or loses no more than a random part of the heat."""
    return gain > costs.least or (costs.heat > 0.0 and gain + costs.heat * (next_random(state) / RANDOM_RANGE) > costs.least)


@inlined_kernel
def _try_place(a, w, s, pull, separation, item, place, robot, rules, costs, state):
    """Exchange item a with what robot s holds in visit w if that gains (`_place_gain`, `_is_taken`); whether it was done."""
    b = place[s, w].item
    if b == a:
        return False
    gain = _place_gain(a, w, s, pull, item, place, robot, costs)
    if gain + costs.heat <= costs.least or not _may_exchange(a, b, w, s, separation, item, rules):
        return False
    if not _is_taken(gain, costs, state):
        return False
    _exchange(a, b, w, s, item, place, robot, rules, costs)
    return True


@inlined_kernel
def _try_waiting(a, b, separation, item, place, robot, rules, costs, state):
    """The same with an item that waits."""
    if not _may_exchange(a, b, -1, -1, separation, item, rules):
        return False
    gain = _waiting_gain(a, b, item, place, robot, costs)
    if gain + costs.heat <= costs.least or not _is_taken(gain, costs, state):
        return False
    _exchange(a, b, -1, -1, item, place, robot, rules, costs)
    return True


@inlined_kernel
def _may_gain(a, s, pull, item, place, robot, costs):
    """Whether any exchange of item a with what robot s holds may be worth it: that has to bring more than its distance from
    the robot's park costs.
    """
    return place[item[a].robot, item[a].visit].own + robot[s].dearest - pull + costs.heat > costs.least


@inlined_kernel
def _try_hot(a, candidates, separation, item, place, robot, rules, costs, state):
    """Exchange an item with its candidates, within its robot's way, and with some places in reach."""
    n_visit = place.shape[1]
    for b in candidates:
        if b >= 0 and item[b].visit < 0:
            if _try_waiting(a, b, separation, item, place, robot, rules, costs, state):
                return
        elif b >= 0:
            s = item[b].robot
            pull = _pull(a, s, item, robot, costs)
            _try_place(a, item[b].visit, s, pull, separation, item, place, robot, rules, costs, state)
    for w in range(n_visit):
        s = item[a].robot
        _try_place(a, w, s, _pull(a, s, item, robot, costs), separation, item, place, robot, rules, costs, state)
    for _ in range(N_RANDOM):
        w, s = draw(n_visit, state), rules.reach_robot[item[a].reach + draw(item[a].n_reach, state)]
        pull = _pull(a, s, item, robot, costs)
        if _may_gain(a, s, pull, item, place, robot, costs):
            _try_place(a, w, s, pull, separation, item, place, robot, rules, costs, state)
    for _ in range(N_TAIL):
        s = rules.reach_robot[item[a].reach + draw(item[a].n_reach, state)]
        _try_tails(a, s, item, place, robot, rules, costs, state)


@inlined_kernel
def _is_old(a, s, item, robot):
    """Whether all exchanges of item a with robot s have been tried since the ways of either, and its own, last changed."""
    return max(robot[item[a].robot].changed, robot[s].changed) <= item[a].tried


@inlined_kernel
def _try_cold(a, candidates, separation, item, place, robot, rules, costs, state):
    """Exchange an item with candidates that wait, and with all places in reach: what was not tried before, from either side.

    Returns
    -------
        Whether anything was exchanged.
    """
    begun = rules.clock[0]
    for b in candidates:
        is_new = b >= 0 and item[b].visit < 0 and robot[item[a].robot].changed > item[a].tried
        if is_new and _try_waiting(a, b, separation, item, place, robot, rules, costs, state):
            return True
    for k in range(item[a].reach, item[a].reach + item[a].n_reach):
        s = rules.reach_robot[k]
        if _is_old(a, s, item, robot):
            continue
        pull = _pull(a, s, item, robot, costs)
        for w in range(place.shape[1]):
            if not _may_gain(a, s, pull, item, place, robot, costs):
                break
            b = place[s, w].item
            if b < 0 or not _is_old(b, item[a].robot, item, robot):
                _try_place(a, w, s, pull, separation, item, place, robot, rules, costs, state)
        _try_tails(a, s, item, place, robot, rules, costs, state)
    item[a].tried = begun
    return rules.clock[0] > begun


@inlined_kernel
def _tail_gain(v, r, s, item, place, robot, is_in_reach, costs):
    """What is gained if two robots exchange all that they hold from visit v on; -inf if they cannot, or it is too little."""
    p, q = place[r, v].before, place[s, v].before
    i = place[r, v].item
    j = place[s, v].item if place[s, v].item >= 0 else place[s, v].after
    gain = place[r, v].pull + place[s, v].pull + _move(p, i, item, costs) + _move(q, j, item, costs)
    gain -= _move(q, i, item, costs) + _move(p, j, item, costs)
    for w in range(v, place.shape[1]):
        if gain + costs.heat <= costs.least:
            return -np.inf
        i, j = place[r, w].item, place[s, w].item
        if (i >= 0 and not is_in_reach[i, s]) or (j >= 0 and not is_in_reach[j, r]):
            return -np.inf
        gain -= _pull(i, s, item, robot, costs) + _pull(j, r, item, robot, costs)
    return gain


@inlined_kernel
def _try_tails(a, s, item, place, robot, rules, costs, state):
    """Exchange all that two robots hold from an item's visit on, as in `_try_place`."""
    v, r = item[a].visit, item[a].robot
    if s == r:
        return
    gain = _tail_gain(v, r, s, item, place, robot, rules.is_in_reach, costs)
    if gain + costs.heat <= costs.least or not _is_taken(gain, costs, state):
        return
    for w in range(v, place.shape[1]):
        i, j = place[r, w].item, place[s, w].item
        place[r, w].item, place[s, w].item = j, i
        if i >= 0:
            item[i].robot = s
        if j >= 0:
            item[j].robot = r
    _link(r, item, place, robot, costs)
    _link(s, item, place, robot, costs)
    rules.clock[0] += 1
    robot[r].changed = robot[s].changed = rules.clock[0]


@kernel
def _fill_items(item, start_xy, xy, value, kin, delay, first, target, reach_first, visit_of, robot_of):
    """Fill in the records of items, and of the robots' starts after them."""
    n_item = len(xy)
    for i in range(n_item):
        item[i].x, item[i].y = xy[i]
        item[i].value, item[i].kin, item[i].delay = value[i], kin[i], delay[i]
        item[i].visit, item[i].robot, item[i].tried = visit_of[i], robot_of[i], -1
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
        np.zeros(1, np.int64),
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
    until nothing is gained: these try all places in reach, but none twice unless a way of its robots has changed.

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
    item, place, robot = np.zeros(n_item + n_robot, ITEM), np.zeros((n_robot, n_visit), PLACE), np.zeros(n_robot, ROBOT)
    _fill_items(item, start_xy, xy, value, kin, delay, first, target, reach_first, visit_of, robot_of)
    rules = _rules(n_item, n_robot, item, target, near, reach_robot, is_pair_open, is_shut, capacity)
    costs = Costs(half_power, park_pull, hot, 1e-9 * hot)
    for r in range(n_robot):
        robot[r].x, robot[r].y = park_xy[r]
        for v in range(n_visit):
            place[r, v].item = slot[v, r]
        _link(r, item, place, robot, costs)
    for sweep in range(n_sweep):
        costs = Costs(half_power, park_pull, hot * (cold / hot) ** (sweep / max(1.0, n_sweep - 1.0)), costs.least)
        for a in range(n_item):
            if item[a].visit >= 0:
                _try_hot(a, candidates[a], separation, item, place, robot, rules, costs, state)
    costs = Costs(half_power, park_pull, 0.0, costs.least)
    for _ in range(MAX_COLD_SWEEPS):
        has_changed = False
        for a in range(n_item):
            if item[a].visit >= 0:
                has_changed |= _try_cold(a, candidates[a], separation, item, place, robot, rules, costs, state)
        if not has_changed:
            break
    for i in range(n_item):
        visit_of[i], robot_of[i] = item[i].visit, item[i].robot
    for v in range(n_visit):
        for r in range(n_robot):
            slot[v, r] = place[r, v].item
