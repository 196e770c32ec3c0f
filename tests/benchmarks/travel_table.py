"""The table of travel in docs/allocation.md: `python -m tests.benchmarks.travel_table`.

For each kind of field, algorithm and number of visits, planned for itself: the median of the visits' greatest travel, mean
of three seeds; 1,431 targets, `paper` instrument, every robot arrives.
"""

from itertools import product

import numpy as np

from survey_sim.allocation import AllocationSettings
from survey_sim.instrument import load_instrument, make_plate
from tests.benchmarks.sessions import all_visits
from tests.mock_targets import clustered_xy, field_targets, uniform_xy

N_TARGET = 1431
SEEDS = (1, 2, 3)
VISITS = (5, 8, 10, 12, 15)
FIELDS = {"uniform": uniform_xy, "clustered": clustered_xy}
ALGORITHMS = ("cda-advanced", "plan")


def median_of_greatest_mm(places: np.ndarray, algorithm: str, visits: int) -> float:
    """Median over the visits of one tile of the greatest travel, mm."""
    plate = make_plate(load_instrument("paper"))
    settings = AllocationSettings.load({"algorithm": algorithm, "visits": visits, "bound": "none"})
    made, _ = all_visits(field_targets(places), plate, settings)
    return float(np.median([visit.travel_mm.max() for visit in made]))


def main() -> None:
    """Print a row a field and algorithm."""
    print("| targets | algorithm | " + " | ".join(f"{visits} visits" for visits in VISITS) + " |")
    print("|" + "---|" * (2 + len(VISITS)))
    for (name, make), algorithm in product(FIELDS.items(), ALGORITHMS):
        figures = [
            np.mean([median_of_greatest_mm(make(N_TARGET, seed), algorithm, visits) for seed in SEEDS]) for visits in VISITS
        ]
        print(f"| {name} | `{algorithm}` | " + " | ".join(f"{figure:.1f}" for figure in figures) + " |", flush=True)


if __name__ == "__main__":
    main()
