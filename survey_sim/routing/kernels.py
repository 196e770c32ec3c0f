"""Compiled geometry of routing. All kernels that call each other are here: the compiler's cache does not notice an edit in
another file.
"""

# Kernels take flat arrays and untyped scalars, and are long where splitting them would cost calls.
# ruff: noqa: PLR0912, PLR0915, PLW3301, SIM110
# mypy: disable-error-code="no-untyped-def"
from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np
from numba import njit


@njit(cache=True)
def _point_segment2(px, py, ax, ay, bx, by):
    """Squared distance of a point from a segment, mm^2."""
    ux, uy = bx - ax, by - ay
    uu = ux * ux + uy * uy
    s = 0.0
    if uu > 0.0:
        s = min(1.0, max(0.0, ((px - ax) * ux + (py - ay) * uy) / uu))
    ex, ey = px - ax - s * ux, py - ay - s * uy
    return ex * ex + ey * ey


@njit(cache=True)
def _segment_segment2(a, b, c, d):
    """Squared distance of segments a-b and c-d, mm^2; 0 where they cross."""
    ux, uy, wx, wy = b[0] - a[0], b[1] - a[1], d[0] - c[0], d[1] - c[1]
    side_c = ux * (c[1] - a[1]) - uy * (c[0] - a[0])
    side_d = ux * (d[1] - a[1]) - uy * (d[0] - a[0])
    side_a = wx * (a[1] - c[1]) - wy * (a[0] - c[0])
    side_b = wx * (b[1] - c[1]) - wy * (b[0] - c[0])
    if side_c * side_d < 0.0 and side_a * side_b < 0.0:
        return 0.0
    return min(
        min(_point_segment2(a[0], a[1], c[0], c[1], d[0], d[1]), _point_segment2(b[0], b[1], c[0], c[1], d[0], d[1])),
        min(_point_segment2(c[0], c[1], a[0], a[1], b[0], b[1]), _point_segment2(d[0], d[1], a[0], a[1], b[0], b[1])),
    )


@njit(cache=True)
def simple_vector_batches(start, goal, has_to_move, separation):
    """(n,) batch in which each robot goes straight to its goal, -1 for those that stay.

    A batch holds robots whose swept lines keep the separation from each other, whatever their timing, and from all that
    stand meanwhile. Robots with fewest crossings join first.
    """
    n = len(start)
    r2 = separation * separation
    is_crossing = np.zeros((n, n), dtype=np.bool_)
    n_crossing = np.zeros(n, dtype=np.int64)
    for i in range(n):
        for j in range(i):
            if (has_to_move[i] or has_to_move[j]) and _segment_segment2(start[i], goal[i], start[j], goal[j]) < r2:
                is_crossing[i, j] = is_crossing[j, i] = True
                n_crossing[i] += 1
                n_crossing[j] += 1
    order = np.argsort(n_crossing, kind="mergesort")
    batch = np.full(n, -1, dtype=np.int64)
    now = start.copy()
    members = np.empty(n, dtype=np.int64)
    k = 0
    while True:
        n_member = 0
        for i in order:
            if not has_to_move[i] or batch[i] >= 0:
                continue
            is_clear = True
            for j in range(n):
                if j == i:
                    continue
                if batch[j] == k:
                    blocked = is_crossing[i, j]
                else:
                    blocked = _point_segment2(now[j, 0], now[j, 1], start[i, 0], start[i, 1], goal[i, 0], goal[i, 1]) < r2
                if blocked:
                    is_clear = False
                    break
            if is_clear:
                batch[i] = k
                members[n_member] = i
                n_member += 1
        if n_member == 0:
            return batch
        for m in range(n_member):
            now[members[m]] = goal[members[m]]
        k += 1


@njit(cache=True)
def has_near(position, least):
    """(n,) whether another robot is nearer than `least`."""
    n = len(position)
    near = np.zeros(n, dtype=np.bool_)
    for i in range(n):
        for j in range(i):
            ex, ey = position[i, 0] - position[j, 0], position[i, 1] - position[j, 1]
            if ex * ex + ey * ey < least * least:
                near[i] = near[j] = True
    return near


# ---------------------------------------------------------------------------------------------------------------------
# Proof that a goal cannot be reached. What a robot may not enter is a union of open discs (fixed robots) and of the outside
# of its patrol disc and of the plate. Start and goal are parted if and only if some closed curve in that union winds around
# just one of them; overlapping parts generate all such curves, and a curve counts by the parity of its crossings of the
# segment from start to goal.


@njit(cache=True)
def _crosses(ax, ay, bx, by, cx, cy, dx, dy):
    """Whether segments a-b and c-d cross; an end on the other's line counts on one side only."""
    side_c = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) >= 0.0
    side_d = (bx - ax) * (dy - ay) - (by - ay) * (dx - ax) >= 0.0
    side_a = (dx - cx) * (ay - cy) - (dy - cy) * (ax - cx) >= 0.0
    side_b = (dx - cx) * (by - cy) - (dy - cy) * (bx - cx) >= 0.0
    return side_c != side_d and side_a != side_b


@njit(cache=True)
def _root(parent, parity, k):
    """Representative of k, and the parity of the way to it."""
    odd = False
    while parent[k] != k:
        odd ^= parity[k]
        k = parent[k]
    return k, odd


@njit(cache=True)
def is_parted(sx, sy, gx, gy, fixed, r, park_x, park_y, reach, plate_radius):
    """Whether fixed robots and the edge of the reach part (sx, sy) from (gx, gy), for any motion at all."""
    n = len(fixed)
    parent = np.arange(n + 1)
    parity = np.zeros(n + 1, dtype=np.bool_)
    for i in range(n):
        x, y = fixed[i, 0], fixed[i, 1]
        for j in range(i + 2):
            # To a fixed robot before it, or (last two) to the outside: of the patrol disc, of the plate.
            if j < i:
                end_x, end_y, other = fixed[j, 0], fixed[j, 1], j
                if (end_x - x) ** 2 + (end_y - y) ** 2 >= 4.0 * r * r:
                    continue
            else:
                ox, oy, edge = (x - park_x, y - park_y, reach) if j == i else (x, y, plate_radius)
                out = np.hypot(ox, oy)
                if out + r <= edge or out == 0.0:
                    continue
                end_x, end_y, other = x + ox / out * r, y + oy / out * r, n
            odd = _crosses(sx, sy, gx, gy, x, y, end_x, end_y)
            a, odd_a = _root(parent, parity, i)
            b, odd_b = _root(parent, parity, other)
            if a != b:
                parent[a] = b
                parity[a] = odd ^ odd_a ^ odd_b
            elif odd ^ odd_a ^ odd_b:
                return True
    return False


