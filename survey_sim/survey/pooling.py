"""Pooling of a survey's visits among its tiles: by the tiling's rules, with plans by the allocator."""

from __future__ import annotations

import pickle
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
import numpy.typing as npt
import polars as pl

from survey_sim.allocation import (
    AllocationSettings,
    Field,
    FieldTargets,
    TileVisits,
    make_field,
    part_of_field,
    plan_visits,
)
from survey_sim.geometry import sky_to_plate
from survey_sim.instrument import Plate
from survey_sim.survey.tile import last_group, magnitude_groups, places_among, planned_visits, stream, subset
from survey_sim.survey.workers import Workers
from survey_sim.tiling import Order, Planned, Pool, make_pool, members, plate_pairs, pool_visits

IntArray = npt.NDArray[np.int64]

# Tiles of a colour are planned in so many tasks at most, each of so many tiles at least: a task costs some milliseconds.
_MOST_TASKS = 8
_TILES_A_TASK = 8
# Columns of a plan; visits are counted in their group, a range of magnitudes.
PLAN = {"survey": pl.String, "tile_id": pl.Int32, "group": pl.Int32, "visit": pl.Int32, "target_id": pl.Int64}


@dataclass(frozen=True)
class PoolRules:
    """What a survey's visits are pooled by.

    Attributes
    ----------
    wanted_frac
        Completeness wanted of each science programme, by name.
    """

    survey: str
    wanted_frac: Mapping[str, float]
    plate: Plate
    allocation: AllocationSettings
    seed: int

    @property
    def capacity(self) -> int:
        """Science fibres of a visit: those that calibration does not need."""
        return self.plate.n_science_live - self.allocation.wanted_standard - self.allocation.wanted_sky

    def among(self, kinds: Collection[str]) -> PoolRules:
        """The rules where only these kinds of targets are to be had: the others need no fibres."""
        absent = {f"wanted_{kind}": 0 for kind in ("standard", "sky") if kind not in kinds}
        return replace(self, allocation=self.allocation.model_copy(update=absent))


@dataclass(frozen=True)
class _TileOrder:
    """One tile to plan.

    Attributes
    ----------
    targets
        Targets that it may use, known by their ascending numbers; their places on the plate are not known yet.
    sky_deg
        (n_target, 2) right ascension and declination.
    n_visit
        (n_group,) visits.
    kept
        Its plan so far, targets by these numbers.
    """

    tile_id: int
    centre_deg: tuple[float, float]
    targets: FieldTargets
    sky_deg: npt.NDArray[np.float64]
    n_visit: IntArray
    kept: Planned


@dataclass(frozen=True)
class _Task:
    """Tiles that a worker plans at a time; the orders are pickled, as one piece is sent sooner than their many arrays."""

    rules: PoolRules
    orders: bytes
    place: int


