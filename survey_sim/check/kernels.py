"""Least distances between moving robots, and crossings of straight segments: closed forms on flat arrays.

A robot's centre moves evenly along straight pieces between *knots*: it waits, turns in place, goes along its own x axis,
then along its own y axis, and slows down where the last `precise_mm` of the travel begin (which may be before or after
the corner). Between two successive knots of either robot of a pair their relative position runs evenly along a segment,
so its least length is the distance of that segment from the origin: a quadratic minimum. Nothing is sampled.
"""

# Kernels take flat arrays and untyped scalars.
# mypy: disable-error-code="no-untyped-def"
import numpy as np
from numba import njit

# Knots that a leg adds at most: start, end of turn, corner, change of speed, end.
_KNOTS_PER_LEG = 5


@njit(cache=True)
def _add_knot(t, x, y, n, first, t_new, x_new, y_new):
    """Append a knot; one that is not later than the last replaces its place. Gives the number of knots."""
    if n > first and t_new <= t[n - 1]:
        x[n - 1] = x_new
        y[n - 1] = y_new
        return n
    t[n] = t_new
    x[n] = x_new
    y[n] = y_new
    return n + 1


@njit(cache=True)
def _leg_knots(t, x, y, n, first, leg, k, coarse, precise):
    """Append the knots of leg k (a row of start_s, turn_s, dx, dy, precise, cos, sin, x, y)."""
    dx, dy, slow, cosine, sine = leg[k, 2], leg[k, 3], leg[k, 4], leg[k, 5], leg[k, 6]
    x0, y0 = x[n - 1], y[n - 1]
    n = _add_knot(t, x, y, n, first, leg[k, 0], x0, y0)
    n = _add_knot(t, x, y, n, first, t[n - 1] + leg[k, 1], x0, y0)
    t0 = t[n - 1]
    corner = abs(dx)
    length = corner + abs(dy)
    fast = max(length - slow, 0.0)
    for s in (min(corner, fast), max(corner, fast)):
        along_x = np.copysign(min(s, corner), dx)
        along_y = np.copysign(max(s - corner, 0.0), dy)
        when = t0 + min(s, fast) / coarse + max(s - fast, 0.0) / precise
        n = _add_knot(
            t, x, y, n, first, when, x0 + cosine * along_x - sine * along_y, y0 + sine * along_x + cosine * along_y
        )
    return _add_knot(t, x, y, n, first, t0 + fast / coarse + (length - fast) / precise, leg[k, 7], leg[k, 8])


@njit(cache=True)
def _least_of_pair(t, x, y, a, a_end, b, b_end):
    """Least squared distance of two robots whose knots are [a, a_end) and [b, b_end), and when."""
    now = t[a]
    rx, ry = x[b] - x[a], y[b] - y[a]
    least, at = rx * rx + ry * ry, now
    while a + 1 < a_end or b + 1 < b_end:
        t_a = t[a + 1] if a + 1 < a_end else np.inf
        t_b = t[b + 1] if b + 1 < b_end else np.inf
        then = min(t_a, t_b)
        xa, ya, xb, yb = x[a], y[a], x[b], y[b]
        if a + 1 < a_end:
            f = (then - t[a]) / (t_a - t[a])
            xa += f * (x[a + 1] - xa)
            ya += f * (y[a + 1] - ya)
        if b + 1 < b_end:
            f = (then - t[b]) / (t_b - t[b])
            xb += f * (x[b + 1] - xb)
            yb += f * (y[b + 1] - yb)
        qx, qy = xb - xa, yb - ya
        ex, ey = qx - rx, qy - ry
        u = -(rx * ex + ry * ey)
        e2 = ex * ex + ey * ey
        u = min(max(u / e2, 0.0), 1.0) if e2 > 0.0 else 0.0
        px, py = rx + u * ex, ry + u * ey
        d2 = px * px + py * py
        if d2 < least:
            least, at = d2, now + u * (then - now)
        now, rx, ry = then, qx, qy
        if t_a == then:
            a += 1
        if t_b == then:
            b += 1
    return least, at


@njit(cache=True)
def _boxes(x, y, first, n, box):
    """Bounding box (x low, x high, y low, y high) of each robot's knots."""
    for i in range(n):
        box[i, 0] = box[i, 2] = np.inf
        box[i, 1] = box[i, 3] = -np.inf
        for k in range(first[i], first[i + 1]):
            box[i, 0] = min(box[i, 0], x[k])
            box[i, 1] = max(box[i, 1], x[k])
            box[i, 2] = min(box[i, 2], y[k])
            box[i, 3] = max(box[i, 3], y[k])


