"""Tables on disk: Parquet through the schema, with units, each file whole or absent.

A run's folder holds `T.parquet` for most tables, and `T/<part>.parquet` for the large ones (allocations, legs, robot_times,
exposure_allocations, exposure_legs). Files are written to a temporary folder beside them, flushed, and renamed, so that no
reader sees half a file.
"""

import json
import os
from contextlib import suppress
from functools import cache
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

from survey_sim.errors import InputError
from survey_sim.schema import SCHEMA_VERSION, Column, Table
from survey_sim.study_schema import ALL_TABLES

# IVOA note "VOParquet" 1.0: the keys under which a file holds its data-less VOTable.
_VOPARQUET_VERSION = b"IVOA.VOTable-Parquet.version"
_VOPARQUET_CONTENT = b"IVOA.VOTable-Parquet.content"
_SCHEMA_VERSION = b"survey_sim.schema_version"
_ROW_GROUP = 262_144
# Entries of run.json that hold entries of their own.
_SECTIONS = ("settings", "instrument", "stages", "scenario")
TEMPORARY = ".tmp"
# What begins a formula in a spreadsheet; not the sign of a name such as +20 1234, which is no formula alone.
_FORMULA = r"^(?:[=@\t\r]|[+-].*[=(|!@+*/])"

_VOTABLE_TYPE = {
    pl.Int8: "short",
    pl.Int16: "short",
    pl.Int32: "int",
    pl.Int64: "long",
    pl.Float64: "double",
    pl.String: "unicodeChar",
    pl.Boolean: "boolean",
}


def empty(table: str) -> pl.DataFrame:
    """A table with its columns and no row."""
    return pl.DataFrame(schema={column.name: column.dtype for column in ALL_TABLES[table].columns})


def conform(frame: pl.DataFrame, table: str) -> pl.DataFrame:
    """The frame with the declared columns first, in order and type, and its rows sorted.

    Raises
    ------
    InputError
        A declared column is absent, an undeclared one present, a value does not fit its type, a null stands where none may,
        or two rows share a key: always a fault of the stage that made the frame.
    """
    declared = ALL_TABLES[table]
    columns = [_declared(frame, declared, name) for name in declared.names]
    extra = [name for name in frame.columns if name not in declared.names]
    columns += [_declared(frame, declared, name) for name in sorted(extra)]
    try:
        typed = frame.select(pl.col(column.name).cast(column.dtype) for column in columns)
    except pl.exceptions.InvalidOperationError as failure:
        raise InputError(f"a value does not fit its column: {failure}", place=table) from None
    for column in columns:
        if not column.is_nullable and typed[column.name].null_count():
            rows = typed[column.name].is_null().arg_true().to_list()
            raise InputError("null where none may be", place=f"{table}.{column.name}", rows=rows)
    repeated = typed.select(declared.key).is_duplicated()
    if repeated.any():
        raise InputError(f"rows share the key {declared.key}", place=table, rows=repeated.arg_true().to_list())
    return typed.sort(declared.order)


def encode(frame: pl.DataFrame, table: str) -> bytes:
    """A table's Parquet file, as bytes: the same rows give the same bytes."""
    typed = conform(frame, table)
    data = typed.to_arrow(compat_level=pl.CompatLevel.oldest())
    data = pa.table(data.columns, schema=_arrow_schema(table, tuple(typed.columns), _text_lengths(typed)))
    buffer = BytesIO()
    # Hardly a float comes twice: a dictionary of them would make files a quarter larger, and writing them twice as long.
    in_dictionary = [name for name, dtype in typed.schema.items() if not dtype.is_float()]
    pq.write_table(data, buffer, compression="zstd", row_group_size=_ROW_GROUP, use_dictionary=in_dictionary)
    return buffer.getvalue()


def write(frame: pl.DataFrame, table: str, path: Path) -> None:
    """Write a table's file (or part), whole or not at all."""
    write_bytes(encode(frame, table), path)


