"""Coordinated routing: all robots planned together, at the lower bound wherever that can be.

Everybody starts by the quicker direct plan, at once. Pairs that come too near are conflicts, and robots in conflict are
planned again one at a time: the delays of their direct plans first (the forbidden ones are intervals, in closed form),
then sampled detours of one to three way points with waits; idle robots step aside and come back. A plan is taken if it
lowers the score of its robot's conflicts: each weighs more the nearer the pair comes, and more with each low point that it
survives, so that two robots can share an evasion and none is stuck.

The bound is that of each robot alone, and is not always to be had: two robots that change places, or one that comes head
on to one without time to spare, take longer even with nobody else about (nearly all paths above the bound hold such a
pair). So where the search fails at the bound, the pairs still in conflict are planned alone, among the robots that cannot
move, for the least duration of each; all robots are then planned in the longest of these, and longer only if that fails.

Complete in practice, not in theory. A robot that fixed robots part from its goal is `unreachable`, and that is proved
(`parted.is_parted`); one that the search gives up is `no-path`; one whose goal such a robot stands on is `deadlock`.
"""

import numpy as np
import numpy.typing as npt

from survey_sim.motion import Legs, make_legs
from survey_sim.routing.kernels import conflicts, coordinate, parted, planned, shapes
from survey_sim.routing.problem import Problem, RoutingSettings, Solution, UnroutedReason

# Steps of the search (`coordinate.Effort`); those at one duration, and as many before a robot is given up.
N_SAMPLE, N_FIRST, N_PAIR, N_QUICK, N_PATIENT = 12, 40, 60, 100, 2000


def route_coordinated(
    problem: Problem, settings: RoutingSettings, rng: np.random.Generator, *, exceeds: bool = True
) -> Solution:
    """Legs and reasons; with the margin if that routes everybody who can be.

    `exceeds`: whether a path that takes longer than the bound is looked for, or given up.
    """
    solution = _plan(problem, settings, settings.margin_mm, rng, exceeds=exceeds)
    if settings.margin_mm > 0 and np.isin(solution.reason, (UnroutedReason.NO_PATH, UnroutedReason.DEADLOCK)).any():
        solution = _plan(problem, settings, 0.0, rng, exceeds=exceeds)
    return solution


def _plan(
    problem: Problem, settings: RoutingSettings, margin: float, rng: np.random.Generator, *, exceeds: bool
) -> Solution:
    phys, separation = physics(problem), problem.separation_mm
    reason = find_unreachable(problem)
    is_fixed = ~problem.plate.is_live | (reason != UnroutedReason.ARRIVED)
    plans = new_plans(problem, is_fixed)
    shapes.start_directly(phys, plans, separation, margin)
    slow_pair, given_up_s = np.full(2, -1), None
    if plans.n_conflict.any():
        bound = float(plans.robot["alone"].max())
        effort = coordinate.Effort(N_SAMPLE, N_FIRST, N_PAIR, N_QUICK, settings.n_repair, exceeds)
        while True:
            ended, time_s = coordinate.coordinate(phys, plans, rng, bound, effort, separation, margin, slow_pair)
            if ended != coordinate.NOT_FOUND:
                given_up_s = time_s if ended == coordinate.GIVEN_UP else None
                break
            if effort.quick < N_PATIENT:
                effort = effort._replace(quick=N_PATIENT)
                continue
            robot = conflicts.ground_worst(plans, separation, margin)
            reason[robot] = UnroutedReason.NO_PATH
            for other in _cascade(problem, plans):
                conflicts.ground(plans, other, separation, margin)
                reason[other] = UnroutedReason.DEADLOCK
    pair = tuple(slow_pair[slow_pair >= 0].tolist())
    return Solution(legs_of(problem, plans), reason, pair, given_up_s)


def find_unreachable(problem: Problem) -> npt.NDArray[np.int8]:
    """(n_robot,) reasons of the robots that cannot arrive whatever is tried: parted from the goal, or the goal is taken.

    Dead robots stay; robots that cannot arrive stay too, so it is repeated until nobody joins them.
    """
    plate = problem.plate
    reason = np.zeros(problem.n_robot, dtype=np.int8)
    is_fixed = ~plate.is_live
    while is_fixed.any():
        fixed = problem.start_mm[is_fixed]
        found = []
        for i in np.flatnonzero(problem.has_to_move & ~is_fixed):
            near = np.hypot(*(fixed - plate.park_mm[i]).T) < plate.patrol_radius_mm[i] + problem.separation_mm
            if (np.hypot(*(fixed[near] - problem.goal_mm[i]).T) < problem.separation_mm).any():
                found.append((i, UnroutedReason.DEADLOCK))
            elif parted.is_parted(
                *problem.start_mm[i],
                *problem.goal_mm[i],
                fixed[near],
                problem.separation_mm,
                *plate.park_mm[i],
                plate.patrol_radius_mm[i],
                plate.instrument.plate_radius_mm,
            ):
                found.append((i, UnroutedReason.UNREACHABLE))
        if not found:
            break
        for robot, why in found:
            reason[robot] = why
            is_fixed[robot] = True
    return reason


def physics(problem: Problem) -> planned.Physics:
    """The instrument's constants for kernels."""
    instrument = problem.plate.instrument
    return planned.Physics(
        instrument.coarse_speed_mm_s,
        instrument.precise_speed_mm_s,
        instrument.rotation_speed_deg_s,
        instrument.precise_approach_mm,
        instrument.plate_radius_mm,
    )


def new_plans(problem: Problem, is_fixed: npt.NDArray[np.bool_], plan_type: np.dtype = planned.PLAN) -> conflicts.Plans:
    """Plans in which nobody moves yet; goals of fixed robots are their starts."""
    plate, theta = problem.plate, np.radians(problem.start_theta_deg)
    robots = np.zeros(problem.n_robot, planned.ROBOT)
    planned.set_tasks(
        robots, problem.start_mm, problem.goal_mm, np.cos(theta), np.sin(theta), plate.park_mm, plate.patrol_radius_mm,
        problem.alone_s, is_fixed,
    )  # fmt: skip
    return conflicts.stand_still(robots, np.zeros(problem.n_robot, plan_type))


def _cascade(problem: Problem, plans: conflicts.Plans) -> list[int]:
    """Robots whose goals are nearer than the separation to one that stays, and to those that stay for that."""
    is_free = plans.robot["is_free"]
    stays = ~is_free
    found: list[int] = []
    while True:
        gap = np.hypot(*(problem.goal_mm[is_free][:, None] - problem.start_mm[stays][None]).transpose(2, 0, 1))
        joins = np.flatnonzero(is_free)[(gap < problem.separation_mm).any(axis=1)]
        joins = joins[~stays[joins]]
        if len(joins) == 0:
            return found
        found.extend(joins.tolist())
        stays[joins] = True


def legs_of(problem: Problem, plans: conflicts.Plans) -> Legs:
    """Legs of plans."""
    legs = planned.list_legs(physics(problem), plans)
    return make_legs(problem.plate.instrument, problem.start_mm, problem.start_theta_deg, *legs)
