"""The paper's Traffic Light and Cooperative A* (Goodwin et al. 2014, Table 6): one robot planned after another.

Whoever is planned keeps the separation from all plans made before, and from the starts of all not yet planned, in closed
form; a robot that cannot be planned yet is tried again after the others, until none can.

Traffic Light goes straight, and waits before it starts or once on its way. It cannot route what simple vector cannot: an
idle or dead robot on the line, both ends of another's line on it (Figure 13), a ring of lines over each other's starts.
Cooperative A* (space-time A* with reservations, after Silver 2005) then tries those that Traffic Light left: steps of one
lattice pitch along the robot's own axes, or waits, and an exact final approach. It goes around what stands, but robots
that hold each other's goals stay unrouted, and nobody moves to make way.
"""

import numpy as np
import numpy.typing as npt

from survey_sim.routing.coordinated import legs_of, new_plans, physics
from survey_sim.routing.kernels import conflicts, lattice, lights, planned, repair
from survey_sim.routing.problem import Problem, RoutingSettings, Solution, UnroutedReason

# Lattice nodes that one search may open.
N_EXPAND = 20_000


def route_traffic_light(problem: Problem, settings: RoutingSettings, rng: np.random.Generator) -> Solution:
    """Legs and reasons."""
    plans = new_plans(problem, ~problem.plate.is_live, planned.LATTICE_PLAN)
    waiting = _plan_straight(problem, plans, rng)
    return Solution(legs_of(problem, plans), _reasons(problem, waiting, UnroutedReason.BLOCKED_STRAIGHT))


def route_cooperative_astar(problem: Problem, settings: RoutingSettings, rng: np.random.Generator) -> Solution:
    """Legs and reasons."""
    plans = new_plans(problem, ~problem.plate.is_live, planned.LATTICE_PLAN)
    waiting = _plan_straight(problem, plans, rng)
    phys, scratch = physics(problem), np.zeros(1, planned.LATTICE_PLAN)
    has_changed = True
    while waiting and has_changed:
        left = [i for i in waiting if not lattice.plan_on_lattice(phys, plans, i, problem.separation_mm, scratch, N_EXPAND)]
        has_changed, waiting = len(left) < len(waiting), left
    return Solution(legs_of(problem, plans), _reasons(problem, waiting, UnroutedReason.NO_PATH))


def _plan_straight(problem: Problem, plans: conflicts.Plans, rng: np.random.Generator) -> list[int]:
    """Plan whoever can go straight, the furthest first; returns those that cannot."""
    phys = physics(problem)
    scratch, room = np.zeros(2, planned.LATTICE_PLAN), np.zeros(1, repair.ROOM)
    near = np.zeros(problem.n_robot, dtype=np.int64)
    movers = np.flatnonzero(problem.has_to_move)
    waiting = movers[np.argsort(-problem.alone_s[movers], kind="stable")].tolist()
    has_changed = True
    while waiting and has_changed:
        left = [
            i for i in waiting if not lights.plan_with_stop(phys, plans, rng, i, problem.separation_mm, scratch, room, near)
        ]
        has_changed, waiting = len(left) < len(waiting), left
    return waiting


def _reasons(problem: Problem, waiting: list[int], reason: UnroutedReason) -> npt.NDArray[np.int8]:
    """Reasons of the robots left; `deadlock` where another of them stands on the goal."""
    reasons = np.zeros(problem.n_robot, dtype=np.int8)
    reasons[waiting] = reason
    gap = np.hypot(*(problem.goal_mm[waiting][:, None] - problem.start_mm[waiting][None]).transpose(2, 0, 1))
    np.fill_diagonal(gap, np.inf)
    reasons[np.array(waiting, dtype=np.int64)[(gap < problem.separation_mm).any(axis=1)]] = UnroutedReason.DEADLOCK
    return reasons
