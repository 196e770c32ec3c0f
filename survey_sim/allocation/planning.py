"""All visits of a tile planned together: what goes into which visit, and in which order the robots get there."""

import numpy as np

from survey_sim.allocation.field import BoolArray, Field, VisitRequest
from survey_sim.allocation.kernels.cover import cover, make_items
from survey_sim.allocation.kernels.shorten import sample_within, shorten
from survey_sim.allocation.matching import (
    NEEDED_VALUE,
    fill_calibration,
    lacks_calibration,
    match,
    pick_calibration,
    untangled,
)
from survey_sim.allocation.targets import GUIDE, SKY, STANDARD, IntArray

# Whole-number worth of a target of value 1, for the search.
VALUE_UNIT = 1000
# Moves without improvement that end the search for more targets; chosen on 1,431 clustered targets, as all below.
N_STEP = 2000
# Rounds of shortening: robots matched anew from visit to visit, then sweeps of exchanges from hot to cold.
N_ROUND = 2
N_SWEEP = 8
HOT_MM, COLD_MM = 20.0, 6.0
EXCHANGE_RADIUS_MM = 30.0
N_EXCHANGE = 30
# An old plan of which so much goes on is mended, not shortened again.
KEPT_FRAC = 0.9
# Length of searches that begin from an older plan, as a share of those that begin from nothing.
MEND_EFFORT_FRAC = 0.3
# The same of shortening: sweeps with heat, in the first round alone, and exchanges tried in each (few targets wait there:
# with twice as many, or with heat in both rounds, ways are 0 to 1 % shorter on tiles of the five-year survey).
MEND_SWEEP_FRAC = 0.5
# Worth of a fibre of a target that goes first, in fibres of one that does not: more than it can be in the way of.
FIRST_WORTH = 8
# Rounds that give up the targets least begun of those that cannot get all their visits.
N_GIVE_UP = 4


class Planner:
    """The plan of one tile, kept up with what is really observed.

    The first request plans all visits; each request matches robots to the visit's targets from where the robots really
    stand. When something planned was not observed, the visits that remain are planned again, beginning from the old plan.
    """

    def __init__(self, field: Field, rng: np.random.Generator, plan: BoolArray | None = None) -> None:
        self.field = field
        self._state = rng.integers(1, 2**63, size=1, dtype=np.uint64)
        self._is_planned = np.zeros((field.targets.n_target, 0), dtype=bool) if plan is None else plan
        self._is_short = False
        self._n_planned = self._is_planned.sum(axis=1)
        self._unplanned = np.full(field.targets.n_target, -1, dtype=np.int64)
        # Who planned knows what other tiles do: its targets go before all others.
        self._goes_first = np.asarray(self._is_planned.any(axis=1))

    def __call__(self, field: Field, request: VisitRequest) -> IntArray:
        """(n_robot,) target of each robot or -1, of the next planned visit."""
        if not self._is_kept(request):
            self._plan(request)
        if not self._is_planned.shape[1]:
            return np.full(field.plate.n_robot, -1, dtype=np.int64)
        now, self._is_planned = self._is_planned[:, 0], self._is_planned[:, 1:]
        self._n_planned = self._n_planned - now
        is_guide = field.targets.kind == GUIDE
        has_guides = (now & is_guide).sum() >= field.minima.min_guide
        is_planned = request.is_open & (now | (is_guide & (not has_guides)))
        value = np.where(is_guide, NEEDED_VALUE, field.value)
        held = fill_calibration(field, request, match(field, request.start_mm, is_planned, request.is_pair_open, value))
        if not lacks_calibration(field, held):
            return untangled(field, request, held)
        is_calibration = request.is_open & ~field.targets.is_science & ~is_guide
        is_needed, _ = pick_calibration(field, is_planned | is_calibration, request.start_mm)
        value[is_needed] = NEEDED_VALUE
        held = match(field, request.start_mm, is_planned | (is_needed & ~is_guide), request.is_pair_open, value)
        return untangled(field, request, fill_calibration(field, request, held))

    def _is_kept(self, request: VisitRequest) -> bool:
        return not (self.field.targets.is_science & (self._n_planned + self._unplanned != request.missing)).any()

    def _plan(self, request: VisitRequest) -> None:
        """Plan the visits from this one on."""
        field, settings = self.field, self.field.settings
        limit = settings.max_visits if settings.visits is None else min(settings.visits, settings.max_visits)
        limit -= request.visit_id
        old = self._is_planned[:, :limit]
        search = Search(field, request, self._state, is_brief=bool(old.any()))
        search.prefer(self._goes_first)
        least = min(limit, max(search.least_visits(), old.shape[1]))
        n_visit = least if settings.visits is None else limit
        kept = search.visits_of(old)
        n_visit, visit_of, guides = search.fill_enough(n_visit, kept, limit)
        if not self._is_short or (kept >= 0).sum() < KEPT_FRAC * (visit_of >= 0).sum():
            visit_of = search.shorten(n_visit, visit_of, guides)
            self._is_short = True
        self._is_planned = np.zeros((field.targets.n_target, n_visit), dtype=bool)
        is_placed = visit_of >= 0
        self._is_planned[search.item_target[is_placed], visit_of[is_placed]] = True
        self._unplanned = request.missing - self._is_planned.sum(axis=1)
        for visit, chosen in enumerate(guides):
            self._is_planned[chosen, visit] = True
        self._n_planned = self._is_planned.sum(axis=1)


