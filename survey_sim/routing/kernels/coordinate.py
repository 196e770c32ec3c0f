"""Coordinated routing: the duration in which all robots find their ways.

Two that have no plan within some duration even alone are in conflict whatever the others do: they say how much longer it
takes.
"""

# Kernels take flat arrays and untyped scalars, and are long where splitting them would cost calls.
# ruff: noqa: PLR0912
# mypy: disable-error-code="no-untyped-def"
from typing import NamedTuple

import numpy as np

from survey_sim.kernel import kernel
from survey_sim.routing.kernels.conflicts import copy_plans, last_arrival, set_plan, stand_still
from survey_sim.routing.kernels.delays import SAME_DELAY_S
from survey_sim.routing.kernels.planned import PLAN
from survey_sim.routing.kernels.repair import begin, repair
from survey_sim.routing.kernels.shapes import start_directly

# How the search of `coordinate` ended.
FOUND, NOT_FOUND, GIVEN_UP = range(3)
MAX_PAIRS = 64
# Longer durations of a pair: the first by this share of the bound, then twice as much; found to within the second share.
FIRST_PAIR_FRAC = 0.01
PAIR_FRAC = 0.002
# A pair that no longer plan is looked for needs less than the first share of the bound more, or about the second.
NEAR_FRAC, FAR_FRAC = 0.05, 0.1
# First stride above what the pairs need, as a share of it; each is twice the one before, up to this many times the bound.
FIRST_STRIDE_FRAC = 0.003
MOST_STRIDES = 6.0
# Pairs may raise the duration so often, each time by as little as they like; strides follow, so that the search ends.
MAX_RAISES = 30
# Shares are of the bound, or of this if it is longer: a field of short hops may need long detours.
SHORT_S = 10.0
# Back down: by this share of the way to the longest duration that failed, but at least by this share of the bound.
DESCENT_FRAC = 0.4
CLOSE_FRAC = 0.003


class Effort(NamedTuple):
    """How long coordinated routing searches.

    Attributes
    ----------
    sample
        Detours tried at each step of repair.
    first
        Steps at the bound before pairs in conflict are looked at alone.
    pair
        Steps in which two robots find their way at one duration, if there is one.
    quick
        Steps of all robots at one duration.
    shorten
        Steps spent on shortening plans that were not found at the bound.
    exceeds
        Whether longer plans are looked for at all; if not, the first pair that has none at the bound ends the search.
    """

    sample: int
    first: int
    pair: int
    quick: int
    shorten: int
    exceeds: bool = True


@kernel
def tasks_of_pair(phys, robots, i, j, duration, separation):
    """Tasks of robots i and j, and of those that cannot move near them."""
    n = len(robots)
    members = np.empty(n, dtype=np.int64)
    members[0], members[1], n_member = i, j, 2
    far = 0.5 * duration * phys.coarse + separation
    for k in range(n):
        if robots[k].is_free or k in (i, j):
            continue
        for m in members[:2]:
            x = 0.5 * (robots[m].sx + robots[m].gx) - robots[k].sx
            y = 0.5 * (robots[m].sy + robots[m].gy) - robots[k].sy
            if robots[m].is_free and x * x + y * y < far * far:
                members[n_member] = k
                n_member += 1
                break
    return robots[members[:n_member]]


@kernel
def least_of_pair(phys, plans, rng, i, j, low, effort, separation, margin):
    """Least duration from `low` on in which robots i and j are found to do without a conflict, were they alone.

    Where that is longer, robots i and j are given the plans that do; if none longer is looked for, only about how long.
    """
    tasks = tasks_of_pair(phys, plans.robot, i, j, low, separation)
    pair = stand_still(tasks, np.zeros(len(tasks), PLAN))
    start_directly(phys, pair, separation, margin)
    begin(phys, pair, rng, low, effort.sample, separation, margin)
    if repair(phys, pair, rng, low, effort.pair, effort.sample, separation, margin) >= 0:
        return low
    if not effort.exceeds:
        return _about_least(phys, pair, rng, low, effort, separation, margin)
    kept = stand_still(tasks, np.zeros(len(tasks), PLAN))
    unit = max(low, SHORT_S)
    failed, found, more = low, np.inf, FIRST_PAIR_FRAC * unit
    # Plans may end so much later than the duration that they were made for; that is no longer duration.
    while found > low + SAME_DELAY_S:
        if found == np.inf:
            trial = low + more
        elif found - failed > PAIR_FRAC * unit:
            trial = 0.5 * (found + failed)
        else:
            # A failure may have been bad luck: once more, a little lower and for longer.
            trial, failed = max(low, found - FIRST_PAIR_FRAC * unit), -np.inf
        n_step = effort.pair if failed > 0.0 else 2 * effort.pair
        begin(phys, pair, rng, trial, effort.sample, separation, margin)
        if repair(phys, pair, rng, trial, n_step, effort.sample, separation, margin) >= 0:
            copy_plans(pair, kept)
            found, failed = last_arrival(pair), max(low, failed)
        elif failed < 0.0:
            break
        else:
            failed = trial
            if found < np.inf:
                copy_plans(kept, pair)
            elif more > MOST_STRIDES * unit:
                return low
            more *= 2.0
    for k, m in ((0, i), (1, j)):
        if plans.robot[m].is_free:
            set_plan(plans, m, kept.plan[k], separation, margin)
    return found if found > low + SAME_DELAY_S else low


