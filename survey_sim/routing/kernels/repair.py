"""Robots in conflict are planned again, one at a time, for the least weight of conflicts."""

# Kernels take flat arrays and untyped scalars, and are long where splitting them would cost calls.
# ruff: noqa: PLR0912
# mypy: disable-error-code="no-untyped-def"
import numpy as np

from survey_sim.kernel import inner_kernel, kernel
from survey_sim.routing.kernels.conflicts import conflict_score, find_near, pair_radius, pair_weight, present_score, set_plan
from survey_sim.routing.kernels.delays import SAME_DELAY_S, forbidden_delays
from survey_sim.routing.kernels.planned import MAX_LATTICE_LEGS, PLAN, arrival, delay_from
from survey_sim.routing.kernels.shapes import direct_shape, sample_shape

# What a conflict's weight gains at each low point that it survives.
WEIGHT_GAIN = 0.3
MAX_INTERVALS = 12
MAX_EVENTS = 1024
# Room for the forbidden intervals of one plan against everybody (lo, hi, robot), for those of one pair, and for knot times.
ROOM = np.dtype(
    [
        ("lo", np.float64, (MAX_EVENTS,)),
        ("hi", np.float64, (MAX_EVENTS,)),
        ("robot", np.int64, (MAX_EVENTS,)),
        ("pair_lo", np.float64, (MAX_INTERVALS,)),
        ("pair_hi", np.float64, (MAX_INTERVALS,)),
        ("late_t", np.float64, (3 * MAX_LATTICE_LEGS + 3,)),
    ],
    align=True,
)


@inner_kernel
def best_delay(robots, plan, weight, rng, me, near, shape, late_leg, delay_max, separation, margin, limit, room):
    """Least score of conflicts over delays of a shape from one leg on, and the delay that has it; inf if not below `limit`.

    Zero is found wherever it is: conflicts end only at the ends of forbidden intervals. Otherwise these, the extremes and
    one delay at random are scored.

    Parameters
    ----------
    weight
        (n,) weights of robot `me` with each other.
    near
        Robots that it may meet.
    """
    n_event, n_knot, box = 0, shape.n_knot, shape.box
    leave = shape.leave[late_leg]
    always = 0.0
    r = separation + margin
    x0, x1, y0, y1 = box[0] - r, box[1] + r, box[2] - r, box[3] + r
    for k in range(len(near)):
        j = near[k]
        other = plan[j]
        if other.box[0] > x1 or other.box[1] < x0 or other.box[2] > y1 or other.box[3] < y0:
            continue
        m = forbidden_delays(
            shape.kt, shape.kx, shape.ky, n_knot, leave, other.kt, other.kx, other.ky, other.n_knot, other.box,
            pair_radius(me, robots[j], separation, margin), delay_max, room.pair_lo, room.pair_hi,
        )  # fmt: skip
        for p in range(m):
            if room.pair_lo[p] < 0.0 and room.pair_hi[p] > delay_max:
                always += 0.5 * pair_weight(robots, weight, j)
                if always >= limit:
                    return np.inf, 0.0
            if n_event < MAX_EVENTS:
                room.lo[n_event], room.hi[n_event], room.robot[n_event] = room.pair_lo[p], room.pair_hi[p], j
                n_event += 1
    least, best = limit, -1.0
    for c in range(-3 if always > 0.0 else -1, n_event):
        if c == -1:
            delay = 0.0
        elif c == -2:
            delay = delay_max
        elif c == -3:
            delay = delay_max * rng.random()
        else:
            delay = room.hi[c]
        if delay > delay_max:
            continue
        total = 0.0
        for k in range(n_event):
            if _is_forbidden(room, k, delay):
                total += 0.5 * pair_weight(robots, weight, room.robot[k])
        if total >= least:
            continue
        if total > 0.0:
            total = 0.0
            for k in range(n_knot):
                room.late_t[k] = shape.kt[k] + (delay if k > leave else 0.0)
            for k in range(n_event):
                if _is_forbidden(room, k, delay):
                    j = room.robot[k]
                    wide = pair_radius(me, robots[j], separation, margin)
                    heavy = pair_weight(robots, weight, j)
                    total += conflict_score(heavy, room.late_t, shape.kx, shape.ky, n_knot, plan[j], wide)
        if total < least or (total == least and delay < best):
            least, best = total, delay
    if best < 0.0:
        return np.inf, 0.0
    return least, best


@inner_kernel
def _is_forbidden(room, k, delay):
    """Whether interval k holds the delay; at 0 an interval that starts there counts too."""
    lo = room.lo[k]
    return (lo < delay - 1e-12 or lo <= 0.0) and delay + 1e-12 < room.hi[k]


