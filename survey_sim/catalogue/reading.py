"""One loader for all catalogues: a card in, rows in our own columns and units out, and the rows that cannot be used."""

from dataclasses import dataclass
from pathlib import Path

import polars as pl

from survey_sim.catalogue.cards import Card, ColumnMap
from survey_sim.catalogue.mock import cached_mock
from survey_sim.catalogue.parsers import MAX_TABLE_BYTES, RawTable, parse, read_bytes
from survey_sim.errors import InputError

REJECTED = {
    "catalogue": pl.String(),
    "source_id": pl.String(),
    "ra_deg": pl.Float64(),
    "dec_deg": pl.Float64(),
    "mag": pl.Float64(),
    "reason": pl.String(),
    "other_source_id": pl.String(),
}
# Rules of the coordinates, deg: what they must be within.
_LIMITS_DEG = {"ra_deg": (0.0, 360.0), "dec_deg": (-90.0, 90.0)}


@dataclass(frozen=True)
class Catalogue:
    """A catalogue as read.

    Attributes
    ----------
    rows
        source_id, ra_deg in [0, 360), dec_deg (ICRS), mag (null if the catalogue has none), and `priority` and `programme`
        where the card maps them.
    rejected
        Columns of `REJECTED`: the rows that cannot be used, each with its reason.
    sha256
        Of the file that was read.
    """

    card: Card
    rows: pl.DataFrame
    rejected: pl.DataFrame
    path: Path
    sha256: str


def read_catalogue(
    card: Card, cache_dir: Path, max_bytes: int = MAX_TABLE_BYTES, *, mock_seed: int | None = None
) -> Catalogue:
    """Rows of a catalogue; a mock is made first if the cache lacks it, with `mock_seed` instead of its card's if given.

    A row without a magnitude is rejected. One whose coordinates are not numbers on the sky, whose identifier is missing, or
    was used before, is an error, or rejected too if the card says `on_bad_row = "reject"`. Of the rows that share an
    identifier the brightest stays.

    Raises
    ------
    InputError
        Missing or damaged file, wrong checksum, column or unit, or a bad row.
    """
    if card.data is not None:
        path, made = card.data, None
    else:
        assert card.settings.recipe is not None
        recipe = card.settings.recipe
        if mock_seed is not None:
            recipe = recipe.model_copy(update={"seed": mock_seed})
        path, made = cached_mock(recipe, card.name, cache_dir)
    content, found = read_bytes(path, max_bytes)
    wanted = made or card.settings.sha256
    if wanted is not None and wanted != found:
        rule = f"the file's SHA-256 is {found}, the card {card.path} says {wanted}"
        raise InputError(rule, file=path, remedy="get the file of the card again, or put the new checksum into the card")
    raw = parse(content, card.format, path, card.settings.columns.names, max_bytes)
    rows = _in_our_columns(card, raw, path)
    rows, rejected = _take_out_bad_rows(card, rows, path)
    return Catalogue(card, rows, rejected, path, found)


def _in_our_columns(card: Card, raw: RawTable, path: Path) -> pl.DataFrame:
    columns = card.settings.columns
    series = [
        _text(raw.frame.select(columns.id_names), path).alias("source_id"),
        _angle(raw, columns.ra, path).alias("ra_deg"),
        _angle(raw, columns.dec, path).alias("dec_deg"),
    ]
    if columns.mag is not None:
        factor = _factor(columns.mag, "mag", raw, path)
        series.append((_number(raw.frame[columns.mag.name], path) * factor).alias("mag"))
    if columns.priority is not None:
        series.append(_priority(_number(raw.frame[columns.priority], path), path))
    if columns.programme is not None:
        series.append(_text(raw.frame.select(columns.programme), path).alias("programme"))
    frame = pl.DataFrame(series)
    if columns.mag is None:
        frame = frame.with_columns(mag=pl.lit(None, dtype=pl.Float64))
    return frame.with_columns(pl.col("ra_deg", "dec_deg", "mag").fill_nan(None))


def _angle(raw: RawTable, column: ColumnMap, path: Path) -> pl.Series:
    return _number(raw.frame[column.name], path) * _factor(column, "deg", raw, path)


def _factor(column: ColumnMap, ours: str, raw: RawTable, path: Path) -> float:
    """What turns a column's numbers into our unit; the unit that the file states, if any, must be the card's."""
    if column.unit == ours and raw.units.get(column.name, ours) == ours:
        return 1.0
    from astropy import units  # noqa: PLC0415 - 0.3 s that the command line's help need not pay

    wanted = units.Unit(ours)
    try:
        factor = float(units.Unit(column.unit).to(wanted))
    except (ValueError, TypeError, units.UnitConversionError) as failure:
        rule = f"cannot be turned into {ours}: {' '.join(str(failure).split())[:200]}"
        raise InputError(rule, file=path, place=f"columns, {column.name}, unit {column.unit!r}") from None
    stated = units.Unit(raw.units.get(column.name, column.unit), parse_strict="silent")
    if stated.is_equivalent(wanted) and abs(stated.to(wanted) / factor - 1.0) > 1e-9:
        rule = f"the card says {column.unit}, the file {stated}"
        raise InputError(rule, file=path, place=column.name, remedy="put the file's unit into the card")
    return factor


def _number(values: pl.Series, path: Path) -> pl.Series:
    """Values as floats; text must be numbers (blank: null)."""
    if values.dtype == pl.String:
        text = values.str.strip_chars()
        number = text.cast(pl.Float64, strict=False)
        bad = (number.is_null() & text.is_not_null() & (text != "")).arg_true().to_list()
        if bad:
            example = str(values[bad[0]])[:40]
            raise InputError(
                f"not a number ({example!r})", file=path, place=values.name, rows=bad, remedy="decimal numbers only"
            )
        return number
    if not (values.dtype.is_numeric() or values.dtype == pl.Null):
        raise InputError(f"holds {values.dtype}, not numbers", file=path, place=values.name, remedy="map another column")
    return values.cast(pl.Float64)


