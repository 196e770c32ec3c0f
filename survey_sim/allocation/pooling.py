"""Plans of one tile while visits are pooled among tiles: which targets so many visits complete."""

import numpy as np

from survey_sim.allocation.field import BoolArray, Field, VisitRequest
from survey_sim.allocation.planning import VALUE_UNIT, Search

# Times that the worth of programmes which lack targets is doubled, while others have theirs.
N_FAVOUR = 2


def plan_visits(
    field: Field,
    is_open: BoolArray,
    n_visit: int,
    kept: BoolArray,
    capacity: int,
    rng: np.random.Generator,
) -> BoolArray:
    """The targets that a number of visits of a tile complete, and when; the ways between the visits are left open.

    Parameters
    ----------
    field
        Of science targets and guides; the other kinds need no place in the plan, only fibres.
    is_open
        (n_target,) science targets that may be planned; all of the other kinds may be.
    n_visit
        Visits.
    kept
        (n_target, n_kept) an older plan to begin from.
    capacity
        Science fibres of a visit.

    Returns
    -------
        (n_target, n_visit) science targets planned; only those that get all visits that they want.
    """
    targets, plate = field.targets, field.plate
    is_free = field.is_on_plate & ~field.blocked_by(plate.park_mm[~plate.is_live]) & (is_open | ~targets.is_science)
    missing = np.where(targets.is_science & is_free, targets.wanted_visits, 0)
    request = VisitRequest(0, plate.park_mm, is_free, np.ones(len(field.reach_robot), dtype=bool), missing)
    state = rng.integers(1, 2**63, size=1, dtype=np.uint64)
    search = Search(field, request, state, capacity=capacity, is_brief=True)
    # A fibre is worth as much to a target that wants many visits as to one that wants one.
    search.value = np.round(VALUE_UNIT * field.value[search.item_target]).astype(np.int64)
    visit_of, _ = search.fill(n_visit, search.visits_of(kept[:, :n_visit]), is_in_part=False)
    for _ in range(N_FAVOUR):
        lack = search.lack(visit_of)
        if not lack.any() or not search.favour(lack > 0):
            break
        visit_of, _ = search.fill(n_visit, visit_of, is_in_part=False)
    return _completed(search, n_visit, visit_of)


def _completed(search: Search, n_visit: int, visit_of: np.ndarray) -> BoolArray:
    """(n_target, n_visit) visits of the targets that get all of theirs."""
    placed = np.bincount(search.item_target[visit_of >= 0], minlength=len(search.copies))
    is_kept = (visit_of >= 0) & (placed == search.copies)[search.item_target]
    is_planned = np.zeros((len(search.copies), n_visit), dtype=bool)
    is_planned[search.item_target[is_kept], visit_of[is_kept]] = True
    return is_planned
