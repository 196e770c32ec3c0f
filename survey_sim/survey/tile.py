"""One tile, visit by visit: allocate, route three ways, play, and note what really happened."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any
from zlib import crc32

import numpy as np
import polars as pl

from survey_sim.allocation import (
    AllocationSettings,
    FieldTargets,
    LostReason,
    completeness_bound,
    crossings,
    ideal_completeness,
    start_allocation,
)
from survey_sim.geometry import FloatArray, sky_to_plate
from survey_sim.instrument import Plate
from survey_sim.motion import Legs
from survey_sim.routing import RoutedPath, RoutingSettings, UnroutedReason, route
from survey_sim.schema import TABLES, TARGET_KINDS
from survey_sim.simulation import SimulatedPath, simulate

# Tables that the tile stage makes.
TILE_TABLES = ("visits", "allocations", "paths", "legs", "robot_times", "unallocated")


@dataclass(frozen=True)
class TileJob:
    """All that one tile needs, so that any process can do it.

    Attributes
    ----------
    targets
        Rows of `targets` that this tile may use: its own science targets, and the shared kinds on its plate.
    wanted_frac
        Completeness wanted of each science programme, by name.
    """

    survey: str
    tile_id: int
    centre_deg: tuple[float, float]
    targets: pl.DataFrame
    wanted_frac: Mapping[str, float]
    plate: Plate
    allocation: AllocationSettings
    routing: RoutingSettings
    seed: int


@dataclass(frozen=True)
class State:
    """Where all robots stand, and how they are turned: (n_robot, 2) mm and (n_robot,) deg."""

    position_mm: FloatArray
    theta_deg: FloatArray


class Rows:
    """Rows of one table, gathered as arrays and made a frame once."""

    def __init__(self, table: str) -> None:
        self.table = table
        self._columns: dict[str, list[np.ndarray]] = {name: [] for name in TABLES[table].names}

    def add(self, n_row: int, **columns: Any) -> None:
        """Add rows; a single value stands for all of them."""
        for name, chunks in self._columns.items():
            value = np.asarray(columns[name])
            chunks.append(value if value.ndim else np.full(n_row, value))

    def frame(self) -> pl.DataFrame:
        """All rows as a frame of the schema; NaN and None stand for null where a column may have it."""
        columns = {}
        for declared in TABLES[self.table].columns:
            chunks = self._columns[declared.name]
            values = np.concatenate(chunks) if chunks else np.empty(0)
            series = pl.Series(declared.name, values.tolist() if values.dtype == object else values, strict=False)
            if declared.is_nullable and series.dtype.is_float():
                series = series.fill_nan(None)
            columns[declared.name] = series.cast(declared.dtype)
        return pl.DataFrame(columns)


def simulate_tile(job: TileJob) -> dict[str, pl.DataFrame]:
    """All visits of one tile.

    Returns
    -------
        A frame for each of `TILE_TABLES`.
    """
    rows = {table: Rows(table) for table in TILE_TABLES}
    tile = _Tile(job, _field(job))
    state = tile.park
    for number, group in enumerate(magnitude_groups(tile.field, job.allocation.mag_ranges)):
        state = _visit_group(tile, group, number, state, rows)
    _note_unallocated(rows["unallocated"], tile)
    return {table: gathered.frame() for table, gathered in rows.items()}


@dataclass
class _Tile:
    """What is known of a tile while its visits go on.

    Attributes
    ----------
    n_done
        (n_target,) visits in which a robot reached the target.
    reason
        (n_target,) `LostReason` of the last visits that could have held the target.
    n_visit
        Visits so far.
    """

    job: TileJob
    field: FieldTargets
    n_visit: int = 0

    def __post_init__(self) -> None:
        self.n_done = np.zeros(self.field.n_target, dtype=np.int64)
        self.reason = np.zeros(self.field.n_target, dtype=np.int8)
        self.park = State(self.job.plate.park_mm, np.zeros(self.job.plate.n_robot))
        self._ideal: FloatArray = np.empty(0)

    @property
    def completeness_frac(self) -> float:
        """Science targets with all their visits / all science targets of the tile; 1 if there are none."""
        is_science = self.field.is_science
        n_complete = (is_science & (self.n_done >= self.field.wanted_visits)).sum()
        return float(n_complete / is_science.sum()) if is_science.any() else 1.0

    def ideal_frac(self) -> float:
        """The same for an ideal positioner after as many visits."""
        if self.n_visit > len(self._ideal):
            self._ideal = ideal_completeness(self.field, self.job.plate, 2 * self.n_visit + 8)
        return float(self._ideal[self.n_visit - 1])

    def bound_frac(self) -> float:
        """Upper bound for any allocation after as many visits; NaN if it is not wanted."""
        if self.job.allocation.bound == "none":
            return np.nan
        return completeness_bound(self.field, self.job.plate, self.n_visit, method=self.job.allocation.bound)


def magnitude_groups(
    field: FieldTargets, ranges: tuple[tuple[float, float], ...]
) -> Iterator[tuple[np.ndarray, FieldTargets]]:
    """Targets that one exposure can serve together, range after range.

    A science target stands in each range that has its magnitude. Only its last range must complete it: before, it may fill
    fibres that would be idle, so it counts for no programme there and has the lowest priority.

    Returns
    -------
        Places in `field`, and the targets there; targets without a magnitude, and the other kinds, stand in every group.
    """
    if not ranges:
        yield np.arange(field.n_target), field
        return
    bright = [-np.inf, *(low for low, _ in ranges[1:])]
    faint = [*(high for _, high in ranges[:-1]), np.inf]
    has_no_range = ~field.is_science | np.isnan(field.mag)
    for number in range(len(ranges)):
        chosen = np.flatnonzero(has_no_range | ((field.mag >= bright[number]) & (field.mag < faint[number])))
        next_bright = bright[number + 1] if number + 1 < len(ranges) else np.inf
        is_last = (field.mag[chosen] < next_bright) | (next_bright == np.inf)
        yield chosen, _chosen(field, chosen, is_filler=field.is_science[chosen] & ~is_last)


def _chosen(field: FieldTargets, chosen: np.ndarray, *, is_filler: np.ndarray) -> FieldTargets:
    """The targets at these places; fillers have the lowest priority and no programme."""
    per_target = {
        column.name: getattr(field, column.name)[chosen]
        for column in fields(FieldTargets)
        if column.name not in ("programmes", "wanted_frac")
    }
    per_target["priority"] = np.where(is_filler, 1, per_target["priority"])
    per_target["programme"] = np.where(is_filler, -1, per_target["programme"])
    return replace(field, **per_target)


def _visit_group(
    tile: _Tile, group: tuple[np.ndarray, FieldTargets], number: int, state: State, rows: Mapping[str, Rows]
) -> State:
    """All visits of one magnitude range, from where the robots stand; gives where they end."""
    job, (chosen, field) = tile.job, group
    rng = _stream(job, "allocation", number)
    session = start_allocation(field, job.plate, job.allocation, rng, n_done=tile.n_done[chosen])
    visit = session.next_visit(state.position_mm)
    while visit is not None:
        keys = {"survey": job.survey, "tile_id": job.tile_id, "visit_id": tile.n_visit}
        start = tile.park if visit.start == "park" else state
        to_target = _route(job, keys, "start_to_target", start, visit.goal_mm, rows)
        end = State(to_target[0].end_mm, to_target[0].end_theta_deg)
        _route(job, keys, "start_to_park", state, _parked(job.plate, state), rows)
        _route(job, keys, "park_to_target", tile.park, end.position_mm, rows)
        is_arrived = to_target[0].reason == UnroutedReason.ARRIVED
        session.record(visit, is_arrived)
        tile.n_done[chosen] = session.n_done
        tile.n_visit += 1
        held = np.where(is_arrived & (visit.target >= 0), chosen[visit.target], -1)
        _note_allocations(rows["allocations"], keys, job.plate, tile.field, held, start, end)
        _note_visit(rows["visits"], keys, tile, visit.start, held, start, to_target)
        state = end
        visit = session.next_visit(state.position_mm)
    tile.reason[chosen] = session.lost_reasons()
    return state


def stream(seed: int, stage: str, *keys: str | int) -> np.random.Generator:
    """Random stream of a stage at a place of the survey: it depends on nothing else, so on no worker and no order."""
    words = [crc32(key.encode()) if isinstance(key, str) else key for key in (stage, *keys)]
    return np.random.default_rng(np.random.SeedSequence([seed, len(words), *words]))


def _stream(job: TileJob, stage: str, *keys: str | int) -> np.random.Generator:
    return stream(job.seed, stage, job.survey, job.tile_id, *keys)


def _field(job: TileJob) -> FieldTargets:
    """The tile's targets on its plate."""
    ra, dec = (job.targets[name].to_numpy() for name in ("ra_deg", "dec_deg"))
    position = sky_to_plate(ra, dec, job.centre_deg, job.plate.instrument.plate_scale_arcsec_mm)
    on_plate = job.targets.with_columns(x_mm=pl.Series(position[:, 0]), y_mm=pl.Series(position[:, 1]))
    return FieldTargets.from_table(on_plate, job.wanted_frac)