def _text(frame: pl.DataFrame, path: Path) -> pl.Series:
    """Values as text, several columns joined by "-"; null where one is missing or all is blank."""
    for values in frame:
        if not (values.dtype in (pl.String, pl.Null) or values.dtype.is_integer()):
            raise InputError(f"holds {values.dtype}, not text or whole numbers", file=path, place=values.name)
    joined = frame.select(pl.concat_str(pl.all().cast(pl.String).str.strip_chars(), separator="-")).to_series()
    return joined.set(joined == "", None)


def _priority(values: pl.Series, path: Path) -> pl.Series:
    bad = (~values.fill_nan(None).is_in([float(value) for value in range(1, 10)])).fill_null(True).arg_true().to_list()
    if bad:
        raise InputError("not a whole number from 1 to 9", file=path, place=values.name, rows=bad, remedy="1 is low, 9 high")
    return values.cast(pl.Int8).alias("priority")


def _take_out_bad_rows(card: Card, rows: pl.DataFrame, path: Path) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Usable rows, and the others as rows of `REJECTED`."""
    bad = _bad_coordinate(rows) | rows["source_id"].is_null()
    if bad.any() or rows["source_id"].is_duplicated().any():
        if card.settings.on_bad_row == "error":
            _raise_for_bad_rows(card, rows, path)
        rows, rejected = _reject(card, rows, bad)
    else:
        rejected = pl.DataFrame(schema=REJECTED)
    if card.settings.columns.mag is not None:
        dark = ~rows["mag"].is_finite().fill_null(False)
        rejected = pl.concat([rejected, as_rejected(rows.filter(dark), card.name, "no-magnitude")])
        rows = rows.filter(~dark)
    return rows.with_columns(pl.when(pl.col("ra_deg") < 360.0).then(pl.col("ra_deg")).otherwise(0.0)), rejected


def _bad_coordinate(rows: pl.DataFrame) -> pl.Series:
    within = [pl.col(name).is_between(*limits).fill_null(False) for name, limits in _LIMITS_DEG.items()]
    return rows.select(~pl.all_horizontal(within)).to_series()


def _raise_for_bad_rows(card: Card, rows: pl.DataFrame, path: Path) -> None:
    columns = card.settings.columns
    remedy = 'mend the rows, or go on without them by `on_bad_row = "reject"` in the card'
    for name, column in (("ra_deg", columns.ra), ("dec_deg", columns.dec)):
        low, high = _LIMITS_DEG[name]
        bad = (~rows[name].is_between(low, high).fill_null(False)).arg_true().to_list()
        if bad:
            rule = f"not a number in [{low:g}, {high:g}] deg"
            raise InputError(rule, file=path, place=column.name, rows=bad, remedy=remedy)
    place = "-".join(columns.id_names)
    missing = rows["source_id"].is_null().arg_true().to_list()
    if missing:
        raise InputError("has no identifier", file=path, place=place, rows=missing, remedy=remedy)
    repeated = rows["source_id"].is_duplicated().arg_true().to_list()
    raise InputError("identifier used more than once", file=path, place=place, rows=repeated, remedy=remedy)


def _reject(card: Card, rows: pl.DataFrame, bad: pl.Series) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Rows with a place and an identifier of their own, and the others, named so that no two rejected rows share a name."""
    numbered = rows.with_row_index("row")
    nameless = pl.format("row {}", "row")
    lost = numbered.filter(bad).with_columns(
        reason=pl.when(pl.col("source_id").is_null()).then(pl.lit("no-identifier")).otherwise(pl.lit("bad-coordinate")),
        source_id=pl.when(pl.col("source_id").is_null() | pl.col("source_id").is_duplicated())
        .then(pl.concat_str(pl.col("source_id").fill_null(""), nameless, separator=" ").str.strip_chars())
        .otherwise("source_id"),
    )
    usable = numbered.filter(~bad)
    is_shared = usable["source_id"].is_duplicated()
    # The brightest of one identifier stays; by position where they are equally bright, so that the file's order has no say.
    place = pl.int_range(pl.len()).over("source_id", order_by=["mag", "ra_deg", "dec_deg"])
    shared = usable.filter(is_shared).with_columns(place=place)
    double = shared.filter(pl.col("place") > 0).with_columns(source_id=pl.format("{}#{}", "source_id", pl.col("place") + 1))
    rejected = pl.concat(
        [as_rejected(lost.filter(reason=reason), card.name, reason) for reason in ("no-identifier", "bad-coordinate")]
        + [as_rejected(double, card.name, "duplicate-identifier")]
    )
    kept = [usable.filter(~is_shared), shared.filter(pl.col("place") == 0).drop("place")]
    return pl.concat(kept).select(rows.columns), rejected


def as_rejected(rows: pl.DataFrame, catalogue: str, reason: str) -> pl.DataFrame:
    """Rows in the columns of `REJECTED`; what is no finite number becomes null."""
    finite = [pl.when(pl.col(name).is_finite()).then(pl.col(name)).alias(name) for name in ("ra_deg", "dec_deg", "mag")]
    other = pl.col("other_source_id") if "other_source_id" in rows.columns else pl.lit(None, dtype=pl.String)
    return rows.with_columns(*finite, catalogue=pl.lit(catalogue), reason=pl.lit(reason), other_source_id=other).select(
        *REJECTED
    )
