"""What is known of a survey's tiles and targets while visits are pooled among them."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# A target that waits in overlaps is expected to come to each tile that sees it with this chance.
_SHARED = 0.5
# The survey is said to lack targets up to so much more than the completeness wanted: what overlaps then serve for nothing
# lets more visits be given up.
_BEYOND_FRAC = 0.01


@dataclass(frozen=True)
class Order:
    """What one tile shall plan.

    Attributes
    ----------
    tile
        Number of the tile.
    row
        Science targets that it may place, ascending.
    n_visit
        (n_group,) visits of each group.
    kept
        Its plan so far.
    """

    tile: int
    row: IntArray
    n_visit: IntArray
    kept: "Planned"

    def is_same(self, other: "Order") -> bool:
        """Whether another order asks for the same, and so gets the same plan."""
        arrays = ((self.row, other.row), (self.n_visit, other.n_visit))
        return self.tile == other.tile and self.kept is other.kept and all(np.array_equal(*pair) for pair in arrays)


@dataclass(frozen=True)
class Planned:
    """Plan of one tile: which targets have all their visits, and when.

    Attributes
    ----------
    row, group, visit
        (n,) target, group of visits, and visit in the group, counted from 0; a target wanted k times stands in k rows.
    """

    row: IntArray
    group: IntArray
    visit: IntArray

    @classmethod
    def empty(cls) -> "Planned":
        """A plan of nothing."""
        none = np.empty(0, dtype=np.int64)
        return cls(none, none, none)


# Plans of tiles, in the order asked; tiles that are asked for together may exchange targets.
PlanTiles = Callable[[Sequence[tuple[Order, ...]]], Iterable[tuple[Planned, ...]]]


@dataclass
class Pool:
    """What is known of one survey's tiles and targets while their visits are pooled. Made by `make_pool`.

    Attributes
    ----------
    first, row
        Lists of the targets on each tile's plate: those of tile t are row[first[t]:first[t + 1]], ascending.
    home
        (n_target,) tile at which each target is at home.
    group
        (n_target,) last group of visits that may serve it.
    programme, wanted_visits
        (n_target,) its programme, and visits that complete it.
    n_lost
        (n_programme,) targets that each programme may lose.
    capacity
        Science fibres of a visit.
    min_gain
        Fewest targets for which a visit is made.
    n_visit
        (n_tile, n_group) visits of each tile.
    is_done
        (n_target,) whether its home's plan completes it.
    plans
        Plan of each tile.
    """

    first: IntArray
    row: IntArray
    home: IntArray
    group: IntArray
    programme: IntArray
    wanted_visits: IntArray
    n_lost: IntArray
    capacity: int
    min_gain: int
    n_visit: IntArray
    is_done: BoolArray
    plans: list[Planned]

    def __post_init__(self) -> None:
        self.tile = np.repeat(np.arange(self.n_tile), np.diff(self.first))
        self.near = _neighbours(self.tile, self.row, self.n_tile, len(self.home))
        self.colours = _colours(self.near)
        # Pairs whose target was waiting when the tile planned last: a tile plans again only if others wait now.
        self._was_offered = np.zeros(len(self.row), dtype=np.bool_)
        self._n_target = self.count(np.arange(len(self.home)))
        self._n_waiting = self.count(np.flatnonzero(~self.is_done))
        n_wanted = np.bincount(self.programme, weights=self.wanted_visits, minlength=len(self.n_lost))
        self._mean_visits = n_wanted / np.maximum(self._n_target, 1)

    @property
    def n_tile(self) -> int:
        """Number of tiles."""
        return len(self.n_visit)

    def lack(self) -> int:
        """Fibres that the targets wanted but not planned would take, over all programmes; some more than wanted."""
        may_wait = np.maximum(self.n_lost - _BEYOND_FRAC * self._n_target, 0)
        return int(np.ceil(np.maximum(self._n_waiting - may_wait, 0) * self._mean_visits).sum())

    def has_enough(self) -> bool:
        """Whether every programme has as many targets planned as it wants."""
        return bool((self._n_waiting <= self.n_lost).all())

    def can_spare(self, lost: IntArray) -> bool:
        """Whether the survey can do without `lost` (n_programme,) of the targets planned.

        A programme that lacks targets although no visit more would help still gives up visits of less than `min_gain`.
        """
        spare = self.n_lost - self._n_waiting
        is_spared = (lost <= np.maximum(spare, 0))[spare >= 0].all()
        return bool(is_spared and self.fibres(np.where(spare < 0, lost, 0)) < self.min_gain)

    def most_spared(self) -> float:
        """Fibres of targets that the survey can do without, at most; what takes more, it cannot spare."""
        spare = self.n_lost - self._n_waiting
        return self.fibres(spare.clip(0)) + (self.min_gain if (spare < 0).any() else 0)

    def fibres(self, n_target: IntArray) -> float:
        """Fibres that so many targets of each programme (n_programme,) take."""
        return float((n_target * self._mean_visits).sum())

    def count(self, row: IntArray) -> IntArray:
        """(n_programme,) targets of each programme among these."""
        return np.bincount(self.programme[row], minlength=len(self.n_lost))

    def one_of(self, group: int) -> IntArray:
        """(n_group,) one visit of a group."""
        return (np.arange(self.n_visit.shape[1]) == group).astype(np.int64)

    def by_colour(self, is_chosen: BoolArray) -> Iterator[list[int]]:
        """The chosen tiles, colour by colour: those of a colour share no target."""
        for colour in range(self.colours.max(initial=-1) + 1):
            yield np.flatnonzero(is_chosen & (self.colours == colour)).tolist()

    def _pairs(self, tile: int) -> slice:
        """Where a tile's pairs stand in `row`."""
        return slice(self.first[tile], self.first[tile + 1])

    def own(self, tile: int) -> IntArray:
        """Targets at home on a tile."""
        on_plate = self.row[self._pairs(tile)]
        return on_plate[self.home[on_plate] == tile]

    def order(self, tile: int, *, is_shared: bool = True, n_visit: IntArray | None = None) -> Order:
        """What a tile shall plan: its own targets and, if it is shared, all that wait elsewhere."""
        on_plate = self.row[self._pairs(tile)]
        is_own = self.home[on_plate] == tile
        may_take = is_own | ~self.is_done[on_plate] if is_shared else is_own
        return Order(tile, on_plate[may_take], self.n_visit[tile] if n_visit is None else n_visit, self.plans[tile])

    def together(self, tiles: IntArray, n_visit: IntArray) -> tuple[Order, ...]:
        """What some tiles (n,) shall plan together, in so many visits (n, n_group).

        All that is at home on any of them or waits, to go where it fits; what wants several visits stays on its tile.
        """
        is_ours = np.zeros(self.n_tile, dtype=np.bool_)
        is_ours[tiles] = True
        orders = []
        for tile, n in zip(tiles.tolist(), n_visit, strict=True):
            on_plate = self.row[self._pairs(tile)]
            home = self.home[on_plate]
            may_move = (is_ours[home] | ~self.is_done[on_plate]) & (self.wanted_visits[on_plate] == 1)
            orders.append(Order(tile, on_plate[may_move | (home == tile)], n, self.plans[tile]))
        return tuple(orders)

    def change(self, orders: Sequence[Order], plans: Sequence[Planned]) -> IntArray:
        """(n_programme,) targets more that are planned if these plans are accepted."""
        change = np.zeros(len(self.n_lost))
        for order, planned in zip(orders, plans, strict=True):
            own, row = self.own(order.tile), planned.row
            # A target is planned as often as it wants.
            change += np.bincount(self.programme[row], weights=1.0 / self.wanted_visits[row], minlength=len(change))
            change -= self.count(own[self.is_done[own]])
        return np.round(change).astype(np.int64)

    def accept(self, orders: Sequence[Order], plans: Sequence[Planned]) -> None:
        """Make new plans, of tiles that planned together, theirs."""
        self._n_waiting -= self.change(orders, plans)
        for order in orders:
            self.is_done[self.own(order.tile)] = False
        for order, planned in zip(orders, plans, strict=True):
            self.is_done[planned.row] = True
            self.home[planned.row] = order.tile
            self.plans[order.tile] = planned
            self.n_visit[order.tile] = order.n_visit
        for order in orders:
            pairs = self._pairs(order.tile)
            self._was_offered[pairs] = ~self.is_done[self.row[pairs]]

    def idle(self) -> IntArray:
        """(n_tile, n_group) science fibres of the planned visits without a target."""
        used = np.zeros_like(self.n_visit)
        for tile, planned in enumerate(self.plans):
            used[tile] = np.bincount(planned.group, minlength=used.shape[1])
        return self.n_visit * self.capacity - used

    def waiting(self) -> FloatArray:
        """(n_tile, n_group) fibres that targets waiting on each plate would take; those at home elsewhere count in part.

        Only targets of programmes that lack some count.
        """
        is_lacking = self._n_waiting > self.n_lost - _BEYOND_FRAC * self._n_target
        pairs = np.flatnonzero(~self.is_done[self.row] & is_lacking[self.programme[self.row]])
        row, tile = self.row[pairs], self.tile[pairs]
        n_group = self.n_visit.shape[1]
        weight = self.wanted_visits[row] * np.where(self.home[row] == tile, 1.0, _SHARED)
        slot = tile * n_group + self.group[row]
        return (
            np.bincount(slot, weights=weight, minlength=self.n_tile * n_group)
            .reshape(self.n_tile, n_group)
            .astype(np.float64)
        )

    def is_offered_more(self) -> BoolArray:
        """(n_tile,) tiles with idle fibres on whose plates targets wait that did not when they planned last."""
        is_new = ~self.is_done[self.row] & ~self._was_offered
        n_new = np.bincount(self.tile[is_new], minlength=self.n_tile)
        return (n_new > 0) & (self.idle() > 0).any(axis=1)