# ---------------------------------------------------------------------------------------------------------------------
# Plans: where a robot goes and when, straight between knots. It stands at its first knot before it and at its last knot
# after it. Robots and plans are records: kernels that pass them by pointer run ten times as fast as with a tuple of arrays,
# whose references are counted at every call. A record must not outlive its array, so arrays are made by the callers.

# Legs of a coordinated plan, and of one found step by step on a lattice.
MAX_LEGS = 6
MAX_LATTICE_LEGS = 60
# Delays nearer than this are one: a gap this narrow between forbidden intervals is rounding, not room.
SAME_DELAY_S = 1e-9


class Physics(NamedTuple):
    """Constants of the instrument that kernels need."""

    coarse: float
    precise: float
    rotation: float
    approach: float
    plate_radius: float


# A robot's task: start and goal, its own x axis at the start (hx, hy), its patrol disc, its time alone, s.
ROBOT = np.dtype(
    [(name, np.float64) for name in ("sx", "sy", "gx", "gy", "hx", "hy", "park_x", "park_y", "reach", "alone")]
    + [("is_free", np.bool_)],
    align=True,
)


def plan_type(max_legs: int) -> np.dtype:
    """Records of plans of up to so many legs.

    Way points (x, y), whether the robot turns onto the line to them, and how long it waits before; the knots that they
    give (kt, kx, ky) and their bounding box (least and greatest x, then y). Leg m starts while the robot stands between
    knots leave[m] and leave[m] + 1; leave[0] is -1, the rest before it all.
    """
    n_knot = 3 * max_legs + 3
    per_leg = [("x", np.float64), ("y", np.float64), ("turned", np.int8), ("wait", np.float64), ("leave", np.int64)]
    knots = [(name, np.float64, (n_knot,)) for name in ("kt", "kx", "ky")]
    return np.dtype(
        [("n_leg", np.int64), ("n_knot", np.int64), ("box", np.float64, (4,))]
        + [(name, kind, (max_legs,)) for name, kind in per_leg]
        + knots,
        align=True,
    )


PLAN = plan_type(MAX_LEGS)
LATTICE_PLAN = plan_type(MAX_LATTICE_LEGS)


@njit(cache=True)
def leg_options(phys, hx, hy, ex, ey, is_last):
    """Seconds of one leg along (ex, ey), turned and not turned, for a robot whose own x axis lies along (hx, hy)."""
    along, across = abs(hx * ex + hy * ey), abs(hx * ey - hy * ex)
    straight, square = np.sqrt(ex * ex + ey * ey), along + across
    turn_s = np.degrees(np.arctan2(min(along, across), max(along, across))) / phys.rotation
    turned_s, square_s = turn_s + straight / phys.coarse, square / phys.coarse
    if is_last:
        late = 1.0 / phys.precise - 1.0 / phys.coarse
        turned_s += min(phys.approach, straight) * late
        square_s += min(phys.approach, square) * late
    return turned_s, square_s


@njit(cache=True)
def turned_heading(hx, hy, ex, ey):
    """Where the own x axis of a robot points once that or its own y axis lies along (ex, ey), by the least turn.

    Between two axes it is the one that motion.turn_onto_line takes.
    """
    along, across = hx * ex + hy * ey, hx * ey - hy * ex
    length = np.sqrt(ex * ex + ey * ey)
    if length == 0.0:
        return hx, hy
    if abs(along) > abs(across) or (abs(along) == abs(across) and along * across < 0.0):
        length = np.copysign(length, along)
        return ex / length, ey / length
    length = np.copysign(length, across)
    return ey / length, -ex / length


@njit(cache=True)
def build_knots(phys, robot, plan, n_leg):
    """Knots of a plan's way points; returns the time at the end, infinite if a corner leaves the patrol."""
    return _build_knots(phys, robot, plan, n_leg, robot.sx, robot.sy)


@njit(cache=True)
def _build_knots(phys, robot, plan, n_leg, x0, y0):
    """The same from (x0, y0), with the heading that the robot has at its start."""
    kt, kx, ky = plan.kt, plan.kx, plan.ky
    hx, hy = robot.hx, robot.hy
    kt[0], kx[0], ky[0] = 0.0, x0, y0
    plan.leave[0] = -1
    n, t = 1, 0.0
    for m in range(n_leg):
        x1, y1 = plan.x[m], plan.y[m]
        ex, ey = x1 - x0, y1 - y0
        t += plan.wait[m]
        along, across = hx * ex + hy * ey, hx * ey - hy * ex
        if plan.turned[m]:
            least, most = min(abs(along), abs(across)), max(abs(along), abs(across))
            # Which axis lies on the line, and so the corners of later legs, would hang on rounding.
            if most - least < 1e-9 * most and _goes_square(plan, m + 1, n_leg):
                return np.inf
            t += np.degrees(np.arctan2(least, most)) / phys.rotation
            hx, hy = turned_heading(hx, hy, ex, ey)
            cx, cy, a, b = x1, y1, np.sqrt(ex * ex + ey * ey), 0.0
        else:
            cx, cy, a, b = x0 + hx * along, y0 + hy * along, abs(along), abs(across)
            if not is_inside(phys, robot, cx, cy):
                return np.inf
        if m == 0:
            kt[0] = t
        else:
            plan.leave[m] = n - 1
            kt[n], kx[n], ky[n] = t, x0, y0
            n += 1
        slow_from = a + b - (min(phys.approach, a + b) if m == n_leg - 1 else 0.0)
        if a > 0.0:
            if 0.0 < slow_from < a:
                t += slow_from / phys.coarse
                kt[n], kx[n], ky[n] = t, x0 + (cx - x0) * (slow_from / a), y0 + (cy - y0) * (slow_from / a)
                n += 1
                t += (a - slow_from) / phys.precise
            else:
                t += a / (phys.coarse if slow_from >= a else phys.precise)
            kt[n], kx[n], ky[n] = t, cx, cy
            n += 1
        if b > 0.0:
            if a < slow_from < a + b:
                t += (slow_from - a) / phys.coarse
                f = (slow_from - a) / b
                kt[n], kx[n], ky[n] = t, cx + (x1 - cx) * f, cy + (y1 - cy) * f
                n += 1
                t += (a + b - slow_from) / phys.precise
            else:
                t += b / (phys.precise if slow_from <= a else phys.coarse)
            kt[n], kx[n], ky[n] = t, x1, y1
            n += 1
        x0, y0 = x1, y1
    plan.n_leg, plan.n_knot = n_leg, n
    box = plan.box
    box[0], box[1], box[2], box[3] = np.inf, -np.inf, np.inf, -np.inf
    for k in range(n):
        box[0], box[1] = min(box[0], kx[k]), max(box[1], kx[k])
        box[2], box[3] = min(box[2], ky[k]), max(box[3], ky[k])
    return t


