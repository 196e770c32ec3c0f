"""Compiled geometry of routing. All kernels that call each other are here: the compiler's cache does not notice an edit in
another file.
"""

# Kernels take flat arrays and untyped scalars, and are long where splitting them would cost calls.
# ruff: noqa: PLR0912, PLW3301
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
# Shapes: where a robot is, straight between knots, with time counted from the start of its first leg. It stands at its
# first knot before it and at its last knot after it.

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


class Shape(NamedTuple):
    """A plan being tried: way points, and the knots they give.

    Leg m starts while the robot stands between knots leave[m] and leave[m] + 1; leave[0] is -1, the rest before it all.
    """

    x: np.ndarray
    y: np.ndarray
    turned: np.ndarray
    wait: np.ndarray
    leave: np.ndarray
    kt: np.ndarray
    kx: np.ndarray
    ky: np.ndarray


@njit(cache=True)
def new_shape(max_legs):
    """An empty shape, to be written over and over."""
    max_knots = 5 * max_legs + 1
    return Shape(
        np.zeros(max_legs),
        np.zeros(max_legs),
        np.zeros(max_legs, dtype=np.bool_),
        np.zeros(max_legs),
        np.zeros(max_legs, dtype=np.int64),
        np.zeros(max_knots),
        np.zeros(max_knots),
        np.zeros(max_knots),
    )


@njit(cache=True)
def turn_deg(theta, ex, ey):
    """Least turn of an axis onto the line along (ex, ey), deg (motion.turn_onto_line)."""
    return np.mod(np.degrees(np.arctan2(ey, ex)) - theta + 45.0, 90.0) - 45.0


@njit(cache=True)
def leg_time(phys, theta, ex, ey, turned, is_last):
    """Seconds of one leg, and theta after it."""
    length = np.hypot(ex, ey)
    turn = turn_deg(theta, ex, ey)
    turn_s = 0.0
    if turned:
        turn_s = abs(turn) / phys.rotation
        theta += turn
    else:
        length *= np.cos(np.radians(abs(turn))) + np.sin(np.radians(abs(turn)))
    slow = min(phys.approach, length) if is_last else 0.0
    return turn_s + (length - slow) / phys.coarse + slow / phys.precise, theta


@njit(cache=True)
def build_knots(phys, shape, n_leg, x0, y0, theta, reach_x, reach_y, reach):
    """Knots of a shape's way points from (x0, y0); returns (n_knot, end time), n_knot 0 if a corner leaves the patrol."""
    kt, kx, ky = shape.kt, shape.kx, shape.ky
    kx[0], ky[0] = x0, y0
    n, t = 1, 0.0
    for m in range(n_leg):
        x1, y1 = shape.x[m], shape.y[m]
        ex, ey = x1 - x0, y1 - y0
        t += shape.wait[m]
        if shape.turned[m]:
            turn = turn_deg(theta, ex, ey)
            theta += turn
            t += abs(turn) / phys.rotation
            cx, cy, a, b = x1, y1, np.hypot(ex, ey), 0.0
        else:
            c, s = np.cos(np.radians(theta)), np.sin(np.radians(theta))
            along = c * ex + s * ey
            cx, cy, a, b = x0 + c * along, y0 + s * along, abs(along), abs(c * ey - s * ex)
            if not is_inside(phys, cx, cy, reach_x, reach_y, reach):
                return 0, 0.0
        if m == 0:
            kt[0] = t
            shape.leave[0] = -1
        else:
            shape.leave[m] = n - 1
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
    return n, t


@njit(cache=True)
def is_inside(phys, x, y, reach_x, reach_y, reach):
    """Whether a centre at (x, y) is on the plate and in the patrol disc."""
    tolerance = 1e-7
    plate, patrol = phys.plate_radius + tolerance, reach + tolerance
    return x * x + y * y <= plate * plate and (x - reach_x) ** 2 + (y - reach_y) ** 2 <= patrol * patrol


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
# robots in conflict are planned again, one at a time, for the least weight of conflicts.

# First stride above the bound, as a share of it; each is twice the one before, up to this many times the bound.
FIRST_STRIDE_FRAC = 0.05
MOST_STRIDES = 6.0
# Back down: by this share of the way to the longest duration that failed, but at least by this share of the bound.
DESCENT_FRAC = 0.4
CLOSE_FRAC = 0.003
# What a conflict's weight gains at each low point that it survives.
WEIGHT_GAIN = 0.3
MAX_INTERVALS = 12
MAX_EVENTS = 1024
# Weight of a conflict with a robot that cannot move.
WEIGHT_FIXED = 1e6
# Two plans conflict below the planned separation less this, so that a plan that just touches does not.
TOUCH_MM = 1e-8