def _parked(plate: Plate, state: State) -> FloatArray:
    """Park positions; dead robots stay."""
    return np.where(plate.is_live[:, None], plate.park_mm, state.position_mm)


def _route(
    job: TileJob, keys: Mapping[str, Any], path: str, start: State, goal_mm: FloatArray, rows: Mapping[str, Rows]
) -> tuple[RoutedPath, SimulatedPath]:
    """Route and play one path, and note its legs and times."""
    rng = _stream(job, "routing", keys["visit_id"], path)
    routed = route(job.plate, start.position_mm, start.theta_deg, goal_mm, job.routing, rng)
    played = simulate(job.plate, start.position_mm, start.theta_deg, routed.legs)
    _note_path(rows["paths"], {**keys, "path": path}, routed, played)
    _note_legs(rows["legs"], {**keys, "path": path}, job.plate, routed.legs)
    _note_times(rows["robot_times"], {**keys, "path": path}, job.plate, routed, played)
    return routed, played


def _note_path(rows: Rows, keys: Mapping[str, Any], routed: RoutedPath, played: SimulatedPath) -> None:
    rows.add(
        1,
        **keys,
        configuration_time_s=played.configuration_time_s,
        configuration_time_p95_s=played.configuration_time_p95_s,
        configuration_time_median_s=played.configuration_time_median_s,
        lower_bound_s=routed.lower_bound_s,
        ticks=played.ticks,
        collisions=played.collisions,
        unrouted=_n_unrouted(routed),
        min_separation_mm=played.min_separation_mm,
    )


