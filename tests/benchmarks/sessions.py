"""All visits of one tile, were every robot to arrive."""

import numpy as np

from survey_sim.allocation import AllocationSettings, FieldTargets, VisitAllocation, start_allocation
from survey_sim.instrument import Plate


def all_visits(targets: FieldTargets, plate: Plate, settings: AllocationSettings) -> tuple[list[VisitAllocation], float]:
    """Its visits, and the completeness after the last."""
    session = start_allocation(targets, plate, settings, np.random.default_rng(1))
    position, has_arrived = plate.park_mm, np.ones(plate.n_robot, dtype=bool)
    visits = []
    while (visit := session.next_visit(position)) is not None:
        session.record(visit, has_arrived)
        visits.append(visit)
        position = visit.goal_mm
    return visits, session.completeness_frac
