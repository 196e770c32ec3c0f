"""Coordinated routing at the lower bound."""

import numpy as np

from survey_sim.motion import Legs, make_legs
from survey_sim.routing import kernels
from survey_sim.routing.problem import Problem, RoutingSettings, UnroutedReason

import os

QUICK = int(os.environ.get("QUICK", "200"))


def physics(problem: Problem) -> kernels.Physics:
    instrument = problem.plate.instrument
    return kernels.Physics(
        instrument.coarse_speed_mm_s,
        instrument.precise_speed_mm_s,
        instrument.rotation_speed_deg_s,
        instrument.precise_approach_mm,
        instrument.plate_radius_mm,
    )


def route_coordinated(problem: Problem, settings: RoutingSettings, rng: np.random.Generator) -> tuple[Legs, np.ndarray]:
    """Legs and (n_robot,) reasons."""
    plate = problem.plate
    phys = physics(problem)
    plans = kernels.new_plans(
        problem.start_mm,
        problem.start_theta_deg,
        problem.goal_mm,
        plate.park_mm,
        plate.patrol_radius_mm,
        plate.is_live,
        problem.alone_s,
    )
    kernels.start_directly(phys, plans, problem.separation_mm, settings.margin_mm)
    bound = problem.alone_s.max(initial=0.0)
    if plans.n_conflict.any():
        kept = kernels.new_plans(
            problem.start_mm,
            problem.start_theta_deg,
            problem.goal_mm,
            plate.park_mm,
            plate.patrol_radius_mm,
            plate.is_live,
            problem.alone_s,
        )
        kernels.coordinate(
            phys, plans, kept, rng, bound, QUICK, settings.n_repair, 12, problem.separation_mm, settings.margin_mm
        )
    reason = np.zeros(problem.n_robot, dtype=np.int8)
    reason[plans.n_conflict > 0] = UnroutedReason.NO_PATH
    return legs_of(problem, plans), reason


def legs_of(problem: Problem, plans: kernels.Plans) -> Legs:
    """Legs of plans."""
    n_leg = plans.n_leg
    robot = np.repeat(np.arange(problem.n_robot), n_leg)
    leg = np.arange(len(robot)) - np.repeat(np.cumsum(n_leg) - n_leg, n_leg)
    way = np.column_stack([plans.x[robot, leg], plans.y[robot, leg]])
    start_s = kernels.leg_starts(physics(problem), plans)[robot, leg]
    return make_legs(
        problem.plate.instrument,
        problem.start_mm,
        problem.start_theta_deg,
        robot.astype(np.int32),
        start_s,
        way,
        plans.turned[robot, leg],
    )
