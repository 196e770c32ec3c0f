"""Pooling: how many visits each tile gets, and which of the tiles that see a target takes it.

A whole survey wants a share of its targets, in as few visits as may be. A tile that stops only when it has that share itself
ends in visits for a handful of targets: too close to others, or beyond a whole number of visits. Where tiles overlap, a
neighbour's idle fibres serve them for nothing. So visits are pooled:

1. Each tile begins with as many visits as its targets fill, rounded, and plans them.
2. What a tile cannot place is offered to all tiles that see it; those with idle fibres plan again, more than they had.
3. While the survey lacks targets, tiles with the most waiting get one visit more, or as many as a target wants.
4. While it has more than it wants, the visits that bring the fewest targets are given up.

Tiles that share no target plan at the same time: tiles are coloured so that no two of a colour do, and colours take turns.
The result depends on no order within a colour, so on no number of workers.

A tile's visits are split in groups (ranges of magnitude, of which one exposure serves one); without ranges there is one.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# Rounds of each of steps 3 and 4 at most. (Taking turns again saved no visit more on the anchors' regions.)
_MAX_ROUNDS = 12
# A target that waits in overlaps is expected to come to each tile that sees it with this chance.
_SHARED = 0.5
# Step 3 goes on to so much more than the completeness wanted: what overlaps then serve for nothing lets step 4 give up more.
_BEYOND_FRAC = 0.01
# Visits are tried to be given up in this share of the tiles at a time: those whose idle fibres come nearest to a visit's.
_TRIED_FRAC = 0.2


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


PlanTiles = Callable[[Sequence[Order]], Iterable[Planned]]


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

    def can_spare(self, lost: IntArray) -> bool:
        """Whether the survey can do without `lost` (n_programme,) of the targets planned.

        A programme that lacks targets although no visit more would help still gives up visits of less than `min_gain`.
        """
        spare = self.n_lost - self._n_waiting
        n_fibre = lost * self._mean_visits
        return bool((lost <= np.maximum(spare, 0))[spare >= 0].all() and n_fibre[spare < 0].sum() < self.min_gain)

    def count(self, row: IntArray) -> IntArray:
        """(n_programme,) targets of each programme among these."""
        return np.bincount(self.programme[row], minlength=len(self.n_lost))

    def by_colour(self, is_chosen: BoolArray) -> Iterator[list[int]]:
        """The chosen tiles, colour by colour: those of a colour share no target."""
        for colour in range(self.colours.max(initial=-1) + 1):
            yield np.flatnonzero(is_chosen & (self.colours == colour)).tolist()

    def own(self, tile: int) -> IntArray:
        """Targets at home on a tile."""
        on_plate = self.row[self.first[tile] : self.first[tile + 1]]
        return on_plate[self.home[on_plate] == tile]

    def order(self, tile: int, *, is_shared: bool = True, n_visit: IntArray | None = None) -> Order:
        """What a tile shall plan: its own targets and, if it is shared, all that wait elsewhere."""
        on_plate = self.row[self.first[tile] : self.first[tile + 1]]
        is_own = self.home[on_plate] == tile
        may_take = is_own | ~self.is_done[on_plate] if is_shared else is_own
        return Order(tile, on_plate[may_take], self.n_visit[tile] if n_visit is None else n_visit, self.plans[tile])

    def accept(self, order: Order, planned: Planned) -> None:
        """Make a tile's new plan its plan."""
        own, done = self.own(order.tile), np.unique(planned.row)
        self._n_waiting += self.count(own[self.is_done[own]])
        self.is_done[own] = False
        self._n_waiting -= self.count(done[~self.is_done[done]])
        self.is_done[done] = True
        self.home[planned.row] = order.tile
        self.plans[order.tile] = planned
        self.n_visit[order.tile] = order.n_visit
        pairs = slice(self.first[order.tile], self.first[order.tile + 1])
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


def pool_visits(pool: Pool, plan_tiles: PlanTiles) -> None:
    """Settle visits, homes and plans of a pool (changed in place).

    Parameters
    ----------
    plan_tiles
        Plans of several tiles, in the order asked: the only work that takes time, and may be done in parallel. A plan
        follows from its order alone.
    """
    _sweep(pool, np.ones(pool.n_tile, dtype=np.bool_), plan_tiles)
    _grow(pool, plan_tiles)
    _shrink(pool, plan_tiles)