@inner_kernel
def _pick_partner(rng, conflict):
    """One of the robots in conflict, of a row, or -1."""
    partner, n_seen = -1, 0
    for j in range(len(conflict)):
        if conflict[j]:
            n_seen += 1
            if rng.random() * n_seen < 1.0:
                partner = j
    return partner


@inner_kernel
def replan(phys, plans, rng, i, duration, n_sample, least, separation, margin, scratch, room, near):
    """Plan robot i again within `duration`, if the score of its conflicts falls below `least`; returns the score.

    The direct shapes are tried, then sampled detours. `scratch` is room for two plans.
    """
    robots, plan, weight = plans.robot, plans.plan, plans.weight[i]
    has_found = _replan(
        phys,
        robots,
        plan,
        plans.conflict,
        weight,
        rng,
        i,
        duration,
        n_sample,
        least,
        separation,
        margin,
        scratch,
        room,
        near,
    )
    if has_found == np.inf:
        return np.inf
    set_plan(plans, i, scratch[1], separation, margin)
    return has_found


@inner_kernel
def _replan(
    phys, robots, plan, conflict, weight, rng, i, duration, n_sample, least, separation, margin, scratch, room, near
):  # fmt: skip
    """The search of `replan`; leaves the best plan in scratch[1] and returns its score, inf if there is none."""
    me, own, shape, space = robots[i], plan[i], scratch[0], room[0]
    partner = _pick_partner(rng, conflict[i]) if n_sample > 0 else -1
    n_near = find_near(phys, robots, plan, conflict, i, duration, separation, margin, near)
    found = np.inf
    for option in range(3 + n_sample):
        late_leg = 0
        if option < 3:
            t = direct_shape(phys, me, option, shape)
        else:
            t, late_leg = sample_shape(phys, me, own, plan[max(partner, 0)], partner >= 0, rng, duration, separation, shape)
        if t > duration + SAME_DELAY_S:
            continue
        delay_max = max(0.0, duration - t)
        score, delay = best_delay(
            robots, plan, weight, rng, me, near[:n_near], shape, late_leg, delay_max, separation, margin, least, space
        )
        if score < least:
            least = found = score
            delay_from(shape, late_leg, delay)
            scratch[1] = scratch[0]
            if score == 0.0:
                break
        if shape.n_leg == 0 and n_sample == 0:
            break
    return found


@kernel
def begin(phys, plans, rng, duration, n_sample, separation, margin):
    """Plan again robots that are late, then those in conflict by the delays of their direct shapes."""
    n = len(plans.robot)
    scratch, room, near = np.zeros(2, PLAN), np.empty(1, ROOM), np.empty(n, dtype=np.int64)
    for i in range(n):
        if arrival(plans.plan[i]) > duration + SAME_DELAY_S:
            replan(phys, plans, rng, i, duration, n_sample, np.inf, separation, margin, scratch, room, near)
    # Robots with most time to spare first: they have most delays to choose from.
    order = np.argsort(plans.robot["alone"])
    for _ in range(2):
        for i in order:
            if plans.n_conflict[i] > 0 and plans.robot[i].is_free:
                limit = present_score(plans, i, separation, margin)
                replan(phys, plans, rng, i, duration, 0, limit, separation, margin, scratch, room, near)


@kernel
def repair(phys, plans, rng, duration, n_step, n_sample, separation, margin):
    """Plan robots that are in conflict again until none is; returns the number of steps, -1 if they were too few."""
    n = len(plans.robot)
    scratch, room, near = np.zeros(2, PLAN), np.empty(1, ROOM), np.empty(n, dtype=np.int64)
    for step in range(n_step + 1):
        i, seen = -1, 0.0
        for k in range(n):
            if plans.n_conflict[k] > 0 and plans.robot[k].is_free:
                # Who has no time to spare has few ways to choose from.
                share = min(1.0, max(0.1, duration - plans.robot[k].alone))
                seen += share
                if rng.random() * seen < share:
                    i = k
        if i < 0:
            return step
        if step == n_step:
            break
        # Only downwards; the conflicts that survive at a low point weigh more from then on, until it is none.
        limit = present_score(plans, i, separation, margin)
        after = replan(phys, plans, rng, i, duration, n_sample, limit, separation, margin, scratch, room, near)
        if after >= limit:
            for j in range(n):
                if plans.conflict[i, j]:
                    plans.weight[i, j] += WEIGHT_GAIN
                    plans.weight[j, i] += WEIGHT_GAIN
    return -1
