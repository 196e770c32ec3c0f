"""What the pull to park brings, on routed visits: `python -m tests.benchmarks.park_pull [ALGORITHM]`.

For each kind of field and each `park_pull`: completeness, the median of the visits' greatest travel, and of the three paths
the mean configuration time, the mean lower bound, and the share of visits at it.
"""

import sys
from itertools import product

import numpy as np

from survey_sim.allocation import AllocationSettings, FieldTargets, start_allocation
from survey_sim.instrument import Plate, load_instrument, make_plate
from survey_sim.routing import RoutedPath, RoutingSettings, UnroutedReason, route
from tests.mock_targets import clustered_xy, field_targets, survey_targets, uniform_xy

SEEDS = (1, 2, 3, 4)
PULLS = (0.0, 0.1, 0.3, 0.5, 1.0)
FIELDS = {
    "1,431 clustered, paper": (lambda seed: field_targets(clustered_xy(1431, seed)), "paper", 10),
    "1,431 uniform, paper": (lambda seed: field_targets(uniform_xy(1431, seed)), "paper", 10),
    "900 clustered, taipan-150": (lambda seed: survey_targets(clustered_xy(900, seed), seed), "taipan-150", 8),
    "3,000 uniform, taipan-300": (lambda seed: survey_targets(uniform_xy(3000, seed), seed), "taipan-300", 13),
}


def routed_visits(targets: FieldTargets, plate: Plate, settings: AllocationSettings) -> tuple[np.ndarray, float]:
    """(n_visit, 10): greatest travel, and of each path its time, bound and whether they are equal; completeness."""
    session = start_allocation(targets, plate, settings, np.random.default_rng(1))
    rng, routing = np.random.default_rng(1), RoutingSettings()
    position, theta, none = plate.park_mm, np.zeros(plate.n_robot), np.zeros(plate.n_robot)
    rows = []
    while (visit := session.next_visit(position)) is not None:
        to_target = route(plate, position, theta, visit.goal_mm, routing, rng)
        to_park = route(plate, position, theta, plate.park_mm, routing, rng)
        from_park = route(plate, plate.park_mm, none, to_target.end_mm, routing, rng)
        session.record(visit, to_target.reason == UnroutedReason.ARRIVED)
        rows.append(
            [visit.travel_mm.max(), *(figure for path in (to_target, to_park, from_park) for figure in _figures(path))]
        )
        position, theta = to_target.end_mm, to_target.end_theta_deg
    return np.array(rows), session.completeness_frac


def _figures(path: RoutedPath) -> tuple[float, float, bool]:
    time_s, bound_s = path.configuration_time_s, path.lower_bound_s
    return time_s, bound_s, time_s <= bound_s + 1e-6


def main(algorithm: str = "plan") -> None:
    """Print a row a field and pull."""
    for (name, (make, instrument, visits)), pull in product(FIELDS.items(), PULLS):
        plate = make_plate(load_instrument(instrument))
        settings = AllocationSettings.load({"algorithm": algorithm, "visits": visits, "park_pull": pull})
        made = [routed_visits(make(seed), plate, settings) for seed in SEEDS]
        rows = np.vstack([visits for visits, _ in made])
        mean = rows.mean(axis=0)
        paths = " | ".join(f"{mean[k]:.2f} ({mean[k + 1]:.2f}), {100 * mean[k + 2]:.0f} %" for k in (1, 4, 7))
        completeness = 100 * np.mean([share for _, share in made])
        print(f"| {name} | {pull:g} | {completeness:.2f} | {np.median(rows[:, 0]):.1f} | {paths} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
