"""The allocation of one tile, visit by visit, with what the router reports in between."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from survey_sim.allocation.closest import choose_advanced, choose_basic
from survey_sim.allocation.field import BoolArray, Field, VisitRequest, close_pair, make_field, with_sub_priority
from survey_sim.allocation.foreign import checked_choice
from survey_sim.allocation.ideal import choose_ideal
from survey_sim.allocation.kernels.choosing import crossings, note_lost
from survey_sim.allocation.kernels.lists import reach_lists
from survey_sim.allocation.kernels.resting import place_idle
from survey_sim.allocation.matching import choose_matching, exchanged
from survey_sim.allocation.planning import Planner
from survey_sim.allocation.resting import rest, resting_places
from survey_sim.allocation.settings import AllocationSettings, LostReason
from survey_sim.allocation.targets import FieldTargets, FloatArray, IntArray
from survey_sim.extensions import load
from survey_sim.instrument import Plate
from survey_sim.schema import TARGET_KINDS

Start = Literal["previous", "park"]
# Who chooses a visit's targets: (n_robot,) index into the field's targets, or -1.
Choice = Callable[[Field, VisitRequest], IntArray]
# Made once for each tile; what it keeps from visit to visit is its own.
Allocator = Callable[[Field, np.random.Generator], Choice]

ALLOCATORS: dict[str, Allocator] = {
    "ideal": lambda field, rng: choose_ideal,
    "cda-basic": lambda field, rng: choose_basic,
    "cda-advanced": lambda field, rng: choose_advanced,
    "matching": lambda field, rng: choose_matching,
    "plan": Planner,
}
# Algorithms that leave it open which robot holds what: the paper's have their own rules.
EXCHANGING = ("matching", "plan")


@dataclass(frozen=True)
class VisitAllocation:
    """Who goes where in one visit.

    Attributes
    ----------
    visit_id
        Counted from 0 in the session.
    target
        (n_robot,) index into the field's targets, or -1.
    goal_mm
        (n_robot, 2) where each robot shall end: its target, a resting place, or its place if it is dead.
    start
        Where the robots set out: their previous ends, or their park positions.
    travel_mm
        (n_robot,) straight distance from there, mm.
    counts
        By kind: fibres that hold it.
    shortfall
        How many fewer `standard`, `sky` and `guide` fibres than the least acceptable number; `sky_region`: sky fibres that
        plate regions lack, summed over regions.
    crossings
        Pairs of straight ways that meet.
    """

    visit_id: int
    target: IntArray
    goal_mm: FloatArray
    start: Start
    travel_mm: FloatArray
    counts: dict[str, int]
    shortfall: dict[str, int]
    crossings: int


class Session:
    """The visits of one tile. Made by `start_allocation`.

    Call `next_visit` with where the robots stand, then `record` with what arrived, until `next_visit` gives None.

    Attributes
    ----------
    n_done
        (n_target,) visits received so far, those before the session included.
    """

    def __init__(
        self, field: Field, rng: np.random.Generator, n_done: npt.ArrayLike | None, plan: BoolArray | None = None
    ) -> None:
        self.field = field
        n_target = field.targets.n_target
        self.n_done = np.zeros(n_target, dtype=np.int64) if n_done is None else np.array(n_done, dtype=np.int64)
        self._choose = _chooser(field, rng, plan)
        self._n_visit = 0
        self._awaits_record = False
        self._is_pair_open = np.ones(len(field.reach_robot), dtype=bool)
        self._is_unrouted = np.zeros(n_target, dtype=bool)
        self._n_clear = np.zeros(n_target, dtype=np.int64)
        self._lowest = np.full(n_target, np.iinfo(np.int64).max)

    @property
    def is_complete(self) -> BoolArray:
        """(n_target,) science targets with all their wanted visits."""
        targets = self.field.targets
        return targets.is_science & (self.n_done >= targets.wanted_visits)

    @property
    def completeness_frac(self) -> float:
        """Complete science targets / science targets on the plate; 1 if there are none."""
        n = int((self.field.targets.is_science & self.field.is_on_plate).sum())
        return float(self.is_complete.sum() / n) if n else 1.0

    def has_wanted_completeness(self) -> bool:
        """Whether every programme has the completeness that it wants of its targets on the plate."""
        targets = self.field.targets
        is_counted = targets.is_science & self.field.is_on_plate & (targets.programme >= 0)
        n_programme = len(targets.programmes)
        n = np.bincount(targets.programme[is_counted], minlength=n_programme)
        n_complete = np.bincount(targets.programme[is_counted & self.is_complete], minlength=n_programme)
        return bool((n_complete >= np.ceil(targets.wanted_frac * n - 1e-9)).all())

    def next_visit(self, position_mm: FloatArray) -> VisitAllocation | None:
        """The next visit, or None when no further one is wanted or worth its time.

        Parameters
        ----------
        position_mm
            (n_robot, 2) where the robots stand, mm, plate frame.
        """
        if self._awaits_record:
            raise RuntimeError("record() the last visit before asking for the next")
        settings, plate = self.field.settings, self.field.plate
        is_last = self.has_wanted_completeness() if settings.visits is None else self._n_visit >= settings.visits
        if is_last or self._n_visit >= settings.max_visits:
            return None
        start: Start = "park" if settings.algorithm == "cda-basic" else "previous"
        start_mm = np.where(plate.is_live[:, None], plate.park_mm, position_mm) if start == "park" else position_mm
        start_mm = np.ascontiguousarray(start_mm, dtype=np.float64)
        missing = self._missing()
        is_open = self.field.is_on_plate & ((missing > 0) | ~self.field.targets.is_science)
        is_open &= ~self.field.blocked_by(start_mm[~plate.is_live])
        self._request = VisitRequest(self._n_visit, start_mm, is_open, self._is_pair_open, missing)
        visit = self._visit(self._choose(self.field, self._request), start)
        if visit.counts["science"] < settings.min_gain:
            return None
        self._awaits_record = True
        return visit

    def exchanged(
        self, visit: VisitAllocation, barred: Collection[tuple[int, int]], *, may_lengthen: bool
    ) -> VisitAllocation | None:
        """The visit that awaits its record again, some targets barred to some robots; None if one would be lost by it.

        So a robot that holds a path up may be got out of the way. `record` takes the visit that is made.

        Parameters
        ----------
        barred
            Pairs of robot and target.
        may_lengthen
            Whether ways may grow beyond the longest there are, from where the robots stand and from park.
        """
        if not self._may_exchange():
            return None
        held = exchanged(self.field, self._request, visit.target, barred, may_lengthen=may_lengthen)
        return None if held is None else self._visit(held, visit.start)

    def resting_places(self, visit: VisitAllocation, robot: int) -> FloatArray:
        """(n, 2) other places where an idle robot of the visit that awaits its record may rest, the best first, mm."""
        if not self._may_exchange():
            return np.empty((0, 2))
        return resting_places(self.field.plate, self._request.start_mm, visit.goal_mm, robot)

    def rested(self, visit: VisitAllocation, places: Mapping[int, FloatArray]) -> VisitAllocation:
        """The same visit, idle robots resting at these places (by robot), as far as there is room for them."""
        plate, start_mm, goal_mm = self.field.plate, self._request.start_mm, visit.goal_mm.copy()
        rest(plate, visit.target < 0, goal_mm, places)
        return _make_visit(
            self.field, visit.visit_id, visit.target, start=visit.start, start_mm=start_mm, goal_mm=goal_mm
        )  # fmt: skip

    def _may_exchange(self) -> bool:
        if not self._awaits_record:
            raise RuntimeError("exchange robots between next_visit() and record()")
        return self.field.settings.algorithm in EXCHANGING

    def record(self, visit: VisitAllocation, is_arrived: BoolArray) -> None:
        """Take note of a visit that was made; targets of robots that did not arrive are open again, to other robots.

        Parameters
        ----------
        is_arrived
            (n_robot,) robots that the router brought to their ends.
        """
        targets = self.field.targets
        has_target = visit.target >= 0
        reached = visit.target[has_target & is_arrived]
        missed = visit.target[has_target & ~is_arrived]
        note_lost(
            visit.target, self._missing() > 0, targets.is_science, targets.priority,
            self.field.near_first, self.field.near, self.field.reach_first, self.field.reach_robot,
            self._n_clear, self._lowest,
        )  # fmt: skip
        self.n_done[reached] += 1
        self._is_unrouted[reached] = False
        self._is_unrouted[missed] = True
        for robot in np.flatnonzero(has_target & ~is_arrived).tolist():
            close_pair(self.field.reach_first, self.field.reach_robot, robot, int(visit.target[robot]), self._is_pair_open)
        self._n_visit += 1
        self._awaits_record = False

    def lost_reasons(self) -> npt.NDArray[np.int8]:
        """(n_target,) `LostReason` of every science target that is not complete; 0 for the rest."""
        field, plate = self.field, self.field.plate
        n_near = np.diff(field.near_first)
        otherwise = LostReason.NO_FIBRE_LEFT if self._n_visit else LostReason.NO_VISIT
        reason = np.full(field.targets.n_target, otherwise, dtype=np.int8)
        reason[(field.targets.priority < self._lowest) & (self._n_visit > 0)] = LostReason.LOW_PRIORITY
        is_crowded = (self._n_clear == 0) & (self._n_visit > 0)
        reason[is_crowded] = LostReason.CROWDED
        reason[is_crowded & (n_near == 1)] = LostReason.TOO_CLOSE_PAIR
        reason[self._is_unrouted] = LostReason.UNROUTED
        reason[field.blocked_by(plate.park_mm[~plate.is_live])] = LostReason.BLOCKED_BY_DEAD
        reason[~field.is_reached] = LostReason.BLOCKED_BY_DEAD
        reason[~field.is_on_plate | ~_in_reach_of_any(field)] = LostReason.OUT_OF_REACH
        reason[~field.targets.is_science | self.is_complete] = LostReason.NONE
        return reason

    def _missing(self) -> IntArray:
        """(n_target,) visits that each science target on the plate still wants."""
        targets = self.field.targets
        return np.where(targets.is_science & self.field.is_on_plate, np.maximum(targets.wanted_visits - self.n_done, 0), 0)

    def _visit(self, held: IntArray, start: Start) -> VisitAllocation:
        """The visit in which robots hold these targets."""
        start_mm, xy = self._request.start_mm, self.field.xy_mm
        goal = start_mm.copy() if self.field.settings.algorithm == "ideal" else self._goals(held, start_mm)
        goal[held >= 0] = xy[held[held >= 0]]
        return _make_visit(self.field, self._n_visit, held, start=start, start_mm=start_mm, goal_mm=goal)

    def _goals(self, held: IntArray, start_mm: FloatArray) -> FloatArray:
        """Ends of all robots; where an idle one finds no room, the nearest science target is given up (in `held`)."""
        plate, xy = self.field.plate, self.field.xy_mm
        while True:
            goal = start_mm.copy()
            goal[held >= 0] = xy[held[held >= 0]]
            stuck = place_idle(
                held < 0, plate.is_live, start_mm, plate.park_mm, plate.patrol_radius_mm,
                plate.instrument.plate_radius_mm, self.field.separation_mm, goal,
            )  # fmt: skip
            if stuck < 0:
                return goal
            holders = np.flatnonzero(held >= 0)
            is_science = self.field.targets.is_science[held[holders]]
            near_first = np.lexsort((np.hypot(*(xy[held[holders]] - start_mm[stuck]).T), ~is_science))
            held[holders[near_first[0]]] = -1


def start_allocation(
    targets: FieldTargets,
    plate: Plate,
    settings: AllocationSettings,
    rng: np.random.Generator,
    n_done: npt.ArrayLike | None = None,
    plan: BoolArray | None = None,
    field: Field | None = None,
) -> Session:
    """Begin the visits of one tile.

    Parameters
    ----------
    n_done
        (n_target,) visits that each science target has received already (a tile that goes on); none by default.
    plan
        (n_target, n_visit) which targets are wanted in which visit, for `plan` to begin from.
    field
        The targets on the plate as `make_field` makes them with these settings, where they are at hand.
    """
    field = field or make_field(targets, plate, settings)
    if settings.sub_priority:
        field = with_sub_priority(field, rng, settings.sub_priority)
    return Session(field, rng, n_done, plan)


def _chooser(field: Field, rng: np.random.Generator, plan: BoolArray | None) -> Choice:
    """Who chooses in this tile; what another package's allocator chooses is checked."""
    name = field.settings.algorithm
    if name == "plan":
        return Planner(field, rng, plan)
    if name in ALLOCATORS:
        return ALLOCATORS[name](field, rng)
    choose: Choice = load("allocator", name)(field, rng)
    return lambda field, request: checked_choice(field, request, choose(field, request))


