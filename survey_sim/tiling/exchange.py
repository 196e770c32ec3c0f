"""Exchange of visits: given up, or made elsewhere instead, where tiles that plan together with their neighbours lose least.

What a tile that gives up a visit loses, its neighbours can often serve if they hand on some of theirs: planned together,
most tiles of a region at 24 targets per square degree lose 7 to 20 targets by it. The last visits are tried in rounds:

1. Tiles whose last visit seems worth least, and tiles to which one more seems worth most, plan that with their neighbours.
2. Visits that the survey can do without are given up, those that lose least first; if there are none, a visit is made where
   it brings most, and one given up elsewhere that brings less.

Tiles whose plans changed, or whose neighbours' did, are tried again. The number of trials is limited.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from survey_sim.tiling.pool import FloatArray, IntArray, Order, Planned, PlanTiles, Pool

# Visits that targets want, times visits, of all trials in a survey, at most: 26 tiles of 370 targets end before.
_MOST_WORK = 20_000_000
# Trials of each kind in the first round, which knows nothing yet, and in each later one.
_FIRST, _TRIED = 75, 8

# What is tried, one visit less or one more, and of which tile.
_Slot = tuple[int, int]
LESS, MORE = 0, 1


@dataclass(frozen=True)
class _Trial:
    """Plans of a tile and its neighbours for one visit less or more.

    Attributes
    ----------
    change
        (n_programme,) targets more that are planned.
    """

    orders: tuple[Order, ...]
    plans: tuple[Planned, ...]
    change: IntArray

    @property
    def tiles(self) -> IntArray:
        """Tiles that planned together."""
        return np.array([order.tile for order in self.orders])

    def meets(self, other: "_Trial") -> bool:
        """Whether a tile planned in both."""
        return bool(np.isin(self.tiles, other.tiles).any())


def exchange_visits(pool: Pool, plan_tiles: PlanTiles) -> None:
    """Give up visits that the survey can do without, and make them where they bring more (the pool is changed in place).

    Nothing is done for a survey that lacks targets.
    """
    if not pool.has_enough():
        return
    worth = _guessed(pool)
    known: dict[_Slot, _Trial] = {}
    left, n_tried = _MOST_WORK, _FIRST
    while left > 0:
        groups = _groups(pool)
        slots = [slot for slot in _promising(worth, n_tried) if slot not in known]
        orders = [(slot, _orders(pool, *slot, groups[slot])) for slot in slots]
        n = int(np.searchsorted(np.cumsum([_work(pool, some) for _, some in orders]), left, side="right"))
        for (slot, some), plans in zip(orders[:n], plan_tiles([some for _, some in orders[:n]]), strict=True):
            known[slot] = _Trial(some, tuple(plans), pool.change(some, plans))
            worth[slot] = pool.fibres(known[slot].change)
        accepted = _given_up(pool, known) or _exchanged(pool, known)
        if not accepted and not n:
            return
        changed = np.zeros(pool.n_tile, dtype=np.bool_)
        for trial in accepted:
            pool.accept(trial.orders, trial.plans)
            changed[trial.tiles] = True
        worth[LESS, ~pool.n_visit.any(axis=1)] = -np.inf
        known = {slot: trial for slot, trial in known.items() if not changed[trial.tiles].any()}
        left, n_tried = left - sum(_work(pool, some) for _, some in orders[:n]), _TRIED


def _guessed(pool: Pool) -> FloatArray:
    """(2, n_tile) fibres of targets that one visit less (negative) and one more may bring: of a tile by itself."""
    return np.stack([-_held(pool).min(axis=1), pool.waiting().max(axis=1)])


def _held(pool: Pool) -> FloatArray:
    """(n_tile, n_group) fibres that cannot be held in one visit less, at least; inf where there is no visit."""
    return np.where(pool.n_visit > 0, pool.capacity - pool.idle(), np.inf)


def _promising(worth: FloatArray, n_tried: int) -> Iterator[_Slot]:
    """The most promising tiles, of both kinds of trial in turn."""
    tiles = np.argsort(-worth, axis=1, kind="stable")[:, :n_tried]
    for less, more in tiles.T.tolist():
        if worth[LESS, less] > -np.inf:
            yield LESS, less
        if worth[MORE, more] > 0.0:
            yield MORE, more


def _groups(pool: Pool) -> IntArray:
    """(2, n_tile) group of which each tile makes a visit less, and more."""
    return np.stack([_held(pool).argmin(axis=1), pool.waiting().argmax(axis=1)])


def _orders(pool: Pool, step: int, tile: int, group: int) -> tuple[Order, ...]:
    """A tile and its neighbours that make visits, with one visit of the tile less or more."""
    tiles = np.union1d(pool.near[tile], [tile])
    tiles = tiles[pool.n_visit[tiles].any(axis=1) | (tiles == tile)]
    visit = (tiles == tile)[:, None] * pool.one_of(group)
    return pool.together(tiles, pool.n_visit[tiles] + (visit if step == MORE else -visit))


def _work(pool: Pool, orders: tuple[Order, ...]) -> int:
    """How much work a trial is: visits that targets want, times visits."""
    n_wanted = sum(int(pool.wanted_visits[order.row].sum()) for order in orders)
    return n_wanted * sum(int(order.n_visit.sum()) for order in orders)


def _given_up(pool: Pool, known: dict[_Slot, _Trial]) -> list[_Trial]:
    """Trials of a visit less that the survey can spare, the least loss first; those of a tile and its neighbours once."""
    accepted: list[_Trial] = []
    for trial in _by_worth(pool, known, LESS):
        lost = -sum((other.change for other in accepted), trial.change)
        if pool.can_spare(lost) and not any(trial.meets(other) for other in accepted):
            accepted.append(trial)
    return accepted


def _exchanged(pool: Pool, known: dict[_Slot, _Trial]) -> list[_Trial]:
    """A visit more and a visit less, far from each other, that together bring targets; none if there are no such."""
    for more in _by_worth(pool, known, MORE):
        if pool.fibres(more.change) < pool.min_gain:
            break
        less = next((trial for trial in _by_worth(pool, known, LESS) if not trial.meets(more)), None)
        if less is not None:
            change = more.change + less.change
            if pool.fibres(change) > 0 and pool.can_spare(-change):
                return [more, less]
    return []


def _by_worth(pool: Pool, known: dict[_Slot, _Trial], step: int) -> list[_Trial]:
    """Trials of a kind, the most worth first."""
    trials = [(-pool.fibres(trial.change), slot[1], trial) for slot, trial in known.items() if slot[0] == step]
    return [trial for _, _, trial in sorted(trials, key=lambda trial: trial[:2])]