@kernel
def _about_least(phys, pair, rng, low, effort, separation, margin):
    """About the duration that a pair needs that has no plan within `low`: near it or far."""
    near = low * (1.0 + NEAR_FRAC)
    begin(phys, pair, rng, near, effort.sample, separation, margin)
    is_near = repair(phys, pair, rng, near, effort.pair, effort.sample, separation, margin) >= 0
    return min(near, last_arrival(pair)) if is_near else low * (1.0 + FAR_FRAC)


@kernel
def least_of_pairs(phys, plans, rng, low, effort, separation, margin, slow_pair):
    """Least duration from `low` on in which each pair now in conflict is found to do without one, were it alone.

    A pair that cannot do in the present duration is in conflict whatever the others do, so no other pair need be looked at.
    Where that is longer, `slow_pair` (2,) is filled with the pair that needs it; with the first in conflict if it is empty.
    """
    n = len(plans.robot)
    n_pair = 0
    pairs = np.empty((MAX_PAIRS, 2), dtype=np.int64)
    for i in range(n):
        for j in range(i):
            if plans.conflict[i, j] and n_pair < MAX_PAIRS:
                pairs[n_pair, 0], pairs[n_pair, 1] = i, j
                n_pair += 1
    if n_pair > 0 and slow_pair[0] < 0:
        slow_pair[:] = pairs[0]
    for k in range(n_pair):
        least = least_of_pair(phys, plans, rng, pairs[k, 0], pairs[k, 1], low, effort, separation, margin)
        if least > low:
            low = least
            slow_pair[:] = pairs[k]
            if not effort.exceeds:
                break
    return low


@kernel
def coordinate(phys, plans, rng, bound, effort, separation, margin, slow_pair):
    """Plans without conflict, as near to `bound` as is found: FOUND, NOT_FOUND or GIVEN_UP, and about the duration needed.

    First at the bound; where that fails, at the least duration of the pairs in conflict, each alone; then at longer ones,
    in strides, since those that fail cost most; then back down from plans that hold, part of the way to what failed or a
    little, again and again until `effort.shorten` steps are used. `slow_pair` (2,) is filled as by `least_of_pairs`.
    """
    begin(phys, plans, rng, bound, effort.sample, separation, margin)
    if repair(phys, plans, rng, bound, effort.first, effort.sample, separation, margin) >= 0:
        return FOUND, bound
    unit = max(bound, SHORT_S)
    low = least_of_pairs(phys, plans, rng, bound, effort, separation, margin, slow_pair)
    duration, failed, more, n_raise = low, bound, FIRST_STRIDE_FRAC * unit, 0
    while True:
        if duration > bound and not effort.exceeds:
            return GIVEN_UP, duration
        if duration > bound:
            begin(phys, plans, rng, duration, effort.sample, separation, margin)
        if repair(phys, plans, rng, duration, effort.quick, effort.sample, separation, margin) >= 0:
            break
        failed = duration
        raised = least_of_pairs(phys, plans, rng, duration, effort, separation, margin, slow_pair)
        if raised > duration and n_raise < MAX_RAISES:
            low = duration = raised
            n_raise += 1
        else:
            if more > MOST_STRIDES * unit:
                return NOT_FOUND, duration
            duration = low + more
            more *= 2.0
    kept = stand_still(plans.robot, np.zeros(len(plans.robot), PLAN))
    copy_plans(plans, kept)
    found, done = last_arrival(kept), 0
    while done < effort.shorten and found > bound + SAME_DELAY_S:
        trial = max(bound, found - max(DESCENT_FRAC * (found - max(failed, low)), CLOSE_FRAC * unit))
        is_below = trial < low
        if is_below and found > low + SAME_DELAY_S:
            trial, is_below = low, False
        begin(phys, plans, rng, trial, effort.sample, separation, margin)
        used = repair(phys, plans, rng, trial, effort.quick, effort.sample, separation, margin)
        if used >= 0:
            copy_plans(plans, kept)
            found = last_arrival(kept)
            done += used + 1
        else:
            copy_plans(kept, plans)
            failed = max(failed, trial)
            # Below what the pairs were found to need, a second failure is as good as certain.
            done += effort.shorten if is_below else effort.quick
    return FOUND, found
