"""Compiled geometry of routing. All kernels that call each other are here: the compiler's cache does not notice an edit in
another file.
"""

# Kernels take flat arrays and untyped scalars, and are long where splitting them would cost calls.
# ruff: noqa: PLR0912, PLR0917, PLW3301
# mypy: disable-error-code="no-untyped-def"
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