def _make_visit(
    field: Field, visit_id: int, held: IntArray, *, start: Start, start_mm: FloatArray, goal_mm: FloatArray
) -> VisitAllocation:
    target = held[held >= 0]
    number = np.bincount(field.targets.kind[target], minlength=len(TARGET_KINDS))
    counts = {kind: int(number[code]) for code, kind in enumerate(TARGET_KINDS)}
    return VisitAllocation(
        visit_id=visit_id,
        target=held,
        goal_mm=goal_mm,
        start=start,
        travel_mm=np.hypot(*(goal_mm - start_mm).T),
        counts=counts,
        shortfall=field.shortfall(held),
        crossings=int(crossings(start_mm, goal_mm)),
    )


def _in_reach_of_any(field: Field) -> BoolArray:
    """(n_target,) targets on the plate in the patrol disc of a robot of their kind, dead or live."""
    plate = field.plate
    is_for_guide = field.targets.kind == TARGET_KINDS.index("guide")
    is_reached = field.is_reached
    if plate.is_live.all():
        return np.asarray(is_reached)
    first, _ = reach_lists(
        plate.park_mm, plate.patrol_radius_mm, plate.is_guide, field.xy_mm, is_for_guide, field.is_on_plate & ~is_reached
    )  # fmt: skip
    return np.asarray(is_reached | (np.diff(first) > 0))
