"""How far the paths above the bound are held up by two robots alone: `python -m tests.benchmarks.pair_limits [CHAINS]`.

Chains of ten matched visits on `taipan-150`, routed three ways. For each path above the bound, every pair in conflict on its
direct ways is planned alone, by the router's own repertoire with ten to thirty times its steps.
"""

import sys
from itertools import combinations

import numpy as np
from rich.progress import track

from survey_sim.routing.coordinated import new_plans, physics
from survey_sim.routing.kernels import conflicts, coordinate, planned, shapes
from survey_sim.routing.problem import Problem, check_problem
from tests.benchmarks.routing_table import matched

LONG = coordinate.Effort(sample=12, first=300, pair=300, quick=300, shorten=600)
LONGEST = coordinate.Effort(sample=12, first=2000, pair=1000, quick=1000, shorten=6000)
AT_BOUND = 1 + 1e-9


def least_of_pair_s(problem: Problem, pair: tuple[int, int], bound_s: float, effort: coordinate.Effort) -> float:
    """Least duration from the bound on that is found for two robots, were they alone."""
    robots = np.ascontiguousarray(new_plans(problem, ~problem.plate.is_live).robot[list(pair)])
    plans = conflicts.stand_still(robots, np.zeros(2, planned.PLAN))
    phys, separation = physics(problem), problem.separation_mm
    shapes.start_directly(phys, plans, separation, 0.0)
    if not plans.n_conflict.any():
        return bound_s
    coordinate.coordinate(phys, plans, np.random.default_rng(0), bound_s, effort, separation, 0.0, np.full(2, -1))
    return max(bound_s, conflicts.last_arrival(plans))


def worst_pair_s(problem: Problem, bound_s: float) -> float:
    """The longest of the least durations of all pairs in conflict."""
    plans = new_plans(problem, ~problem.plate.is_live)
    shapes.start_directly(physics(problem), plans, problem.separation_mm, 0.0)
    worst = bound_s
    for pair in combinations(range(problem.n_robot), 2):
        if plans.conflict[pair] and least_of_pair_s(problem, pair, bound_s, LONG) > worst * AT_BOUND:
            worst = max(worst, least_of_pair_s(problem, pair, bound_s, LONGEST))
    return worst


def main(n_chain: int = 10) -> None:
    """Print what was found."""
    n_path, rows = 0, []
    for seed in track(range(1, n_chain + 1), "chains"):
        for task, path, _ in matched("taipan-150", 160, "coordinated", seed):
            n_path += 1
            if path.configuration_time_s > path.lower_bound_s * AT_BOUND:
                problem = check_problem(task.plate, task.start_mm, task.theta_deg, task.goal_mm)
                rows.append((path.configuration_time_s, worst_pair_s(problem, path.lower_bound_s), path.lower_bound_s))
    found, pair, bound = np.array(rows).T
    excess = found / pair - 1
    print(f"{n_path} paths, {len(rows)} above the bound; {(pair > bound * AT_BOUND).sum()} of them hold a pair above it")
    within = 100 * (excess <= 0.005).mean()
    print(f"excess over the worst pair: median {100 * np.median(excess):.2f} %, {within:.0f} % of them within 0.5 %")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