@njit(cache=True)
def _goes_square(plan, leg, n_leg):
    """Whether the plan has a leg without a turn from this one on."""
    for m in range(leg, n_leg):
        if not plan.turned[m]:
            return True
    return False


@njit(cache=True)
def delay_from(plan, leg, delay):
    """The plan is late by `delay` from one of its legs on."""
    if delay > 0.0 and plan.n_leg > 0:
        plan.wait[leg] += delay
        for k in range(plan.leave[leg] + 1, plan.n_knot):
            plan.kt[k] += delay


@njit(cache=True)
def is_inside(phys, robot, x, y):
    """Whether a centre at (x, y) is on the plate and in the robot's patrol disc."""
    tolerance = 1e-7
    plate, patrol = phys.plate_radius + tolerance, robot.reach + tolerance
    return x * x + y * y <= plate * plate and (x - robot.park_x) ** 2 + (y - robot.park_y) ** 2 <= patrol * patrol


# ---------------------------------------------------------------------------------------------------------------------
# Forbidden delays. Robot i goes through its shape, late by d from one of its rests on (its start, or a way point); robot j
# keeps its own times. For one straight piece of each, positions a + u s and b + w tau with (s, tau) in a box, the pairs
# nearer than r fill an ellipse cut by the box: convex, so its projection on tau - s is one interval, found from the box's
# edges and the ellipse's two tangents.


@njit(cache=True)
def _near_span(cx, cy, vx, vy, span, r2):
    """Interval of t in [0, span] with |c + v t| < r; empty if the first is larger."""
    vv = vx * vx + vy * vy
    cv = cx * vx + cy * vy
    cc = cx * cx + cy * cy - r2
    if vv == 0.0:
        if cc < 0.0:
            return 0.0, span
        return 1.0, 0.0
    disc = cv * cv - vv * cc
    if disc <= 0.0:
        return 1.0, 0.0
    root = np.sqrt(disc)
    return max(0.0, (-cv - root) / vv), min(span, (-cv + root) / vv)


@njit(cache=True)
def _near_shift(cx, cy, ux, uy, sa, wx, wy, sb, r2):
    """Interval of tau - s over the s in [0, sa], tau in [0, sb] with |c + u s - w tau| < r; empty if the first is larger."""
    lo, hi = np.inf, -np.inf
    p, q = _near_span(cx, cy, -wx, -wy, sb, r2)
    if p < q:
        lo, hi = min(lo, p), max(hi, q)
    p, q = _near_span(cx + ux * sa, cy + uy * sa, -wx, -wy, sb, r2)
    if p < q:
        lo, hi = min(lo, p - sa), max(hi, q - sa)
    p, q = _near_span(cx, cy, ux, uy, sa, r2)
    if p < q:
        lo, hi = min(lo, -q), max(hi, -p)
    p, q = _near_span(cx - wx * sb, cy - wy * sb, ux, uy, sa, r2)
    if p < q:
        lo, hi = min(lo, sb - q), max(hi, sb - p)
    cross_uw = ux * wy - uy * wx
    vx, vy = ux - wx, uy - wy
    vv = vx * vx + vy * vy
    if abs(cross_uw) > 1e-12 and vv > 1e-12:
        # Shifted by delta, the offset is (c - w delta) + v s; its line passes at r where the cross product is r |v|.
        cross_wv = wx * vy - wy * vx
        cross_cv = cx * vy - cy * vx
        reach = np.sqrt(r2 * vv)
        for sign in (-1.0, 1.0):
            delta = (cross_cv + sign * reach) / cross_wv
            s = -((cx - wx * delta) * vx + (cy - wy * delta) * vy) / vv
            if 0.0 <= s <= sa and 0.0 <= s + delta <= sb:
                lo, hi = min(lo, delta), max(hi, delta)
    return lo, hi


@njit(cache=True)
def _piece(kt, kx, ky, n, p):
    """Piece p of n knots: start and end time, position, velocity, and duration; p = -1 and n - 1 are the rests."""
    if p < 0:
        return -np.inf, kt[0], kx[0], ky[0], 0.0, 0.0
    if p == n - 1:
        return kt[p], np.inf, kx[p], ky[p], 0.0, 0.0
    span = kt[p + 1] - kt[p]
    if span <= 0.0:
        return kt[p], kt[p + 1], kx[p], ky[p], 0.0, 0.0
    return kt[p], kt[p + 1], kx[p], ky[p], (kx[p + 1] - kx[p]) / span, (ky[p + 1] - ky[p]) / span


