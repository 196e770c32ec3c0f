"""The planner of `cooperative-astar`, one robot at a time: A* in space and time on a lattice."""

# Kernels take flat arrays and untyped scalars, and are long where splitting them would cost calls.
# mypy: disable-error-code="no-untyped-def"
from heapq import heappop, heappush

import numpy as np

from survey_sim.kernel import inner_kernel, kernel
from survey_sim.routing.kernels.conflicts import TOUCH_MM, set_plan
from survey_sim.routing.kernels.geometry import point_segment2
from survey_sim.routing.kernels.lights import LONGEST_WAIT_S
from survey_sim.routing.kernels.planned import MAX_LATTICE_LEGS, build_knots, build_knots_from, coordinate_at, is_inside

# Lattice pitch, mm. At any pitch a move is checked in closed form against what the others do meanwhile; a finer one finds
# narrower ways.
LATTICE_MM = 3.0
# Turns on the lattice cost this, s: fewer legs among equals.
TURN_COST_S = 0.01


@inner_kernel
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
        ex = x0 - coordinate_at(kt, kx, k, last, t0)
        ey = y0 - coordinate_at(kt, ky, k, last, t0)
        if ex * ex + ey * ey < r2:
            return False
        while t < t1:
            event = min(t1, kt[k + 1]) if k < last else t1
            f = 1.0 if event >= t1 else (event - t0) / (t1 - t0)
            x, y = x0 + f * (x1 - x0), y0 + f * (y1 - y0)
            gx = x - coordinate_at(kt, kx, k, last, event)
            gy = y - coordinate_at(kt, ky, k, last, event)
            if point_segment2(0.0, 0.0, ex, ey, gx, gy) < r2:
                return False
            ex, ey, t = gx, gy, event
            k += 1
    return True


# Moves on the lattice, in the robot's own frame: along +x, -x, +y, -y, and none.
LATTICE_X = np.array([1, -1, 0, 0, 0])
LATTICE_Y = np.array([0, 0, 1, -1, 0])


@inner_kernel
def _final_approach(phys, robot, plans, i, x, y, t, separation, shape):
    """Whether robot i can go from (x, y) at t to its goal, x then y, and stay there for good."""
    shape.x[0], shape.y[0], shape.turned[0], shape.wait[0] = robot.gx, robot.gy, False, 0.0
    if build_knots_from(phys, robot, shape, 1, x, y) == np.inf:
        return False
    for k in range(shape.n_knot):
        end_t, end_x, end_y = np.inf, shape.kx[k], shape.ky[k]
        if k < shape.n_knot - 1:
            end_t, end_x, end_y = t + shape.kt[k + 1], shape.kx[k + 1], shape.ky[k + 1]
        if not _is_piece_clear(plans, i, shape.kx[k], shape.ky[k], t + shape.kt[k], end_x, end_y, end_t, separation):
            return False
    return True


@inner_kernel
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


@kernel
def plan_on_lattice(phys, plans, i, separation, scratch, n_expand):
    """Plan robot i by A* in space and time: steps along its own axes or waits, never turning; False if none is found.

    Every step and the exact final approach are checked in closed form against the plans of all others.
    """
    if not _search_lattice(phys, plans.robot[i], plans.plan, i, separation, scratch[0], n_expand):
        return False
    set_plan(plans, i, scratch[0], separation, 0.0)
    return True


@kernel
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
