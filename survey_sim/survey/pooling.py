"""Pooling of a survey's visits among its tiles: by the tiling's rules, with plans by the allocator."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import polars as pl

from survey_sim.allocation import AllocationSettings, FieldTargets, plan_visits
from survey_sim.geometry import sky_to_plate
from survey_sim.instrument import Plate
from survey_sim.survey.tile import last_group, magnitude_groups, planned_visits, stream
from survey_sim.survey.workers import Workers
from survey_sim.tiling import Order, Planned, Pool, make_pool, members, plate_pairs, pool_visits

IntArray = npt.NDArray[np.int64]

# Tiles that a worker plans at a time, at most.
_TILES_A_TASK = 16
# Columns of a plan; visits are counted in their group, a range of magnitudes.
PLAN = {"survey": pl.String, "tile_id": pl.Int32, "group": pl.Int32, "visit": pl.Int32, "target_id": pl.Int64}
_COLUMNS = ("target_id", "kind", "programme", "ra_deg", "dec_deg", "mag", "priority", "wanted_visits")


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


@dataclass(frozen=True)
class _TileOrder:
    """One tile to plan: the targets that it may use, visits of each group, and its plan so far (targets by their ids)."""

    tile_id: int
    centre_deg: tuple[float, float]
    targets: pl.DataFrame
    n_visit: IntArray
    kept: Planned


@dataclass(frozen=True)
class _Task:
    """Tiles that a worker plans at a time."""

    rules: PoolRules
    orders: tuple[_TileOrder, ...]
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
    place = (targets["survey"] == rules.survey).arg_true().to_numpy()
    mine = targets[place]
    pool = survey_pool(rules, mine, tiles, workers)
    is_science = (mine["kind"] == "science").to_numpy()
    tile_id = targets["tile_id"].scatter(place[is_science], pool.home.astype(np.int32))
    return targets.with_columns(tile_id), _plan_table(rules.survey, pool, mine.filter(is_science)["target_id"].to_numpy())


def survey_pool(rules: PoolRules, targets: pl.DataFrame, tiles: pl.DataFrame, workers: Workers) -> Pool:
    """The pool of one survey, settled; its targets are the science rows of `targets`, which has no other survey's."""
    row = (targets["kind"] == "science").arg_true().to_numpy()
    science, columns = targets[row], targets.select(_COLUMNS)
    pool = _begin(rules, science, tiles, _capacity(rules, targets["kind"]))
    shared = members(tiles, targets, rules.plate.instrument.field_radius_deg)
    centres = tiles.select("ra_deg", "dec_deg").rows()
    target_id = science["target_id"].to_numpy()
    by_id = np.argsort(target_id)

    def plan_tiles(orders: Sequence[Order]) -> list[Planned]:
        asked = [
            _TileOrder(
                tile_id=order.tile,
                centre_deg=centres[order.tile],
                targets=columns[np.sort(np.concatenate([row[order.row], shared.of(order.tile)]))],
                n_visit=order.n_visit,
                kept=Planned(target_id[order.kept.row], order.kept.group, order.kept.visit),
            )
            for order in orders
        ]
        tasks = [_Task(rules, tuple(some), place) for place, some in enumerate(_chunks(asked, _TILES_A_TASK))]
        done = sorted(workers.stream(_plan_task, tasks), key=lambda result: result[0])
        planned = [plan for _, plans in done for plan in plans]
        return [replace(plan, row=by_id[np.searchsorted(target_id, plan.row, sorter=by_id)]) for plan in planned]

    pool_visits(pool, plan_tiles)
    return pool


def _begin(rules: PoolRules, science: pl.DataFrame, tiles: pl.DataFrame, capacity: int) -> Pool:
    names = sorted(rules.wanted_frac)
    return make_pool(
        plate_pairs(science, tiles, rules.plate.instrument.field_radius_deg),
        science["tile_id"].to_numpy().astype(np.int64),
        tiles.height,
        group=last_group(science["mag"].cast(pl.Float64).fill_null(np.nan).to_numpy(), rules.allocation.mag_ranges),
        programme=science["programme"].replace_strict(names, range(len(names)), return_dtype=pl.Int64).to_numpy(),
        wanted_visits=science["wanted_visits"].to_numpy().astype(np.int64),
        wanted_frac=np.array([rules.wanted_frac[name] for name in names]),
        capacity=capacity,
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


def _capacity(rules: PoolRules, kinds: pl.Series) -> int:
    """Science fibres of a visit: those that calibration does not need."""
    settings, known = rules.allocation, set(kinds.unique())
    n_standard = settings.wanted_standard if "standard" in known else 0
    n_sky = settings.wanted_sky if "sky" in known else 0
    return rules.plate.n_science_live - n_standard - n_sky


def _chunks(orders: list[_TileOrder], n: int) -> Iterator[list[_TileOrder]]:
    for begin in range(0, len(orders), n):
        yield orders[begin : begin + n]


def _plan_task(task: _Task) -> tuple[int, list[Planned]]:
    return task.place, [_plan_tile(task.rules, order) for order in task.orders]


def _plan_tile(rules: PoolRules, order: _TileOrder) -> Planned:
    """Plan the visits of one tile, group after group; rows are target ids."""
    ra, dec = (order.targets[name].to_numpy() for name in ("ra_deg", "dec_deg"))
    position = sky_to_plate(ra, dec, order.centre_deg, rules.plate.instrument.plate_scale_arcsec_mm)
    on_plate = order.targets.with_columns(x_mm=pl.Series(position[:, 0]), y_mm=pl.Series(position[:, 1]))
    field = FieldTargets.from_table(on_plate, rules.wanted_frac)
    rng = stream(rules.seed, "pool", rules.survey, order.tile_id)
    is_done = np.zeros(field.n_target, dtype=np.bool_)
    parts = [Planned.empty()]
    for group, (chosen, part) in enumerate(magnitude_groups(field, rules.allocation.mag_ranges)):
        if order.n_visit[group]:
            n_visit = int(order.n_visit[group])
            kept = planned_visits(part.target_id, order.kept, group, n_visit)
            planned = plan_visits(part, rules.plate, rules.allocation, ~is_done[chosen], n_visit, kept, rng)
            target, visit = np.nonzero(planned)
            is_done[chosen[target]] = True
            parts.append(Planned(part.target_id[target], np.full(len(target), group), visit))
    return Planned(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("row", "group", "visit")))
