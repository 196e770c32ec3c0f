"""Completeness of `plan` beside its proven bound, the ideal and CDA-Basic: `python -m tests.benchmarks.plan_bound`.

For each kind of field and each number of visits, planned for itself: the mean over the seeds, the least plan / bound of any
seed, what `plan` gains on CDA-Basic, and the most that any allocation could.
"""

from collections.abc import Callable, Iterator
from itertools import product

import numpy as np

from survey_sim.allocation import AllocationSettings, FieldTargets, completeness_bound, ideal_completeness
from survey_sim.instrument import Plate, load_instrument, make_plate
from tests.benchmarks.sessions import all_visits
from tests.mock_targets import clumped_xy, clustered_xy, field_targets, uniform_xy

N_TARGET = 1431
SEEDS = (1, 2, 3)
VISITS = (5, 8, 10, 12, 15)
FIELDS: dict[str, Callable[[int], np.ndarray]] = {
    "uniform": lambda seed: uniform_xy(N_TARGET, seed),
    "clustered": lambda seed: clustered_xy(N_TARGET, seed),
    "half in 60 clumps": lambda seed: clumped_xy(N_TARGET, seed, 0.5, 60, 3.5),
    "80 % in 60 clumps": lambda seed: clumped_xy(N_TARGET, seed, 0.8, 60, 5.0),
    "60 % in 40 clumps": lambda seed: clumped_xy(N_TARGET, seed, 0.6, 40, 4.0),
}


def completeness(targets: FieldTargets, plate: Plate, algorithm: str, visits: int) -> float:
    """Completeness after so many visits, were every robot to arrive."""
    settings = AllocationSettings.load({"algorithm": algorithm, "visits": visits, "bound": "none"})
    return all_visits(targets, plate, settings)[1]


def figures(make: Callable[[int], np.ndarray], visits: int) -> Iterator[tuple[float, float, float, float]]:
    """Of each seed: `plan`, its bound, CDA-Basic, the ideal."""
    plate = make_plate(load_instrument("paper"))
    for seed in SEEDS:
        targets = field_targets(make(seed))
        plan, basic = (completeness(targets, plate, algorithm, visits) for algorithm in ("plan", "cda-basic"))
        yield plan, completeness_bound(targets, plate, visits), basic, ideal_completeness(targets, plate, visits)[-1]


def main() -> None:
    """Print a row a field and number of visits."""
    print("| targets | visits | plan % | bound % | least plan / bound % | cda-basic % | ideal % | gain | possible gain |")
    print("|---|---|---|---|---|---|---|---|---|")
    for (name, make), visits in product(FIELDS.items(), VISITS):
        rows = 100 * np.array(list(figures(make, visits)))
        plan, bound, basic, ideal = rows.mean(axis=0)
        ratio = 100 * (rows[:, 0] / rows[:, 1]).min()
        print(
            f"| {name} | {visits} | {plan:.1f} | {bound:.1f} | {ratio:.1f} | {basic:.1f} | {ideal:.1f} "
            f"| {plan - basic:.1f} | {bound - basic:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