@njit(cache=True)
def forbidden_delays(at, ax, ay, na, rest, bt, bx, by, nb, b_box, r, delay_max, lo, hi):
    """Delays d in (lo, hi) that bring shape a, late by d from piece `rest` on, within r of trajectory b.

    Piece `rest` is a stand, which the delay lengthens: -1 for the one before the shape starts. `b_box` bounds trajectory b
    (least and greatest x, then y). Returns how many intervals were written: disjoint, ascending, each open; only those that
    meet [0, delay_max].
    """
    r2 = r * r
    n = 0
    for p in range(-1, na):
        a0, a1, px, py, ux, uy = _piece(at, ax, ay, na, p)
        last_p = min(p + 1, na - 1)
        first_p = max(p, 0)
        box_x0, box_x1 = min(ax[first_p], ax[last_p]) - r, max(ax[first_p], ax[last_p]) + r
        box_y0, box_y1 = min(ay[first_p], ay[last_p]) - r, max(ay[first_p], ay[last_p]) + r
        if b_box[1] < box_x0 or b_box[0] > box_x1 or b_box[3] < box_y0 or b_box[2] > box_y1:
            continue
        is_still = ux == 0.0 and uy == 0.0
        for q in range(-1, nb):
            first_q, last_q = max(q, 0), min(q + 1, nb - 1)
            if max(bx[first_q], bx[last_q]) < box_x0 or min(bx[first_q], bx[last_q]) > box_x1:
                continue
            if max(by[first_q], by[last_q]) < box_y0 or min(by[first_q], by[last_q]) > box_y1:
                continue
            b0, b1, qx, qy, wx, wy = _piece(bt, bx, by, nb, q)
            if b1 <= a0 or b0 >= a1 + (delay_max if p >= rest else 0.0):
                continue
            cx, cy = px - qx, py - qy
            if wx == 0.0 and wy == 0.0:
                # With b at rest, a is near it while s is in [s0, s1]: b must not be there at a's time.
                if is_still:
                    if cx * cx + cy * cy >= r2:
                        continue
                    d0, d1 = b0 - a1, b1 - a0
                else:
                    s0, s1 = _near_span(cx, cy, ux, uy, a1 - a0, r2)
                    if s0 >= s1:
                        continue
                    d0, d1 = b0 - (a0 + s1), b1 - (a0 + s0)
            elif is_still:
                t0, t1 = _near_span(cx, cy, -wx, -wy, b1 - b0, r2)
                if t0 >= t1:
                    continue
                d0, d1 = b0 + t0 - a1, b0 + t1 - a0
            else:
                shift0, shift1 = _near_shift(cx, cy, ux, uy, a1 - a0, wx, wy, b1 - b0, r2)
                if shift0 >= shift1:
                    continue
                d0, d1 = b0 - a0 + shift0, b0 - a0 + shift1
            if p < rest:
                # Before the delay: near or not, whatever the delay.
                if d0 >= 0.0 or d1 <= 0.0:
                    continue
                d0, d1 = -np.inf, np.inf
            elif p == rest and d1 > 0.0:
                # The stand begins on time and ends late.
                d1 = np.inf
            if d1 <= 0.0 or d0 >= delay_max + SAME_DELAY_S:
                continue
            n = _insert_interval(lo, hi, n, d0, d1)
    return n


@njit(cache=True)
def _insert_interval(lo, hi, n, d0, d1):
    """Union of n ascending disjoint intervals with (d0, d1); the last is widened if there is no room for one more."""
    k = 0
    while k < n and hi[k] + SAME_DELAY_S < d0:
        k += 1
    m = k
    while m < n and lo[m] <= d1 + SAME_DELAY_S:
        d0, d1 = min(d0, lo[m]), max(d1, hi[m])
        m += 1
    if m == k:
        if n == len(lo):
            # Too many to keep apart: forbid the gap as well, which is safe.
            j = min(k, n - 1)
            lo[j], hi[j] = min(lo[j], d0), max(hi[j], d1)
            return n
        for j in range(n, k, -1):
            lo[j], hi[j] = lo[j - 1], hi[j - 1]
        lo[k], hi[k] = d0, d1
        return n + 1
    lo[k], hi[k] = d0, d1
    for j in range(m, n):
        lo[j - m + k + 1], hi[j - m + k + 1] = lo[j], hi[j]
    return n - (m - k) + 1


# ---------------------------------------------------------------------------------------------------------------------
# Coordinated routing: every robot has one plan (way points, waits, a start delay); pairs that come too near are conflicts;
# robots in conflict are planned again, one at a time, for the least weight of conflicts. Two that have no plan within some
# duration even alone are in conflict whatever the others do: they say how much longer it takes.

MAX_PAIRS = 64
# Longer durations of a pair: the first by this share of the bound, then twice as much; found to within the second share.
FIRST_PAIR_FRAC = 0.01
PAIR_FRAC = 0.002
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
# Trials to find a detour that is short enough.
N_TRIAL = 8
# What a conflict's weight gains at each low point that it survives.
WEIGHT_GAIN = 0.3
MAX_INTERVALS = 12
MAX_EVENTS = 1024
# Weight of a conflict with a robot that cannot move.
WEIGHT_FIXED = 1e6
# Two plans conflict below the planned separation less this, so that a plan that just touches does not.
TOUCH_MM = 1e-8


class Plans(NamedTuple):
    """The tasks of all robots (ROBOT), the plan of each, and the conflicts between plans with the weights of pairs."""

    robot: np.ndarray
    plan: np.ndarray
    conflict: np.ndarray
    n_conflict: np.ndarray
    weight: np.ndarray


@njit(cache=True)
def stand_still(robots, plans):
    """Plans in which nobody moves."""
    n = len(robots)
    for i in range(n):
        stay(robots[i], plans[i])
    return Plans(
        robots,
        plans,
        np.zeros((n, n), dtype=np.bool_),
        np.zeros(n, dtype=np.int64),
        np.ones((n, n), dtype=np.float32),
    )


@njit(cache=True)
def stay(robot, plan):
    """A plan without legs."""
    plan.n_leg, plan.n_knot, plan.leave[0] = 0, 1, -1
    plan.kt[0], plan.kx[0], plan.ky[0] = 0.0, robot.sx, robot.sy
    plan.box[0] = plan.box[1] = robot.sx
    plan.box[2] = plan.box[3] = robot.sy


@njit(cache=True)
def pair_radius(one, other, separation, margin):
    """Separation to plan for a pair: with the margin, as far as their starts and goals allow."""
    if margin == 0.0:
        return separation
    starts = np.hypot(one.sx - other.sx, one.sy - other.sy)
    goals = np.hypot(one.gx - other.gx, one.gy - other.gy)
    return max(separation, min(separation + margin, min(starts, goals)))


@njit(cache=True)
def closest2(ti, xi, yi, ni, tj, xj, yj, nj, enough2):
    """Least squared distance of two trajectories; any value below `enough2` once it is that near."""
    ex, ey = xi[0] - xj[0], yi[0] - yj[0]
    least2 = ex * ex + ey * ey
    # From the first knot of either on; the other stands until its own.
    a, b, a_last, b_last = -1, -1, ni - 1, nj - 1
    while (a < a_last or b < b_last) and least2 >= enough2:
        ta = ti[a + 1] if a < a_last else np.inf
        tb = tj[b + 1] if b < b_last else np.inf
        event = min(ta, tb)
        fx = _coordinate(ti, xi, a, a_last, event) - _coordinate(tj, xj, b, b_last, event)
        fy = _coordinate(ti, yi, a, a_last, event) - _coordinate(tj, yj, b, b_last, event)
        ux, uy = fx - ex, fy - ey
        uu = ux * ux + uy * uy
        s = 1.0
        if uu > 0.0:
            s = min(1.0, max(0.0, -(ex * ux + ey * uy) / uu))
        gx, gy = ex + s * ux, ey + s * uy
        least2 = min(least2, gx * gx + gy * gy)
        ex, ey = fx, fy
        if ta <= event:
            a += 1
        if tb <= event:
            b += 1
    return least2


