"""Routing: a collision-free path of all robots from where they stand to where they should.

`route` checks the problem and hands it to one of the paper's three routers or to ours (`coordinated`, the default). All
keep the separation at every instant, by closed form; what a method cannot route stays where it starts, with a reason. A
router of another package is called in the same way.
"""

from collections.abc import Callable

import numpy as np

from survey_sim.extensions import load
from survey_sim.instrument import Plate
from survey_sim.motion import FloatArray, leg_times_s
from survey_sim.routing.coordinated import route_coordinated
from survey_sim.routing.foreign import checked_routes
from survey_sim.routing.prioritised import route_cooperative_astar, route_traffic_light
from survey_sim.routing.problem import (
    ROUTER_NAMES,
    HeldUp,
    Problem,
    RoutedPath,
    RoutingSettings,
    Solution,
    UnroutedReason,
    check_problem,
)
from survey_sim.routing.simple_vector import route_simple_vector

__all__ = [
    "ROUTERS",
    "ROUTER_NAMES",
    "HeldUp",
    "Problem",
    "RoutedPath",
    "Router",
    "RoutingSettings",
    "Solution",
    "UnroutedReason",
    "route",
    "route_at_bound",
]

# Times this share above the bound are at it: rounding.
BOUND_TOLERANCE = 1e-9

Router = Callable[[Problem, RoutingSettings, np.random.Generator], Solution]

ROUTERS: dict[str, Router] = {
    "simple-vector": lambda problem, settings, rng: route_simple_vector(problem),
    "traffic-light": route_traffic_light,
    "cooperative-astar": route_cooperative_astar,
    "coordinated": route_coordinated,
}


def route(
    plate: Plate,
    start_mm: FloatArray,
    start_theta_deg: FloatArray,
    goal_mm: FloatArray,
    settings: RoutingSettings,
    rng: np.random.Generator,
) -> RoutedPath:
    """Collision-free legs that take every robot from its start to its goal.

    Parameters
    ----------
    plate
        The robots; dead ones are obstacles that never move.
    start_mm, goal_mm
        (n_robot, 2) mm, plate frame. A robot whose goal equals its start is idle.
    start_theta_deg
        (n_robot,) orientation at the start, deg.
    rng
        Stream of the coordinated router's repairs; same stream, same legs.

    Raises
    ------
    InputError
        A start or goal outside plate or patrol, nearer to another than the separation, or not finite; a dead robot's goal
        that is not its start; a wrong shape. All bad robots are named.
    """
    problem = check_problem(plate, start_mm, start_theta_deg, goal_mm)
    if settings.router in ROUTERS:
        solution = ROUTERS[settings.router](problem, settings, rng)
    else:
        solution = checked_routes(problem, settings, load("router", settings.router)(problem, settings, rng))
    return _result(problem, solution)


def route_at_bound(
    plate: Plate,
    start_mm: FloatArray,
    start_theta_deg: FloatArray,
    goal_mm: FloatArray,
    settings: RoutingSettings,
    rng: np.random.Generator,
) -> RoutedPath | HeldUp:
    """What `route` finds, if that is at the bound; `coordinated` gives up what is not, in a third of the time.

    Other routers find what they find.
    """
    if settings.router != "coordinated":
        return route(plate, start_mm, start_theta_deg, goal_mm, settings, rng)
    problem = check_problem(plate, start_mm, start_theta_deg, goal_mm)
    solution = route_coordinated(problem, settings, rng, exceeds=False)
    if solution.given_up_s is not None:
        return HeldUp(_bound_s(problem, solution), solution.given_up_s, solution.slow_pair)
    return _result(problem, solution)


def _bound_s(problem: Problem, solution: Solution) -> float:
    return float(problem.alone_s[solution.reason == UnroutedReason.ARRIVED].max(initial=0.0))


def _result(problem: Problem, solution: Solution) -> RoutedPath:
    legs, reason, slow_pair, _ = solution
    end_mm, end_theta = problem.start_mm.copy(), problem.start_theta_deg.copy()
    last = legs.last
    mover = legs.robot[last]
    end_mm[mover, 0], end_mm[mover, 1] = legs.x_mm[last], legs.y_mm[last]
    end_theta[mover] = legs.theta_deg[last]
    rotating, moving = leg_times_s(problem.plate.instrument, legs)
    rest_s = legs.start_s + rotating + moving
    time_s = float(rest_s.max(initial=0.0))
    bound_s = _bound_s(problem, solution)
    is_above = time_s > bound_s * (1.0 + BOUND_TOLERANCE)
    return RoutedPath(
        legs=legs,
        reason=reason,
        end_mm=end_mm,
        end_theta_deg=end_theta,
        lower_bound_s=bound_s,
        configuration_time_s=time_s,
        held_up=tuple(dict.fromkeys([*slow_pair, int(legs.robot[np.argmax(rest_s)])])) if is_above else (),
    )
