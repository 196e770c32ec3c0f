"""Proof that a goal cannot be reached.

What a robot may not enter is a union of open discs (fixed robots) and of the outside of its patrol disc and of the plate.
Start and goal are parted if and only if some closed curve in that union winds around just one of them; overlapping parts
generate all such curves, and a curve counts by the parity of its crossings of the segment from start to goal.
"""

# Kernels take flat arrays and untyped scalars, and are long where splitting them would cost calls.
# mypy: disable-error-code="no-untyped-def"
import numpy as np

from survey_sim.kernel import inner_kernel, kernel


@inner_kernel
def _crosses(ax, ay, bx, by, cx, cy, dx, dy):
    """Whether segments a-b and c-d cross; an end on the other's line counts on one side only."""
    side_c = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) >= 0.0
    side_d = (bx - ax) * (dy - ay) - (by - ay) * (dx - ax) >= 0.0
    side_a = (dx - cx) * (ay - cy) - (dy - cy) * (ax - cx) >= 0.0
    side_b = (dx - cx) * (by - cy) - (dy - cy) * (bx - cx) >= 0.0
    return side_c != side_d and side_a != side_b


@inner_kernel
def _root(parent, parity, k):
    """Representative of k, and the parity of the way to it."""
    odd = False
    while parent[k] != k:
        odd ^= parity[k]
        k = parent[k]
    return k, odd


@kernel
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