@njit(cache=True)
def is_near(one, other, r):
    """Whether two plans come nearer than r."""
    r2 = (r - TOUCH_MM) ** 2
    least2 = closest2(one.kt, one.kx, one.ky, one.n_knot, other.kt, other.kx, other.ky, other.n_knot, r2)
    return least2 < r2


@njit(cache=True)
def conflict_score(weight, t, x, y, n, other, r):
    """Score of a conflict of this trajectory with another plan: half its weight however slight, all of it if they meet."""
    depth = 1.0 - np.sqrt(closest2(t, x, y, n, other.kt, other.kx, other.ky, other.n_knot, 0.0)) / r
    return weight * (0.5 + 0.5 * max(0.0, depth))


@njit(cache=True)
def pair_weight(robots, weight, j):
    """Weight of a conflict with robot j, of a row of weights."""
    return weight[j] if robots[j].is_free else WEIGHT_FIXED


@njit(cache=True)
def _coordinate(t, z, k, last, when):
    """Coordinate at `when`, between knots k and k + 1; -1 and `last` are the rests."""
    if k < 0:
        return z[0]
    if k >= last or when <= t[k]:
        return z[min(k, last)]
    if when >= t[k + 1]:
        return z[k + 1]
    return z[k] + (z[k + 1] - z[k]) * ((when - t[k]) / (t[k + 1] - t[k]))


@njit(cache=True)
def set_plan(plans, i, plan, separation, margin):
    """Give robot i this plan, and find its conflicts."""
    plans.plan[i] = plan
    find_conflicts(plans.robot, plans.plan, plans.conflict, plans.n_conflict, i, len(plans.plan), separation, margin)


@njit(cache=True)
def find_conflicts(robots, plan, conflict, n_conflict, i, n, separation, margin):
    """Conflicts of robot i with the robots before n."""
    widest = separation + margin
    own, me = plan[i], robots[i]
    x0, x1 = own.box[0] - widest, own.box[1] + widest
    y0, y1 = own.box[2] - widest, own.box[3] + widest
    for j in range(n):
        other = plan[j]
        now = False
        if other.box[0] <= x1 and other.box[1] >= x0 and other.box[2] <= y1 and other.box[3] >= y0 and j != i:
            now = is_near(own, other, pair_radius(me, robots[j], separation, margin))
        if now != conflict[i, j]:
            conflict[i, j] = conflict[j, i] = now
            step = 1 if now else -1
            n_conflict[i] += step
            n_conflict[j] += step


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


@njit(cache=True)
def find_near(phys, robots, plan, conflict, i, duration, separation, margin, near):
    """Robots that robot i may meet on any way that takes it no longer than `duration`; those in conflict with it first."""
    far = 0.5 * duration * phys.coarse + separation + margin
    me = robots[i]
    x, y = 0.5 * (me.sx + me.gx), 0.5 * (me.sy + me.gy)
    n_near, n_conflict = 0, 0
    for j in range(len(robots)):
        box = plan[j].box
        if j == i or box[0] > x + far or box[1] < x - far or box[2] > y + far or box[3] < y - far:
            continue
        near[n_near] = j
        if conflict[i, j]:
            near[n_near], near[n_conflict] = near[n_conflict], j
            n_conflict += 1
        n_near += 1
    return n_near


@njit(cache=True)
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


@njit(cache=True)
def _is_forbidden(room, k, delay):
    """Whether interval k holds the delay; at 0 an interval that starts there counts too."""
    lo = room.lo[k]
    return (lo < delay - 1e-12 or lo <= 0.0) and delay + 1e-12 < room.hi[k]


@njit(cache=True)
def direct_shape(phys, robot, option, shape):
    """A plan without detour: 0 turned, 1 x then y, 2 y then x; returns its time, infinite if it cannot be."""
    if robot.sx == robot.gx and robot.sy == robot.gy:
        stay(robot, shape)
        return 0.0
    n_leg = 1
    shape.x[0], shape.y[0], shape.turned[0], shape.wait[0] = robot.gx, robot.gy, option == 0, 0.0
    if option == 2:
        ex, ey = robot.gx - robot.sx, robot.gy - robot.sy
        across, along = robot.hx * ey - robot.hy * ex, robot.hx * ex + robot.hy * ey
        if min(abs(across), abs(along)) < phys.approach:
            return np.inf
        shape.x[0], shape.y[0] = robot.sx - robot.hy * across, robot.sy + robot.hx * across
        shape.x[1], shape.y[1], shape.turned[1], shape.wait[1] = robot.gx, robot.gy, False, 0.0
        n_leg = 2
        if not is_inside(phys, robot, shape.x[0], shape.y[0]):
            return np.inf
    return build_knots(phys, robot, shape, n_leg)


@njit(cache=True)
def _pick_partner(rng, conflict):
    """One of the robots in conflict, of a row, or -1."""
    partner, n_seen = -1, 0
    for j in range(len(conflict)):
        if conflict[j]:
            n_seen += 1
            if rng.random() * n_seen < 1.0:
                partner = j
    return partner


@njit(cache=True)
def _clear_of(rng, robot, other, separation):
    """A point just clear of another plan: beside its line, or around a place where it stands."""
    k = int(rng.random() * other.n_knot)
    x, y = other.kx[k], other.ky[k]
    far = separation * (1.0 + 0.3 * rng.random() ** 2)
    last = other.n_knot - 1
    if last == 0 or rng.random() < 0.3:
        angle = 2.0 * np.pi * rng.random()
        return x + far * np.cos(angle), y + far * np.sin(angle)
    k = int(rng.random() * last)
    x, y = other.kx[k], other.ky[k]
    ex, ey = other.kx[k + 1] - x, other.ky[k + 1] - y
    length = np.sqrt(ex * ex + ey * ey)
    if length == 0.0:
        return x + far, y
    side = far / length if rng.random() < 0.5 else -far / length
    # Beside the robot's start or its goal, or anywhere along the line.
    f = rng.random()
    if f < 0.7:
        px, py = robot.sx, robot.sy
        if f < 0.3:
            px, py = robot.gx, robot.gy
        f = ((px - x) * ex + (py - y) * ey) / (length * length) + 0.3 * (rng.random() - 0.5)
    return x + f * ex - side * ey, y + f * ey + side * ex


