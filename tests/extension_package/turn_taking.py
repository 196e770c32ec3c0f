"""An allocator and a router for survey-sim, each on a page: everybody waits for his turn."""

import numpy as np

from survey_sim.allocation import Field, VisitRequest
from survey_sim.motion import Legs, leg_times_s, make_legs
from survey_sim.routing import Problem, RoutingSettings, UnroutedReason
from survey_sim.schema import TARGET_KINDS


def begin_brightest_first(field: Field, rng: np.random.Generator):
    """Called once for each tile; what it returns is called for each visit."""
    target, robot = field.pair_target(), field.reach_robot
    is_science = field.targets.kind == TARGET_KINDS.index("science")
    order = np.lexsort([field.targets.target_id, field.targets.mag, ~is_science])

    def choose(field: Field, request: VisitRequest) -> np.ndarray:
        """(n_robot,) index of each robot's target, or -1: the brightest star first, to the nearest robot that is free."""
        held = np.full(field.plate.n_robot, -1)
        way_mm = np.hypot(*(field.xy_mm[target] - request.start_mm[robot]).T)
        is_open = request.is_open.copy()
        for star in order:
            pairs = np.flatnonzero((target == star) & request.is_pair_open & (held[robot] < 0))
            if is_open[star] and len(pairs):
                held[robot[pairs[np.argmin(way_mm[pairs])]]] = star
                is_open &= ~field.near_any(np.array([star]))
        return held

    return choose


def route_one_at_a_time(problem: Problem, settings: RoutingSettings, rng: np.random.Generator) -> tuple[Legs, np.ndarray]:
    """One robot moves at a time, straight, as soon as nobody stands in its way; so it is safe, and slow."""
    pause_s = settings.options.get("pause_s", 0.0)
    standing_mm = problem.start_mm.copy()
    waiting, turns, n_gone = list(np.flatnonzero(problem.has_to_move)), [], -1
    while len(turns) > n_gone:
        n_gone = len(turns)
        for i in [*waiting]:
            if _is_clear(problem, standing_mm, i):
                waiting.remove(i)
                turns.append(i)
                standing_mm[i] = problem.goal_mm[i]
    robot = np.sort(turns).astype(np.int32)
    legs = make_legs(
        problem.plate.instrument,
        problem.start_mm,
        problem.start_theta_deg,
        robot,
        start_s=np.zeros(len(robot)),
        way_mm=problem.goal_mm[robot],
        is_turned=np.ones(len(robot), dtype=bool),
    )
    time_s = np.zeros(problem.n_robot)
    time_s[robot] = np.add(*leg_times_s(problem.plate.instrument, legs)) + pause_s
    start_s = np.zeros(problem.n_robot)
    start_s[turns] = np.cumsum(time_s[turns]) - time_s[turns]
    reasons = np.full(problem.n_robot, UnroutedReason.ARRIVED, dtype=np.int8)
    reasons[waiting] = UnroutedReason.BLOCKED_STRAIGHT
    return legs.starting_at(start_s[robot]), reasons


def _is_clear(problem: Problem, standing_mm: np.ndarray, robot: int) -> bool:
    """Whether a robot can go straight to its goal past all others where they stand now."""
    begin, way = problem.start_mm[robot], problem.goal_mm[robot] - problem.start_mm[robot]
    others = np.delete(standing_mm, robot, axis=0) - begin
    along = np.clip(others @ way / (way @ way), 0.0, 1.0)
    return bool((np.hypot(*(others - along[:, None] * way).T) >= problem.separation_mm).all())
