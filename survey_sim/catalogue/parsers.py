"""Bytes of a table to its columns: Parquet, CSV, FITS and VOTable, each read as hostile until it is parsed.

A file is read into memory once, so that what was checked is what is parsed. Nothing here opens a second file or an address:
a VOTable may not declare entities nor point to a stream elsewhere, and compressed files grow to a limit and no further.
"""

import csv
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from survey_sim import packed
from survey_sim.errors import InputError, did_you_mean

# Bytes of a table, unpacked; assumed: ten times the largest catalogue of the two surveys.
MAX_TABLE_BYTES = 2 << 30
# gzip, zstd, bzip2, xz, zip: what a parser might unpack by itself, past the limit.
_PACKED = (packed.GZIP_MAGIC, b"\x28\xb5\x2f\xfd", b"BZh", b"\xfd7zXZ", b"PK\x03\x04")
_STREAM = re.compile(rb"<(?:[\w.-]+:)?STREAM\b")
_INLINE_STREAM = re.compile(rb"<(?:[\w.-]+:)?STREAM\s+encoding\s*=\s*(?:\"base64\"|'base64')\s*>")


@dataclass(frozen=True)
class RawTable:
    """Columns as the file has them (null where it has no value), and the units that it states."""

    frame: pl.DataFrame
    units: Mapping[str, str] = field(default_factory=dict)


def read_bytes(path: Path, max_bytes: int = MAX_TABLE_BYTES) -> tuple[bytes, str]:
    """Content of a file, unpacked if its name ends in .gz, and the SHA-256 of the file as it is.

    Raises
    ------
    InputError
        It cannot be read, or is larger than `max_bytes`, packed or unpacked.
    """
    content = packed.read_bytes(path, max_bytes)
    digest = sha256(content).hexdigest()
    if path.suffix.lower() == ".gz":
        content = packed.gunzip(content, path, max_bytes)
    if content.startswith(_PACKED):
        raise InputError("is packed", file=path, remedy="unpack it, or name it .gz if gzip packed it once")
    return content, digest


def parse(content: bytes, format_: str, path: Path, names: Sequence[str], max_bytes: int = MAX_TABLE_BYTES) -> RawTable:
    """The named columns of a table.

    Raises
    ------
    InputError
        The content is not of the format, holds what it may not, or lacks a column.
    """
    try:
        return _PARSERS[format_](content, path, names, max_bytes)
    except InputError:
        raise
    except Exception as failure:  # the formats' libraries raise anything on a damaged file: it is always the file's fault
        text = " ".join(str(failure).split())[:200] or type(failure).__name__
        raise InputError(f"is not a readable {format_} table: {text}", file=path, remedy="make the file again") from None


def _too_large(path: Path, max_bytes: int) -> InputError:
    rule = f"unpacks to more than {max_bytes >> 20} MiB"
    return InputError(rule, file=path, remedy="keep only the rows and columns that the survey needs")


def _check_columns(names: Sequence[str], present: Sequence[str], path: Path) -> None:
    for name in names:
        if name not in present:
            shown = list(present)[:30]
            raise InputError("no such column", file=path, place=name, remedy=did_you_mean(name, shown))
        if list(present).count(name) > 1:
            raise InputError("two columns have this name", file=path, place=name, remedy="rename one of them")


def _parse_parquet(content: bytes, path: Path, names: Sequence[str], max_bytes: int) -> RawTable:
    import pyarrow.parquet as pq  # noqa: PLC0415 - 0.2 s that the command line's help need not pay

    file = pq.ParquetFile(BytesIO(content))
    _check_columns(names, file.schema_arrow.names, path)
    if max(file.metadata.num_rows * 8 * len(names), _parquet_bytes(file.metadata)) > max_bytes:
        raise _too_large(path, max_bytes)
    fields = {name: file.schema_arrow.field(name) for name in names}
    units = {name: text.decode() for name, item in fields.items() if (text := (item.metadata or {}).get(b"unit"))}
    frame = pl.from_arrow(file.read(columns=list(names), use_threads=True))
    assert isinstance(frame, pl.DataFrame)
    return RawTable(frame.select(names), units)