@njit(cache=True)
def _sample_ways(phys, robot, own, partner, has_partner, rng, aside, separation, shape):
    """Random way points of one to three, or the present ones varied; returns their number, 0 if one is out of reach."""
    ex, ey = robot.gx - robot.sx, robot.gy - robot.sy
    length = np.sqrt(ex * ex + ey * ey)
    scatter = 0.0
    is_varied = own.n_leg > 1 and rng.random() < 0.4
    if is_varied:
        n_via = own.n_leg - 1
        scatter = 5.0 * rng.random() ** 3
    else:
        share = rng.random()
        n_via = 1 if share < 0.75 else (2 if share < 0.93 else 3)
    for m in range(n_via):
        if is_varied:
            x, y = own.x[m] + scatter * (2.0 * rng.random() - 1.0), own.y[m] + scatter * (2.0 * rng.random() - 1.0)
        else:
            kind = rng.random()
            if kind < 0.4 and has_partner:
                x, y = _clear_of(rng, robot, partner, separation)
            elif kind < 0.6 or length == 0.0:
                angle, far = 2.0 * np.pi * rng.random(), aside * rng.random()
                x, y = far * np.cos(angle), far * np.sin(angle)
                if rng.random() * n_via > m:
                    x, y = robot.sx + x, robot.sy + y
                else:
                    x, y = robot.gx + x, robot.gy + y
            else:
                f, h = (m + rng.random()) / n_via, aside * (2.0 * rng.random() - 1.0) / length
                x, y = robot.sx + f * ex - h * ey, robot.sy + f * ey + h * ex
        if not is_inside(phys, robot, x, y):
            return 0
        shape.x[m], shape.y[m] = x, y
    return n_via


@njit(cache=True)
def sample_shape(phys, robot, own, partner, has_partner, rng, duration, separation, shape):
    """A random detour of one to three way points, or the present one varied, that takes no longer than `duration`.

    Returns its time, infinite if none is found in a few trials, and the leg to be delayed.
    """
    length = np.hypot(robot.gx - robot.sx, robot.gy - robot.sy)
    spare = max(0.0, (duration - robot.alone) * phys.coarse)
    aside = min(25.0, np.sqrt((length + spare) ** 2 - length * length) / 2)
    n_via, total = 0, np.inf
    for _ in range(N_TRIAL):
        n_via = _sample_ways(phys, robot, own, partner, has_partner, rng, aside, separation, shape)
        if n_via == 0:
            continue
        shape.x[n_via], shape.y[n_via] = robot.gx, robot.gy
        total = _choose_turns(phys, robot, rng, n_via + 1, duration, shape)
        if total <= duration:
            break
    if n_via == 0 or total > duration:
        return np.inf, 0
    n_leg = n_via + 1
    # One wait is found exactly; now and then another is tried at random.
    if rng.random() < 0.25:
        shape.wait[int(rng.random() * n_leg)] = (duration - total) * rng.random()
    late_leg = int(rng.random() * n_leg)
    return build_knots(phys, robot, shape, n_leg), late_leg


@njit(cache=True)
def _choose_turns(phys, robot, rng, n_leg, duration, shape):
    """Turn before a leg or not, mostly whichever is quicker; returns the time, infinite if longer than `duration`."""
    hx, hy, total, x, y = robot.hx, robot.hy, 0.0, robot.sx, robot.sy
    for m in range(n_leg):
        ex, ey = shape.x[m] - x, shape.y[m] - y
        if ex * ex + ey * ey < phys.approach * phys.approach:
            return np.inf
        turned_s, square_s = leg_options(phys, hx, hy, ex, ey, m == n_leg - 1)
        shape.turned[m] = (turned_s < square_s) != (rng.random() < 0.15)
        if shape.turned[m]:
            hx, hy = turned_heading(hx, hy, ex, ey)
        total += turned_s if shape.turned[m] else square_s
        if total > duration:
            return np.inf
        x, y = shape.x[m], shape.y[m]
        shape.wait[m] = 0.0
    return total


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
def present_score(plans, i, separation, margin):
    """Score of the conflicts of robot i as planned."""
    robots, plan, weight = plans.robot, plans.plan, plans.weight[i]
    me, own = robots[i], plan[i]
    total = 0.0
    for j in range(len(robots)):
        if plans.conflict[i, j]:
            r = pair_radius(me, robots[j], separation, margin)
            heavy = pair_weight(robots, weight, j)
            total += conflict_score(heavy, own.kt, own.kx, own.ky, own.n_knot, plan[j], r)
    return total


@njit(cache=True)
def start_directly(phys, plans, separation, margin):
    """Everybody by the quicker direct shape, at once."""
    scratch = np.zeros(1, PLAN)
    for i in range(len(plans.robot)):
        _start_directly(phys, plans.robot[i], plans.plan, i, scratch)
        find_conflicts(plans.robot, plans.plan, plans.conflict, plans.n_conflict, i, i, separation, margin)


