"""Pooling: how many visits each tile gets, and which of the tiles that see a target takes it.

A whole survey wants a share of its targets, in as few visits as may be. A tile that stops only when it has that share itself
ends in visits for a handful of targets: too close to others, or beyond a whole number of visits. Where tiles overlap, a
neighbour's idle fibres serve them for nothing. So visits are pooled:

1. Each tile begins with as many visits as its targets fill, rounded, and plans them.
2. What a tile cannot place is offered to all tiles that see it; those with idle fibres plan again, more than they had.
3. While the survey lacks targets, tiles with the most waiting get one visit more, or as many as a target wants.
4. While it has more than it wants, the visits that bring the fewest targets are given up.
5. Visits are given up, or made elsewhere instead, where tiles that plan together with their neighbours lose least by it.

Tiles that share no target plan at the same time: tiles are coloured so that no two of a colour do, and colours take turns.
The result depends on no order within a colour, so on no number of workers.

A tile's visits are split in groups (ranges of magnitude, of which one exposure serves one); without ranges there is one.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from survey_sim.tiling.exchange import exchange_visits
from survey_sim.tiling.pool import BoolArray, Order, Planned, PlanTiles, Pool

# Rounds of each of steps 3 and 4 at most. (Taking turns again saved no visit more on the anchors' regions.)
_MAX_ROUNDS = 12
# Visits are tried to be given up in this share of the tiles at a time: those whose idle fibres come nearest to a visit's.
_TRIED_FRAC = 0.2


def pool_visits(pool: Pool, plan_tiles: PlanTiles) -> None:
    """Settle visits, homes and plans of a pool (changed in place).

    Parameters
    ----------
    plan_tiles
        The only work that takes time, and may be done in parallel. A plan follows from its order alone.
    """
    _sweep(pool, np.ones(pool.n_tile, dtype=np.bool_), plan_tiles)
    _grow(pool, plan_tiles)
    _shrink(pool, plan_tiles)
    exchange_visits(pool, plan_tiles)


def _each(plan_tiles: PlanTiles, orders: Sequence[Order]) -> Iterator[Planned]:
    """Plans of tiles that plan each by itself."""
    for (planned,) in plan_tiles([(order,) for order in orders]):
        yield planned


def _sweep(pool: Pool, is_chosen: BoolArray, plan_tiles: PlanTiles) -> None:
    """Plan the chosen tiles again, colour by colour: those of a colour share no target."""
    for tiles in pool.by_colour(is_chosen & pool.n_visit.any(axis=1)):
        orders = [pool.order(tile) for tile in tiles]
        for order, planned in zip(orders, _each(plan_tiles, orders), strict=True):
            pool.accept([order], [planned])


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
            orders = [pool.order(t, n_visit=pool.n_visit[t] + n_more[t] * pool.one_of(group[t])) for t in now]
            for order, planned in zip(orders, _each(plan_tiles, orders), strict=True):
                slot = order.tile, group[order.tile]
                gain = (len(planned.row) - len(pool.plans[order.tile].row)) / stride[slot]
                if gain >= pool.min_gain:
                    most[slot] = gain
                    pool.accept([order], [planned])
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
        tiles = tiles[loss[tiles] <= pool.most_spared()]
        orders = [pool.order(int(t), is_shared=False, n_visit=pool.n_visit[t] - pool.one_of(group[t])) for t in tiles]
        new = [order for order in orders if order.tile not in tried or not order.is_same(tried[order.tile][0])]
        tried |= {order.tile: (order, planned) for order, planned in zip(new, _each(plan_tiles, new), strict=True)}
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
                pool.accept([order], [planned])
                is_shut[pool.near[tile]] = True
                n_accepted += 1
        if not n_accepted:
            return
        least[is_shut] = 0.0
        _sweep(pool, pool.is_offered_more(), plan_tiles)