class PlannedGuides:
    """Guide stars of each visit: those that stand in the way of the least science, not always the same."""

    def __init__(self, field: Field, request: VisitRequest, is_wanted: BoolArray) -> None:
        self._field, self._request = field, request
        self._is_guide = request.is_open & (field.targets.kind == GUIDE)
        self._blocked = np.where(is_wanted, field.value, 0.0)
        self._chosen: list[IntArray] = []

    def first(self, n_visit: int) -> list[IntArray]:
        """Guides of so many visits; those of a visit are the same whatever the number."""
        if not self._is_guide.any():
            return [np.empty(0, dtype=np.int64)] * n_visit
        field, request = self._field, self._request
        while len(self._chosen) < n_visit:
            displaced = field.sum_near(self._blocked)
            value = NEEDED_VALUE - displaced / (1.0 + displaced.max(initial=0.0))
            held = match(field, request.start_mm, self._is_guide, request.is_pair_open, value)
            chosen = held[held >= 0]
            self._chosen.append(chosen)
            self._blocked = self._blocked * (1.0 + field.near_any(chosen))
        return self._chosen[:n_visit]


class Search:
    """The items of one plan and the searches over them; `guides` may be shared by plans of the same field."""

    def __init__(
        self,
        field: Field,
        request: VisitRequest,
        state: np.ndarray,
        guides: "PlannedGuides | None" = None,
        capacity: int | None = None,
        *,
        is_brief: bool = False,
    ) -> None:
        self.field, self.request, self.state = field, request, state
        targets, settings = field.targets, field.settings
        self.n_step = round(N_STEP * settings.effort * (MEND_EFFORT_FRAC if is_brief else 1.0))
        sweep_frac = MEND_SWEEP_FRAC if is_brief else 1.0
        n_sweep = max(1, round(N_SWEEP * settings.effort * sweep_frac))
        self.sweeps = (n_sweep, *[0 if is_brief else n_sweep] * (N_ROUND - 1))
        self.n_exchange = round(N_EXCHANGE * sweep_frac)
        is_served = request.is_open & field.is_reached
        copies = np.where(is_served & targets.is_science, request.missing, 0)
        self.item_target, self.near_first, self.near = make_items(copies, field.near_first, field.near)
        self.copies = copies
        self.guides = guides or PlannedGuides(field, request, copies > 0)
        # A target counts when it is complete: each of its visits is worth its share.
        worth = VALUE_UNIT * field.value / np.maximum(copies, 1)
        self.value = np.maximum(1, np.round(worth[self.item_target])).astype(np.int64)
        n_standard, n_sky = ((is_served & (targets.kind == code)).sum() for code in (STANDARD, SKY))
        n_reserved = min(settings.wanted_standard, n_standard) + min(settings.wanted_sky, n_sky)
        self.capacity = max(0, field.plate.n_science_live - int(n_reserved)) if capacity is None else capacity

    def prefer(self, is_first: BoolArray) -> None:
        """Make each fibre of some targets (n_target,), however many they want, worth more than one of any other."""
        worth = np.round(FIRST_WORTH * VALUE_UNIT * self.field.value[self.item_target]).astype(np.int64)
        self.value = np.where(is_first[self.item_target], worth, self.value)

    def least_visits(self) -> int:
        """Fewest visits that could do."""
        n = self._needed().sum()
        return max(1, int(-(-n // max(1, self.capacity)))) if n else 0

    def visits_of(self, is_planned: BoolArray) -> IntArray:
        """(n_item,) visit of each item in an older plan, or -1."""
        visit_of = np.full(len(self.item_target), -1, dtype=np.int64)
        begin = np.cumsum(self.copies) - self.copies
        target, visit = np.nonzero(is_planned & (self.copies > 0)[:, None])
        copy = np.arange(len(target)) - np.searchsorted(target, target)
        is_wanted = copy < self.copies[target]
        visit_of[(begin[target] + copy)[is_wanted]] = visit[is_wanted]
        return visit_of

    def lack(self, visit_of: IntArray) -> IntArray:
        """(n_programme,) science targets that are wanted complete and not planned so, of those that can be served."""
        return np.minimum(self._needed() - self._n_complete(visit_of), self._n_waiting(visit_of)).clip(0)

    def favour(self, is_lacking: BoolArray) -> bool:
        """Double the worth of targets of some programmes; nothing to do if that is none or all of them."""
        if is_lacking.all() or not is_lacking.any():
            return False
        programme = self.field.targets.programme[self.item_target]
        self.value = np.where((programme >= 0) & is_lacking[programme], 2, 1) * self.value
        return True

    def fill_enough(self, n_visit: int, visit_of: IntArray, limit: int) -> tuple[int, IntArray, list[IntArray]]:
        """Most value in so many visits, or, if their number is not set, in as many more as the completeness wanted needs."""
        visit_of, guides = self.fill(n_visit, visit_of)
        while self.field.settings.visits is None and (lack := self.lack(visit_of)).any():
            if self.favour(lack > 0):
                visit_of, guides = self.fill(n_visit, visit_of)
                lack = self.lack(visit_of)
            more = min(limit - n_visit, -(-int(lack.sum()) // max(1, self.capacity)))
            if more <= 0:
                break
            wider, wider_guides = self.fill(n_visit + more, visit_of)
            if (wider >= 0).sum() <= (visit_of >= 0).sum():
                break
            n_visit, visit_of, guides = n_visit + more, wider, wider_guides
        return n_visit, visit_of, guides

    def fill(self, n_visit: int, visit_of: IntArray, *, is_in_part: bool = True) -> tuple[IntArray, list[IntArray]]:
        """Most value in so many visits; targets that cannot get all their visits are given up, the least begun first.

        `is_in_part`: fibres that are left then go to those given up.
        """
        guides = self.guides.first(n_visit)
        is_shut = self._shut(guides)
        is_dropped = (self.copies > n_visit)[self.item_target]
        for _ in range(N_GIVE_UP):
            visit_of = self._cover(n_visit, np.where(is_dropped, -1, visit_of), is_dropped, is_shut)
            placed = np.bincount(self.item_target[visit_of >= 0], minlength=len(self.copies))
            is_partial = (placed > 0) & (placed < self.copies)
            if not is_partial.any():
                break
            share = placed[is_partial] / self.copies[is_partial]
            is_partial[is_partial] = share <= np.median(share)
            is_dropped |= is_partial[self.item_target]
        if is_in_part and is_dropped.any():
            visit_of = self._cover(n_visit, visit_of, is_dropped & False, is_shut, np.where(is_dropped, 1, self.value))
        return visit_of, guides

    def shorten(self, n_visit: int, visit_of: IntArray, guides: list[IntArray]) -> IntArray:
        """The same plan, or one of the same value, with shorter ways from visit to visit."""
        field, settings = self.field, self.field.settings
        xy = np.ascontiguousarray(field.xy_mm[self.item_target])
        power = settings.travel_power
        # Targets of several visits stay as they are: a part of one is worth nothing.
        kin = np.where(self.copies == 1, field.targets.programme, -1)[self.item_target]
        rank = (field.targets.priority[self.item_target] - 1.0) / 8.0
        is_shut = self._shut(guides)
        visit_of = visit_of.copy()
        candidates = sample_within(xy, EXCHANGE_RADIUS_MM, self.n_exchange, self.state)
        for n_sweep in self.sweeps if n_visit else ():
            slot, robot_of = self._match_all(n_visit, visit_of)
            shorten(
                n_sweep, HOT_MM**power, COLD_MM**power, power / 2.0,
                settings.used_park_pull, self.request.start_mm, field.plate.park_mm, xy, field.separation_mm,
                self.value, kin, settings.delay_worth_mm**power * rank,
                self.near_first, self.near, self.item_target, field.reach_first, field.reach_robot,
                self.request.is_pair_open, is_shut, np.full(n_visit, self.capacity),
                candidates, slot, visit_of, robot_of, self.state,
            )  # fmt: skip
        return visit_of

    def _cover(
        self, n_visit: int, visit_of: IntArray, is_dropped: BoolArray, is_shut: BoolArray, value: IntArray | None = None
    ) -> IntArray:
        field = self.field
        value = np.where(is_dropped, 0, self.value if value is None else value)
        visit_of = visit_of.copy()
        capacity = np.full(n_visit, self.capacity)
        most = np.sort(value)[::-1][: n_visit * self.capacity].sum()
        cover(
            self.n_step, most, value, self.near_first, self.near, self.item_target,
            field.reach_first, field.reach_robot, self.request.is_pair_open, self._place(n_visit), is_shut, capacity,
            visit_of, field.plate.n_robot, self.state,
        )  # fmt: skip
        return visit_of

    def _place(self, n_visit: int) -> IntArray:
        """(n_visit,) where the lists of robots in reach of each visit's tile begin in those of the field."""
        return np.zeros(n_visit, dtype=np.int64)

    def _match_all(self, n_visit: int, visit_of: IntArray) -> tuple[IntArray, IntArray]:
        """Robots matched to each visit from where the one before left them: slot (n_visit, n_robot), robot_of (n_item,)."""
        field = self.field
        slot = np.full((n_visit, field.plate.n_robot), -1, dtype=np.int64)
        robot_of = np.full(len(visit_of), -1, dtype=np.int64)
        item_of = np.full(field.targets.n_target, -1, dtype=np.int64)
        position = self.request.start_mm.copy()
        for visit in range(n_visit):
            items = np.flatnonzero(visit_of == visit)
            is_open = np.zeros(field.targets.n_target, dtype=bool)
            is_open[self.item_target[items]] = True
            item_of[self.item_target[items]] = items
            held = match(field, position, is_open, self.request.is_pair_open, field.value)
            robots = np.flatnonzero(held >= 0)
            slot[visit, robots] = item_of[held[robots]]
            robot_of[slot[visit, robots]] = robots
            position[robots] = field.xy_mm[held[robots]]
        visit_of[robot_of < 0] = -1
        return slot, robot_of

    def _shut(self, guides: list[IntArray]) -> BoolArray:
        """(n_target, n_visit) targets that a visit's guides leave no room for."""
        is_shut = np.zeros((self.field.targets.n_target, len(guides)), dtype=bool)
        for visit, chosen in enumerate(guides):
            is_shut[:, visit] = self.field.near_any(chosen)
        return is_shut

    def _programme_counts(self, is_counted: BoolArray) -> IntArray:
        targets = self.field.targets
        is_counted = is_counted & targets.is_science & self.field.is_on_plate & (targets.programme >= 0)
        return np.bincount(targets.programme[is_counted], minlength=len(targets.programmes))

    def _needed(self) -> IntArray:
        """(n_programme,) science targets still to be completed for the completeness wanted."""
        n = self._programme_counts(np.ones(self.field.targets.n_target, dtype=bool))
        is_complete = self.request.missing == 0
        return (
            np.ceil(self.field.targets.wanted_frac * n - 1e-9).astype(np.int64) - self._programme_counts(is_complete)
        ).clip(0)

    def _n_complete(self, visit_of: IntArray) -> IntArray:
        placed = np.bincount(self.item_target[visit_of >= 0], minlength=len(self.copies))
        return self._programme_counts((self.copies > 0) & (placed == self.copies))

    def _n_waiting(self, visit_of: IntArray) -> IntArray:
        placed = np.bincount(self.item_target[visit_of >= 0], minlength=len(self.copies))
        return self._programme_counts(placed < self.copies)