def make_pool(
    pairs: tuple[IntArray, IntArray],
    home: IntArray,
    n_tile: int,
    *,
    group: IntArray,
    programme: IntArray,
    wanted_visits: IntArray,
    wanted_frac: FloatArray,
    capacity: int,
    min_gain: int,
) -> Pool:
    """A pool whose tiles have as many visits as the targets at home on them fill, rounded, and no plan yet.

    Parameters
    ----------
    pairs
        Target and tile of each pair of which the target lies on the tile's plate.
    home
        (n_target,) tile at which each target is at home at first.
    group, programme, wanted_visits
        (n_target,) see `Pool`.
    wanted_frac
        (n_programme,) completeness wanted.
    capacity
        Science fibres of a visit.
    min_gain
        Fewest targets for which a visit is made.
    """
    row, tile = pairs
    by_tile = np.lexsort((row, tile))
    n_group = int(group.max(initial=0)) + 1
    load = np.bincount(home * n_group + group, weights=wanted_visits * wanted_frac[programme], minlength=n_tile * n_group)
    n_target = np.bincount(programme, minlength=len(wanted_frac))
    return Pool(
        first=np.searchsorted(tile[by_tile], np.arange(n_tile + 1)),
        row=row[by_tile],
        home=home.copy(),
        group=group,
        programme=programme,
        wanted_visits=wanted_visits,
        n_lost=n_target - np.ceil(n_target * wanted_frac - 1e-9).astype(np.int64),
        capacity=max(1, capacity),
        min_gain=min_gain,
        n_visit=np.round(load / max(1, capacity)).astype(np.int64).reshape(n_tile, n_group),
        is_done=np.zeros(len(home), dtype=np.bool_),
        plans=[Planned.empty() for _ in range(n_tile)],
    )