def _sweep(pool: Pool, is_chosen: BoolArray, plan_tiles: PlanTiles) -> None:
    """Plan the chosen tiles again, colour by colour: those of a colour share no target."""
    for tiles in pool.by_colour(is_chosen & pool.n_visit.any(axis=1)):
        orders = [pool.order(tile) for tile in tiles]
        for order, planned in zip(orders, plan_tiles(orders), strict=True):
            pool.accept(order, planned)


def _grow(pool: Pool, plan_tiles: PlanTiles) -> None:
    """Give visits to the tiles where most targets wait, until the survey has somewhat more than it wants.

    What a visit brought when it was tried last stands for what it may bring: it seldom brings more later. But where a target
    wants several visits, one more may bring nothing and several much (two galaxies too near to each other to be observed at
    the same time, five visits each): a tile whose next visit brings too little tries as many as a target wants.
    """
    most = np.full(pool.n_visit.shape, float(pool.capacity))
    stride = np.ones(pool.n_visit.shape, dtype=np.int64)
    longest = int(pool.wanted_visits.max(initial=1))
    for _ in range(_MAX_ROUNDS):
        lack = pool.lack()
        hope = np.minimum(pool.waiting() / stride, most)
        group, hope = hope.argmax(axis=1), hope.max(axis=1)
        n_more = stride[np.arange(pool.n_tile), group]
        tiles = np.argsort(-hope, kind="stable")
        tiles = tiles[hope[tiles] >= pool.min_gain]
        if not lack or not len(tiles):
            return
        is_chosen = np.zeros(pool.n_tile, dtype=np.bool_)
        is_chosen[tiles[: np.searchsorted(np.cumsum((hope * n_more)[tiles]), lack) + 1]] = True
        for now in pool.by_colour(is_chosen):
            orders = [pool.order(t, n_visit=pool.n_visit[t] + n_more[t] * _one(pool, group[t])) for t in now]
            for order, planned in zip(orders, plan_tiles(orders), strict=True):
                slot = order.tile, group[order.tile]
                gain = (len(planned.row) - len(pool.plans[order.tile].row)) / stride[slot]
                if gain >= pool.min_gain:
                    most[slot] = gain
                    pool.accept(order, planned)
                elif stride[slot] < longest:
                    stride[slot] = longest
                else:
                    most[slot] = gain
        _sweep(pool, pool.is_offered_more(), plan_tiles)


def _shrink(pool: Pool, plan_tiles: PlanTiles) -> None:
    """Give up the visits that bring the fewest targets, as far as the survey can spare them.

    What was tried before and nothing has changed since is not planned again: half of all trials on a dense survey.
    """
    least = np.zeros(pool.n_visit.shape)
    tried: dict[int, tuple[Order, Planned]] = {}
    for _ in range(_MAX_ROUNDS):
        loss = np.maximum(pool.capacity - pool.idle(), least).astype(np.float64)
        loss[pool.n_visit == 0] = np.inf
        group, loss = loss.argmin(axis=1), loss.min(axis=1)
        tiles = np.argsort(loss, kind="stable")[: max(4, round(_TRIED_FRAC * pool.n_tile))]
        tiles = tiles[np.isfinite(loss[tiles])]
        orders = [pool.order(int(t), is_shared=False, n_visit=pool.n_visit[t] - _one(pool, group[t])) for t in tiles]
        new = [order for order in orders if order.tile not in tried or not order.is_same(tried[order.tile][0])]
        tried |= {order.tile: (order, planned) for order, planned in zip(new, plan_tiles(new), strict=True)}
        trials = []
        for order, planned in (tried[order.tile] for order in orders):
            own = pool.own(order.tile)
            lost = own[pool.is_done[own] & ~np.isin(own, planned.row)]
            least[order.tile, group[order.tile]] = len(lost)
            trials.append((len(lost), order.tile, order, planned, pool.count(lost)))
        trials.sort(key=lambda trial: trial[:2])
        is_shut = np.zeros(pool.n_tile, dtype=np.bool_)
        n_accepted = 0
        for n_lost, tile, order, planned, lost in trials:
            if not is_shut[tile] and n_lost <= 2 * trials[0][0] + pool.min_gain and pool.can_spare(lost):
                pool.accept(order, planned)
                is_shut[pool.near[tile]] = True
                n_accepted += 1
        if not n_accepted:
            return
        least[is_shut] = 0.0
        _sweep(pool, pool.is_offered_more(), plan_tiles)


def _one(pool: Pool, group: int) -> IntArray:
    return (np.arange(pool.n_visit.shape[1]) == group).astype(np.int64)


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
