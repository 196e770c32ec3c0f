"""Kernels that find robots which cannot pass each other on straight lines, and exchange targets until few are left.

Two robots go straight at the same speed, and each may start later. The positions on their ways at which they are too near
fill an ellipse, cut by the box of both ways; a delay d of the second after the first is a line a - b = d through it. The
delays that bring them too near are one interval, open on a side where one sweeps the other's start or goal: on both sides
where they exchange places, or where both ends of one lie on the other's line (Goodwin et al. 2014, Figure 13).
"""

# mypy: allow-untyped-defs

from typing import NamedTuple

import numpy as np

from survey_sim.kernel import inlined_kernel, kernel

# All below was chosen on fields of the demo run; lengths are mm of way.
# A robot with so much more time than its way takes goes round another whatever their ways are.
DETOUR_MM = 24.0
# Turning takes time that the lengths of ways leave out: so much of the longest way is not counted on.
TURNING_MM = 1.3
# Tangles below this are left.
LEAST_TANGLE = 0.02
# What a tangle that leaves no time at all is worth, in travel costs of the longest way.
TANGLE_WORTH = 2.0
# A robot's ways: from where it stands, and from park.
N_WAY = 2
# Robots that a target freed by one goes through, at most; steps without a better state before the search ends.
N_LEVEL = 4
N_STEP = 24


class Ways(NamedTuple):
    """Straight ways of all robots to what they hold: from where they stand [0], and from park [1].

    `begin`, `unit` (2, n_robot, 2) and `length` (2, n_robot), mm; `longest` (2,) at first; `is_fixed` (n_robot,) robots that
    never move; `is_seen` (2, n_robot) ways that count; `radius`, the least separation; `tangle` (n_robot,) the sum of each
    robot's tangles.
    """

    begin: np.ndarray
    unit: np.ndarray
    length: np.ndarray
    longest: np.ndarray
    is_fixed: np.ndarray
    is_seen: np.ndarray
    radius: float
    tangle: np.ndarray


@inlined_kernel
def _near_part(wx, wy, vx, vy, length, radius2):
    """Part (low, high) of a way from 0 along v that is nearer to w than the radius; low > high if there is none."""
    along = wx * vx + wy * vy
    aside2 = wx * wx + wy * wy - along * along
    if aside2 >= radius2:
        return 1.0, 0.0
    half = np.sqrt(radius2 - aside2)
    low, high = along - half, along + half
    if high <= 0.0 or low >= length:
        return 1.0, 0.0
    return max(0.0, low), min(length, high)


@kernel
def forbidden_delays(ax, ay, ux, uy, length_a, bx, by, vx, vy, length_b, radius):
    """Delays of b after a, as lengths of way, at which the two come too near: (low, high), low > high if there are none.

    Parameters
    ----------
    ax, ay, ux, uy, length_a
        Start, unit direction and length of the one's way, mm; of the other likewise.
    """
    wx, wy = ax - bx, ay - by
    radius2 = radius * radius
    low, high = np.inf, -np.inf
    for is_end in range(2):
        # One stands at its start (a side opens for who goes first) or at its goal (for who goes last), the other comes by.
        a = is_end * length_a
        b0, b1 = _near_part(wx + a * ux, wy + a * uy, vx, vy, length_b, radius2)
        if b0 <= b1:
            low = min(low, a - b1) if is_end else -np.inf
            high = np.inf if is_end else max(high, a - b0)
        b = is_end * length_b
        a0, a1 = _near_part(-wx + b * vx, -wy + b * vy, ux, uy, length_a, radius2)
        if a0 <= a1:
            low = -np.inf if is_end else min(low, a0 - b)
            high = max(high, a1 - b) if is_end else np.inf
    # The ellipse's own extremes: for each d the least of |w + d u + b (u - v)|^2 over b, a quadratic in d.
    ex, ey = ux - vx, uy - vy
    e2 = ex * ex + ey * ey
    if e2 < 1e-12:
        return low, high
    we, ue = wx * ex + wy * ey, ux * ex + uy * ey
    p = 1.0 - ue * ue / e2
    q = wx * ux + wy * uy - we * ue / e2
    discriminant = q * q - p * (wx * wx + wy * wy - we * we / e2 - radius2)
    if p < 1e-12 or discriminant <= 0.0:
        return low, high
    for sign in (-1.0, 1.0):
        d = (-q + sign * np.sqrt(discriminant)) / p
        b = -(we + d * ue) / e2
        if 0.0 <= b <= length_b and 0.0 <= b + d <= length_a:
            low, high = min(low, d), max(high, d)
    return low, high


