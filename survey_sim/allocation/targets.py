"""Targets of one tile on its plate, checked at the door."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt
import polars as pl

from survey_sim.errors import InputError, did_you_mean
from survey_sim.schema import TARGET_KINDS

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

SCIENCE, STANDARD, SKY, GUIDE = range(len(TARGET_KINDS))
PRIORITY_RANGE = (1, 9)


@dataclass(frozen=True)
class FieldTargets:
    """Targets of one tile, by ascending `target_id`.

    Attributes
    ----------
    target_id
        (n_target,) ascending, unique.
    x_mm, y_mm
        (n_target,) plate frame, mm.
    kind
        (n_target,) int8 codes: places in `TARGET_KINDS` (0 science, 1 standard, 2 sky, 3 guide).
    priority
        (n_target,) 1 (low) to 9 (high).
    wanted_visits
        (n_target,) visits that complete a science target; the other kinds serve at every visit and are never used up.
    programme
        (n_target,) places in `programmes`; -1 where there is none.
    mag
        (n_target,) magnitude; NaN where unknown.
    programmes
        Names of the programmes.
    wanted_frac
        (n_programme,) completeness wanted of each programme.
    """

    target_id: IntArray
    x_mm: FloatArray
    y_mm: FloatArray
    kind: npt.NDArray[np.int8]
    priority: IntArray
    wanted_visits: IntArray
    programme: IntArray
    mag: FloatArray
    programmes: tuple[str, ...]
    wanted_frac: FloatArray

    @classmethod
    def from_table(cls, table: pl.DataFrame, wanted_completeness: float | Mapping[str, float] = 1.0) -> Self:
        """Targets from a table, in any order of rows.

        Parameters
        ----------
        table
            target_id, x_mm, y_mm; optionally kind (name or code; science by default), priority (9 by default),
            wanted_visits (1 by default), programme (name or number) and mag.
        wanted_completeness
            Fraction wanted of every programme, or by the programme's name (1 where it is not named).

        Raises
        ------
        InputError
            Missing columns; duplicate ids; NaN; unknown kinds; priority, visits or completeness out of range.
        """
        missing = [name for name in ("target_id", "x_mm", "y_mm") if name not in table.columns]
        if missing:
            raise InputError("missing column", place="targets", rows=missing, remedy=f"has {', '.join(table.columns)}")
        ids = table["target_id"]
        _refuse("targets.target_id", "null", ids.is_null())
        _refuse("targets.target_id", "duplicate id", ids.is_duplicated())
        for name in ("x_mm", "y_mm"):
            _refuse(f"targets.{name}", "null, NaN or infinite", ~table[name].cast(pl.Float64).is_finite().fill_null(False))
        kind = _kinds(table)
        is_science = kind == SCIENCE
        priority = _integers(table, "priority", PRIORITY_RANGE[1], is_science)
        outside = (priority < PRIORITY_RANGE[0]) | (priority > PRIORITY_RANGE[1])
        _refuse("targets.priority", f"outside {list(PRIORITY_RANGE)}", pl.Series(outside & is_science))
        wanted = _integers(table, "wanted_visits", 1, is_science)
        _refuse("targets.wanted_visits", "less than 1", pl.Series((wanted < 1) & is_science))
        programme, programmes = _programmes(table)
        order = np.argsort(ids.to_numpy(), kind="stable")
        mag = table["mag"] if "mag" in table.columns else pl.Series(np.full(len(ids), np.nan))
        return cls(
            target_id=ids.cast(pl.Int64).to_numpy()[order],
            x_mm=table["x_mm"].cast(pl.Float64).to_numpy()[order],
            y_mm=table["y_mm"].cast(pl.Float64).to_numpy()[order],
            kind=kind[order],
            priority=priority[order],
            wanted_visits=wanted[order],
            programme=programme[order],
            mag=mag.cast(pl.Float64).fill_null(np.nan).to_numpy()[order],
            programmes=programmes,
            wanted_frac=_wanted_fractions(programmes, wanted_completeness),
        )

    @property
    def n_target(self) -> int:
        """Number of targets of all kinds."""
        return len(self.target_id)

    @property
    def is_science(self) -> npt.NDArray[np.bool_]:
        """(n_target,) science targets."""
        return self.kind == SCIENCE

    def is_on_plate(self, plate_radius_mm: float) -> npt.NDArray[np.bool_]:
        """(n_target,) targets that lie on the plate; the others are set aside: counted, never allocated."""
        return np.hypot(self.x_mm, self.y_mm) <= plate_radius_mm


def _refuse(place: str, rule: str, is_bad: pl.Series) -> None:
    if is_bad.any():
        raise InputError(rule, place=place, rows=is_bad.arg_true().to_list())


def _kinds(table: pl.DataFrame) -> npt.NDArray[np.int8]:
    if "kind" not in table.columns:
        return np.zeros(len(table), np.int8)
    column = table["kind"]
    if column.dtype.is_integer():
        _refuse("targets.kind", f"unknown code, not 0 to {GUIDE}", ~column.is_between(SCIENCE, GUIDE).fill_null(False))
        return column.cast(pl.Int8).to_numpy()
    names = column.cast(pl.String)
    codes = names.replace_strict(list(TARGET_KINDS), list(range(len(TARGET_KINDS))), return_dtype=pl.Int8, default=-1)
    unknown = codes < 0
    if unknown.any():
        word = names.filter(unknown)[0]
        hint = did_you_mean(str(word), TARGET_KINDS)
        raise InputError(f"unknown kind {word!r}", place="targets.kind", rows=unknown.arg_true().to_list(), remedy=hint)
    return codes.to_numpy()


def _integers(table: pl.DataFrame, name: str, default: int, is_needed: npt.NDArray[np.bool_]) -> IntArray:
    """A column as whole numbers; only targets that are not science may leave it empty."""
    if name not in table.columns:
        return np.full(len(table), default, np.int64)
    column = table[name]
    if column.dtype.is_integer() and not column.null_count():
        return column.cast(pl.Int64).to_numpy()
    values = column.cast(pl.Float64, strict=False)
    is_whole = (values.is_finite() & (values == values.floor())).fill_null(False)
    _refuse(f"targets.{name}", "not a whole number", ~is_whole & pl.Series(is_needed))
    return values.set(~is_whole, float(default)).cast(pl.Int64).to_numpy()


def _programmes(table: pl.DataFrame) -> tuple[IntArray, tuple[str, ...]]:
    if "programme" not in table.columns:
        return np.zeros(len(table), np.int64), ("science",)
    names = table["programme"].cast(pl.String)
    known = tuple(names.drop_nulls().unique().sort().to_list())
    codes = names.replace_strict(list(known), list(range(len(known))), return_dtype=pl.Int64, default=-1)
    return codes.to_numpy(), known


def _wanted_fractions(programmes: tuple[str, ...], wanted: float | Mapping[str, float]) -> FloatArray:
    named = wanted if isinstance(wanted, Mapping) else dict.fromkeys(programmes, wanted)
    values = np.array([named.get(name, 1.0) for name in programmes], dtype=np.float64)
    if not ((values >= 0) & (values <= 1)).all():
        bad = [name for name, value in zip(programmes, values, strict=True) if not 0 <= value <= 1]
        raise InputError("completeness wanted outside [0, 1]", place="programme.completeness", rows=bad)
    return values
