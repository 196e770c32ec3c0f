"""Forbidden delays, in closed form.

Robot i goes through its shape, late by d from one of its rests on (its start, or a way point); robot j keeps its own times.
For one straight piece of each, positions a + u s and b + w tau with (s, tau) in a box, the pairs nearer than r fill an
ellipse cut by the box: convex, so its projection on tau - s is one interval, found from the box's edges and the ellipse's
two tangents.
"""

# Kernels take flat arrays and untyped scalars, and are long where splitting them would cost calls.
# ruff: noqa: PLR0912
# mypy: disable-error-code="no-untyped-def"
import numpy as np

from survey_sim.kernel import inner_kernel

# Delays nearer than this are one: a gap this narrow between forbidden intervals is rounding, not room.
SAME_DELAY_S = 1e-9


@inner_kernel
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


@inner_kernel
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


@inner_kernel
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


@inner_kernel
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


@inner_kernel
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