def write_bytes(content: bytes, path: Path, aside: Path | None = None) -> None:
    """Write a file whole or not at all: into a hidden temporary file, flushed, then renamed.

    Parameters
    ----------
    aside
        Folder of the temporary file, on the same disk; the file's own by default. Parts of a table give the folder above,
        so that who scans the table never sees a file that is not a part.

    Raises
    ------
    InputError
        The disk is full or the place cannot be written; nothing is left behind.
    """
    temporary = (aside or path.parent) / f".{path.name}.{os.getpid()}{TEMPORARY}"
    make_folder(path.parent)
    try:
        with temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as failure:
        raise unwritable(path, failure) from None
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_plain(frame: pl.DataFrame, path: Path) -> bytes:
    """Write a table that the schema does not know (a study's, a mock catalogue) as Parquet; gives the file's bytes."""
    buffer = BytesIO()
    frame.write_parquet(buffer, compression="zstd")
    write_bytes(buffer.getvalue(), path)
    return buffer.getvalue()


def csv_bytes(frame: pl.DataFrame) -> bytes:
    """Rows as CSV. Text that a spreadsheet would take for a formula gets an apostrophe before it, so that it stays text."""
    text = [name for name, dtype in frame.schema.items() if dtype == pl.String]
    is_formula = {name: pl.col(name).str.contains(_FORMULA) for name in text}
    return (
        frame.with_columns(
            pl.when(is_formula[name]).then(pl.concat_str(pl.lit("'"), name)).otherwise(name).alias(name) for name in text
        )
        .write_csv()
        .encode()
    )


def make_folder(folder: Path) -> None:
    """Make a folder, and those above it; InputError if the place cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as failure:
        raise unwritable(folder, failure) from None


def unwritable(path: Path, failure: Exception) -> InputError:
    """The error of a file that the disk, or its rights, refuse."""
    rule = f"cannot be written: {getattr(failure, 'strerror', None) or failure}"
    return InputError(rule, file=path, remedy="free space or choose another --out; what is done is kept")


def clean_up(folder: Path) -> None:
    """Remove temporary files that a killed process left in a run's folder."""
    for place in ("", ".state/**/", "report/**/"):
        for stray in folder.glob(f"{place}.*{TEMPORARY}"):
            stray.unlink(missing_ok=True)


def files(run_dir: Path, table: str) -> list[Path]:
    """The files of a run's table, in order of their names; empty if the run has none."""
    if ALL_TABLES[table].is_in_parts:
        return sorted((run_dir / table).glob("*.parquet"))
    single = run_dir / f"{table}.parquet"
    return [single] if single.is_file() else []


def scan(run_dir: Path, table: str) -> pl.LazyFrame:
    """A run's table, read lazily through the schema.

    Raises
    ------
    InputError
        The run has no such table, a file is not readable, is of another schema version, or a declared column is absent.
    """
    found = files(run_dir, table)
    if not found and ALL_TABLES[table].is_in_parts and (run_dir / table).is_dir():
        return empty(table).lazy()
    if not found:
        where = run_dir / (f"{table}/" if ALL_TABLES[table].is_in_parts else f"{table}.parquet")
        raise InputError("no such table", file=where, remedy="name the folder of a finished run")
    for path in found:
        _check_file(path, ALL_TABLES[table])
    return pl.scan_parquet(found, glob=False)


def read(run_dir: Path, table: str) -> pl.DataFrame:
    """A run's whole table; see `scan`."""
    return scan(run_dir, table).collect()


def read_record(folder: Path) -> dict[str, Any]:
    """A run's run.json.

    Raises
    ------
    InputError
        It is not there, is not JSON, or not of the form of a record.
    """
    path = folder / "run.json"
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError("no such file", file=path, remedy="name the folder of a run") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as failure:
        raise InputError(f"is not JSON: {failure}", file=path, remedy="run the pipeline again") from None
    if not isinstance(record, dict) or not all(isinstance(record.get(name, {}), dict) for name in _SECTIONS):
        raise InputError("is not the record of a run", file=path, remedy="run the pipeline again")
    return record


