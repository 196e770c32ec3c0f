"""Pairs taken in order, targets picked apart from each other, ways that cross, and why a target was not held."""

# mypy: allow-untyped-defs

import numpy as np

from survey_sim.kernel import kernel


@kernel
def segments_cross(ax, ay, bx, by, cx, cy, dx, dy):
    """Whether segments a-b and c-d cross; ends that touch do not (a robot may take the place that another leaves)."""
    if max(ax, bx) < min(cx, dx) or max(cx, dx) < min(ax, bx) or max(ay, by) < min(cy, dy) or max(cy, dy) < min(ay, by):
        return False
    c_side = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    d_side = (bx - ax) * (dy - ay) - (by - ay) * (dx - ax)
    a_side = (dx - cx) * (ay - cy) - (dy - cy) * (ax - cx)
    b_side = (dx - cx) * (by - cy) - (dy - cy) * (bx - cx)
    return c_side * d_side < 0.0 and a_side * b_side < 0.0


@kernel
def crossings(start_mm, end_mm):
    """Number of pairs of robots whose straight ways cross.

    Parameters
    ----------
    start_mm, end_mm
        (n_robot, 2) mm. A robot that does not move crosses none.
    """
    n = 0
    for i in range(len(start_mm)):
        for j in range(i):
            n += segments_cross(
                start_mm[i, 0], start_mm[i, 1], end_mm[i, 0], end_mm[i, 1],
                start_mm[j, 0], start_mm[j, 1], end_mm[j, 0], end_mm[j, 1],
            )  # fmt: skip
    return n


@kernel
def pairs_by_distance(is_wanted, is_pair_open, is_free, reach_first, reach_robot, start_xy, xy):
    """Usable pairs of free robots and wanted targets, the nearest first: robots and targets, (n_pair,) each.

    Parameters
    ----------
    is_wanted, is_pair_open, is_free
        (n_target,), (n_all,) and (n_robot,) which targets, entries of `reach_robot` and robots.
    reach_first, reach_robot
        Lists of the robots that reach each target; of pairs as far apart, the first here comes first.
    start_xy, xy
        (n_robot, 2) and (n_target, 2) mm.
    """
    n = 0
    for t in range(len(is_wanted)):
        if is_wanted[t]:
            n += reach_first[t + 1] - reach_first[t]
    robot, target, d2 = np.empty(n, np.int32), np.empty(n, np.int64), np.empty(n)
    n = 0
    for t in range(len(is_wanted)):
        if is_wanted[t]:
            for p in range(reach_first[t], reach_first[t + 1]):
                r = reach_robot[p]
                if is_free[r] and is_pair_open[p]:
                    dx, dy = xy[t, 0] - start_xy[r, 0], xy[t, 1] - start_xy[r, 1]
                    robot[n], target[n], d2[n] = r, t, dx * dx + dy * dy
                    n += 1
    order = np.argsort(d2[:n], kind="mergesort")
    return robot[order], target[order]


@kernel
def take_in_order(pair_robot, pair_target, limit, first, near, start_xy, xy, shuns_crossings, is_open, held):
    """Go through pairs of robot and target in the order given, and take each one that still can be.

    A pair can be taken while its robot is free, its target is open and, if crossings are shunned, the robot's way crosses
    none that was taken before. A target that is taken closes itself and all that are near it.

    Parameters
    ----------
    pair_robot, pair_target
        (n_pair,) indices, best first.
    limit
        Most pairs to take.
    first, near
        Lists of targets near each target (`near_lists`).
    start_xy, xy
        (n_robot, 2) and (n_target, 2) mm.
    shuns_crossings
        Whether a pair whose way crosses another's is left out.
    is_open
        (n_target,) bool; changed.
    held
        (n_robot,) target of each robot or -1; changed.

    Returns
    -------
        Number of pairs taken.
    """
    n_taken = 0
    for p in range(len(pair_robot)):
        if n_taken >= limit:
            break
        r, t = pair_robot[p], pair_target[p]
        if held[r] >= 0 or not is_open[t]:
            continue
        if shuns_crossings and _crosses_held(r, t, start_xy, xy, held):
            continue
        held[r] = t
        n_taken += 1
        is_open[t] = False
        for k in range(first[t], first[t + 1]):
            is_open[near[k]] = False
    return n_taken


@kernel
def _crosses_held(r, t, start_xy, xy, held):
    for q in range(len(held)):
        if q != r and held[q] >= 0:
            u = held[q]
            if segments_cross(
                start_xy[r, 0], start_xy[r, 1], xy[t, 0], xy[t, 1],
                start_xy[q, 0], start_xy[q, 1], xy[u, 0], xy[u, 1],
            ):  # fmt: skip
                return True
    return False


@kernel
def _is_near_marked(t, first, near, is_marked):
    """Whether any target near t is marked (n_target,)."""
    for k in range(first[t], first[t + 1]):  # noqa: SIM110 - a kernel has no any() of a generator
        if is_marked[near[k]]:
            return True
    return False


@kernel
def pick_apart(candidates, limit, first, near, is_open, is_picked):
    """Pick targets in the order given, none near one picked before; the number picked now.

    Parameters
    ----------
    candidates, limit
        (n,) targets, best first; most to pick.
    first, near
        Lists of near targets.
    is_open, is_picked
        (n_target,) may be picked; picked so far (changed).
    """
    n = 0
    for t in candidates:
        if n >= limit:
            break
        if is_open[t] and not is_picked[t] and not _is_near_marked(t, first, near, is_picked):
            is_picked[t] = True
            n += 1
    return n


@kernel
def note_lost(held, is_open, is_science, priority, first, near, reach_first, reach_robot, n_clear, lowest):
    """Keep what tells later why a target was lost: whether it had room, and whom its robots served instead.

    Parameters
    ----------
    held
        (n_robot,) target of each robot or -1 in one visit.
    is_open, is_science, priority
        (n_target,) still wanted; science; 1 to 9.
    first, near, reach_first, reach_robot
        Lists of near targets and of robots in reach.
    n_clear
        (n_target,) visits in which no target near it was held; changed.
    lowest
        (n_target,) least priority that a robot in its reach served in a visit in which it had room; changed.
    """
    is_held = np.zeros(len(is_open), np.bool_)
    for t in held:
        if t >= 0:
            is_held[t] = True
    for t in range(len(is_open)):
        if not is_open[t] or is_held[t] or _is_near_marked(t, first, near, is_held):
            continue
        n_clear[t] += 1
        for k in range(reach_first[t], reach_first[t + 1]):
            u = held[reach_robot[k]]
            if u < 0:
                lowest[t] = 0
            elif is_science[u]:
                lowest[t] = min(lowest[t], priority[u])