def _colours(near: list[IntArray]) -> IntArray:
    """(n_tile,) colours of the tiles, so that no two with a target in common have the same: most neighbours first."""
    colours = np.full(len(near), -1, dtype=np.int64)
    for t in np.argsort([-len(around) for around in near], kind="stable"):
        taken = set(colours[near[t]].tolist())
        colours[t] = next(colour for colour in range(len(near)) if colour not in taken)
    return colours


def _neighbours(tile: IntArray, row: IntArray, n_tile: int, n_target: int) -> list[IntArray]:
    """Tiles that have a target in common with each tile."""
    by_row = np.argsort(row, kind="stable")
    tile = tile[by_row]
    first = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=n_target))])
    found = [np.empty(0, dtype=np.int64)]
    most = int(np.diff(first).max(initial=0))
    for step in range(1, most):
        here = np.arange(max(0, len(tile) - step))
        is_same = row[by_row[here]] == row[by_row[here + step]]
        a, b = tile[here[is_same]], tile[here[is_same] + step]
        found.append(np.unique(np.concatenate([a * n_tile + b, b * n_tile + a])))
    both = np.unique(np.concatenate(found))
    ends = np.searchsorted(both // max(n_tile, 1), np.arange(n_tile + 1))
    return [both[ends[t] : ends[t + 1]] % max(n_tile, 1) for t in range(n_tile)]