@inlined_kernel
def _pair_tangle(ways, w, i, j):
    """How far two robots are from passing each other in the time of the slowest: 0 (they can) to 1 (no time at all)."""
    begin, unit, length = ways.begin[w], ways.unit[w], ways.length[w]
    reach = length[i] + length[j] + ways.radius
    dx, dy = begin[i, 0] - begin[j, 0], begin[i, 1] - begin[j, 1]
    if dx * dx + dy * dy >= reach * reach or (ways.is_fixed[i] and ways.is_fixed[j]):
        return 0.0
    low, high = forbidden_delays(
        begin[i, 0], begin[i, 1], unit[i, 0], unit[i, 1], length[i],
        begin[j, 0], begin[j, 1], unit[j, 0], unit[j, 1], length[j], ways.radius,
    )  # fmt: skip
    spare_i = max(0.0, ways.longest[w] - TURNING_MM - length[i])
    spare_j = max(0.0, ways.longest[w] - TURNING_MM - length[j])
    if low >= high or low >= -spare_i or high <= spare_j:
        return 0.0
    # Who meets a robot that never moves can only go round it.
    spare = spare_j if ways.is_fixed[i] else spare_i if ways.is_fixed[j] else max(spare_i, spare_j)
    return max(0.0, 1.0 - spare / DETOUR_MM)


@inlined_kernel
def _note_tangles(ways, r, sign):
    """Add (1) or take away (-1) a robot's tangles with all others, at both."""
    for w in range(N_WAY):
        for q in range(len(ways.tangle) if ways.is_seen[w, r] else 0):
            if ways.is_seen[w, q] and q != r:
                amount = sign * _pair_tangle(ways, w, r, q)
                ways.tangle[r] += amount
                ways.tangle[q] += amount


@inlined_kernel
def _remove(ways, r):
    """Take a robot's ways out."""
    _note_tangles(ways, r, -1.0)
    for w in range(N_WAY):
        ways.is_seen[w, r] = False
    ways.tangle[r] = 0.0


@inlined_kernel
def _set_way(begin, x, y, unit, length, r):
    """Fill in the unit (2,) of a robot's way to (x, y), and its length among those of all."""
    dx, dy = x - begin[0], y - begin[1]
    length[r] = np.hypot(dx, dy)
    unit[0] = dx / length[r] if length[r] > 0.0 else 1.0
    unit[1] = dy / length[r] if length[r] > 0.0 else 0.0


@inlined_kernel
def _add(ways, r, x, y, has_target):
    """Bring in a robot's ways to (x, y); without a target it steps aside where others pass from where they stand."""
    for w in range(N_WAY):
        _set_way(ways.begin[w, r], x, y, ways.unit[w, r], ways.length[w], r)
    ways.is_seen[0, r] = has_target or ways.is_fixed[r]
    ways.is_seen[1, r] = True
    _note_tangles(ways, r, 1.0)


