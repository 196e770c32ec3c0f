"""Where robots without a target rest."""

# mypy: allow-untyped-defs

import numpy as np

from survey_sim.allocation.kernels.lists import GUARD_MM
from survey_sim.kernel import kernel


@kernel
def place_idle(is_idle, is_live, start_xy, park_xy, patrol, plate_radius, separation, goal_xy):
    """Give every idle robot the legal place nearest to where it stands.

    Legal is: in its patrol disc, on the plate, and no nearer than the separation to any other robot's end. First every
    idle robot that can stay does; the others then go, in order of index, to the nearest place left. That place is where
    the robot stands, or its foot on the circle around one end, or where two circles (ends, patrol disc, plate) meet.

    Parameters
    ----------
    is_idle, is_live
        (n_robot,) bool. A robot that is not live keeps its place.
    start_xy, park_xy, patrol
        (n_robot, 2), (n_robot, 2), (n_robot,) mm.
    plate_radius, separation
        mm.
    goal_xy
        (n_robot, 2) mm; ends of the others given, of idle ones filled in.

    Returns
    -------
        -1, or the first robot for which no legal place exists.
    """
    n = len(is_idle)
    is_placed = np.empty(n, np.bool_)
    for r in range(n):
        is_placed[r] = not (is_idle[r] and is_live[r])
    for r in range(n):
        if not is_live[r]:
            goal_xy[r] = start_xy[r]
        elif is_idle[r] and _is_free(start_xy[r, 0], start_xy[r, 1], r, is_placed, goal_xy, separation):
            goal_xy[r] = start_xy[r]
            is_placed[r] = True
    for r in range(n):
        if not is_placed[r]:
            if not _nearest_place(
                r, start_xy[r, 0], start_xy[r, 1], park_xy, patrol, plate_radius, separation, is_placed, goal_xy
            ):
                return r
            is_placed[r] = True
    return -1


@kernel
def _is_free(px, py, robot, is_placed, goal_xy, separation):
    for q in range(len(is_placed)):
        if is_placed[q] and q != robot:
            dx, dy = px - goal_xy[q, 0], py - goal_xy[q, 1]
            if dx * dx + dy * dy < separation * separation:
                return False
    return True


@kernel
def _nearest_place(robot, px, py, park_xy, patrol, plate_radius, separation, is_placed, goal_xy):
    """Fill in the nearest legal place of one robot; whether there is one."""
    cx, cy, reach = park_xy[robot, 0], park_xy[robot, 1], patrol[robot]
    circle = np.empty((len(is_placed) + 2, 3))
    m = 0
    for q in range(len(is_placed)):
        if is_placed[q] and q != robot:
            dx, dy = goal_xy[q, 0] - cx, goal_xy[q, 1] - cy
            if dx * dx + dy * dy < (reach + separation) ** 2:
                circle[m, 0], circle[m, 1], circle[m, 2] = goal_xy[q, 0], goal_xy[q, 1], separation + GUARD_MM
                m += 1
    n_end = m
    circle[m, 0], circle[m, 1], circle[m, 2] = cx, cy, reach - GUARD_MM
    circle[m + 1, 0], circle[m + 1, 1], circle[m + 1, 2] = 0.0, 0.0, plate_radius - GUARD_MM
    m += 2
    best = np.inf
    for i in range(m):
        ix, iy, ir = circle[i, 0], circle[i, 1], circle[i, 2]
        distance = np.hypot(px - ix, py - iy)
        ux, uy = (1.0, 0.0) if distance == 0.0 else ((px - ix) / distance, (py - iy) / distance)
        best = _try_place(robot, ix + ir * ux, iy + ir * uy, px, py, circle, n_end, best, goal_xy)
        for j in range(i):
            ex, ey = circle[j, 0] - ix, circle[j, 1] - iy
            d2 = ex * ex + ey * ey
            if d2 == 0.0:
                continue
            along = (d2 + ir * ir - circle[j, 2] ** 2) / (2.0 * d2)
            h2 = ir * ir / d2 - along * along
            if h2 < 0.0:
                continue
            h = np.sqrt(h2)
            for sign in (-1.0, 1.0):
                best = _try_place(
                    robot, ix + along * ex - sign * h * ey, iy + along * ey + sign * h * ex,
                    px, py, circle, n_end, best, goal_xy,
                )  # fmt: skip
    return best < np.inf


@kernel
def _try_place(robot, x, y, px, py, circle, n_end, best, goal_xy):
    """Take a place if it is legal and nearer than the best so far (squared distance); the new best."""
    d2 = (x - px) ** 2 + (y - py) ** 2
    if d2 >= best:
        return best
    slack = 0.5 * GUARD_MM
    for k in range(n_end + 2):
        distance = np.hypot(x - circle[k, 0], y - circle[k, 1])
        if k < n_end and distance < circle[k, 2] - slack:
            return best
        if k >= n_end and distance > circle[k, 2] + slack:
            return best
    goal_xy[robot, 0], goal_xy[robot, 1] = x, y
    return d2
