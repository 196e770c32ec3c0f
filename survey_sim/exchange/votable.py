"""VOTable bytes from frames, and frames in our units from any VOTable with the same columns."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import polars as pl

from survey_sim import __version__
from survey_sim.errors import InputError
from survey_sim.exchange.door import Outline, check_xml, read_bytes
from survey_sim.exchange.model import ALIASES, FileModel, TableModel
from survey_sim.schema import Column

if TYPE_CHECKING:
    from astropy.io.votable import tree
    from astropy.table import Table as AstropyTable

Serialisation = Literal["tabledata", "binary", "binary2"]

_DATATYPE = {
    pl.Int8: "short",
    pl.Int16: "short",
    pl.Int32: "int",
    pl.Int64: "long",
    pl.Float64: "double",
    pl.String: "unicodeChar",
    pl.Boolean: "boolean",
}
# Stands for null in integer columns.
_NULL_INTEGER = -1
_SUFFIX = re.compile(r"(_(mm|um|m|cm|deg|rad|arcsec|arcmin|mas|s|ms|min))+$")
_XML_CANNOT_HOLD = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")


@dataclass(frozen=True)
class Document:
    """Contents of one exchange file.

    Attributes
    ----------
    params
        PARAM values by name, in our units; absent ones are not there.
    tables
        A frame for each TABLE of the model; optional columns that were absent are not there.
    file
        Where it was read from.
    """

    model: FileModel
    params: Mapping[str, Any]
    tables: Mapping[str, pl.DataFrame]
    file: Path | None = None

    def table(self, name: str | None = None) -> pl.DataFrame:
        """The frame of a TABLE; by default of the only one."""
        return self.tables[name or self.model.tables[0].name]


@dataclass
class _Reader:
    """One file being read: where faults are, for messages."""

    path: Path
    table: str = ""

    def refuse(self, rule: str, *, column: str = "", rows: Iterable[int] | None = None, remedy: str = "") -> InputError:
        place = ", ".join(part for part in (f"table {self.table}" if self.table else "", column) if part)
        shown = None if rows is None else list(rows)
        return InputError(rule, file=self.path, place=place or None, rows=shown, remedy=remedy or None)


def to_bytes(document: Document, serialisation: Serialisation = "tabledata") -> bytes:
    """The document as VOTable 1.4 bytes."""
    model = document.model
    return votable_bytes(
        model.name,
        model.description,
        [(column, document.params[column.name]) for column in model.params if document.params.get(column.name) is not None],
        [(table.name, f"One row is {table.row}.", table.columns, document.tables[table.name]) for table in model.tables],
        serialisation,
    )


def votable_bytes(
    name: str,
    description: str,
    params: Iterable[tuple[Column, Any]],
    tables: Iterable[tuple[str, str, Iterable[Column], pl.DataFrame]],
    serialisation: Serialisation = "tabledata",
) -> bytes:
    """VOTable 1.4 bytes of any frames.

    Parameters
    ----------
    params
        Declaration and value of each PARAM.
    tables
        Name, description, declared columns and frame of each TABLE; declared columns that a frame lacks are left out.
    """
    from astropy.io.votable import tree  # noqa: PLC0415 - 0.3 s that the command line's help need not pay

    document = tree.VOTableFile(version="1.4")
    resource = tree.Resource()
    resource.description = description
    resource.infos.append(tree.Info(name="file", value=name))
    resource.infos.append(tree.Info(name="creator", value=f"survey-sim {__version__}"))
    document.resources.append(resource)
    for column, value in params:
        resource.params.append(_param(document, column, value))
    for table_name, table_description, columns, frame in tables:
        element = tree.TableElement(document, name=table_name, ID=table_name)
        element.description = table_description
        resource.tables.append(element)
        kept = [column for column in columns if column.name in frame.columns]
        element.fields.extend(_field(document, column) for column in kept)
        element.create_arrays(len(frame))
        for column in kept:
            element.array[column.name], element.array.mask[column.name] = _values(frame[column.name], column)
        for item in element.fields:
            item.ID = None  # else columns of one name in two TABLEs would share an ID, or need other names than their own
    buffer = BytesIO()
    # astropy's C writer of TABLEDATA (8.0.2) writes one byte beyond its buffer, which in time crashes the process: valgrind
    # shows it in tablewriter.c. Its writer in Python is slower, and sound.
    document.to_xml(buffer, tabledata_format=serialisation, _debug_python_based_parser=True)
    return buffer.getvalue()


def read(path: Path, model: FileModel) -> Document:
    """A file of this kind, from us or from elsewhere.

    Columns are found by name, in any order and case, with or without the unit at the end of the name, and brought to our
    units by the file's own.

    Raises
    ------
    InputError
        Not safe, not a VOTable, a TABLE or column absent, a unit of another kind, a number that is none; names file, table,
        column and rows.
    """
    content = read_bytes(path)
    outline = check_xml(content, path)
    document = _parse(content, outline, path)
    reader = _Reader(path)
    params = {param.name: param for param in _params(document)}
    found = {}
    for table in model.tables:
        element = _table(document, table, model, reader)
        reader.table = table.name
        found[table.name] = _frame(element, table, reader)
    reader.table = ""
    values = {}
    for column in model.params:
        param = _named(params, column.name)
        if param is not None:
            values[column.name] = _param_value(param, column, reader)
    return Document(model, values, found, path)


def read_columns(table: AstropyTable, path: Path, model: TableModel) -> pl.DataFrame:
    """Declared columns of an astropy table (of a FITS file, say), by name and unit as in `read`."""
    return _columns({name: (table[name], table[name]) for name in table.colnames}, model, _Reader(path, model.name))


def _parse(content: bytes, outline: Outline, path: Path) -> tree.VOTableFile:
    from astropy.io.votable import parse  # noqa: PLC0415 - slow to import

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return parse(BytesIO(content), verify="ignore", invalid="exception", filename=str(path))
    except Exception as failure:  # the parser raises whatever its converters do
        text = " ".join(str(failure).split())
        position = re.match(r".*?:(\d+):\d+: (?:\w+: )?", text)
        reason = text[position.end() :] if position else text or type(failure).__name__
        rule = f"is not a readable VOTable: {reason}"
        where = None
        if position:
            where = outline.place(int(position[1]))
            rule += f", line {position[1]}"
        raise InputError(rule, file=path, place=where, remedy="write the file again") from None


def _params(document: tree.VOTableFile) -> Iterable[tree.Param]:
    yield from document.params
    stack = list(document.resources)
    while stack:
        resource = stack.pop()
        stack.extend(resource.resources)
        yield from resource.params
        for table in resource.tables:
            yield from table.params


def _table(document: tree.VOTableFile, table: TableModel, model: FileModel, reader: _Reader) -> tree.TableElement:
    """The TABLE by its name or ID; where one is wanted and one is there, that."""
    elements = list(document.iter_tables())
    named = [element for element in elements if table.name in (element.name, element.ID)]
    if not named and len(model.tables) == 1 and len(elements) == 1:
        named = elements
    if not named:
        has = ", ".join(str(element.name or element.ID) for element in elements) or "none"
        raise reader.refuse(f"no TABLE named {table.name!r}", remedy=f"a {model.name} file needs it; this one has: {has}")
    if len(named) > 1:
        raise reader.refuse(f"more than one TABLE named {table.name!r}", remedy="keep one")
    return named[0]


def _named(fields: Mapping[str, Any], name: str) -> Any:
    """The field of this name: as it is, in another case, with another unit at its end or none, or under the paper's name."""
    if name in fields:
        return fields[name]
    lower = {key.lower(): value for key, value in fields.items() if key}
    if name in lower:
        return lower[name]
    for key, value in lower.items():
        if ALIASES.get(key) == name or (_SUFFIX.search(name) and _SUFFIX.sub("", key) == _SUFFIX.sub("", name)):
            return value
    return None


