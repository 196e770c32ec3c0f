"""Simple Vector: straight lines in batches, nobody waits on the way (Goodwin et al. 2014, Table 6).

Robots without a crossing go first, with one of each crossing pair; then the rest, batch after batch. A batch keeps its
separation whatever the timing of its members. It cannot route a robot whose line passes one that never leaves it: an idle
or dead robot, one that is itself blocked, or both ends of another's line (Figure 13). Configuration times add up.
"""

import numpy as np

from survey_sim.motion import leg_times_s, make_legs
from survey_sim.routing.kernels.batches import simple_vector_batches
from survey_sim.routing.problem import Problem, Solution, UnroutedReason


def route_simple_vector(problem: Problem) -> Solution:
    """Legs and reasons."""
    instrument = problem.plate.instrument
    batch = simple_vector_batches(problem.start_mm, problem.goal_mm, problem.has_to_move, problem.separation_mm)
    robot = np.flatnonzero(batch >= 0).astype(np.int32)
    legs = make_legs(
        instrument,
        problem.start_mm,
        problem.start_theta_deg,
        robot,
        np.zeros(len(robot)),
        problem.goal_mm[robot],
        np.ones(len(robot), dtype=bool),
    )
    longest_s = np.zeros(batch.max(initial=-1) + 1)
    np.maximum.at(longest_s, batch[robot], np.add(*leg_times_s(instrument, legs)))
    start_s = np.concatenate([[0.0], np.cumsum(longest_s)])[batch[robot]]
    is_unrouted = problem.has_to_move & (batch < 0)
    reason = np.where(is_unrouted, UnroutedReason.BLOCKED_STRAIGHT, UnroutedReason.ARRIVED).astype(np.int8)
    return Solution(legs.starting_at(start_s), reason)
