"""From tables to the arrays of the nightly loop, checked at the door."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import polars as pl

from survey_sim.errors import InputError, did_you_mean
from survey_sim.geometry import unit_vectors
from survey_sim.schedule.kernels import State, Targets, Visits, add_gains
from survey_sim.schedule.settings import Programme

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_TILE = ["survey", "tile_id"]
_VISIT = ["survey", "tile_id", "visit_id"]
# Paths by which the usual configuration time is judged.
_USED_PATHS = ("start_to_target", "park_to_target")
_KEY_TYPES = {"survey": pl.String, "tile_id": pl.Int32, "visit_id": pl.Int16, "target_id": pl.Int64}


@dataclass(frozen=True)
class Problem:
    """What is to be observed.

    Attributes
    ----------
    programmes
        By place, as arrays name them.
    surveys
        Names in order; a survey's place is its number.
    tiles
        Frame survey, tile_id in order; a tile's place is its number. `tile_survey` (n,) and `tile_icrs` (n, 3) go
        with it.
    first_visit
        (n_tile + 1,) places of each tile's visits.
    visit_table
        Frame survey, tile_id, visit_id, in the order of `visits`.
    n_target
        (n_programme,) targets of each programme.
    """

    programmes: tuple[Programme, ...]
    surveys: tuple[str, ...]
    tiles: pl.DataFrame
    tile_survey: IntArray
    tile_icrs: FloatArray
    first_visit: IntArray
    visit_table: pl.DataFrame
    visits: Visits
    targets: Targets
    n_target: IntArray


def make_problem(
    visits: pl.DataFrame,
    paths: pl.DataFrame,
    tiles: pl.DataFrame,
    targets: pl.DataFrame,
    holdings: pl.DataFrame,
    programmes: Sequence[Programme],
    *,
    is_routed: bool,
) -> Problem:
    """Arrays of the tables; `is_routed`: the times of `paths` are needed."""
    _check_programmes(programmes)
    visits, paths, tiles, targets, holdings = map(_with_key_types, (visits, paths, tiles, targets, holdings))
    named = pl.concat([tiles["survey"], pl.Series("survey", [p.survey for p in programmes], dtype=pl.String)])
    surveys = sorted(named.unique())
    tiles = tiles.sort(_TILE).with_row_index("tile")
    visit_table = visits.sort(_VISIT).join(tiles.select(*_TILE, "tile"), on=_TILE, how="left", maintain_order="left")
    _check_visits(visit_table)
    visit_table = visit_table.with_row_index("visit")
    science = _science(targets, programmes)
    held = _held(holdings, visit_table, science)

    n_tile, n_visit, n_target = len(tiles), len(visit_table), len(science)
    visit_tile = _ints(visit_table["tile"])
    target_programme = _ints(science["number"])
    held_visit, held_target = _ints(held["visit"]), _ints(held["target"])
    by_target = np.argsort(held_target, kind="stable")
    exposure_s = np.zeros(n_visit)
    by_programme = np.array([programme.exposure_s for programme in programmes])
    np.maximum.at(exposure_s, held_visit, by_programme[target_programme[held_target]])
    times = _path_times(paths, visit_table) if is_routed else np.zeros((len(_USED_PATHS), n_visit))
    return Problem(
        programmes=tuple(programmes),
        surveys=tuple(surveys),
        tiles=tiles.select(_TILE),
        tile_survey=np.searchsorted(np.array(surveys, dtype=str), tiles["survey"].to_numpy().astype(str)).astype(np.int64),
        tile_icrs=unit_vectors(tiles["ra_deg"].to_numpy(), tiles["dec_deg"].to_numpy()),
        first_visit=_starts(visit_tile, n_tile),
        visit_table=visit_table.select(_VISIT),
        visits=Visits(
            tile=visit_tile,
            exposure_s=exposure_s,
            start_to_target_s=times[0],
            park_to_target_s=times[1],
            first_holding=_starts(held_visit, n_visit),
            target=held_target,
        ),
        targets=Targets(
            target_id=_ints(science["target_id"]),
            programme=target_programme,
            wanted=_ints(science["wanted_visits"]),
            first_held=_starts(held_target, n_target),
            visit=held_visit[by_target],
        ),
        n_target=np.bincount(target_programme, minlength=len(programmes)).astype(np.int64),
    )


def initial_state(problem: Problem) -> State:
    """Nothing observed yet."""
    visits, targets = problem.visits, problem.targets
    n_programme, n_target = len(problem.programmes), len(targets.target_id)
    n_observed = np.zeros(n_target, dtype=np.int64)
    gain = np.zeros((len(visits.tile), n_programme), dtype=np.int64)
    add_gains(visits, targets, n_observed, gain)
    complete = np.bincount(targets.programme[targets.wanted == 0], minlength=n_programme)
    return State(
        next_visit=problem.first_visit[:-1].copy(),
        gain=gain,
        n_observed=n_observed,
        n_tried=np.zeros(n_target, dtype=np.int64),
        first_night=np.full(n_target, -1, dtype=np.int64),
        last_night=np.full(n_target, -1, dtype=np.int64),
        n_complete=complete.astype(np.int64),
    )


def _with_key_types(frame: pl.DataFrame) -> pl.DataFrame:
    """The frame with the columns that others are joined on of the schema's types."""
    return frame.cast({name: dtype for name, dtype in _KEY_TYPES.items() if name in frame.columns})