def _frame(element: tree.TableElement, table: TableModel, reader: _Reader) -> pl.DataFrame:
    keys = element.array.dtype.names or ()
    fields = {item.name: (item, element.array[key]) for item, key in zip(element.fields, keys, strict=True)}
    return _columns(fields, table, reader)


def _columns(fields: Mapping[str, tuple[Any, Any]], table: TableModel, reader: _Reader) -> pl.DataFrame:
    """Frame of the declared columns among `fields`: what declares each (name, unit), and its values."""
    columns = {}
    for column in table.columns:
        found = _named(fields, column.name)
        if found is None:
            if column.name in table.optional:
                continue
            remedy = f"has {', '.join(fields)}" if fields else "the table has no columns"
            raise reader.refuse(f"no column {column.name!r}", remedy=remedy)
        columns[column.name] = _series(found[0], found[1], column, reader)
    return pl.DataFrame(columns)


def _series(declared: tree.Field, values: np.ma.MaskedArray, column: Column, reader: _Reader) -> pl.Series:
    is_null = np.broadcast_to(np.ma.getmaskarray(values), values.shape)
    if values.ndim != 1:
        raise reader.refuse("cells hold arrays, not single values", column=column.name)
    data = np.ma.getdata(values)
    if column.dtype == pl.String:
        texts = ["" if null else _as_text(value) for value, null in zip(data.tolist(), is_null.tolist(), strict=True)]
        series = pl.Series(column.name, [text or None for text in texts], dtype=pl.String)
    else:
        series = _numbers(declared, data, is_null, column, reader)
    if not column.is_nullable and series.null_count():
        rows = series.is_null().arg_true().to_list()
        raise reader.refuse("null where a value is needed", column=column.name, rows=rows)
    return series


