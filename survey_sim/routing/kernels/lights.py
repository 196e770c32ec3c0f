"""The planner of `traffic-light`, one robot at a time: everybody else keeps the plan it has, or stands where it starts."""

# Kernels take flat arrays and untyped scalars, and are long where splitting them would cost calls.
# mypy: disable-error-code="no-untyped-def"
import numpy as np

from survey_sim.kernel import inner_kernel
from survey_sim.routing.kernels.conflicts import find_near, set_plan
from survey_sim.routing.kernels.planned import build_knots, delay_from
from survey_sim.routing.kernels.repair import best_delay

# Longest start or wait of a traffic light, and of the lattice search, s.
LONGEST_WAIT_S = 300.0
# Places on its line where a robot may stop.
N_STOP = 16


@inner_kernel
def plan_with_stop(phys, plans, rng, i, separation, scratch, room, near):
    """Plan robot i straight to its goal, waiting before it starts or once on the way; False if no wait clears it."""
    robots, plan, weight = plans.robot, plans.plan, plans.weight[i]
    n_near = find_near(phys, robots, plan, plans.conflict, i, LONGEST_WAIT_S, separation, 0.0, near)
    if not _find_stop(phys, robots, plan, weight, rng, i, near[:n_near], separation, scratch, room[0]):
        return False
    set_plan(plans, i, scratch[1], separation, 0.0)
    return True


@inner_kernel
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
