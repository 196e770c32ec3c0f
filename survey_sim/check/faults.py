"""What the check finds: faults as rows, kept in bounded number and counted in full."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields

import polars as pl

# A broken run can hold a fault in every one of its millions of rows: this many of each check are kept, all are counted.
MAX_ROWS = 1000

FAULT_SCHEMA = pl.Schema(
    {
        "check": pl.String(),
        "table": pl.String(),
        "survey": pl.String(),
        "tile_id": pl.Int32(),
        "visit_id": pl.Int16(),
        "exposure_id": pl.Int32(),
        "path": pl.String(),
        "robot_id": pl.Int32(),
        "other_robot_id": pl.Int32(),
        "value": pl.Float64(),
        "limit": pl.Float64(),
        "detail": pl.String(),
    }
)


@dataclass(frozen=True)
class Fault:
    """One fault: the check that failed, the row at fault, what stands there (`value`) and what should (`limit`)."""

    check: str
    table: str
    survey: str | None = None
    tile_id: int | None = None
    visit_id: int | None = None
    exposure_id: int | None = None
    path: str | None = None
    robot_id: int | None = None
    other_robot_id: int | None = None
    value: float | None = None
    limit: float | None = None
    detail: str = ""

    def __str__(self) -> str:
        """The fault as one readable line."""
        named = ((f.name, getattr(self, f.name)) for f in fields(self)[2:-1])
        where = ", ".join(f"{name} {value}" for name, value in named if value is not None)
        return f"{self.check}: {self.detail} ({self.table}{': ' if where else ''}{where})"


@dataclass
class FaultLog:
    """Faults as they are found: at most `MAX_ROWS` rows of each check, and how many there were."""

    count: Counter[str] = field(default_factory=Counter)
    rows: list[pl.DataFrame] = field(default_factory=list)

    def add(
        self,
        check: str,
        table: str,
        rows: pl.DataFrame,
        detail: str | pl.Expr,
        *,
        value: pl.Expr | None = None,
        limit: pl.Expr | float | None = None,
        n_hidden: int = 0,
    ) -> None:
        """Add a fault for each row.

        Parameters
        ----------
        rows
            The rows at fault; columns that `FAULT_SCHEMA` names say where, the others serve `detail`, `value` and `limit`.
        n_hidden
            Further faults of the kind that have no row here.
        """
        n_kept = max(MAX_ROWS - self.count[check], 0)
        self.count[check] += rows.height + n_hidden
        if rows.is_empty() or not n_kept:
            return
        made = {
            "check": pl.lit(check),
            "table": pl.lit(table),
            "value": _expression(value),
            "limit": _expression(limit),
            "detail": pl.lit(detail) if isinstance(detail, str) else detail,
        }
        columns = [
            made.get(name, pl.col(name) if name in rows.columns else pl.lit(None)).cast(dtype).alias(name)
            for name, dtype in FAULT_SCHEMA.items()
        ]
        self.rows.append(rows.head(n_kept).select(columns))

    def add_one(self, fault: Fault) -> None:
        """Add a fault that belongs to no row."""
        frame = pl.DataFrame([[getattr(fault, name)] for name in FAULT_SCHEMA], schema=FAULT_SCHEMA)
        self.add(fault.check, fault.table, frame, fault.detail, value=pl.col("value"), limit=pl.col("limit"))

    def compare(
        self, check: str, table: str, frame: pl.DataFrame, columns: Mapping[str, float], detail: str = "derived again"
    ) -> None:
        """Faults where a column differs from `own_<column>`, the same derived here, by more than its tolerance."""
        for column, tolerance in columns.items():
            given, own = pl.col(column), pl.col(f"own_{column}")
            same = given.eq_missing(own)
            if frame.schema[column].is_numeric():
                same = same | ((given - own).abs() <= tolerance).fill_null(value=False)
            bad = frame.filter(~same)
            is_number = frame.schema[column].is_numeric()
            value, limit = (given, own) if is_number else (None, None)
            text = pl.lit(f"{column} is not what it is when {detail}")
            if not is_number:
                text = pl.format("{}: {} instead of {}", text, given.fill_null("null"), own.fill_null("null"))
            self.add(check, table, bad, text, value=value, limit=limit)

    def frame(self) -> pl.DataFrame:
        """All kept faults, in the order in which they were found."""
        return pl.concat(self.rows) if self.rows else pl.DataFrame(schema=FAULT_SCHEMA)


@dataclass(frozen=True)
class CheckResult:
    """What was proved of a run, and every fault found.

    Attributes
    ----------
    faults
        A fault a row, the columns of `Fault`; at most `MAX_ROWS` of each check. Empty: the run passed.
    n_faults
        Number of faults of each check that failed, those without a row included.
    n_visit, n_exposure, n_path, n_leg, n_pair
        Visits, pointings at which robots were followed, paths of both, legs, and pairs of robots on a path whose separation
        was derived at every instant.
    least_separation_mm
        Least distance between two robots at any instant of any path; inf where no pair was looked at.
    """

    faults: pl.DataFrame
    n_faults: Mapping[str, int]
    n_visit: int
    n_exposure: int
    n_path: int
    n_leg: int
    n_pair: int
    least_separation_mm: float

    @property
    def is_passed(self) -> bool:
        """Whether no fault was found."""
        return not self.n_faults

    def __iter__(self) -> Iterator[Fault]:
        """The kept faults one by one."""
        return (Fault(**row) for row in self.faults.iter_rows(named=True))


def _expression(value: pl.Expr | float | None) -> pl.Expr:
    return value if isinstance(value, pl.Expr) else pl.lit(value)
