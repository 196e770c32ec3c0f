"""`survey-sim export`: a run's tables, or those of a tile or visit, for TOPCAT and friends."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import polars as pl

from survey_sim import tables
from survey_sim.errors import InputError, did_you_mean
from survey_sim.exchange import votable_bytes
from survey_sim.schema import TABLES, Column

Format = Literal["votable", "fits", "csv"]
FORMATS: tuple[str, ...] = get_args(Format)
_SUFFIX = {"votable": "vot", "fits": "fits", "csv": "csv"}
# VOTables with more rows than this are written in binary: half the size, in less than half the time.
N_TEXT_ROWS_MAX = 20_000
# Larger tables are written as several files (legs_000, legs_001, ...), so that memory is bounded.
N_ROWS_MAX = 2_000_000
_FITS_NULL = -1


def export_run(
    run_dir: Path,
    out: Path,
    form: str,
    *,
    survey: str | None = None,
    tile_id: int | None = None,
    visit_ids: Sequence[int] | None = None,
    only: Sequence[str] | None = None,
) -> list[Path]:
    """Write a file for each table of a run; several for a very large one.

    Parameters
    ----------
    form
        votable (1.4), fits or csv.
    survey, tile_id, visit_ids
        Only rows of these, of the tables that have such rows.
    only
        Tables wanted; all that the run has by default.

    Returns
    -------
        The files.

    Raises
    ------
    InputError
        Unknown format or table; a run without that tile or visit.
    """
    if form not in FORMATS:
        raise InputError(f"unknown format {form!r}", place="--format", remedy=did_you_mean(form, FORMATS))
    unknown = [name for name in only or () if name not in TABLES]
    if unknown:
        raise InputError(f"unknown table {unknown[0]!r}", place="--table", remedy=did_you_mean(unknown[0], TABLES))
    has = [name for name in TABLES if tables.files(run_dir, name)]
    if not has:
        raise InputError("holds no table", file=run_dir, remedy="name the folder of a finished run")
    wanted = [name for name in has if (only is None or name in only) and _has_keys(name, survey, tile_id, visit_ids)]
    missing = [name for name in only or () if name not in wanted]
    if missing:
        rule = "the run has no such table, or it has no rows of one tile or visit"
        raise InputError(rule, file=run_dir, place="--table", rows=missing, remedy=f"it has {', '.join(wanted)}")
    _check_chosen(run_dir, survey, tile_id, visit_ids)
    written = []
    # All are opened before one is written: a damaged table leaves nothing behind.
    for name, table in [(name, tables.scan(run_dir, name)) for name in wanted]:
        rows = _chosen(table, name, survey, tile_id, visit_ids)
        n_row = rows.select(pl.len()).collect().item()
        for number, first in enumerate(range(0, max(n_row, 1), N_ROWS_MAX)):
            stem = name if n_row <= N_ROWS_MAX else f"{name}_{number:03d}"
            path = out / f"{stem}.{_SUFFIX[form]}"
            tables.write_bytes(encode(rows.slice(first, N_ROWS_MAX).collect(), name, form), path)
            written.append(path)
    return written


def encode(frame: pl.DataFrame, table: str, form: str) -> bytes:
    """Rows of a table as the bytes of a file of this format; units, UCDs and descriptions where the format has them."""
    declared = TABLES[table]
    columns = [column for name in frame.columns if (column := declared.column(name)) is not None]
    if form == "csv":
        return tables.csv_bytes(frame)
    if form == "fits":
        return _fits(frame, table, columns)
    serialisation: Literal["tabledata", "binary"] = "tabledata" if len(frame) <= N_TEXT_ROWS_MAX else "binary"
    description = f"One row is {declared.row}."
    return votable_bytes(table, description, [], [(table, description, columns, frame)], serialisation)


def _has_keys(table: str, survey: str | None, tile_id: int | None, visit_ids: Sequence[int] | None) -> bool:
    """Whether a table has rows of one survey, tile, visit, as far as these are asked for."""
    names = TABLES[table].names
    if tile_id is not None and "tile_id" not in names and table != "robots":
        return False
    if visit_ids is not None and "visit_id" not in names and table not in {"robots", "tiles", "targets"}:
        return False
    return survey is None or "survey" in names


def _check_chosen(run_dir: Path, survey: str | None, tile_id: int | None, visit_ids: Sequence[int] | None) -> None:
    if survey is None and tile_id is None and visit_ids is None:
        return
    table = "visits" if tables.files(run_dir, "visits") else "allocations"
    found = _chosen(tables.scan(run_dir, table), table, survey, tile_id, visit_ids)
    if found.head(1).collect().is_empty():
        raise InputError("no visit there", file=run_dir, place="--survey, --tile, --visit", remedy=f"look at {table}")


def _chosen(
    frame: pl.LazyFrame, table: str, survey: str | None, tile_id: int | None, visit_ids: Sequence[int] | None
) -> pl.LazyFrame:
    names = TABLES[table].names
    if survey is not None and "survey" in names:
        frame = frame.filter(pl.col("survey") == survey)
    if tile_id is not None and "tile_id" in names:
        is_here = pl.col("tile_id") == tile_id
        frame = frame.filter(is_here | pl.col("tile_id").is_null() if table == "targets" else is_here)
    if visit_ids is not None and "visit_id" in names:
        frame = frame.filter(pl.col("visit_id").is_in(list(visit_ids)))
    return frame


def _fits(frame: pl.DataFrame, table: str, columns: Sequence[Column]) -> bytes:
    """FITS binary table: units in TUNIT, meanings in TCOMM, nulls of integers as TNULL."""
    from astropy.io import fits  # noqa: PLC0415 - slow to import

    made = []
    for column in columns:
        series = frame[column.name]
        values, code, null = _fits_values(series, column)
        made.append(fits.Column(name=column.name, format=code, unit=column.unit or None, null=null, array=values))
    unit = fits.BinTableHDU.from_columns(made, name=table)
    for number, column in enumerate(columns, start=1):
        unit.header[f"TCOMM{number}"] = column.description
        unit.header[f"TUCD{number}"] = column.ucd
    buffer = BytesIO()
    with warnings.catch_warnings():
        # TCOMM cards are cut at 68 characters, or go on in CONTINUE cards: both are as they should be.
        warnings.simplefilter("ignore", fits.verify.VerifyWarning)
        fits.HDUList([fits.PrimaryHDU(), unit]).writeto(buffer)
    return buffer.getvalue()


def _fits_values(series: pl.Series, column: Column) -> tuple[np.ndarray, str, int | None]:
    """Values, FITS format and null of a column."""
    if column.dtype == pl.String:
        texts = np.array([(text or "").encode("utf-8") for text in series.to_list()] or [b""], dtype=np.bytes_)
        return texts[: len(series)], f"{max(texts.dtype.itemsize, 1)}A", None
    if column.dtype == pl.Boolean:
        return series.fill_null(False).to_numpy(), "L", None
    if column.dtype.is_integer():
        code, kind = ("K", "i8") if column.dtype == pl.Int64 else ("J", "i4") if column.dtype == pl.Int32 else ("I", "i2")
        return series.fill_null(_FITS_NULL).to_numpy().astype(kind), code, _FITS_NULL if column.is_nullable else None
    return series.fill_null(np.nan).to_numpy(), "D", None