def _n_unrouted(routed: RoutedPath) -> int:
    return int((routed.reason != UnroutedReason.ARRIVED).sum())


def _note_legs(rows: Rows, keys: Mapping[str, Any], plate: Plate, legs: Legs) -> None:
    rows.add(
        len(legs),
        **keys,
        robot_id=plate.robot_id[legs.robot],
        leg=legs.leg,
        start_s=legs.start_s,
        rotate_deg=legs.rotate_deg,
        dx_mm=legs.dx_mm,
        dy_mm=legs.dy_mm,
        precise_mm=legs.precise_mm,
        x_mm=legs.x_mm,
        y_mm=legs.y_mm,
        theta_deg=legs.theta_deg,
    )


def _note_times(rows: Rows, keys: Mapping[str, Any], plate: Plate, routed: RoutedPath, played: SimulatedPath) -> None:
    codes = np.array([None, *(reason.code for reason in UnroutedReason if reason != UnroutedReason.ARRIVED)], dtype=object)
    rows.add(
        plate.n_robot,
        **keys,
        robot_id=plate.robot_id,
        rotating_s=played.rotating_s,
        moving_s=played.moving_s,
        waiting_s=played.waiting_s,
        reason=codes[routed.reason],
    )


def _note_allocations(
    rows: Rows, keys: Mapping[str, Any], plate: Plate, field: FieldTargets, held: np.ndarray, start: State, end: State
) -> None:
    has_target = held >= 0
    target_id = np.where(has_target, field.target_id[held], np.nan) if field.n_target else np.full(len(held), np.nan)
    kinds = np.array([*TARGET_KINDS, None], dtype=object)
    rows.add(
        plate.n_robot,
        **keys,
        robot_id=plate.robot_id,
        target_id=target_id,
        kind=kinds[np.where(has_target, field.kind[held], -1)] if field.n_target else kinds[np.full(len(held), -1)],
        x_mm=end.position_mm[:, 0],
        y_mm=end.position_mm[:, 1],
        travel_mm=np.hypot(*(end.position_mm - start.position_mm).T),
    )


def _note_visit(
    rows: Rows,
    keys: Mapping[str, Any],
    tile: _Tile,
    begins: str,
    held: np.ndarray,
    start: State,
    to_target: tuple[RoutedPath, SimulatedPath],
) -> None:
    field, (routed, played) = tile.field, to_target
    kind = field.kind[held[held >= 0]]
    number = dict(zip(TARGET_KINDS, np.bincount(kind, minlength=len(TARGET_KINDS)), strict=True))
    mag = field.mag[held[held >= 0]][kind == TARGET_KINDS.index("science")]
    mag = mag[np.isfinite(mag)]
    travel = np.hypot(*(routed.end_mm - start.position_mm).T)
    travel = np.sort(travel[travel > 0])
    rows.add(
        1,
        **keys,
        start=begins,
        mag_bright=mag.min() if len(mag) else np.nan,
        mag_faint=mag.max() if len(mag) else np.nan,
        n_science=number["science"],
        n_standard=number["standard"],
        n_sky=number["sky"],
        n_guide=number["guide"],
        n_idle=int((tile.job.plate.is_live & (held < 0)).sum()),
        completeness_frac=tile.completeness_frac,
        ideal_completeness_frac=tile.ideal_frac(),
        completeness_bound_frac=tile.bound_frac(),
        travel_mean_mm=travel.mean() if len(travel) else 0.0,
        travel_p95_mm=travel[int(np.ceil(0.95 * len(travel) - 1e-9)) - 1] if len(travel) else 0.0,
        travel_max_mm=travel[-1] if len(travel) else 0.0,
        crossings=crossings(start.position_mm, routed.end_mm),
        collisions=played.collisions,
        unrouted=_n_unrouted(routed),
        ticks=played.ticks,
        configuration_time_s=played.configuration_time_s,
        configuration_time_p95_s=played.configuration_time_p95_s,
        lower_bound_s=routed.lower_bound_s,
    )


def _note_unallocated(rows: Rows, tile: _Tile) -> None:
    """Science targets that are not complete, and why."""
    field = tile.field
    lost = np.flatnonzero(field.is_science & (tile.n_done < field.wanted_visits))
    labels = np.array([LostReason(code).label for code in range(len(LostReason))], dtype=object)
    rows.add(
        len(lost),
        survey=tile.job.survey,
        tile_id=tile.job.tile_id,
        target_id=field.target_id[lost],
        n_allocated=tile.n_done[lost],
        reason=labels[tile.reason[lost]],
    )
