"""Ways that a robot may take, before they are delayed: direct ones, and detours at random."""

# Kernels take flat arrays and untyped scalars, and are long where splitting them would cost calls.
# mypy: disable-error-code="no-untyped-def"
import numpy as np

from survey_sim.kernel import inner_kernel, kernel
from survey_sim.routing.kernels.conflicts import find_conflicts
from survey_sim.routing.kernels.planned import PLAN, build_knots, is_inside, leg_options, stay, turned_heading

# Trials to find a detour that is short enough.
N_TRIAL = 8


@inner_kernel
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


@kernel
def start_directly(phys, plans, separation, margin):
    """Everybody by the quicker direct shape, at once."""
    scratch = np.zeros(1, PLAN)
    for i in range(len(plans.robot)):
        _start_directly(phys, plans.robot[i], plans.plan, i, scratch)
        find_conflicts(plans.robot, plans.plan, plans.conflict, plans.n_conflict, i, i, separation, margin)


@inner_kernel
def _start_directly(phys, robot, plan, i, scratch):
    t = direct_shape(phys, robot, 0, plan[i])
    if direct_shape(phys, robot, 1, scratch[0]) < t:
        plan[i] = scratch[0]


@inner_kernel
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


@inner_kernel
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


@inner_kernel
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


@inner_kernel
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
