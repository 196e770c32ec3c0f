"""Plans of tiles while visits are pooled among them: which targets so many visits complete."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from survey_sim.allocation.field import BoolArray, Field, VisitRequest
from survey_sim.allocation.kernels.lists import near_among
from survey_sim.allocation.planning import VALUE_UNIT, PlannedGuides, Search
from survey_sim.allocation.targets import FieldTargets, IntArray

# Times that the worth of programmes which lack targets is doubled, while others have theirs.
N_FAVOUR = 2


@dataclass(frozen=True)
class TileVisits:
    """One tile whose visits are to be planned.

    Attributes
    ----------
    field
        Of science targets and guides; the other kinds need no place in the plan, only fibres.
    is_open
        (n_target,) science targets that may be planned; all of the other kinds may be.
    kept
        (n_target, n_visit) an older plan to begin from, of as many visits as are planned.
    """

    field: Field
    is_open: BoolArray
    kept: BoolArray

    @property
    def n_visit(self) -> int:
        """Visits."""
        return self.kept.shape[1]

    def request(self) -> VisitRequest:
        """What may be planned."""
        field, targets, plate = self.field, self.field.targets, self.field.plate
        is_free = field.is_on_plate & ~field.blocked_by(plate.park_mm[~plate.is_live])
        is_free &= self.is_open | ~targets.is_science
        missing = np.where(targets.is_science & is_free, targets.wanted_visits, 0)
        return VisitRequest(0, plate.park_mm, is_free, np.ones(len(field.reach_robot), dtype=bool), missing)


def plan_visits(tiles: Sequence[TileVisits], capacity: int, rng: np.random.Generator) -> list[BoolArray]:
    """The targets that the visits of one or more tiles complete together; the ways between visits are left open.

    Parameters
    ----------
    tiles
        Where they are several, a target that is open in more than one goes to any of them, if it wants one visit; one that
        wants more is open in one tile alone.
    capacity
        Science fibres of a visit.

    Returns
    -------
        Of each tile (n_target, n_visit) science targets planned; only those that get all visits that they want.
    """
    state = rng.integers(1, 2**63, size=1, dtype=np.uint64)
    if len(tiles) > 1:
        return _planned_together(tiles, capacity, state)
    tile = tiles[0]
    return [_planned(Search(tile.field, tile.request(), state, capacity=capacity, is_brief=True), tile.kept)]


def _planned(search: Search, kept: BoolArray) -> BoolArray:
    """(n_target, n_visit) visits of the targets that get all of theirs, beginning from an older plan."""
    n_visit = kept.shape[1]
    # A fibre is worth as much to a target that wants many visits as to one that wants one.
    search.value = np.round(VALUE_UNIT * search.field.value[search.item_target]).astype(np.int64)
    visit_of, _ = search.fill(n_visit, search.visits_of(kept), is_in_part=False)
    for _ in range(N_FAVOUR):
        lack = search.lack(visit_of)
        if not lack.any() or not search.favour(lack > 0):
            break
        visit_of, _ = search.fill(n_visit, visit_of, is_in_part=False)
    placed = np.bincount(search.item_target[visit_of >= 0], minlength=len(search.copies))
    is_kept = (visit_of >= 0) & (placed == search.copies)[search.item_target]
    is_planned = np.zeros((len(search.copies), n_visit), dtype=bool)
    is_planned[search.item_target[is_kept], visit_of[is_kept]] = True
    return is_planned


def _planned_together(tiles: Sequence[TileVisits], capacity: int, state: np.ndarray) -> list[BoolArray]:
    requests = [tile.request() for tile in tiles]
    science = [np.flatnonzero(request.missing > 0) for request in requests]
    joined, place = _join([tile.field for tile in tiles], science)
    ends = np.cumsum([0, *(tile.n_visit for tile in tiles)])
    kept = np.zeros((joined.targets.n_target, ends[-1]), dtype=bool)
    is_shut = np.ones_like(kept)
    for number, (tile, request) in enumerate(zip(tiles, requests, strict=True)):
        mine, visits = np.ix_(place[number], np.arange(ends[number], ends[number + 1]))
        kept[mine, visits] = tile.kept[science[number]]
        is_shut[mine, visits] = False
        for visit, guides in enumerate(PlannedGuides(tile.field, request, request.missing > 0).first(tile.n_visit)):
            is_shut[place[number], ends[number] + visit] = tile.field.near_any(guides)[science[number]]
    everything = VisitRequest(
        visit_id=0,
        start_mm=joined.plate.park_mm,
        is_open=np.ones(joined.targets.n_target, dtype=bool),
        is_pair_open=np.ones(len(joined.reach_robot), dtype=bool),
        missing=joined.targets.wanted_visits,
    )
    tile_of = np.repeat(np.arange(len(tiles)), [tile.n_visit for tile in tiles])
    found = _planned(_JoinedSearch(joined, everything, state, capacity, tile_of, is_shut), kept)
    plans = []
    for number, tile in enumerate(tiles):
        is_planned = np.zeros_like(tile.kept)
        is_planned[science[number]] = found[place[number], ends[number] : ends[number + 1]]
        plans.append(is_planned)
    return plans


class _JoinedField(Field):
    """Science targets of several tiles: near if they are on any plate; lists of robots in reach, tile after tile.

    Their places, which differ from plate to plate, are left out.
    """

    @property
    def is_reached(self) -> BoolArray:
        """(n_target,) whether a robot of any tile may serve each target."""
        return np.asarray((np.diff(self.reach_first).reshape(-1, self.targets.n_target) > 0).any(axis=0))


class _JoinedSearch(Search):
    """A search over the visits of several tiles.

    Parameters
    ----------
    tile_of
        (n_visit,) number of each visit's tile.
    is_shut
        (n_target, n_visit) targets that a visit cannot take.
    """

    def __init__(
        self,
        field: _JoinedField,
        request: VisitRequest,
        state: np.ndarray,
        capacity: int,
        tile_of: IntArray,
        is_shut: BoolArray,
    ) -> None:
        super().__init__(field, request, state, capacity=capacity, is_brief=True)
        self._tile_of, self._is_shut = tile_of, is_shut

    def _shut(self, guides: list[IntArray]) -> BoolArray:
        return self._is_shut

    def _place(self, n_visit: int) -> IntArray:
        return self._tile_of * self.field.targets.n_target


def _join(fields: Sequence[Field], science: Sequence[IntArray]) -> tuple[_JoinedField, list[IntArray]]:
    """The science targets (places in each field) of several fields as one, and where each field's stand there."""
    ids = [field.targets.target_id[some] for field, some in zip(fields, science, strict=True)]
    target_id, first = np.unique(np.concatenate(ids), return_index=True)
    place = [np.searchsorted(target_id, some) for some in ids]
    n_target = len(target_id)
    n_reach = np.zeros((len(fields), n_target), dtype=np.int64)
    robots, near = [], []
    for number, (field, some) in enumerate(zip(fields, science, strict=True)):
        begin, pairs = field.pairs_of(some)
        n_reach[number, place[number]] = np.diff(begin)
        robots.append(field.reach_robot[pairs])
        begin, own_near = near_among(some, field.targets.n_target, field.near_first, field.near)
        near.append(np.repeat(place[number], np.diff(begin)) * n_target + place[number][own_near])
    pairs = np.unique(np.concatenate(near))

    def gathered(columns: Sequence[np.ndarray]) -> np.ndarray:
        return np.concatenate([column[some] for column, some in zip(columns, science, strict=True)])[first]

    columns = {c.name: getattr(fields[0].targets, c.name) for c in dataclasses.fields(FieldTargets)}
    for name in columns.keys() - {"programmes", "wanted_frac"}:
        columns[name] = gathered([getattr(field.targets, name) for field in fields])
    joined = _JoinedField(
        targets=FieldTargets(**columns),
        plate=fields[0].plate,
        settings=fields[0].settings,
        minima=fields[0].minima,
        xy_mm=np.zeros((n_target, 2)),
        is_on_plate=np.ones(n_target, dtype=bool),
        value=gathered([field.value for field in fields]),
        sector=np.full(n_target, -1, dtype=np.int64),
        near_first=np.searchsorted(pairs, np.arange(n_target + 1) * n_target),
        near=(pairs % max(n_target, 1)).astype(np.int32),
        reach_first=np.concatenate([[0], np.cumsum(n_reach)]),
        reach_robot=np.concatenate(robots),
    )
    return joined, place