def pool_survey(
    rules: PoolRules, targets: pl.DataFrame, tiles: pl.DataFrame, workers: Workers
) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Pool the visits of one survey.

    Parameters
    ----------
    targets
        Table `targets`, science targets with their nearest tile.
    tiles
        Rows of `tiles` of the survey.

    Returns
    -------
        Table `targets`, science targets of the survey with their home tile; the plan, as `PLAN`.
    """
    mine = targets.with_row_index("place").filter(survey=rules.survey).sort("target_id")
    pool = survey_pool(rules, mine, tiles, workers)
    science = mine.filter(kind="science")
    tile_id = targets["tile_id"].scatter(science["place"].to_numpy(), pool.home.astype(np.int32))
    return targets.with_columns(tile_id), _plan_table(rules.survey, pool, science["target_id"].to_numpy())


def survey_pool(rules: PoolRules, targets: pl.DataFrame, tiles: pl.DataFrame, workers: Workers) -> Pool:
    """The pool of one survey, settled.

    Parameters
    ----------
    targets
        Rows of `targets` of the survey, by ascending `target_id`; those of science are the pool's, with the nearest tile.
    tiles
        Rows of `tiles` of the survey.
    """
    rules = rules.among(targets["kind"].unique().to_list())
    targets = targets.filter(pl.col("kind").is_in(["science", "guide"]))
    known = FieldTargets.from_table(targets.with_columns(x_mm=pl.lit(0.0), y_mm=pl.lit(0.0)), rules.wanted_frac)
    # Among tiles that plan, a target is known by its place here: no search for its id.
    known = replace(known, target_id=np.arange(known.n_target))
    row = np.flatnonzero(known.is_science)
    number = np.cumsum(known.is_science) - 1
    pool = _begin(rules, targets[row], subset(known, row), tiles)
    shared = members(tiles, targets, rules.plate.instrument.field_radius_deg)
    centres = tiles.select("ra_deg", "dec_deg").rows()
    sky_deg = targets.select("ra_deg", "dec_deg").to_numpy()

    def asked(order: Order) -> _TileOrder:
        some = np.sort(np.concatenate([row[order.row], shared.of(order.tile)]))
        return _TileOrder(
            tile_id=order.tile,
            centre_deg=centres[order.tile],
            targets=subset(known, some),
            sky_deg=sky_deg[some],
            n_visit=order.n_visit,
            kept=replace(order.kept, row=row[order.kept.row]),
        )

    def plan_tiles(orders: Sequence[tuple[Order, ...]]) -> list[tuple[Planned, ...]]:
        together = [tuple(asked(order) for order in some) for some in orders]
        tasks = [_Task(rules, pickle.dumps(some), place) for place, some in enumerate(_chunks(together))]
        done = sorted(workers.stream(_plan_task, tasks), key=lambda result: result[0])
        plans = chain.from_iterable(pickle.loads(packed) for _, packed in done)
        return [tuple(replace(plan, row=number[plan.row]) for plan in some) for some in plans]

    pool_visits(pool, plan_tiles)
    return pool


def _begin(rules: PoolRules, science: pl.DataFrame, known: FieldTargets, tiles: pl.DataFrame) -> Pool:
    return make_pool(
        plate_pairs(science, tiles, rules.plate.instrument.field_radius_deg),
        science["tile_id"].to_numpy().astype(np.int64),
        tiles.height,
        group=last_group(known.mag, rules.allocation.mag_ranges),
        programme=known.programme,
        wanted_visits=known.wanted_visits,
        wanted_frac=known.wanted_frac,
        capacity=rules.capacity,
        min_gain=rules.allocation.min_gain,
    )


def _plan_table(survey: str, pool: Pool, target_id: IntArray) -> pl.DataFrame:
    return pl.DataFrame(
        {
            "survey": [survey] * sum(len(plan.row) for plan in pool.plans),
            "tile_id": np.repeat(np.arange(pool.n_tile), [len(plan.row) for plan in pool.plans]).astype(np.int32),
            "group": np.concatenate([plan.group for plan in pool.plans]).astype(np.int32),
            "visit": np.concatenate([plan.visit for plan in pool.plans]).astype(np.int32),
            "target_id": target_id[np.concatenate([plan.row for plan in pool.plans])],
        },
        schema=PLAN,
    )


def _chunks(orders: Sequence[tuple[_TileOrder, ...]]) -> Iterator[tuple[tuple[_TileOrder, ...], ...]]:
    """Orders of each task."""
    n = max(_TILES_A_TASK, -(-len(orders) // _MOST_TASKS))
    for begin in range(0, len(orders), n):
        yield tuple(orders[begin : begin + n])


def _plan_task(task: _Task) -> tuple[int, bytes]:
    return task.place, pickle.dumps([_plan_together(task.rules, orders) for orders in pickle.loads(task.orders)])


def _plan_together(rules: PoolRules, orders: tuple[_TileOrder, ...]) -> tuple[Planned, ...]:
    """Plan the visits of tiles that may exchange targets, group after group; rows are the targets' numbers."""
    rng = stream(rules.seed, "pool", rules.survey, *(order.tile_id for order in orders))
    fields = [_field(rules, order) for order in orders]
    groups = [list(magnitude_groups(field.targets, rules.allocation.mag_ranges)) for field in fields]
    done: list[IntArray] = []
    parts = [[Planned.empty()] for _ in orders]
    for group in range(len(groups[0])):
        chosen = [number for number, order in enumerate(orders) if order.n_visit[group]]
        if not chosen:
            continue
        tiles = [_tile_visits(rules, fields[n], groups[n][group], orders[n], group, done) for n in chosen]
        for number, tile, planned in zip(chosen, tiles, plan_visits(tiles, rules.capacity, rng), strict=True):
            target, visit = np.nonzero(planned)
            target_id = tile.field.targets.target_id[target]
            done.append(target_id)
            parts[number].append(Planned(target_id, np.full(len(target), group), visit))
    names = ("row", "group", "visit")
    return tuple(Planned(*(np.concatenate([getattr(part, name) for part in some]) for name in names)) for some in parts)


def _field(rules: PoolRules, order: _TileOrder) -> Field:
    scale = rules.plate.instrument.plate_scale_arcsec_mm
    x_mm, y_mm = sky_to_plate(order.sky_deg[:, 0], order.sky_deg[:, 1], order.centre_deg, scale).T.copy()
    return make_field(replace(order.targets, x_mm=x_mm, y_mm=y_mm), rules.plate, rules.allocation)


def _tile_visits(
    rules: PoolRules, field: Field, part: tuple[IntArray, FieldTargets], order: _TileOrder, group: int, done: list[IntArray]
) -> TileVisits:
    """A group of a tile's visits, of the targets (places in its field, and they) that are not planned in a group before.

    Those are in `done`, of each tile and group ascending.
    """
    chosen, targets = part
    kept = planned_visits(targets.target_id, order.kept, group, int(order.n_visit[group]))
    is_open = np.ones(targets.n_target, dtype=np.bool_)
    for planned in done:
        is_open[places_among(planned, targets.target_id)[1]] = False
    return TileVisits(part_of_field(field, chosen, targets, rules.allocation), is_open, kept)
