"""Rows of a run's tables from visits that were allocated, routed and played, of tiles and fields alike."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import polars as pl

from survey_sim.allocation import (
    AllocationSettings,
    Field,
    FieldTargets,
    LostReason,
    Minima,
    completeness_bound,
    crossings,
    fast_bounds,
    ideal_completeness,
    make_field,
)
from survey_sim.geometry import FloatArray
from survey_sim.instrument import Plate
from survey_sim.motion import Legs
from survey_sim.schema import TABLES, TARGET_KINDS, Column
from survey_sim.simulation import ExecutedPath, SimulatedPath

# Tables that the visits of a tile make.
TILE_TABLES = ("visits", "allocations", "paths", "legs", "robot_times", "executions", "unallocated")
_LEG_COLUMNS = ("leg", "start_s", "rotate_deg", "dx_mm", "dy_mm", "precise_mm", "x_mm", "y_mm", "theta_deg")
_PLAYED = ("configuration_time_s", "configuration_time_p95_s", "ticks", "collisions")
# Figures of `start_to_target` that `visits` holds too.
_OF_PATH = (*_PLAYED, "unrouted", "lower_bound_s")
_EXECUTED = (
    *("moving_time_s", "metrology_rounds", "metrology_time_s", "configuration_time_s"),
    *("min_separation_mm", "collisions", "contacts", "is_within_tolerance"),
)
_SHORTFALLS = ("standard", "sky", "guide", "sky_region")


@dataclass(frozen=True)
class PlayedPath:
    """One path of a visit, routed and played.

    Attributes
    ----------
    reason
        (n_robot,) why each robot was not routed; None where it was.
    lower_bound_s
        The slowest robot, were it alone.
    """

    legs: Legs
    played: SimulatedPath
    reason: npt.NDArray[np.object_]
    lower_bound_s: float

    @cached_property
    def n_unrouted(self) -> int:
        """Robots that were not routed."""
        return len(self.reason) - self.reason.tolist().count(None)

    def figures(self) -> dict[str, float | int]:
        """Those that both `paths` and `visits` hold."""
        own = {name: getattr(self.played, name) for name in _PLAYED}
        return {**own, "unrouted": self.n_unrouted, "lower_bound_s": self.lower_bound_s}

    def path_columns(self) -> dict[str, float | int]:
        """All figures of the path."""
        more = {name: getattr(self.played, name) for name in ("configuration_time_median_s", "min_separation_mm")}
        return {**self.figures(), **more}

    def leg_columns(self, plate: Plate) -> dict[str, npt.NDArray[Any]]:
        """(n_leg,) columns of the legs."""
        return {
            "robot_id": plate.robot_id[self.legs.robot],
            **{name: getattr(self.legs, name) for name in _LEG_COLUMNS},
        }


class Rows:
    """Rows of one table, gathered as arrays and made a frame once."""

    def __init__(self, table: str) -> None:
        self.table = table
        self._columns: dict[str, list[Any]] = {name: [] for name in TABLES[table].names}
        self._n_row: list[int] = []

    def add(self, n_row: int, **columns: Any) -> None:
        """Add rows; a single value stands for all of them."""
        self._n_row.append(n_row)
        for name, chunks in self._columns.items():
            chunks.append(columns[name])

    def frame(self) -> pl.DataFrame:
        """All rows as a frame of the schema; NaN and None stand for null where a column may have it."""
        declared = TABLES[self.table].columns
        is_array = {name: any(isinstance(chunk, np.ndarray) for chunk in chunks) for name, chunks in self._columns.items()}
        made = {column.name: self._of_arrays(column) for column in declared if is_array[column.name]}
        single = pl.DataFrame([self._of_values(column) for column in declared if not is_array[column.name]])
        if any(n != 1 for n in self._n_row):
            single = single[np.repeat(np.arange(len(single)), self._n_row)]
        made |= {series.name: series for series in single}
        return pl.DataFrame([made[column.name] for column in declared])

    def _of_values(self, column: Column) -> pl.Series:
        """A column that has a single value each time that rows were added: these values."""
        values = pl.Series(column.name, self._columns[column.name], strict=False)
        if column.is_nullable and values.dtype.is_float():
            values = values.fill_nan(None)
        return values.cast(column.dtype)

    def _of_arrays(self, column: Column) -> pl.Series:
        """A column that has arrays, of all its rows."""
        parts = zip(self._columns[column.name], self._n_row, strict=True)
        values = np.concatenate([part if isinstance(part, np.ndarray) else np.full(n, part) for part, n in parts])
        listed = values.tolist() if values.dtype == object else values
        return pl.Series(column.name, listed, strict=False, nan_to_null=column.is_nullable).cast(column.dtype)


def tile_rows() -> dict[str, Rows]:
    """No row yet of any of `TILE_TABLES`."""
    return {table: Rows(table) for table in TILE_TABLES}


def frames(rows: Mapping[str, Rows]) -> dict[str, pl.DataFrame]:
    """A frame for each table."""
    return {table: of_table.frame() for table, of_table in rows.items()}


class TileRows:
    """Rows of all visits of one tile, with the tally that they need.

    Parameters
    ----------
    minima
        Least acceptable fibres of a visit; None where nobody knows: shortfalls are null.
    bound
        Method of the bound of completeness; "none" leaves it null.
    rows
        Where the rows go, if those of several tiles are gathered (`tile_rows`).

    Attributes
    ----------
    n_done
        (n_target,) visits in which a robot reached the target.
    n_visit
        Visits so far.
    """

    def __init__(
        self,
        survey: str,
        tile_id: int,
        field: FieldTargets,
        plate: Plate,
        minima: Minima | None,
        bound: Literal["none", "fast", "linear"] = "none",
        rows: Mapping[str, Rows] | None = None,
    ) -> None:
        self.survey, self.tile_id, self.field, self.plate = survey, tile_id, field, plate
        self.n_done = np.zeros(field.n_target, dtype=np.int64)
        self.n_visit = 0
        self._minima, self._bound = minima, bound
        self._ideal: FloatArray = np.empty(0)
        self._bounds: FloatArray = np.empty(0)
        self._rows = tile_rows() if rows is None else rows

    def frames(self) -> dict[str, pl.DataFrame]:
        """A frame for each of `TILE_TABLES`."""
        return frames(self._rows)

    @property
    def is_complete(self) -> npt.NDArray[np.bool_]:
        """(n_target,) science targets with all their visits."""
        return self.field.is_science & (self.n_done >= self.field.wanted_visits)

    @property
    def completeness_frac(self) -> float:
        """Complete science targets / science targets of the tile; 1 if there are none."""
        is_science = self.field.is_science
        return float(self.is_complete.sum() / is_science.sum()) if is_science.any() else 1.0

    @cached_property
    def lists(self) -> Field:
        """Who is near whom and who reaches what, of all targets."""
        return make_field(self.field, self.plate, AllocationSettings.load({}))

    def add_path(self, path: str, made: PlayedPath) -> None:
        """A path of the visit that comes next: `paths`, `legs`, `robot_times`."""
        keys = {**self._keys(self.n_visit), "path": path}
        played = made.played
        self._rows["paths"].add(1, **keys, **made.path_columns())
        self._rows["legs"].add(len(made.legs), **keys, **made.leg_columns(self.plate))
        self._rows["robot_times"].add(
            self.plate.n_robot,
            **keys,
            robot_id=self.plate.robot_id,
            rotating_s=played.rotating_s,
            moving_s=played.moving_s,
            waiting_s=played.waiting_s,
            reason=made.reason if made.n_unrouted else None,
        )

    def add_execution(self, path: str, mode: str, done: ExecutedPath) -> None:
        """A path of the visit that comes next, played with errors: `executions`."""
        figures = {name: getattr(done, name) for name in _EXECUTED}
        error_um = float(done.error_um.max(initial=0.0))
        self._rows["executions"].add(1, **self._keys(self.n_visit), path=path, mode=mode, **figures, error_max_um=error_um)

    def add_visit(
        self, begins: str, held: np.ndarray, start_mm: FloatArray, end_mm: FloatArray, to_target: PlayedPath | None
    ) -> None:
        """The visit that comes next, and the tally: `visits`, `allocations`.

        Parameters
        ----------
        begins
            Where `start_to_target` begins: previous or park.
        held
            (n_robot,) places in `field` of the targets that the robots reach, or -1.
        start_mm, end_mm
            (n_robot, 2) where `start_to_target` begins and ends.
        to_target
            That path; None while it is not routed.
        """
        keys = self._keys(self.n_visit)
        self.n_visit += 1
        self.n_done[held[held >= 0]] += 1
        travel_mm = np.hypot(*(end_mm - start_mm).T)
        self._add_allocations(keys, held, end_mm, travel_mm)
        self._rows["visits"].add(
            1,
            **keys,
            start=begins,
            **self._fibres(held),
            completeness_frac=self.completeness_frac,
            ideal_completeness_frac=self._ideal_frac(),
            completeness_bound_frac=self._bound_frac(),
            **_travel(travel_mm),
            crossings=crossings(start_mm, end_mm),
            **(dict.fromkeys(_OF_PATH, np.nan) if to_target is None else to_target.figures()),
        )

    def add_unallocated(self, reason: np.ndarray) -> None:
        """Science targets that are not complete, and why: (n_target,) `LostReason`."""
        lost = np.flatnonzero(self.field.is_science & ~self.is_complete)
        labels = np.array([LostReason(code).label for code in range(len(LostReason))], dtype=object)
        self._rows["unallocated"].add(
            len(lost),
            survey=self.survey,
            tile_id=self.tile_id,
            target_id=self.field.target_id[lost],
            n_allocated=self.n_done[lost],
            reason=labels[reason[lost]],
        )

    def _keys(self, visit_id: int) -> dict[str, Any]:
        return {"survey": self.survey, "tile_id": self.tile_id, "visit_id": visit_id}

    def _add_allocations(self, keys: Mapping[str, Any], held: np.ndarray, end_mm: FloatArray, travel_mm: FloatArray) -> None:
        kinds = np.array([*TARGET_KINDS, None], dtype=object)
        target_id = np.full(len(held), np.nan)
        kind = np.full(len(held), -1)
        has_target = held >= 0
        target_id[has_target] = self.field.target_id[held[has_target]]
        kind[has_target] = self.field.kind[held[has_target]]
        self._rows["allocations"].add(
            self.plate.n_robot,
            **keys,
            robot_id=self.plate.robot_id,
            target_id=target_id,
            kind=kinds[kind],
            x_mm=end_mm[:, 0],
            y_mm=end_mm[:, 1],
            travel_mm=travel_mm,
        )

    def _fibres(self, held: np.ndarray) -> dict[str, float | int]:
        """What the fibres of a visit hold, and lack."""
        field, target = self.field, held[held >= 0]
        kind = field.kind[target]
        number = np.bincount(kind, minlength=len(TARGET_KINDS))
        mag = field.mag[target][kind == TARGET_KINDS.index("science")]
        mag = mag[np.isfinite(mag)]
        lack: Mapping[str, float] = dict.fromkeys(_SHORTFALLS, np.nan)
        if self._minima is not None:
            lack = self._minima.shortfall(kind, field.x_mm[target], field.y_mm[target])
        return {
            "mag_bright": mag.min() if len(mag) else np.nan,
            "mag_faint": mag.max() if len(mag) else np.nan,
            **{f"n_{name}": int(n) for name, n in zip(TARGET_KINDS, number, strict=True)},
            "n_idle": int((self.plate.is_live & (held < 0)).sum()),
            **{f"{name}_shortfall": lack[name] for name in _SHORTFALLS},
        }

    def _ideal_frac(self) -> float:
        """Completeness of an ideal positioner after as many visits."""
        if self.n_visit > len(self._ideal):
            self._ideal = ideal_completeness(self.field, self.plate, 2 * self.n_visit + 8)
        return float(self._ideal[self.n_visit - 1])

    def _bound_frac(self) -> float:
        """Upper bound of completeness for any allocation after as many visits; NaN if it is not wanted."""
        if self._bound == "none":
            return np.nan
        if self._bound == "linear":
            return completeness_bound(self.field, self.plate, self.n_visit, field=self.lists)
        if self.n_visit > len(self._bounds):
            self._bounds = fast_bounds(self.lists, 2 * self.n_visit + 8)
        return float(self._bounds[self.n_visit - 1])


def _travel(travel_mm: FloatArray) -> dict[str, float]:
    """Figures of the robots that travel."""
    travel = np.sort(travel_mm[travel_mm > 0])
    if not len(travel):
        return {"travel_mean_mm": 0.0, "travel_p95_mm": 0.0, "travel_max_mm": 0.0}
    p95 = travel[int(np.ceil(0.95 * len(travel) - 1e-9)) - 1]
    return {"travel_mean_mm": float(travel.mean()), "travel_p95_mm": float(p95), "travel_max_mm": float(travel[-1])}