class Plans(NamedTuple):
    """The problem, and the plan of every robot with the conflicts between them."""

    start: np.ndarray
    theta: np.ndarray
    goal: np.ndarray
    park: np.ndarray
    reach: np.ndarray
    is_free: np.ndarray
    alone: np.ndarray
    n_leg: np.ndarray
    x: np.ndarray
    y: np.ndarray
    turned: np.ndarray
    wait: np.ndarray
    n_knot: np.ndarray
    kt: np.ndarray
    kx: np.ndarray
    ky: np.ndarray
    box: np.ndarray
    conflict: np.ndarray
    n_conflict: np.ndarray
    weight: np.ndarray


@njit(cache=True)
def new_plans(start, theta, goal, park, reach, is_free, alone, max_legs):
    """Plans in which nobody moves yet."""
    n, max_knots = len(start), 5 * max_legs + 1
    plans = Plans(
        start,
        theta,
        goal,
        park,
        reach,
        is_free,
        alone,
        np.zeros(n, dtype=np.int64),
        np.zeros((n, max_legs)),
        np.zeros((n, max_legs)),
        np.zeros((n, max_legs), dtype=np.bool_),
        np.zeros((n, max_legs)),
        np.ones(n, dtype=np.int64),
        np.zeros((n, max_knots)),
        np.zeros((n, max_knots)),
        np.zeros((n, max_knots)),
        np.zeros((n, 4)),
        np.zeros((n, n), dtype=np.bool_),
        np.zeros(n, dtype=np.int64),
        np.ones((n, n), dtype=np.float32),
    )
    plans.kx[:, 0] = start[:, 0]
    plans.ky[:, 0] = start[:, 1]
    for i in range(n):
        plans.box[i, 0] = plans.box[i, 1] = start[i, 0]
        plans.box[i, 2] = plans.box[i, 3] = start[i, 1]
    return plans


@njit(cache=True)
def pair_radius(plans, i, j, separation, margin):
    """Separation to plan for a pair: with the margin, as far as their starts and goals allow."""
    if margin == 0.0:
        return separation
    starts = np.hypot(plans.start[i, 0] - plans.start[j, 0], plans.start[i, 1] - plans.start[j, 1])
    goals = np.hypot(plans.goal[i, 0] - plans.goal[j, 0], plans.goal[i, 1] - plans.goal[j, 1])
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
def is_near(plans, i, j, r):
    """Whether two plans come nearer than r."""
    r2 = (r - TOUCH_MM) ** 2
    least2 = closest2(
        plans.kt[i], plans.kx[i], plans.ky[i], plans.n_knot[i],
        plans.kt[j], plans.kx[j], plans.ky[j], plans.n_knot[j], r2,
    )  # fmt: skip
    return least2 < r2


@njit(cache=True)
def conflict_score(plans, i, j, t, x, y, n, r):
    """Weight of a conflict of robot i, on this trajectory, with j: half of it however slight, all of it if they meet."""
    depth = 1.0 - np.sqrt(closest2(t, x, y, n, plans.kt[j], plans.kx[j], plans.ky[j], plans.n_knot[j], 0.0)) / r
    return (plans.weight[i, j] if plans.is_free[j] else WEIGHT_FIXED) * (0.5 + 0.5 * max(0.0, depth))


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
def set_plan(plans, i, shape, n_leg, n_knot, late_leg, delay, separation, margin):
    """Give robot i the shape, late by `delay` from leg `late_leg` on, and find its conflicts."""
    plans.n_leg[i], plans.n_knot[i] = n_leg, n_knot
    for m in range(n_leg):
        plans.x[i, m], plans.y[i, m] = shape.x[m], shape.y[m]
        plans.turned[i, m] = shape.turned[m]
        plans.wait[i, m] = shape.wait[m] + (delay if m == late_leg else 0.0)
    box = plans.box[i]
    box[0], box[1], box[2], box[3] = np.inf, -np.inf, np.inf, -np.inf
    for k in range(n_knot):
        x, y = shape.kx[k], shape.ky[k]
        late = delay if k > shape.leave[late_leg] else 0.0
        plans.kt[i, k], plans.kx[i, k], plans.ky[i, k] = shape.kt[k] + late, x, y
        box[0], box[1], box[2], box[3] = min(box[0], x), max(box[1], x), min(box[2], y), max(box[3], y)
    find_conflicts(plans, i, len(plans.start), separation, margin)


@njit(cache=True)
def find_conflicts(plans, i, n, separation, margin):
    """Conflicts of robot i with the robots before n."""
    widest = separation + margin
    x0, x1 = plans.box[i, 0] - widest, plans.box[i, 1] + widest
    y0, y1 = plans.box[i, 2] - widest, plans.box[i, 3] + widest
    box, conflict = plans.box, plans.conflict[i]
    for j in range(n):
        now = False
        if box[j, 0] <= x1 and box[j, 1] >= x0 and box[j, 2] <= y1 and box[j, 3] >= y0 and j != i:
            now = is_near(plans, i, j, pair_radius(plans, i, j, separation, margin))
        if now != conflict[j]:
            plans.conflict[i, j] = plans.conflict[j, i] = now
            step = 1 if now else -1
            plans.n_conflict[i] += step
            plans.n_conflict[j] += step