@kernel
def _make_ways(start_xy, park_xy, is_live, xy, radius, held):
    """Ways of all robots, with their tangles."""
    n_robot = len(held)
    begin = np.empty((N_WAY, n_robot, 2))
    begin[0], begin[1] = start_xy, park_xy
    longest = np.zeros(N_WAY)
    for r in range(n_robot):
        if not is_live[r]:
            begin[1, r] = start_xy[r]
        x, y = xy[held[r]] if held[r] >= 0 else start_xy[r]
        for w in range(N_WAY):
            longest[w] = max(longest[w], np.hypot(x - begin[w, r, 0], y - begin[w, r, 1]))
    ways = Ways(
        begin, np.empty((N_WAY, n_robot, 2)), np.zeros((N_WAY, n_robot)), longest, ~is_live,
        np.zeros((N_WAY, n_robot), np.bool_), radius, np.zeros(n_robot),
    )  # fmt: skip
    for r in range(n_robot):
        x, y = xy[held[r]] if held[r] >= 0 else start_xy[r]
        _add(ways, r, x, y, held[r] >= 0)
    return ways


@inlined_kernel
def _has_twice(chain, n):
    """Whether one of the first n robots of a chain comes again."""
    for k in range(n):
        for m in range(k):
            if chain[k] == chain[m]:
                return True
    return False


@inlined_kernel
def _find_chain(i, cost, own_pair, reach_first, reach_robot, is_usable, held, gain, via, chain):
    """The cheapest way for a robot to be rid of its target: another takes it, whose target a third takes, and so on.

    The last of the chain has no target, and then the first has none after it; or the first takes that of the last.

    Parameters
    ----------
    cost, is_usable
        (n_pair,) what robot and target cost together, and whether they may.
    own_pair
        (n_robot,) pair that each robot holds, or -1.
    gain, via
        (N_LEVEL, n_robot) room for the search.
    chain
        (N_LEVEL + 1,) filled in: each robot takes the target of the one before it, the first that of the last.

    Returns
    -------
        Cost that is added, and number of robots in the chain (0: there is none).
    """
    gain[:] = np.inf
    best, best_level, last = np.inf, -1, -1
    for level in range(N_LEVEL):
        for r in range(len(held)):
            base = 0.0 if level == 0 and r == i else np.inf if level == 0 else gain[level - 1, r]
            if base == np.inf or held[r] < 0:
                continue
            for p in range(reach_first[held[r]], reach_first[held[r] + 1]):
                q = reach_robot[p]
                if not is_usable[p] or q == r:
                    continue
                total = base + cost[p] - (cost[own_pair[q]] if own_pair[q] >= 0 else 0.0)
                if q == i:
                    if total < best:
                        best, best_level, last = total, level - 1, r
                elif total < gain[level, q]:
                    gain[level, q], via[level, q] = total, r
                    if held[q] < 0 and total - cost[own_pair[i]] < best:
                        best, best_level, last = total - cost[own_pair[i]], level, q
    if last < 0:
        return np.inf, 0
    chain[0], r = i, last
    for level in range(best_level, -1, -1):
        chain[level + 1] = r
        r = via[level, r]
    n = best_level + 2
    return (np.inf, 0) if _has_twice(chain, n) else (best, n)


@inlined_kernel
def _find_spare(i, cost, own_pair, reach_first, reach_robot, is_usable, near_first, near, spare_target, held, holder):
    """The cheapest spare target in the place of a robot's own: (cost added, target), (inf, -1) if there is none."""
    best, found, is_spare = np.inf, -1, False
    for t in spare_target:
        is_spare = is_spare or t == held[i]
    if not is_spare:
        return best, found
    for t in spare_target:
        is_free = holder[t] < 0
        for k in range(near_first[t], near_first[t + 1]):
            is_free = is_free and (holder[near[k]] < 0 or holder[near[k]] == i)
        for p in range(reach_first[t], reach_first[t + 1] if is_free else reach_first[t]):
            if reach_robot[p] == i and is_usable[p] and cost[p] - cost[own_pair[i]] < best:
                best, found = cost[p] - cost[own_pair[i]], t
    return best, found