@njit(cache=True)
def _least_at_ends(x, y, first, n):
    """Least squared distance of any pair where the robots start and where they end: a first upper bound of the least."""
    least = np.inf
    for i in range(n):
        for j in range(i):
            dx, dy = x[first[i]] - x[first[j]], y[first[i]] - y[first[j]]
            least = min(least, dx * dx + dy * dy)
            k, m = first[i + 1] - 1, first[j + 1] - 1
            dx, dy = x[k] - x[m], y[k] - y[m]
            least = min(least, dx * dx + dy * dy)
    return least


@njit(cache=True)
def least_separations(n_path, first_row, start, first_leg, leg, coarse, precise, limit, near):
    """Least distance between any two robots at every instant of every path.

    A pair whose bounding boxes lie no nearer than both the limit and the least distance found so far is passed over: it can
    change neither result.

    Parameters
    ----------
    first_row
        (n_visit + 1,) int64: visit v holds the rows (robots) first_row[v] to first_row[v + 1] - 1 of each block of n_row.
    start
        (n_path * n_row, 2) mm: where each robot is at time 0, a block of first_row[-1] rows for each of n_path paths.
    first_leg
        (n_path * n_row + 1,) int64: legs of each row of `start`.
    leg
        (n_leg, 9): start_s, turn_s, dx_mm, dy_mm, precise_mm, cos and sin of theta after the turn, x_mm, y_mm at the end.
    coarse, precise
        Speeds, mm/s.
    limit
        Pairs nearer than this are collisions, mm.
    near
        (n_max, 4) float64, written: a row of `start`, the other, least distance in mm, when in s, for each collision.

    Returns
    -------
    least
        (n_path, n_visit) mm; inf where there is no pair.
    n_near
        (n_path, n_visit) int64, collisions.
    """
    n_row, n_visit = first_row[-1], len(first_row) - 1
    least = np.full((n_path, n_visit), np.inf)
    n_near = np.zeros((n_path, n_visit), np.int64)
    n_found = 0
    for p in range(n_path):
        for v in range(n_visit):
            lo, hi = p * n_row + first_row[v], p * n_row + first_row[v + 1]
            n = hi - lo
            room = n + _KNOTS_PER_LEG * (first_leg[hi] - first_leg[lo])
            t, x, y = np.empty(room), np.empty(room), np.empty(room)
            first = np.zeros(n + 1, np.int64)
            m = 0
            for i in range(n):
                first[i] = m
                m = _add_knot(t, x, y, m, m, 0.0, start[lo + i, 0], start[lo + i, 1])
                for k in range(first_leg[lo + i], first_leg[lo + i + 1]):
                    m = _leg_knots(t, x, y, m, first[i], leg, k, coarse, precise)
            first[n] = m
            box = np.empty((n, 4))
            _boxes(x, y, first, n, box)
            best = _least_at_ends(x, y, first, n)
            for i in range(n):
                for j in range(i):
                    gap_x = max(box[i, 0] - box[j, 1], box[j, 0] - box[i, 1], 0.0)
                    gap_y = max(box[i, 2] - box[j, 3], box[j, 2] - box[i, 3], 0.0)
                    if gap_x * gap_x + gap_y * gap_y >= max(best, limit * limit):
                        continue
                    d2, at = _least_of_pair(t, x, y, first[j], first[j + 1], first[i], first[i + 1])
                    best = min(best, d2)
                    if d2 < limit * limit:
                        n_near[p, v] += 1
                        if n_found < len(near):
                            near[n_found, 0], near[n_found, 1] = lo + j, lo + i
                            near[n_found, 2], near[n_found, 3] = np.sqrt(d2), at
                            n_found += 1
            least[p, v] = np.sqrt(best)
    return least, n_near


@njit(cache=True)
def _side(ax, ay, bx, by, px, py):
    """Which side of the line from a to b the point p is on: the sign of the cross product."""
    return np.sign((bx - ax) * (py - ay) - (by - ay) * (px - ax))


@njit(cache=True)
def count_crossings(first_row, start, end):
    """Pairs of segments, start to end, that properly intersect: each has the other's ends on both its sides.

    Parameters
    ----------
    first_row
        (n_visit + 1,) int64: rows of each visit.
    start, end
        (n_row, 2) mm.

    Returns
    -------
        (n_visit,) int64.
    """
    out = np.zeros(len(first_row) - 1, np.int64)
    for v in range(len(out)):
        for i in range(first_row[v], first_row[v + 1]):
            ax, ay, bx, by = start[i, 0], start[i, 1], end[i, 0], end[i, 1]
            for j in range(first_row[v], i):
                cx, cy, dx, dy = start[j, 0], start[j, 1], end[j, 0], end[j, 1]
                if max(cx, dx) < min(ax, bx) or max(ax, bx) < min(cx, dx):
                    continue
                if _side(ax, ay, bx, by, cx, cy) * _side(ax, ay, bx, by, dx, dy) >= 0:
                    continue
                if _side(cx, cy, dx, dy, ax, ay) * _side(cx, cy, dx, dy, bx, by) < 0:
                    out[v] += 1
    return out