class Events(NamedTuple):
    """Forbidden intervals of one shape against everybody, and room for those of one pair; whom the robot may meet at all."""

    near: np.ndarray
    lo: np.ndarray
    hi: np.ndarray
    robot: np.ndarray
    pair_lo: np.ndarray
    pair_hi: np.ndarray
    late_t: np.ndarray


@njit(cache=True)
def new_events(n_robot, max_legs):
    """Room for the intervals of one shape."""
    return Events(
        np.empty(n_robot, dtype=np.int64),
        np.empty(MAX_EVENTS),
        np.empty(MAX_EVENTS),
        np.empty(MAX_EVENTS, dtype=np.int64),
        np.empty(MAX_INTERVALS),
        np.empty(MAX_INTERVALS),
        np.empty(5 * max_legs + 1),
    )


@njit(cache=True)
def find_near(phys, plans, i, duration, separation, margin, near):
    """Robots that robot i may meet on any way that takes it no longer than `duration`; those in conflict with it first."""
    far = 0.5 * duration * phys.coarse + separation + margin
    x, y = 0.5 * (plans.start[i, 0] + plans.goal[i, 0]), 0.5 * (plans.start[i, 1] + plans.goal[i, 1])
    n_near, n_conflict = 0, 0
    for j in range(len(plans.start)):
        if j == i or plans.box[j, 0] > x + far or plans.box[j, 1] < x - far:
            continue
        if plans.box[j, 2] > y + far or plans.box[j, 3] < y - far:
            continue
        near[n_near] = j
        if plans.conflict[i, j]:
            near[n_near], near[n_conflict] = near[n_conflict], j
            n_conflict += 1
        n_near += 1
    return n_near


@njit(cache=True)
def best_delay(plans, rng, i, n_near, shape, n_knot, late_leg, delay_max, separation, margin, limit, events):
    """Least score of conflicts over delays of a shape from one leg on, and the delay that has it; inf if not below `limit`.

    Zero is found wherever it is: conflicts end only at the ends of forbidden intervals. Otherwise these, the extremes and
    one delay at random are scored.
    """
    x0, x1 = shape.kx[:n_knot].min(), shape.kx[:n_knot].max()
    y0, y1 = shape.ky[:n_knot].min(), shape.ky[:n_knot].max()
    n_event = 0
    always = 0.0
    r_all = separation + margin
    for k in range(n_near):
        j = events.near[k]
        r = r_all
        if plans.box[j, 0] > x1 + r or plans.box[j, 1] < x0 - r or plans.box[j, 2] > y1 + r or plans.box[j, 3] < y0 - r:
            continue
        r = pair_radius(plans, i, j, separation, margin)
        m = forbidden_delays(
            shape.kt, shape.kx, shape.ky, n_knot, shape.leave[late_leg],
            plans.kt[j], plans.kx[j], plans.ky[j], plans.n_knot[j], plans.box[j],
            r, delay_max, events.pair_lo, events.pair_hi,
        )  # fmt: skip
        for p in range(m):
            if events.pair_lo[p] < 0.0 and events.pair_hi[p] > delay_max:
                always += 0.5 * (plans.weight[i, j] if plans.is_free[j] else WEIGHT_FIXED)
                if always >= limit:
                    return np.inf, 0.0
            if n_event < MAX_EVENTS:
                events.lo[n_event], events.hi[n_event], events.robot[n_event] = events.pair_lo[p], events.pair_hi[p], j
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
            delay = events.hi[c]
        if delay > delay_max:
            continue
        total = 0.0
        for k in range(n_event):
            if _is_forbidden(events, k, delay):
                j = events.robot[k]
                total += 0.5 * (plans.weight[i, j] if plans.is_free[j] else WEIGHT_FIXED)
        if total >= least:
            continue
        if total > 0.0:
            total = 0.0
            for k in range(n_knot):
                events.late_t[k] = shape.kt[k] + (delay if k > shape.leave[late_leg] else 0.0)
            for k in range(n_event):
                if _is_forbidden(events, k, delay):
                    j = events.robot[k]
                    r = pair_radius(plans, i, j, separation, margin)
                    total += conflict_score(plans, i, j, events.late_t, shape.kx, shape.ky, n_knot, r)
        if total < least or (total == least and delay < best):
            least, best = total, delay
    if best < 0.0:
        return np.inf, 0.0
    return least, best


@njit(cache=True)
def _is_forbidden(events, k, delay):
    """Whether interval k holds the delay; at 0 an interval that starts there counts too."""
    lo = events.lo[k]
    return (lo < delay - 1e-12 or lo <= 0.0) and delay + 1e-12 < events.hi[k]