@njit(cache=True)
def _start_directly(phys, robot, plan, i, scratch):
    t = direct_shape(phys, robot, 0, plan[i])
    if direct_shape(phys, robot, 1, scratch[0]) < t:
        plan[i] = scratch[0]


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
    """

    sample: int
    first: int
    pair: int
    quick: int
    shorten: int


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
def arrival(plan):
    """When the robot comes to rest, s."""
    return plan.kt[plan.n_knot - 1]


@njit(cache=True)
def copy_plans(source, target):
    """Overwrite the plans and conflicts of `target`; weights are not copied."""
    target.plan[:], target.conflict[:], target.n_conflict[:] = source.plan, source.conflict, source.n_conflict


@njit(cache=True)
def last_arrival(plans):
    """When the last robot comes to rest, s."""
    latest = 0.0
    for i in range(len(plans.plan)):
        latest = max(latest, arrival(plans.plan[i]))
    return latest


@njit(cache=True)
def ground(plans, i, separation, margin):
    """Robot i stays where it starts, for good."""
    scratch = np.zeros(1, PLAN)
    _ground(plans.robot[i], scratch[0])
    set_plan(plans, i, scratch[0], separation, margin)


@njit(cache=True)
def _ground(robot, plan):
    robot.gx, robot.gy, robot.is_free, robot.alone = robot.sx, robot.sy, False, 0.0
    stay(robot, plan)


@njit(cache=True)
def ground_worst(plans, separation, margin):
    """Ground the free robot with most conflicts, of those the one with least slack; returns it, -1 if none is left."""
    worst = -1
    for i in range(len(plans.robot)):
        if plans.robot[i].is_free and plans.n_conflict[i] > 0:
            more = worst < 0 or plans.n_conflict[i] > plans.n_conflict[worst]
            if more or (plans.n_conflict[i] == plans.n_conflict[worst] and plans.robot[i].alone > plans.robot[worst].alone):
                worst = i
    if worst >= 0:
        ground(plans, worst, separation, margin)
    return worst


@njit(cache=True)
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


@njit(cache=True)
def least_of_pair(phys, plans, rng, i, j, low, effort, separation, margin):
    """Least duration from `low` on in which robots i and j are found to do without a conflict, were they alone.

    Where that is longer, robots i and j are given the plans that do.
    """
    tasks = tasks_of_pair(phys, plans.robot, i, j, low, separation)
    pair = stand_still(tasks, np.zeros(len(tasks), PLAN))
    start_directly(phys, pair, separation, margin)
    begin(phys, pair, rng, low, effort.sample, separation, margin)
    if repair(phys, pair, rng, low, effort.pair, effort.sample, separation, margin) >= 0:
        return low
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


@njit(cache=True)
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
    return low


@njit(cache=True)
def coordinate(phys, plans, kept, rng, bound, effort, separation, margin, slow_pair):
    """Plans without conflict, as near to `bound` as is found; returns whether there are any.

    First at the bound; where that fails, at the least duration of the pairs in conflict, each alone; then at longer ones,
    in strides, since those that fail cost most; then back down from plans that hold, part of the way to what failed or a
    little, again and again until `effort.shorten` steps are used. `slow_pair` (2,) is filled as by `least_of_pairs`.
    """
    begin(phys, plans, rng, bound, effort.sample, separation, margin)
    if repair(phys, plans, rng, bound, effort.first, effort.sample, separation, margin) >= 0:
        return True
    unit = max(bound, SHORT_S)
    low = least_of_pairs(phys, plans, rng, bound, effort, separation, margin, slow_pair)
    duration, failed, more, n_raise = low, bound, FIRST_STRIDE_FRAC * unit, 0
    while True:
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
                return False
            duration = low + more
            more *= 2.0
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
    return True


@njit(cache=True)
def leg_starts(phys, plans):
    """(n, max_legs) when each leg of each plan starts, s."""
    start_s = np.zeros((len(plans.robot), len(plans.plan[0].x)))
    for i in range(len(plans.robot)):
        _leg_starts(phys, plans.robot[i], plans.plan[i], start_s[i])
    return start_s


@njit(cache=True)
def _leg_starts(phys, robot, plan, start_s):
    t, hx, hy, x, y = 0.0, robot.hx, robot.hy, robot.sx, robot.sy
    for m in range(plan.n_leg):
        t += plan.wait[m]
        start_s[m] = t
        ex, ey = plan.x[m] - x, plan.y[m] - y
        turned_s, square_s = leg_options(phys, hx, hy, ex, ey, m == plan.n_leg - 1)
        t += turned_s if plan.turned[m] else square_s
        if plan.turned[m]:
            hx, hy = turned_heading(hx, hy, ex, ey)
        x, y = plan.x[m], plan.y[m]


# ---------------------------------------------------------------------------------------------------------------------
# The paper's planners, one robot at a time: everybody else keeps the plan it has, or stands where it starts.

# Longest start or wait of a traffic light, and of the lattice search, s.
LONGEST_WAIT_S = 300.0
# Places on its line where a robot may stop.
N_STOP = 16
# Lattice pitch, mm. At any pitch a move is checked in closed form against what the others do meanwhile; a finer one finds
# narrower ways.
LATTICE_MM = 3.0
# Turns on the lattice cost this, s: fewer legs among equals.
TURN_COST_S = 0.01


@njit(cache=True)
def plan_with_stop(phys, plans, rng, i, separation, scratch, room, near):
    """Plan robot i straight to its goal, waiting before it starts or once on the way; False if no wait clears it."""
    robots, plan, weight = plans.robot, plans.plan, plans.weight[i]
    n_near = find_near(phys, robots, plan, plans.conflict, i, LONGEST_WAIT_S, separation, 0.0, near)
    if not _find_stop(phys, robots, plan, weight, rng, i, near[:n_near], separation, scratch, room[0]):
        return False
    set_plan(plans, i, scratch[1], separation, 0.0)
    return True


@njit(cache=True)
def _find_stop(phys, robots, plan, weight, rng, i, near, separation, scratch, space):
    """The search of `plan_with_stop`; leaves the plan in scratch[1]."""
    robot, shape = robots[i], scratch[0]
    least = np.inf
    for stop in range(N_STOP):
        n_leg = 1 if stop == 0 else 2
        f = stop / N_STOP
        shape.x[0], shape.y[0] = robot.sx + f * (robot.gx - robot.sx), robot.sy + f * (robot.gy - robot.sy)
        shape.x[n_leg - 1], shape.y[n_leg - 1] = robot.gx, robot.gy
        for m in range(n_leg):
            shape.turned[m], shape.wait[m] = True, 0.0
        t = build_knots(phys, robot, shape, n_leg)
        if t == np.inf:
            continue
        # Below the least weight of a conflict only none will do.
        score, delay = best_delay(
            robots, plan, weight, rng, robot, near, shape, n_leg - 1, LONGEST_WAIT_S, separation, 0.0, 0.1, space
        )
        if score == 0.0 and t + delay < least:
            least = t + delay
            delay_from(shape, n_leg - 1, delay)
            scratch[1] = scratch[0]
    return least < np.inf


@njit(cache=True)
def _is_piece_clear(plans, i, x0, y0, t0, x1, y1, t1, r):
    """Whether a straight move (or a stand) of robot i from t0 to t1 keeps r from all other plans meanwhile."""
    r2 = (r - TOUCH_MM) ** 2
    low_x, high_x, low_y, high_y = min(x0, x1) - r, max(x0, x1) + r, min(y0, y1) - r, max(y0, y1) + r
    for j in range(len(plans)):
        other = plans[j]
        box = other.box
        if j == i or box[0] > high_x or box[1] < low_x or box[2] > high_y or box[3] < low_y:
            continue
        kt, kx, ky, last = other.kt, other.kx, other.ky, other.n_knot - 1
        t, x, y, k = t0, x0, y0, -1
        while k < last and kt[k + 1] <= t0:
            k += 1
        ex = x0 - _coordinate(kt, kx, k, last, t0)
        ey = y0 - _coordinate(kt, ky, k, last, t0)
        if ex * ex + ey * ey < r2:
            return False
        while t < t1:
            event = min(t1, kt[k + 1]) if k < last else t1
            f = 1.0 if event >= t1 else (event - t0) / (t1 - t0)
            x, y = x0 + f * (x1 - x0), y0 + f * (y1 - y0)
            gx = x - _coordinate(kt, kx, k, last, event)
            gy = y - _coordinate(kt, ky, k, last, event)
            if _point_segment2(0.0, 0.0, ex, ey, gx, gy) < r2:
                return False
            ex, ey, t = gx, gy, event
            k += 1
    return True


# Moves on the lattice, in the robot's own frame: along +x, -x, +y, -y, and none.
LATTICE_X = np.array([1, -1, 0, 0, 0])
LATTICE_Y = np.array([0, 0, 1, -1, 0])


@njit(cache=True)
def _final_approach(phys, robot, plans, i, x, y, t, separation, shape):
    """Whether robot i can go from (x, y) at t to its goal, x then y, and stay there for good."""
    shape.x[0], shape.y[0], shape.turned[0], shape.wait[0] = robot.gx, robot.gy, False, 0.0
    if _build_knots(phys, robot, shape, 1, x, y) == np.inf:
        return False
    for k in range(shape.n_knot):
        end_t, end_x, end_y = np.inf, shape.kx[k], shape.ky[k]
        if k < shape.n_knot - 1:
            end_t, end_x, end_y = t + shape.kt[k + 1], shape.kx[k + 1], shape.ky[k + 1]
        if not _is_piece_clear(plans, i, shape.kx[k], shape.ky[k], t + shape.kt[k], end_x, end_y, end_t, separation):
            return False
    return True


@njit(cache=True)
def _legs_from_moves(robot, moves, pitch, step_s, shape):
    """Way points of lattice moves, x before y within a leg, and of the final approach; returns n_leg, 0 if too many."""
    c, s = robot.hx, robot.hy
    a, b, n_leg, wait, leg_x, leg_y = 0, 0, 0, 0.0, 0, 0
    for k in range(len(moves) + 1):
        is_end = k == len(moves)
        move_x, move_y = (0, 0) if is_end else (LATTICE_X[moves[k]], LATTICE_Y[moves[k]])
        goes_on_x = move_x != 0 and leg_y == 0 and leg_x * move_x >= 0
        goes_on_y = move_y != 0 and leg_y * move_y >= 0
        if not (goes_on_x or goes_on_y) and (leg_x != 0 or leg_y != 0):
            if n_leg >= MAX_LATTICE_LEGS - 1:
                return 0
            a, b = a + leg_x, b + leg_y
            shape.x[n_leg] = robot.sx + pitch * (c * a - s * b)
            shape.y[n_leg] = robot.sy + pitch * (s * a + c * b)
            shape.turned[n_leg], shape.wait[n_leg] = False, wait
            n_leg, wait, leg_x, leg_y = n_leg + 1, 0.0, 0, 0
        if not is_end and move_x == 0 and move_y == 0:
            wait += step_s
        leg_x, leg_y = leg_x + move_x, leg_y + move_y
    shape.x[n_leg], shape.y[n_leg] = robot.gx, robot.gy
    shape.turned[n_leg], shape.wait[n_leg] = False, wait
    return n_leg + 1


@njit(cache=True)
def plan_on_lattice(phys, plans, i, separation, scratch, n_expand):
    """Plan robot i by A* in space and time: steps along its own axes or waits, never turning; False if none is found.

    Every step and the exact final approach are checked in closed form against the plans of all others.
    """
    if not _search_lattice(phys, plans.robot[i], plans.plan, i, separation, scratch[0], n_expand):
        return False
    set_plan(plans, i, scratch[0], separation, 0.0)
    return True


@njit(cache=True)
def _search_lattice(phys, robot, plans, i, separation, shape, n_expand):
    """The search of `plan_on_lattice`; leaves the plan in `shape`."""
    pitch, step_s = LATTICE_MM, LATTICE_MM / phys.coarse
    half = int(2.0 * robot.reach / pitch) + 1
    n_time, width = int(LONGEST_WAIT_S / 2.0 / step_s), 2 * half + 1
    # How each (time, x, y) was come to: 0 not yet, else 1 + move.
    came = np.zeros((n_time, width, width), dtype=np.int8)
    is_done = np.zeros((n_time, width, width), dtype=np.bool_)
    c, s = robot.hx, robot.hy
    x0, y0 = robot.sx, robot.sy
    ex, ey = robot.gx - x0, robot.gy - y0
    goal_a, goal_b = c * ex + s * ey, c * ey - s * ex
    heap = [((abs(goal_a) + abs(goal_b)) / phys.coarse, 0.0, 0, half, half, 4)]
    came[0, half, half] = 5
    while len(heap) > 0 and n_expand > 0:
        _, cost, k, ia, ib, last = heappop(heap)
        if is_done[k, ia, ib]:
            continue
        is_done[k, ia, ib] = True
        n_expand -= 1
        a, b, t = (ia - half) * pitch, (ib - half) * pitch, k * step_s
        x, y = x0 + c * a - s * b, y0 + s * a + c * b
        is_close = abs(goal_a - a) <= pitch and abs(goal_b - b) <= pitch
        if is_close and _final_approach(phys, robot, plans, i, x, y, t, separation, shape):
            moves = np.zeros(k, dtype=np.int64)
            for m in range(k - 1, -1, -1):
                moves[m] = came[m + 1, ia, ib] - 1
                ia, ib = ia - LATTICE_X[moves[m]], ib - LATTICE_Y[moves[m]]
            n_leg = _legs_from_moves(robot, moves, pitch, step_s, shape)
            return n_leg > 0 and build_knots(phys, robot, shape, n_leg) < np.inf
        if k + 1 >= n_time:
            continue
        for move in range(5):
            ja, jb = ia + LATTICE_X[move], ib + LATTICE_Y[move]
            if not (0 <= ja < width and 0 <= jb < width) or came[k + 1, ja, jb] > 0:
                continue
            a, b = (ja - half) * pitch, (jb - half) * pitch
            x1, y1 = x0 + c * a - s * b, y0 + s * a + c * b
            if not is_inside(phys, robot, x1, y1):
                continue
            if not _is_piece_clear(plans, i, x, y, t, x1, y1, t + step_s, separation):
                continue
            came[k + 1, ja, jb] = move + 1
            new_cost = cost + step_s + (0.0 if move == last else TURN_COST_S)
            ahead = (abs(goal_a - a) + abs(goal_b - b)) / phys.coarse
            heappush(heap, (new_cost + ahead, new_cost, k + 1, ja, jb, move))
    return False