def read_manifest(path: Path) -> dict[str, Any]:
    """What is said of a part (name, signature, SHA-256 by table); one that is absent or damaged says nothing."""
    try:
        kept = json.loads(path.read_bytes())
    except (FileNotFoundError, ValueError):
        return {}
    return kept if isinstance(kept, dict) and kept.keys() >= {"name", "signature", "sha256"} else {}


def checksum(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        digest = sha256()
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def _text_lengths(frame: pl.DataFrame) -> tuple[tuple[str, int], ...]:
    """Bytes of the longest string of each text column; astropy needs them to size its arrays."""
    longest = frame.select(pl.col(pl.String).str.len_bytes().max())
    return tuple((name, max(longest[name].item() or 1, 1)) for name in longest.columns)


def _declared(frame: pl.DataFrame, table: Table, name: str) -> Column:
    column = table.column(name)
    if column is None:
        raise InputError("column is not declared in the schema", place=f"{table.name}.{name}")
    if name not in frame.columns:
        raise InputError("column is absent", place=f"{table.name}.{name}")
    return column


def _check_file(path: Path, table: Table) -> None:
    try:
        schema = pq.read_schema(path)
    except (pa.ArrowInvalid, OSError) as failure:
        raise InputError(f"is not a readable Parquet file: {failure}", file=path, remedy="run again to remake it") from None
    version = (schema.metadata or {}).get(_SCHEMA_VERSION, b"none").decode()
    if version != str(SCHEMA_VERSION):
        rule = f"schema version {version}, this package reads {SCHEMA_VERSION}"
        raise InputError(
            rule, file=path, remedy="run the pipeline again with this version, or read it with the one it names"
        )
    absent = [name for name in table.names if name not in schema.names]
    if absent:
        raise InputError(f"columns absent: {', '.join(absent)}", file=path, remedy="run the pipeline again")


@cache
def _arrow_schema(table: str, names: tuple[str, ...], text_lengths: tuple[tuple[str, int], ...]) -> pa.Schema:
    """Arrow schema of a file, its metadata included."""
    declared = ALL_TABLES[table]
    columns = [column for name in names if (column := declared.column(name)) is not None]
    types = pl.DataFrame(schema={c.name: c.dtype for c in columns}).to_arrow(compat_level=pl.CompatLevel.oldest()).schema
    fields = [
        pa.field(c.name, types.field(c.name).type, metadata={"unit": c.unit, "ucd": c.ucd, "description": c.description})
        for c in columns
    ]
    metadata = {
        _SCHEMA_VERSION: str(SCHEMA_VERSION).encode(),
        _VOPARQUET_VERSION: b"1.0",
        _VOPARQUET_CONTENT: _votable_header(declared, columns, dict(text_lengths)),
    }
    metadata |= {f"table::len::{name}".encode(): str(length).encode() for name, length in text_lengths}
    return pa.schema(fields, metadata=metadata)


def _votable_header(table: Table, columns: list[Column], text_lengths: dict[str, int]) -> bytes:
    """Data-less VOTable that gives the columns' units, UCDs and descriptions."""
    from astropy.io.votable import tree  # noqa: PLC0415 - 0.3 s that the command line's help need not pay

    document = tree.VOTableFile(version="1.4")
    resource = tree.Resource()
    document.resources.append(resource)
    element = tree.TableElement(document, name=table.name)
    element.description = f"One row is {table.row}."
    resource.tables.append(element)
    for column in columns:
        length = text_lengths.get(column.name)
        field = tree.Field(
            document,
            name=column.name,
            ID=column.name,
            datatype=_VOTABLE_TYPE[type(column.dtype)],
            arraysize=str(length) if length else None,
            unit=column.unit or None,
            ucd=column.ucd or None,
        )
        field.description = column.description
        element.fields.append(field)
    buffer = BytesIO()
    document.to_xml(buffer)
    return buffer.getvalue()
