"""The allocation of one tile many times, its targets' sub-priorities drawn anew each time: who would be selected how often.

Robots are taken to arrive. `plan` is realised by its search for most targets alone: the exchanges that shorten ways give up
no target for one worth less, and which robot serves which target is no matter here (measured: docs/imprint.md).
"""

import numpy as np

from survey_sim.allocation.field import BoolArray, Field, VisitRequest, make_field, with_sub_priority
from survey_sim.allocation.planning import PlannedGuides, Search
from survey_sim.allocation.session import Session
from survey_sim.allocation.settings import AllocationSettings
from survey_sim.allocation.targets import FieldTargets, IntArray
from survey_sim.instrument import Plate

# `plan`: length of the search, as a share of that of a run. Probabilities differ from those of whole sessions by no more
# than their noise (docs/imprint.md).
EFFORT_FRAC = 0.4


class Realisations:
    """Realisations of one field, which share all that does not depend on sub-priorities.

    Parameters
    ----------
    targets, plate, settings
        As for `start_allocation`; a `sub_priority` of 0 counts as 1.
    n_planned
        `plan`: visits that a tile has at least, where visits were pooled among tiles.
    """

    def __init__(self, targets: FieldTargets, plate: Plate, settings: AllocationSettings, n_planned: int = 0) -> None:
        self._settings = settings.model_copy(update={"effort": EFFORT_FRAC * settings.effort})
        self._field = make_field(targets, plate, self._settings)
        self._worth = settings.sub_priority or 1.0
        self._plate = plate
        self._n_planned = n_planned
        self._guides: PlannedGuides | None = None

    def draw(self, rng: np.random.Generator, n_done: IntArray) -> IntArray:
        """(n_target,) visits that each target has received in the end, of `n_done` (n_target,) at the start."""
        field = with_sub_priority(self._field, rng, self._worth)
        if self._settings.algorithm == "plan":
            return n_done + self._planned(field, self._request(n_done), rng)
        session = Session(field, rng, n_done)
        position = self._plate.park_mm
        while (visit := session.next_visit(position)) is not None:
            session.record(visit, np.ones(self._plate.n_robot, dtype=bool))
            position = visit.goal_mm
        return session.n_done

    def _request(self, n_done: IntArray) -> VisitRequest:
        """What the first visit starts from."""
        field, plate = self._field, self._plate
        targets = field.targets
        missing = np.where(targets.is_science & field.is_on_plate, np.maximum(targets.wanted_visits - n_done, 0), 0)
        is_open: BoolArray = field.is_on_plate & ((missing > 0) | ~targets.is_science)
        is_open &= ~field.blocked_by(plate.park_mm[~plate.is_live])
        return VisitRequest(0, plate.park_mm, is_open, np.ones(len(field.reach_robot), dtype=bool), missing)

    def _planned(self, field: Field, request: VisitRequest, rng: np.random.Generator) -> IntArray:
        """(n_target,) visits that a plan gives each target."""
        settings = self._settings
        state = rng.integers(1, 2**63, size=1, dtype=np.uint64)
        self._guides = self._guides or PlannedGuides(self._field, request, request.missing > 0)
        search = Search(field, request, state, self._guides)
        limit = settings.max_visits if settings.visits is None else min(settings.visits, settings.max_visits)
        n_visit = limit if settings.visits is not None else min(limit, max(search.least_visits(), self._n_planned))
        nothing = np.full(len(search.item_target), -1, dtype=np.int64)
        n_visit, visit_of, _ = search.fill_enough(n_visit, nothing, limit)
        # As in a session, a visit that brings too little ends the tile.
        n_science = np.bincount(visit_of[visit_of >= 0], minlength=n_visit)
        n_made = int(np.argmax(np.append(n_science, -1) < settings.min_gain))
        made = (visit_of >= 0) & (visit_of < n_made)
        return np.bincount(search.item_target[made], minlength=field.targets.n_target)
