"""Pooling of a survey's visits among its tiles: the tiling's rules, with plans by the allocator."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import polars as pl

from survey_sim.allocation import AllocationSettings, FieldTargets, plan_visits
from survey_sim.geometry import sky_to_plate
from survey_sim.instrument import Plate
from survey_sim.survey.tile import magnitude_groups, stream
from survey_sim.survey.workers import Workers
from survey_sim.tiling import Members, Order, Planned, make_pool, plate_pairs, pool_visits

IntArray = npt.NDArray[np.int64]

# Tiles that a worker plans at a time.
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
class _Task:
    """Tiles that one worker plans: their orders, with the targets that each may use."""

    rules: PoolRules
    orders: tuple[tuple[int, tuple[float, float], pl.DataFrame, IntArray, pl.DataFrame], ...]


def pool_survey(
    rules: PoolRules, targets: pl.DataFrame, tiles: pl.DataFrame, shared: Members, workers: Workers
) -> tuple[pl.Series, pl.DataFrame]:
    """Home tiles of a survey's science targets, and the plan of its visits.

    Parameters
    ----------
    targets
        Table `targets`, science with the nearest tile in `tile_id`.
    tiles
        Rows of `tiles` of this survey.
    shared
        Rows of `targets` with the calibration targets on each of these tiles' plates.

    Returns
    -------
        `tile_id` of all rows of `targets`, and the plan: columns of `PLAN`.
    """
    is_mine = (targets["kind"] == "science") & (targets["survey"] == rules.survey)
    row = is_mine.arg_true().to_numpy()
    science = targets[row].select(_COLUMNS)
    programme, names = _programmes(science["programme"])
    pool = make_pool(
        plate_pairs(science, tiles, rules.max_distance_deg),
        science["tile_id_"].to_numpy(),
        tiles.height,
        group=_last_group(science["mag"], rules.allocation.mag_ranges),
        programme=programme,
        wanted_visits=science["wanted_visits"].to_numpy().astype(np.int64),
        wanted_frac=np.array([rules.wanted_frac[name] for name in names]),
        capacity=_capacity(rules, targets),
        min_gain=rules.allocation.min_gain,
    )
    raise NotImplementedError