def _as_text(value: Any) -> str:
    return (value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)).strip()


def _numbers(declared: tree.Field, data: np.ndarray, is_null: np.ndarray, column: Column, reader: _Reader) -> pl.Series:
    if data.dtype.kind not in "iufb":
        raise reader.refuse("holds no numbers", column=column.name)
    if column.dtype.is_integer() and data.dtype.kind in "iu" and not column.unit:
        return (
            pl.Series(column.name, np.where(is_null, 0, data), strict=False).set(pl.Series(is_null), None).cast(column.dtype)
        )
    numbers = np.where(is_null, np.nan, data).astype(np.float64) * _factor(declared, column, reader)
    if np.isinf(numbers).any():
        raise reader.refuse("not a finite number", column=column.name, rows=np.flatnonzero(np.isinf(numbers)).tolist())
    if not column.is_nullable and np.isnan(numbers).any():
        raise reader.refuse("NaN or empty", column=column.name, rows=np.flatnonzero(np.isnan(numbers)).tolist())
    series = pl.Series(column.name, numbers).fill_nan(None)
    if column.dtype.is_integer():
        broken = np.flatnonzero(numbers != np.floor(numbers))
        broken = broken[~np.isnan(numbers[broken])]
        if len(broken):
            raise reader.refuse("not a whole number", column=column.name, rows=broken.tolist())
    return series.cast(column.dtype)


def _factor(declared: tree.Field, column: Column, reader: _Reader) -> float:
    """What brings the file's unit to ours."""
    from astropy import units  # noqa: PLC0415 - slow to import

    given = declared.unit
    if given is None or str(given) == "":
        if column.unit and declared.name.lower() != column.name:
            remedy = f"give the unit ({column.unit}, or one that converts to it)"
            raise reader.refuse("has no unit", column=declared.name, remedy=remedy)
        return 1.0
    wanted = units.Unit(column.unit) if column.unit else units.dimensionless_unscaled
    try:
        return 1.0 if given == wanted else float(given.to(wanted))
    except (units.UnitConversionError, ValueError, TypeError):
        rule = f"unit {str(given)!r} does not convert to {column.unit or 'a plain number'!r}"
        raise reader.refuse(rule, column=declared.name, remedy=f"give {column.name} in {column.unit or 'no unit'}") from None


def _param_value(param: tree.Param, column: Column, reader: _Reader) -> Any:
    place = f"PARAM {param.name}"
    value = param.value
    if column.dtype == pl.String:
        return _as_text(value)
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise reader.refuse("is not a single number", column=place) from None
    if not np.isfinite(number):
        raise reader.refuse("is not a finite number", column=place)
    number *= _factor(param, column, reader)
    return int(number) if column.dtype.is_integer() else number


def _field(document: tree.VOTableFile, column: Column) -> tree.Field:
    from astropy.io.votable import tree  # noqa: PLC0415 - slow to import

    element = tree.Field(document, ID=column.name, **_attributes(column))
    element.description = column.description
    if column.is_nullable and column.dtype.is_integer():
        element.values = tree.Values(document, element, null=_NULL_INTEGER)
    return element


def _param(document: tree.VOTableFile, column: Column, value: Any) -> tree.Param:
    from astropy.io.votable import tree  # noqa: PLC0415 - slow to import

    checked = _holdable(str(value), column.name) if column.dtype == pl.String else value
    element = tree.Param(document, ID=column.name, value=checked, **_attributes(column))
    if column.dtype == pl.String:
        # Astropy escapes a text PARAM twice: by its converter, then as an attribute.
        element.converter.output = lambda text, _: str(text)
    element.description = column.description
    return element


def _attributes(column: Column) -> dict[str, Any]:
    return {
        "name": column.name,
        "datatype": _DATATYPE[type(column.dtype)],
        "arraysize": "*" if column.dtype == pl.String else None,
        "unit": column.unit or None,
        "ucd": column.ucd or None,
    }


def _values(series: pl.Series, column: Column) -> tuple[np.ndarray, np.ndarray]:
    is_null = series.is_null().to_numpy()
    if column.dtype == pl.String:
        texts = [_holdable(text, column.name) for text in series.cast(pl.String).fill_null("").to_list()]
        return np.array(texts, dtype=object), is_null
    if column.dtype.is_integer():
        return series.fill_null(_NULL_INTEGER).cast(column.dtype).to_numpy(), is_null
    if column.dtype == pl.Boolean:
        return series.fill_null(False).to_numpy(), is_null
    return series.cast(pl.Float64).fill_null(np.nan).to_numpy(), is_null


def _holdable(text: str, name: str) -> str:
    if _XML_CANNOT_HOLD.search(text):
        raise InputError(f"{text!r} has a control character, which XML cannot hold", place=name, remedy="rename it")
    return text