def _check_programmes(programmes: Sequence[Programme]) -> None:
    names = [programme.name for programme in programmes]
    if len(set(names)) < len(names):
        raise InputError("two programmes share a name", place="programmes", rows=sorted(names))
    short = [programme.name for programme in programmes if not programme.exposure_s > 0]
    if short:
        raise InputError("exposure_s must exceed 0", place="programmes", rows=short)


def _check_visits(visit_table: pl.DataFrame) -> None:
    lost = visit_table.filter(pl.col("tile").is_null())
    if len(lost):
        raise InputError("visits of a tile that `tiles` does not have", place="visits", rows=lost.rows()[:10])
    order = pl.int_range(pl.len()).over("tile")
    gaps = visit_table.filter(pl.col("visit_id") != order)
    if len(gaps):
        raise InputError("visits of a tile are not 0, 1, 2, ...", place="visits.visit_id", rows=gaps.select(_VISIT).rows())


def _science(targets: pl.DataFrame, programmes: Sequence[Programme]) -> pl.DataFrame:
    """Science targets in order of target_id, with their place and the number of their programme."""
    science = targets.filter(pl.col("kind") == "science").select("target_id", "survey", "programme", "wanted_visits")
    numbers = {programme.name: number for number, programme in enumerate(programmes)}
    unknown = set(science["programme"].unique().to_list()) - numbers.keys()
    if unknown:
        name = sorted(map(str, unknown))[0]
        raise InputError(f"no programme '{name}'", place="targets.programme", remedy=did_you_mean(name, numbers))
    number = pl.col("programme").replace_strict(numbers, return_dtype=pl.Int64)
    return science.sort("target_id").with_columns(number.alias("number")).with_row_index("target")


def _held(holdings: pl.DataFrame, visit_table: pl.DataFrame, science: pl.DataFrame) -> pl.DataFrame:
    """Holdings as places of visits and targets, in order."""
    held = holdings.select(*_VISIT, "target_id")
    held = held.join(visit_table.select(*_VISIT, "visit"), on=_VISIT, how="left")
    held = held.join(science.select("target_id", "target"), on="target_id", how="left")
    for column, of in (("visit", "visits"), ("target", "the science targets")):
        lost = held.filter(pl.col(column).is_null())
        if len(lost):
            raise InputError(f"not among {of}", place="holdings", rows=lost.select(*_VISIT, "target_id").rows())
    return held.select("visit", "target").sort("visit", "target")


def _path_times(paths: pl.DataFrame, visit_table: pl.DataFrame) -> FloatArray:
    """(2, n_visit) configuration times by path, s, in the order of `_USED_PATHS`."""
    times = np.empty((len(_USED_PATHS), len(visit_table)))
    for row, path in enumerate(_USED_PATHS):
        one = paths.filter(pl.col("path") == path).select(*_VISIT, "configuration_time_s")
        joined = visit_table.select(_VISIT).join(one, on=_VISIT, how="left", maintain_order="left")
        lost = joined.filter(pl.col("configuration_time_s").is_null())
        if len(lost):
            remedy = "route every visit, or set schedule.configuration_s to a number"
            raise InputError(f"no {path} of visits", place="paths", rows=lost.select(_VISIT).rows(), remedy=remedy)
        times[row] = joined["configuration_time_s"].to_numpy()
    return times


def _ints(series: pl.Series) -> IntArray:
    return series.cast(pl.Int64).to_numpy().copy()


def _starts(owner: IntArray, n_owner: int) -> IntArray:
    """(n_owner + 1,) places at which the items of each owner start, for items sorted by owner."""
    return np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=n_owner))]).astype(np.int64)
