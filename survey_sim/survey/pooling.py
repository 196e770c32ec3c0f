"""Pooling of a survey's visits among its tiles: by the tiling's rules, with plans by the allocator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import polars as pl

from survey_sim.allocation import AllocationSettings, FieldTargets, plan_visits
from survey_sim.geometry import sky_to_plate
from survey_sim.instrument import Plate
from survey_sim.survey.tile import last_group, magnitude_groups, stream
from survey_sim.survey.workers import Workers
from survey_sim.tiling import Members, Order, Planned, Pool, make_pool, plate_pairs, pool_visits

IntArray = npt.NDArray[np.int64]

# Tiles that a worker plans at a time, at most.
_TILES_A_TASK = 16
_COLUMNS = ("target_id", "kind", "programme", "ra_deg", "dec_deg", "mag", "priority", "wanted_visits")


@dataclass(frozen=True)
class PoolRules:
    """What a survey's visits are pooled by.

    Attributes
    ----------
    wanted_frac
        Completeness wanted of each science programme, by name.
    max_distance_deg
        Furthest that a target may be from the centre of its tile.
    """

    survey: str
    wanted_frac: Mapping[str, float]
    plate: Plate
    allocation: AllocationSettings
    max_distance_deg: float
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
    rules: PoolRules, targets: pl.DataFrame, tiles: pl.DataFrame, shared: Members, workers: Workers
) -> tuple[Pool, pl.DataFrame]:
    """Pool the visits of one survey.

    Parameters
    ----------
    targets
        Rows of `targets` of the survey: `tile_id` of science targets is the nearest tile, numbered by rows of `tiles`.
    tiles
        Rows of `tiles` of the survey.
    shared
        Rows of `targets` with the calibration targets on each plate.

    Returns
    -------
        The pool, its targets being the science rows in order; the plan: tile_id, group, visit (within the group), target_id.
    """
    row = (targets["kind"] == "science").arg_true().to_numpy()
    science = targets[row]
    names = sorted(rules.wanted_frac)
    pool = make_pool(
        plate_pairs(science, tiles, rules.max_distance_deg),
        science["tile_id"].to_numpy().astype(np.int64),
        tiles.height,
        group=last_group(science["mag"].cast(pl.Float64).fill_null(np.nan).to_numpy(), rules.allocation.mag_ranges),
        programme=science["programme"].replace_strict(names, range(len(names)), return_dtype=pl.Int64).to_numpy(),
        wanted_visits=science["wanted_visits"].to_numpy().astype(np.int64),
        wanted_frac=np.array([rules.wanted_frac[name] for name in names]),
        capacity=_capacity(rules, targets["kind"]),
        min_gain=rules.allocation.min_gain,
    )
    centres = tiles.select("ra_deg", "dec_deg").rows()
    columns = targets.select(_COLUMNS)
    target_id = science["target_id"].to_numpy()

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
        n_task = max(1, -(-len(asked) // _TILES_A_TASK))
        tasks = [_Task(rules, tuple(some), place) for place, some in enumerate(np.array_split(np.array(asked, object), n_task))]
        done = sorted(workers.stream(_plan_task, tasks), key=lambda result: result[0])
        planned = [plan for _, plans in done for plan in plans]
        return [Planned(np.searchsorted(target_id, plan.row), plan.group, plan.visit) for plan in planned]

    pool_visits(pool, plan_tiles)
    return pool, _plan_table(pool, target_id)


def _plan_table(pool: Pool, target_id: IntArray) -> pl.DataFrame:
    return pl.DataFrame(
        {
            "tile_id": np.repeat(np.arange(pool.n_tile), [len(plan.row) for plan in pool.plans]).astype(np.int32),
            "group": np.concatenate([plan.group for plan in pool.plans]).astype(np.int32),
            "visit": np.concatenate([plan.visit for plan in pool.plans]).astype(np.int32),
            "target_id": target_id[np.concatenate([plan.row for plan in pool.plans])],
        }
    )


def _capacity(rules: PoolRules, kinds: pl.Series) -> int:
    """Science fibres of a visit: those that calibration does not need."""
    settings, known = rules.allocation, set(kinds.unique())
    n_standard = settings.wanted_standard if "standard" in known else 0
    n_sky = settings.wanted_sky if "sky" in known else 0
    return rules.plate.n_science_live - n_standard - n_sky


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
            kept = planned_visits(part.target_id, order.kept, group, int(order.n_visit[group]))
            planned = plan_visits(
                part, rules.plate, rules.allocation, ~is_done[chosen], int(order.n_visit[group]), kept, rng
            )
            target, visit = np.nonzero(planned)
            is_done[chosen[target]] = True
            parts.append(Planned(part.target_id[target], np.full(len(target), group), visit))
    return Planned(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("row", "group", "visit")))


def planned_visits(target_id: IntArray, plan: Planned, group: int, n_visit: int) -> npt.NDArray[np.bool_]:
    """(n_target, n_visit) a group's plan for the targets with these ids, ascending; others of the plan are left out."""
    is_planned = np.zeros((len(target_id), n_visit), dtype=np.bool_)
    is_known = (plan.group == group) & (plan.visit < n_visit) & np.isin(plan.row, target_id)
    is_planned[np.searchsorted(target_id, plan.row[is_known]), plan.visit[is_known]] = True
    return is_planned