@njit(cache=True)
def direct_shape(phys, plans, i, option, shape):
    """Way points of a plan without detour: 0 turned, 1 x then y, 2 y then x; returns (n_leg, n_knot, time)."""
    x0, y0, x1, y1 = plans.start[i, 0], plans.start[i, 1], plans.goal[i, 0], plans.goal[i, 1]
    n_leg = 1
    shape.leave[0] = -1
    if x0 == x1 and y0 == y1:
        shape.kt[0], shape.kx[0], shape.ky[0] = 0.0, x0, y0
        return 0, 1, 0.0
    shape.x[0], shape.y[0], shape.turned[0], shape.wait[0] = x1, y1, option == 0, 0.0
    if option == 2:
        c, s = np.cos(np.radians(plans.theta[i])), np.sin(np.radians(plans.theta[i]))
        across = c * (y1 - y0) - s * (x1 - x0)
        along = c * (x1 - x0) + s * (y1 - y0)
        if min(abs(across), abs(along)) < phys.approach:
            return 0, 0, 0.0
        shape.x[0], shape.y[0] = x0 - s * across, y0 + c * across
        shape.x[1], shape.y[1], shape.turned[1], shape.wait[1] = x1, y1, False, 0.0
        n_leg = 2
        if not is_inside(phys, shape.x[0], shape.y[0], plans.park[i, 0], plans.park[i, 1], plans.reach[i]):
            return 0, 0, 0.0
    n_knot, t = build_knots(phys, shape, n_leg, x0, y0, plans.theta[i], plans.park[i, 0], plans.park[i, 1], plans.reach[i])
    return n_leg, n_knot, t


@njit(cache=True)
def _pick_partner(plans, rng, i):
    """One of the robots in conflict with i, or -1."""
    partner, n_seen = -1, 0
    if plans.n_conflict[i] > 0:
        for j in range(len(plans.start)):
            if plans.conflict[i, j]:
                n_seen += 1
                if rng.random() * n_seen < 1.0:
                    partner = j
    return partner


@njit(cache=True)
def _clear_of(plans, rng, i, j, separation):
    """A point just clear of robot j: beside the line of its plan, or around a place where it stands."""
    k = int(rng.random() * plans.n_knot[j])
    x, y = plans.kx[j, k], plans.ky[j, k]
    far = separation * (1.0 + 0.3 * rng.random() ** 2)
    last = plans.n_knot[j] - 1
    if last == 0 or rng.random() < 0.3:
        angle = 2.0 * np.pi * rng.random()
        return x + far * np.cos(angle), y + far * np.sin(angle)
    k = int(rng.random() * last)
    x, y = plans.kx[j, k], plans.ky[j, k]
    ex, ey = plans.kx[j, k + 1] - x, plans.ky[j, k + 1] - y
    length = np.hypot(ex, ey)
    if length == 0.0:
        return x + far, y
    side = far / length if rng.random() < 0.5 else -far / length
    # Beside the start or the goal of i, or anywhere along the line.
    f = rng.random()
    if f < 0.7:
        px, py = plans.start[i, 0], plans.start[i, 1]
        if f < 0.3:
            px, py = plans.goal[i, 0], plans.goal[i, 1]
        f = ((px - x) * ex + (py - y) * ey) / (length * length) + 0.3 * (rng.random() - 0.5)
    return x + f * ex - side * ey, y + f * ey + side * ex