def _parquet_bytes(metadata: Any) -> int:
    return sum(metadata.row_group(group).total_byte_size for group in range(metadata.num_row_groups))


def _parse_csv(content: bytes, path: Path, names: Sequence[str], max_bytes: int) -> RawTable:
    start = 0
    while content.startswith(b"#", start):  # leading comment lines (ECSV); never between the rows, where data may begin so
        start = content.find(b"\n", start) + 1 or len(content)
    body = content[start:].removeprefix(b"\xef\xbb\xbf")
    if not body.strip():
        raise InputError("is empty", file=path, remedy="a CSV table begins with a line of column names")
    header = next(csv.reader([body.split(b"\n", 1)[0].decode("utf-8").rstrip("\r")]))
    _check_columns(names, header, path)
    # As text, so that a cell that is no number is reported with its row.
    frame = pl.read_csv(body, columns=list(names), infer_schema=False)
    return RawTable(frame.select(names))


def _parse_fits(content: bytes, path: Path, names: Sequence[str], max_bytes: int) -> RawTable:
    from astropy.io import fits  # noqa: PLC0415 - 0.3 s that the command line's help need not pay
    from astropy.table import Table  # noqa: PLC0415 - as above

    with _only_warned_of_truncation(), fits.open(BytesIO(content), memmap=False) as units:
        tables = [unit for unit in units[1:] if isinstance(unit, fits.BinTableHDU | fits.TableHDU)]
        if not tables:
            raise InputError("holds no table", file=path, remedy="the first table extension is read")
        _check_columns(names, tables[0].columns.names, path)
        return _from_astropy(Table.read(tables[0]), names)


def _parse_votable(content: bytes, path: Path, names: Sequence[str], max_bytes: int) -> RawTable:
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content or b"\0" in content:
        remedy = "save it as UTF-8 XML without DOCTYPE and ENTITY"
        raise InputError("declares a document type or entities, or is not UTF-8", file=path, remedy=remedy)
    if len(_STREAM.findall(content)) != len(_INLINE_STREAM.findall(content)):
        raise InputError("points to data elsewhere, or packed", file=path, remedy="save it with its data inside (TABLEDATA)")
    from astropy.io.votable import parse as parse_votable  # noqa: PLC0415 - 0.3 s that the command line's help need not pay

    with _only_warned_of_truncation():
        document = parse_votable(BytesIO(content), verify="ignore")
        table = document.get_first_table().to_table(use_names_over_ids=True)
    _check_columns(names, table.colnames, path)
    return _from_astropy(table, names)


@contextmanager
def _only_warned_of_truncation() -> Iterator[None]:
    """Departures from a standard are passed over in silence; a file cut short is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.filterwarnings("error", message=".*truncated")
        yield


def _from_astropy(table: Any, names: Sequence[str]) -> RawTable:
    """Columns of an astropy table; masked values become nulls."""
    columns, units = {}, {}
    for name in names:
        column = table[name]
        values, mask = np.ma.getdata(column), np.ma.getmaskarray(column)
        if values.ndim != 1:
            raise InputError("holds several values a row", place=name, remedy="one number or text a row")
        if values.dtype.kind == "S":
            values = np.char.decode(values, "utf-8")
        if values.dtype.kind in "UO":
            values = values.astype(object)
        elif not values.dtype.isnative:
            values = values.astype(values.dtype.newbyteorder("="))
        series = pl.Series(name, values.tolist() if values.dtype == object else np.ascontiguousarray(values), strict=False)
        columns[name] = series.to_frame().select(pl.when(pl.Series(~mask)).then(pl.col(name))).to_series()
        if getattr(column, "unit", None) is not None:
            units[name] = str(column.unit)
    return RawTable(pl.DataFrame(columns), units)


_PARSERS: Mapping[str, Callable[[bytes, Path, Sequence[str], int], RawTable]] = {
    "parquet": _parse_parquet,
    "csv": _parse_csv,
    "fits": _parse_fits,
    "votable": _parse_votable,
}
