"""Distances of points and segments."""

# Kernels take flat arrays and untyped scalars, and are long where splitting them would cost calls.
# ruff: noqa: PLW3301
# mypy: disable-error-code="no-untyped-def"
import numpy as np

from survey_sim.kernel import inner_kernel, kernel


@inner_kernel
def point_segment2(px, py, ax, ay, bx, by):
    """Squared distance of a point from a segment, mm^2."""
    ux, uy = bx - ax, by - ay
    uu = ux * ux + uy * uy
    s = 0.0
    if uu > 0.0:
        s = min(1.0, max(0.0, ((px - ax) * ux + (py - ay) * uy) / uu))
    ex, ey = px - ax - s * ux, py - ay - s * uy
    return ex * ex + ey * ey


@inner_kernel
def segment_segment2(a, b, c, d):
    """Squared distance of segments a-b and c-d, mm^2; 0 where they cross."""
    ux, uy, wx, wy = b[0] - a[0], b[1] - a[1], d[0] - c[0], d[1] - c[1]
    side_c = ux * (c[1] - a[1]) - uy * (c[0] - a[0])
    side_d = ux * (d[1] - a[1]) - uy * (d[0] - a[0])
    side_a = wx * (a[1] - c[1]) - wy * (a[0] - c[0])
    side_b = wx * (b[1] - c[1]) - wy * (b[0] - c[0])
    if side_c * side_d < 0.0 and side_a * side_b < 0.0:
        return 0.0
    return min(
        min(point_segment2(a[0], a[1], c[0], c[1], d[0], d[1]), point_segment2(b[0], b[1], c[0], c[1], d[0], d[1])),
        min(point_segment2(c[0], c[1], a[0], a[1], b[0], b[1]), point_segment2(d[0], d[1], a[0], a[1], b[0], b[1])),
    )


@kernel
def is_legal(start, goal, theta, park, reach, is_live, plate_radius, least):
    """Whether robots may stand at `start` and `goal` (n, 2): on the plate, in reach, apart; the dead stay."""
    for i in range(len(start)):
        has_moved = start[i, 0] != goal[i, 0] or start[i, 1] != goal[i, 1]
        if not np.isfinite(theta[i]) or (has_moved and not is_live[i]):
            return False
    return _may_stand(start, park, reach, is_live, plate_radius, least) and _may_stand(
        goal, park, reach, is_live, plate_radius, least
    )


@inner_kernel
def _may_stand(position, park, reach, is_live, plate_radius, least):
    for i in range(len(position)):
        x, y = position[i, 0], position[i, 1]
        if not (np.isfinite(x) and np.isfinite(y)):
            return False
        if is_live[i] and (np.hypot(x, y) > plate_radius or np.hypot(x - park[i, 0], y - park[i, 1]) > reach[i]):
            return False
        for j in range(i):
            ex, ey = x - position[j, 0], y - position[j, 1]
            if ex * ex + ey * ey < least * least:
                return False
    return True


@kernel
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