@njit(cache=True)
def sample_shape(phys, plans, rng, i, partner, duration, separation, shape):
    """A random detour of one to three way points, or the present one varied.

    Returns (n_leg, n_knot, time, leg to be delayed); n_knot is 0 if the detour cannot be.
    """
    x0, y0, x1, y1 = plans.start[i, 0], plans.start[i, 1], plans.goal[i, 0], plans.goal[i, 1]
    ex, ey = x1 - x0, y1 - y0
    length = np.hypot(ex, ey)
    spare = max(0.0, (duration - plans.alone[i]) * phys.coarse)
    aside = min(25.0, np.sqrt((length + spare) ** 2 - length * length) / 2)
    share = rng.random()
    n_via = 1 if share < 0.75 else (2 if share < 0.93 else 3)
    is_varied = plans.n_leg[i] > 1 and rng.random() < 0.4
    if is_varied:
        n_via = plans.n_leg[i] - 1
        scatter = 5.0 * rng.random() ** 3
    for m in range(n_via):
        if is_varied:
            # The present way points, a little off.
            x, y = plans.x[i, m] + scatter * (2.0 * rng.random() - 1.0), plans.y[i, m] + scatter * (2.0 * rng.random() - 1.0)
            if not is_inside(phys, x, y, plans.park[i, 0], plans.park[i, 1], plans.reach[i]):
                return 0, 0, 0.0, 0
            shape.x[m], shape.y[m] = x, y
            continue
        kind = rng.random()
        if kind < 0.4 and partner >= 0:
            x, y = _clear_of(plans, rng, i, partner, separation)
        elif kind < 0.6 or length == 0.0:
            angle, far = 2.0 * np.pi * rng.random(), aside * rng.random()
            at_start = rng.random() * n_via > m
            x, y = (x0 if at_start else x1) + far * np.cos(angle), (y0 if at_start else y1) + far * np.sin(angle)
        else:
            f, h = (m + rng.random()) / n_via, aside * (2.0 * rng.random() - 1.0) / length
            x, y = x0 + f * ex - h * ey, y0 + f * ey + h * ex
        if not is_inside(phys, x, y, plans.park[i, 0], plans.park[i, 1], plans.reach[i]):
            return 0, 0, 0.0, 0
        shape.x[m], shape.y[m] = x, y
    shape.x[n_via], shape.y[n_via] = x1, y1
    n_leg = n_via + 1
    theta, total, px, py = plans.theta[i], 0.0, x0, y0
    for m in range(n_leg):
        ex, ey = shape.x[m] - px, shape.y[m] - py
        turned_s, turned_theta = leg_time(phys, theta, ex, ey, True, m == n_leg - 1)
        square_s, _ = leg_time(phys, theta, ex, ey, False, m == n_leg - 1)
        shape.turned[m] = (turned_s < square_s) != (rng.random() < 0.15)
        if shape.turned[m]:
            theta = turned_theta
        total += turned_s if shape.turned[m] else square_s
        if np.hypot(ex, ey) < phys.approach:
            return 0, 0, 0.0, 0
        px, py = shape.x[m], shape.y[m]
        shape.wait[m] = 0.0
    if total > duration:
        return 0, 0, 0.0, 0
    # One wait is found exactly; now and then another is tried at random.
    if rng.random() < 0.25:
        shape.wait[int(rng.random() * n_leg)] = (duration - total) * rng.random()
    late_leg = int(rng.random() * n_leg)
    n_knot, t = build_knots(phys, shape, n_leg, x0, y0, plans.theta[i], plans.park[i, 0], plans.park[i, 1], plans.reach[i])
    return n_leg, n_knot, t, late_leg


@njit(cache=True)
def replan(phys, plans, rng, i, duration, n_sample, least, separation, margin, shape, best, events):
    """Plan robot i again within `duration`, if the score of its conflicts falls below `least`; returns the score.

    The direct shapes are tried, then sampled detours.
    """
    best_legs, best_knots, delay, late_best = -1, 0, 0.0, 0
    partner = _pick_partner(plans, rng, i) if n_sample > 0 else -1
    n_near = find_near(phys, plans, i, duration, separation, margin, events.near)
    for option in range(3 + n_sample):
        late_leg = 0
        if option < 3:
            n_leg, n_knot, t = direct_shape(phys, plans, i, option, shape)
        else:
            n_leg, n_knot, t, late_leg = sample_shape(phys, plans, rng, i, partner, duration, separation, shape)
        if n_knot == 0 or t > duration + SAME_DELAY_S:
            continue
        delay_max = max(0.0, duration - t)
        score, d = best_delay(plans, rng, i, n_near, shape, n_knot, late_leg, delay_max, separation, margin, least, events)
        if score < least:
            least, best_legs, best_knots, delay, late_best = score, n_leg, n_knot, d, late_leg
            _copy_shape(shape, best, n_leg, n_knot)
            if score == 0.0:
                break
        if n_leg == 0 and n_sample == 0:
            break
    if best_legs < 0:
        return np.inf
    set_plan(plans, i, best, best_legs, best_knots, late_best, delay, separation, margin)
    return least


@njit(cache=True)
def present_score(plans, i, separation, margin):
    """Score of the conflicts of robot i as planned."""
    total = 0.0
    for j in range(len(plans.start)):
        if plans.conflict[i, j]:
            r = pair_radius(plans, i, j, separation, margin)
            total += conflict_score(plans, i, j, plans.kt[i], plans.kx[i], plans.ky[i], plans.n_knot[i], r)
    return total


@njit(cache=True)
def _copy_shape(source, target, n_leg, n_knot):
    for m in range(n_leg):
        target.x[m], target.y[m] = source.x[m], source.y[m]
        target.turned[m], target.wait[m], target.leave[m] = source.turned[m], source.wait[m], source.leave[m]
    for k in range(n_knot):
        target.kt[k], target.kx[k], target.ky[k] = source.kt[k], source.kx[k], source.ky[k]