@inlined_kernel
def _pair_of(r, t, reach_first, reach_robot):
    """The pair of a robot and a target that it reaches."""
    for p in range(reach_first[t], reach_first[t + 1]):
        if reach_robot[p] == r:
            return p
    return -1


@inlined_kernel
def _price(t, start_xy, park_xy, xy, half_power, park_pull, reach_first, reach_robot, longest, cost, is_usable):
    """Fill in what a target costs each robot that reaches it, and bar ways beyond the longest."""
    for p in range(reach_first[t], reach_first[t + 1]):
        r = reach_robot[p]
        d0 = np.hypot(xy[t, 0] - start_xy[r, 0], xy[t, 1] - start_xy[r, 1])
        d1 = np.hypot(xy[t, 0] - park_xy[r, 0], xy[t, 1] - park_xy[r, 1])
        cost[p] = d0 ** (2.0 * half_power) + park_pull * d1 ** (2.0 * half_power)
        is_usable[p] = is_usable[p] and d0 <= longest[0] and d1 <= longest[1]


@inlined_kernel
def _most_tangled(ways, held, is_stuck):
    """The robot with a target that is most in others' way, of those not stuck; -1 if none is enough."""
    i = -1
    for r in range(len(held)):
        may = held[r] >= 0 and not is_stuck[r] and ways.tangle[r] >= LEAST_TANGLE
        if may and (i < 0 or ways.tangle[r] > ways.tangle[i]):
            i = r
    return i


@inlined_kernel
def _follow(chain, freed, start_xy, xy, reach_first, reach_robot, travel, ways, held, holder, own_pair):
    """Give each robot of a chain the target of the one before it, the first the target freed; the travel that is added."""
    added = 0.0
    for r in chain:
        _remove(ways, r)
        added -= travel[own_pair[r]] if own_pair[r] >= 0 else 0.0
    for k in range(len(chain) - 1, -1, -1):
        held[chain[k]] = held[chain[k - 1]] if k > 0 else freed
    for r in chain:
        t = held[r]
        own_pair[r] = -1
        x, y = start_xy[r, 0], start_xy[r, 1]
        if t >= 0:
            holder[t], own_pair[r] = r, _pair_of(r, t, reach_first, reach_robot)
            added += travel[own_pair[r]]
            x, y = xy[t, 0], xy[t, 1]
        _add(ways, r, x, y, t >= 0)
    return added