@njit(cache=True)
def start_directly(phys, plans, separation, margin):
    """Everybody by the quicker direct shape, at once."""
    shape, other = new_shape(MAX_LEGS), new_shape(MAX_LEGS)
    for i in range(len(plans.start)):
        n_leg, n_knot, t = direct_shape(phys, plans, i, 0, shape)
        n_leg1, n_knot1, t1 = direct_shape(phys, plans, i, 1, other)
        chosen = shape
        if n_knot1 > 0 and t1 < t:
            chosen, n_leg, n_knot = other, n_leg1, n_knot1
        plans.n_leg[i], plans.n_knot[i] = n_leg, n_knot
        set_plan_alone(plans, i, chosen, n_leg, n_knot)
        find_conflicts(plans, i, i, separation, margin)


@njit(cache=True)
def set_plan_alone(plans, i, shape, n_leg, n_knot):
    """Give robot i the shape, started at once, without looking for conflicts."""
    plans.n_leg[i], plans.n_knot[i] = n_leg, n_knot
    for m in range(n_leg):
        plans.x[i, m], plans.y[i, m] = shape.x[m], shape.y[m]
        plans.turned[i, m], plans.wait[i, m] = shape.turned[m], shape.wait[m]
    plans.kt[i, :n_knot], plans.kx[i, :n_knot], plans.ky[i, :n_knot] = (
        shape.kt[:n_knot],
        shape.kx[:n_knot],
        shape.ky[:n_knot],
    )
    plans.box[i, 0], plans.box[i, 1] = shape.kx[:n_knot].min(), shape.kx[:n_knot].max()
    plans.box[i, 2], plans.box[i, 3] = shape.ky[:n_knot].min(), shape.ky[:n_knot].max()


@njit(cache=True)
def repair(phys, plans, rng, duration, n_step, n_sample, separation, margin):
    """Plan robots that are late or in conflict again until none is; returns the number of steps, -1 if they were too few."""
    n = len(plans.start)
    shape, best, events = new_shape(MAX_LEGS), new_shape(MAX_LEGS), new_events(n, MAX_LEGS)
    for i in range(n):
        if plans.kt[i, plans.n_knot[i] - 1] > duration + SAME_DELAY_S:
            replan(phys, plans, rng, i, duration, n_sample, np.inf, separation, margin, shape, best, events)
    # Robots with most time to spare first: they have most delays to choose from.
    order = np.argsort(plans.alone)
    for _ in range(2):
        for i in order:
            if plans.n_conflict[i] > 0 and plans.is_free[i]:
                limit = present_score(plans, i, separation, margin)
                replan(phys, plans, rng, i, duration, 0, limit, separation, margin, shape, best, events)
    for step in range(n_step):
        i, seen = -1, 0.0
        for k in range(n):
            if plans.n_conflict[k] > 0 and plans.is_free[k]:
                # Who has no time to spare has few ways to choose from.
                share = min(1.0, max(0.1, duration - plans.alone[k]))
                seen += share
                if rng.random() * seen < share:
                    i = k
        if i < 0:
            return step
        # Only downwards; the conflicts that survive at a low point weigh more from then on, until it is none.
        limit = present_score(plans, i, separation, margin)
        after = replan(phys, plans, rng, i, duration, n_sample, limit, separation, margin, shape, best, events)
        if after >= limit:
            for j in range(n):
                if plans.conflict[i, j]:
                    plans.weight[i, j] += WEIGHT_GAIN
                    plans.weight[j, i] += WEIGHT_GAIN
    return -1


@njit(cache=True)
def copy_plans(source, target):
    """Overwrite the plans and conflicts of `target`; weights are not copied."""
    target.n_leg[:], target.x[:], target.y[:] = source.n_leg, source.x, source.y
    target.turned[:], target.wait[:] = source.turned, source.wait
    target.n_knot[:], target.kt[:], target.kx[:], target.ky[:] = source.n_knot, source.kt, source.kx, source.ky
    target.box[:], target.conflict[:], target.n_conflict[:] = source.box, source.conflict, source.n_conflict


@njit(cache=True)
def last_arrival(plans):
    """When the last robot comes to rest, s."""
    latest = 0.0
    for i in range(len(plans.start)):
        latest = max(latest, plans.kt[i, plans.n_knot[i] - 1])
    return latest


@njit(cache=True)
def ground(plans, i, shape, separation, margin):
    """Robot i stays where it starts, for good."""
    plans.goal[i] = plans.start[i]
    plans.is_free[i] = False
    plans.alone[i] = 0.0
    shape.kt[0], shape.kx[0], shape.ky[0], shape.leave[0] = 0.0, plans.start[i, 0], plans.start[i, 1], -1
    set_plan(plans, i, shape, 0, 1, 0, 0.0, separation, margin)


@njit(cache=True)
def ground_worst(plans, separation, margin):
    """Ground the free robot with most conflicts, of those the one with least slack; returns it, -1 if none is left."""
    worst = -1
    for i in range(len(plans.start)):
        if plans.is_free[i] and plans.n_conflict[i] > 0:
            more = worst < 0 or plans.n_conflict[i] > plans.n_conflict[worst]
            if more or (plans.n_conflict[i] == plans.n_conflict[worst] and plans.alone[i] > plans.alone[worst]):
                worst = i
    if worst >= 0:
        ground(plans, worst, new_shape(MAX_LEGS), separation, margin)
    return worst


@njit(cache=True)
def coordinate(phys, plans, kept, rng, bound, n_quick, n_step, n_sample, separation, margin):
    """Plans without conflict, as near to `bound` as is found; returns whether there are any.

    First at the bound; then at longer durations, in long strides, since those that fail cost most; then back down from
    plans that hold, part of the way to what failed or a little, again and again until `n_step` steps are used.
    """
    if repair(phys, plans, rng, bound, n_quick, n_sample, separation, margin) >= 0:
        return True
    # A field of short hops may need long detours: longer by shares of the bound, or of this, s.
    unit = max(bound, 10.0)
    failed, more = bound, FIRST_STRIDE_FRAC * unit
    while repair(phys, plans, rng, bound + more, n_quick // 2, n_sample, separation, margin) < 0:
        failed = bound + more
        if more > MOST_STRIDES * unit:
            return False
        more *= 2.0
    copy_plans(plans, kept)
    found, done = last_arrival(kept), 0
    while done < n_step and found > bound + SAME_DELAY_S:
        trial = max(bound, found - max(DESCENT_FRAC * (found - failed), CLOSE_FRAC * bound))
        used = repair(phys, plans, rng, trial, n_quick, n_sample, separation, margin)
        if used >= 0:
            copy_plans(plans, kept)
            found = last_arrival(kept)
            done += used + 1
        else:
            copy_plans(kept, plans)
            failed = max(failed, trial)
            done += n_quick
    return True


@njit(cache=True)
def leg_starts(phys, plans):
    """(n, max_legs) when each leg of each plan starts, s."""
    n = len(plans.start)
    start_s = np.zeros(plans.x.shape)
    for i in range(n):
        t, theta, x, y = 0.0, plans.theta[i], plans.start[i, 0], plans.start[i, 1]
        for m in range(plans.n_leg[i]):
            t += plans.wait[i, m]
            start_s[i, m] = t
            is_last = m == plans.n_leg[i] - 1
            took, theta = leg_time(phys, theta, plans.x[i, m] - x, plans.y[i, m] - y, plans.turned[i, m], is_last)
            t += took
            x, y = plans.x[i, m], plans.y[i, m]
    return start_s


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
def plan_with_stop(phys, plans, rng, i, separation, shape, best, events):
    """Plan robot i straight to its goal, waiting before it starts or once on the way; False if no wait clears it."""
    x0, y0, x1, y1 = plans.start[i, 0], plans.start[i, 1], plans.goal[i, 0], plans.goal[i, 1]
    least, best_legs, best_knots, best_delay_s = np.inf, 0, 0, 0.0
    n_near = find_near(phys, plans, i, LONGEST_WAIT_S, separation, 0.0, events.near)
    for stop in range(N_STOP):
        n_leg = 1 if stop == 0 else 2
        f = stop / N_STOP
        shape.x[0], shape.y[0] = x0 + f * (x1 - x0), y0 + f * (y1 - y0)
        shape.x[n_leg - 1], shape.y[n_leg - 1] = x1, y1
        for m in range(n_leg):
            shape.turned[m], shape.wait[m] = True, 0.0
        n_knot, t = build_knots(
            phys, shape, n_leg, x0, y0, plans.theta[i], plans.park[i, 0], plans.park[i, 1], plans.reach[i]
        )
        # Below the least weight of a conflict only none will do.
        score, delay = best_delay(
            plans, rng, i, n_near, shape, n_knot, n_leg - 1, LONGEST_WAIT_S, separation, 0.0, 0.1, events
        )  # fmt: skip
        if score == 0.0 and t + delay < least:
            least, best_legs, best_knots, best_delay_s = t + delay, n_leg, n_knot, delay
            _copy_shape(shape, best, n_leg, n_knot)
    if best_legs == 0:
        return False
    set_plan(plans, i, best, best_legs, best_knots, best_legs - 1, best_delay_s, separation, 0.0)
    return True


@njit(cache=True)
def _is_piece_clear(plans, i, x0, y0, t0, x1, y1, t1, r):
    """Whether a straight move (or a stand) of robot i from t0 to t1 keeps r from all other plans meanwhile."""
    r2 = (r - TOUCH_MM) ** 2
    low_x, high_x, low_y, high_y = min(x0, x1) - r, max(x0, x1) + r, min(y0, y1) - r, max(y0, y1) + r
    for j in range(len(plans.start)):
        box = plans.box[j]
        if j == i or box[0] > high_x or box[1] < low_x or box[2] > high_y or box[3] < low_y:
            continue
        kt, kx, ky, last = plans.kt[j], plans.kx[j], plans.ky[j], plans.n_knot[j] - 1
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
def _final_approach(phys, plans, i, x, y, t, separation, shape):
    """Whether robot i can go from (x, y) at t to its goal, x then y, and stay there for good."""
    shape.x[0], shape.y[0], shape.turned[0], shape.wait[0] = plans.goal[i, 0], plans.goal[i, 1], False, 0.0
    park_x, park_y = plans.park[i]
    n_knot, _ = build_knots(phys, shape, 1, x, y, plans.theta[i], park_x, park_y, plans.reach[i])
    for k in range(n_knot):
        end_t, end_x, end_y = np.inf, shape.kx[k], shape.ky[k]
        if k < n_knot - 1:
            end_t, end_x, end_y = t + shape.kt[k + 1], shape.kx[k + 1], shape.ky[k + 1]
        if not _is_piece_clear(plans, i, shape.kx[k], shape.ky[k], t + shape.kt[k], end_x, end_y, end_t, separation):
            return False
    return n_knot > 0


@njit(cache=True)
def _legs_from_moves(plans, i, moves, pitch, step_s, shape):
    """Way points of lattice moves, x before y within a leg, and of the final approach; returns n_leg, 0 if too many."""
    c, s = np.cos(np.radians(plans.theta[i])), np.sin(np.radians(plans.theta[i]))
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
            shape.x[n_leg] = plans.start[i, 0] + pitch * (c * a - s * b)
            shape.y[n_leg] = plans.start[i, 1] + pitch * (s * a + c * b)
            shape.turned[n_leg], shape.wait[n_leg] = False, wait
            n_leg, wait, leg_x, leg_y = n_leg + 1, 0.0, 0, 0
        if not is_end and move_x == 0 and move_y == 0:
            wait += step_s
        leg_x, leg_y = leg_x + move_x, leg_y + move_y
    shape.x[n_leg], shape.y[n_leg] = plans.goal[i, 0], plans.goal[i, 1]
    shape.turned[n_leg], shape.wait[n_leg] = False, wait
    return n_leg + 1


@njit(cache=True)
def plan_on_lattice(phys, plans, i, separation, shape, n_expand):
    """Plan robot i by A* in space and time: steps along its own axes or waits, never turning; False if none is found.

    Every step and the exact final approach are checked in closed form against the plans of all others.
    """
    pitch, step_s = LATTICE_MM, LATTICE_MM / phys.coarse
    half = int(2.0 * plans.reach[i] / pitch) + 1
    n_time, width = int(LONGEST_WAIT_S / 2.0 / step_s), 2 * half + 1
    # How each (time, x, y) was come to: 0 not yet, else 1 + move.
    came = np.zeros((n_time, width, width), dtype=np.int8)
    is_done = np.zeros((n_time, width, width), dtype=np.bool_)
    c, s = np.cos(np.radians(plans.theta[i])), np.sin(np.radians(plans.theta[i]))
    x0, y0 = plans.start[i, 0], plans.start[i, 1]
    park_x, park_y = plans.park[i]
    ex, ey = plans.goal[i, 0] - x0, plans.goal[i, 1] - y0
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
        if is_close and _final_approach(phys, plans, i, x, y, t, separation, shape):
            moves = np.zeros(k, dtype=np.int64)
            for m in range(k - 1, -1, -1):
                moves[m] = came[m + 1, ia, ib] - 1
                ia, ib = ia - LATTICE_X[moves[m]], ib - LATTICE_Y[moves[m]]
            n_leg = _legs_from_moves(plans, i, moves, pitch, step_s, shape)
            n_knot, _ = build_knots(phys, shape, n_leg, x0, y0, plans.theta[i], park_x, park_y, plans.reach[i])
            if n_leg == 0 or n_knot == 0:
                return False
            set_plan(plans, i, shape, n_leg, n_knot, 0, 0.0, separation, 0.0)
            return True
        if k + 1 >= n_time:
            continue
        for move in range(5):
            ja, jb = ia + LATTICE_X[move], ib + LATTICE_Y[move]
            if not (0 <= ja < width and 0 <= jb < width) or came[k + 1, ja, jb] > 0:
                continue
            a, b = (ja - half) * pitch, (jb - half) * pitch
            x1, y1 = x0 + c * a - s * b, y0 + s * a + c * b
            if not is_inside(phys, x1, y1, park_x, park_y, plans.reach[i]):
                continue
            if not _is_piece_clear(plans, i, x, y, t, x1, y1, t + step_s, separation):
                continue
            came[k + 1, ja, jb] = move + 1
            new_cost = cost + step_s + (0.0 if move == last else TURN_COST_S)
            ahead = (abs(goal_a - a) + abs(goal_b - b)) / phys.coarse
            heappush(heap, (new_cost + ahead, new_cost, k + 1, ja, jb, move))
    return False