@kernel
def untangle(
    start_xy, park_xy, is_live, xy, half_power, park_pull, reach_first, reach_robot, is_pair_open,
    near_first, near, spare_target, radius, held,
):  # fmt: skip
    """Exchange targets among robots, or one for a spare target, while that leaves fewer robots in each other's way.

    A robot in another's way is charged for its target, and the cheapest chain of exchanges that rids it of it is made; of
    all states on the way that of least travel and tangles is kept. No way grows beyond the longest. Every target stays
    held; spare ones may take each other's place.

    Parameters
    ----------
    start_xy, park_xy, is_live
        (n_robot, 2) twice, mm, and (n_robot,).
    xy
        (n_target, 2) mm.
    half_power, park_pull
        P / 2; weight of the distance from park, as in `match_open`.
    reach_first, reach_robot, is_pair_open
        Robots that reach each target; (n_pair,) pairs that may be used.
    near_first, near
        Lists of targets too close to each target.
    spare_target
        (n_spare,) targets that may replace each other: guide stars.
    radius
        Least separation, mm.
    held
        (n_robot,) target of each robot or -1; changed.

    Returns
    -------
        Sum of the tangles before and after.
    """
    n_robot = len(held)
    ways = _make_ways(start_xy, park_xy, is_live, xy, radius, held)
    at_first = ways.tangle.sum() / 2.0
    if ways.tangle.max() < LEAST_TANGLE:
        return at_first, at_first
    holder, own_pair = np.full(len(xy), -1, np.int64), np.full(n_robot, -1, np.int64)
    cost, is_usable = np.empty(len(reach_robot)), is_pair_open.copy()
    # No other target changes hands.
    for t in np.concatenate((held[held >= 0], spare_target)):
        _price(
            t, start_xy, park_xy, xy, half_power, park_pull, reach_first, reach_robot, ways.longest, cost, is_usable
        )  # fmt: skip
    for r in range(n_robot):
        if held[r] >= 0:
            holder[held[r]], own_pair[r] = r, _pair_of(r, held[r], reach_first, reach_robot)
    travel = cost.copy()
    worth = TANGLE_WORTH * (ways.longest[0] ** (2.0 * half_power) + park_pull * ways.longest[1] ** (2.0 * half_power))
    gain, via = np.empty((N_LEVEL, n_robot)), np.empty((N_LEVEL, n_robot), np.int64)
    chain = np.empty(N_LEVEL + 1, np.int64)
    state, best, best_tangle, best_held = 0.0, worth * at_first, at_first, held.copy()
    is_stuck = np.zeros(n_robot, np.bool_)
    step = 0
    while step < N_STEP:
        step += 1
        i = _most_tangled(ways, held, is_stuck)
        if i < 0:
            break
        cost[own_pair[i]] += worth * ways.tangle[i]
        added, n = _find_chain(i, cost, own_pair, reach_first, reach_robot, is_usable, held, gain, via, chain)
        by_spare, spare = _find_spare(
            i, cost, own_pair, reach_first, reach_robot, is_usable, near_first, near, spare_target, held, holder
        )
        if min(added, by_spare) >= 0.0:
            is_stuck[i] = True
            continue
        is_stuck[:] = False
        freed = held[chain[n - 1]]
        if by_spare < added:
            holder[held[i]] = -1
            chain[0], n, freed = i, 1, spare
        state += _follow(
            chain[:n], freed, start_xy, xy, reach_first, reach_robot, travel, ways, held, holder, own_pair
        )  # fmt: skip
        tangle = ways.tangle.sum() / 2.0
        if state + worth * tangle < best - 1e-9 * worth:
            best, best_tangle, step = state + worth * tangle, tangle, 0
            best_held[:] = held
    held[:] = best_held
    return at_first, best_tangle


@kernel
def tangles_of_places(start_xy, park_xy, is_live, goal_xy, radius, robot, places):
    """(n_place,) sum of a robot's tangles were it to go to each of these places; inf where no way is as long as that.

    Parameters
    ----------
    start_xy, park_xy, goal_xy
        (n_robot, 2) mm: where all robots stand, park and shall go.
    radius
        Least separation, mm.
    places
        (n_place, 2) mm.
    """
    n_robot = len(goal_xy)
    begin = np.empty((N_WAY, n_robot, 2))
    begin[0], begin[1] = start_xy, park_xy
    unit, length, longest = np.zeros((N_WAY, n_robot, 2)), np.zeros((N_WAY, n_robot)), np.zeros(N_WAY)
    for w in range(N_WAY):
        for r in range(n_robot):
            if not is_live[r]:
                begin[w, r] = start_xy[r]
            _set_way(begin[w, r], goal_xy[r, 0], goal_xy[r, 1], unit[w, r], length[w], r)
            if r != robot:
                longest[w] = max(longest[w], length[w, r])
    ways = Ways(
        begin, unit, length, longest, ~is_live, np.ones((N_WAY, n_robot), np.bool_), radius, np.zeros(n_robot)
    )  # fmt: skip
    total = np.zeros(len(places))
    for k in range(len(places)):
        for w in range(N_WAY):
            _set_way(begin[w, robot], places[k, 0], places[k, 1], unit[w, robot], length[w], robot)
            if length[w, robot] > longest[w]:
                total[k] = np.inf
            for q in range(n_robot):
                if q != robot and total[k] < np.inf:
                    total[k] += _pair_tangle(ways, w, robot, q)
    return total
