"""Targets of one field from a file that a person has: VOTable, FITS, CSV or Parquet."""

from __future__ import annotations

import csv
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from survey_sim.allocation import FieldTargets
from survey_sim.errors import InputError
from survey_sim.exchange import CATALOGUE, N_BYTES_MAX, AllocatedVisit, RoutedVisit, read, read_columns
from survey_sim.geometry import plate_to_sky, sky_to_plate
from survey_sim.instrument import Plate
from survey_sim.region import healpix_29
from survey_sim.schema import TABLES, TARGET_KINDS

SURVEY = "field"
CATALOGUE_FILE = "catalogue.xml"
# Where a field whose place on the sky nobody gave is put.
NOWHERE_DEG = (0.0, 0.0)
# Half the sky, from the field's centre.
SKY_RADIUS_DEG = 180.0
_SUFFIXES = {".xml": "votable", ".vot": "votable", ".votable": "votable", ".gz": "votable"}
_SUFFIXES |= {".fits": "fits", ".fit": "fits", ".csv": "csv", ".parquet": "parquet"}


def read_targets(path: Path, plate: Plate, centre_deg: tuple[float, float] | None) -> pl.DataFrame:
    """Targets of one field, as rows of `targets` with their plate positions.

    Parameters
    ----------
    path
        Needs `target_id`, and `x_mm`, `y_mm` or (with a centre) `ra_deg`, `dec_deg`; may have `kind` (science by default),
        `priority` (9), `wanted_visits` (1), `mag`, `source_id`. VOTable and FITS columns are converted by their own units.
    centre_deg
        Right ascension and declination of the field centre; sky positions are then those that count.

    Returns
    -------
        Columns of `targets` but tile-less ones, `x_mm` and `y_mm`; sorted as `targets` is.

    Raises
    ------
    InputError
        With the file, and column, rule and rows of what is wrong.
    """
    return _checked(_read(path), path, plate, centre_deg)


def targets_of_files(
    visits: Sequence[AllocatedVisit] | Sequence[RoutedVisit],
) -> tuple[pl.DataFrame, tuple[float, float] | None]:
    """As `read_targets`, of the catalogue beside the visits' files, or else of the targets that they hold; and the centre.

    Raises
    ------
    InputError
        A visit holds a target that the catalogue does not have, or has as another kind.
    """
    first = visits[0]
    beside = None if first.file is None else first.file.parent / CATALOGUE_FILE
    if beside is None or not beside.is_file():
        held = [visit.held.with_columns(x_mm=visit.goal_mm[:, 0], y_mm=visit.goal_mm[:, 1]) for visit in visits]
        frame = pl.concat(held).drop_nulls("target_id").unique("target_id", keep="first").sort("target_id")
        centre_deg = centre_of(first.params)
        return _checked(frame, Path("allocation"), first.plate, centre_deg, is_by_sky=False), centre_deg
    catalogue = read(beside, CATALOGUE)
    frame, centre_deg = catalogue.table(), centre_of(catalogue.params)
    has_plate = {"x_mm", "y_mm"} <= set(frame.columns)
    targets = _checked(frame, beside, first.plate, centre_deg, is_by_sky=not has_plate)
    _check_held(visits, targets)
    return targets, centre_deg


def centre_of(params: Mapping[str, Any]) -> tuple[float, float] | None:
    """The field centre that a file gives, if it does."""
    names = ("centre_ra_deg", "centre_dec_deg")
    return (params[names[0]], params[names[1]]) if all(name in params for name in names) else None


def field_targets(targets: pl.DataFrame) -> FieldTargets:
    """What the allocator takes."""
    return FieldTargets.from_table(targets.drop("programme"))


def targets_table(targets: pl.DataFrame) -> pl.DataFrame:
    """Rows of the run's `targets`."""
    return targets.select(TABLES["targets"].names)


def _check_held(visits: Sequence[AllocatedVisit] | Sequence[RoutedVisit], targets: pl.DataFrame) -> None:
    """Refuse visits that hold targets which the catalogue does not have, or has as another kind."""
    known = targets.select("target_id", own_kind="kind")
    for visit in visits:
        held = visit.held.with_row_index("row").drop_nulls("target_id")
        held = held.join(known, on="target_id", how="left", maintain_order="left")
        odd = held.filter(pl.col("own_kind").is_null() | (pl.col("own_kind") != pl.col("kind")))
        if len(odd):
            rule = "targets are not in the catalogue beside the file, or are of another kind there"
            raise InputError(rule, file=visit.file, place="target_id", rows=odd["target_id"].to_list())


def _checked(
    frame: pl.DataFrame, path: Path, plate: Plate, centre_deg: tuple[float, float] | None, *, is_by_sky: bool = True
) -> pl.DataFrame:
    if "kind" in frame.columns:
        frame = frame.with_columns(pl.col("kind").cast(pl.String).fill_null("science"))
    frame = _placed(frame, path, plate, centre_deg if is_by_sky else None)
    far_mm = SKY_RADIUS_DEG * 3600.0 / plate.instrument.plate_scale_arcsec_mm
    far = np.hypot(*frame.select("x_mm", "y_mm").cast(pl.Float64, strict=False).to_numpy().T) > far_mm
    if far.any():
        raise InputError(
            "further from the plate than the sky reaches",
            file=path,
            place="x_mm, y_mm",
            rows=np.flatnonzero(far).tolist(),
            remedy="give them in mm, or with their unit",
        )
    try:
        checked = FieldTargets.from_table(frame)
    except InputError as fault:
        raise fault.of_file(path) from None
    return _as_targets(frame, checked, plate, centre_deg or NOWHERE_DEG)


def _read(path: Path) -> pl.DataFrame:
    form = _SUFFIXES.get(path.suffix.lower())
    if form is None:
        raise InputError("is of no known kind", file=path, remedy=f"name it {', '.join(sorted(_SUFFIXES))}")
    if not path.is_file():
        raise InputError("no such file", file=path, remedy="check the path")
    if form == "votable":
        return read(path, CATALOGUE).table()
    try:
        if form == "fits":
            return _read_fits(path)
        frame = _read_csv(path) if form == "csv" else _read_parquet(path)
    except InputError:
        raise
    except Exception as failure:  # the formats' libraries raise anything on a damaged file: it is always the file's fault
        text = " ".join(str(failure).split())[:200] or type(failure).__name__
        raise InputError(f"is not readable {form.upper()}: {text}", file=path, remedy="write the file again") from None
    known = [column.name for column in CATALOGUE.tables[0].columns if column.name in frame.columns]
    if "target_id" not in known:
        raise InputError("no column 'target_id'", file=path, remedy=f"has {', '.join(frame.columns)}")
    return _typed(frame.select(known), path)


def _read_csv(path: Path) -> pl.DataFrame:
    with path.open(newline="", encoding="utf-8") as file:
        names = next(csv.reader(file), [])
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError("two columns have this name", file=path, place=twice[0], remedy="rename one of them")
    return pl.read_csv(path, infer_schema_length=None)


def _read_parquet(path: Path) -> pl.DataFrame:
    import pyarrow.parquet as pq  # noqa: PLC0415 - slow to import; and, unlike polars, sound on damaged files

    with pq.ParquetFile(path) as file:
        about = file.metadata
        n_bytes = sum(about.row_group(group).total_byte_size for group in range(about.num_row_groups))
        if max(n_bytes, about.num_rows * about.num_columns) > N_BYTES_MAX:
            rule = f"unpacks to more than {N_BYTES_MAX >> 20} MiB"
            raise InputError(rule, file=path, remedy="keep only the targets of one field, and the columns that are read")
        frame = pl.from_arrow(file.read())
    assert isinstance(frame, pl.DataFrame)
    return frame


def _typed(frame: pl.DataFrame, path: Path) -> pl.DataFrame:
    """Numbers where numbers are meant."""
    for column in CATALOGUE.tables[0].columns:
        if column.name not in frame.columns or column.name == "kind":
            continue
        given = frame[column.name]
        typed = given.cast(column.dtype, strict=False)
        broken = typed.is_null() & given.is_not_null()
        if given.dtype.is_float() and column.dtype.is_integer():
            broken |= (given != given.floor()).fill_null(False)
        if broken.any():
            kind = "whole number" if column.dtype.is_integer() else "number"
            raise InputError(f"not a {kind}", file=path, place=column.name, rows=broken.arg_true().to_list())
        if typed.dtype.is_float():
            infinite = typed.is_infinite().fill_null(False)
            if infinite.any():
                raise InputError("not a finite number", file=path, place=column.name, rows=infinite.arg_true().to_list())
            typed = typed.fill_nan(None)
        frame = frame.with_columns(typed)
    return frame


def _read_fits(path: Path) -> pl.DataFrame:
    from astropy.table import Table  # noqa: PLC0415 - slow to import

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.filterwarnings("error", message=".*truncated")
        table = Table.read(path, hdu=1, format="fits")
    return read_columns(table, path, CATALOGUE.tables[0])


def _placed(frame: pl.DataFrame, path: Path, plate: Plate, centre_deg: tuple[float, float] | None) -> pl.DataFrame:
    """The frame with plate positions."""
    has_sky = {"ra_deg", "dec_deg"} <= set(frame.columns)
    if has_sky and centre_deg is not None:
        for name, least, most in (("ra_deg", 0.0, 360.0), ("dec_deg", -90.0, 90.0)):
            bad = ~frame[name].is_between(least, most).fill_null(False)
            if bad.any():
                rule = f"outside [{least:g}, {most:g}] or empty"
                raise InputError(rule, file=path, place=name, rows=bad.arg_true().to_list())
        scale = plate.instrument.plate_scale_arcsec_mm
        position = sky_to_plate(frame["ra_deg"].to_numpy(), frame["dec_deg"].to_numpy(), centre_deg, scale)
        return frame.with_columns(x_mm=position[:, 0], y_mm=position[:, 1])
    if not {"x_mm", "y_mm"} <= set(frame.columns):
        remedy = "give --centre RA,DEC" if has_sky else "give x_mm, y_mm; or ra_deg, dec_deg with --centre RA,DEC"
        raise InputError("no plate positions", file=path, remedy=remedy)
    return frame


def _as_targets(frame: pl.DataFrame, checked: FieldTargets, plate: Plate, centre_deg: tuple[float, float]) -> pl.DataFrame:
    order = np.argsort(frame["target_id"].to_numpy(), kind="stable")
    position = np.column_stack([checked.x_mm, checked.y_mm])
    if {"ra_deg", "dec_deg"} <= set(frame.columns) and not frame.select("ra_deg", "dec_deg").null_count().sum_horizontal()[
        0
    ]:
        ra, dec = (frame[name].to_numpy()[order] for name in ("ra_deg", "dec_deg"))
    else:
        ra, dec = plate_to_sky(position, centre_deg, plate.instrument.plate_scale_arcsec_mm).T
    kinds = np.array(TARGET_KINDS, dtype=object)[checked.kind]
    is_science = checked.is_science
    source = frame["source_id"].cast(pl.String).gather(order) if "source_id" in frame.columns else None
    made = pl.DataFrame(
        {
            "target_id": checked.target_id,
            "survey": [SURVEY] * checked.n_target,
            "programme": [SURVEY if is_own else None for is_own in is_science],
            "kind": kinds.tolist(),
            "source_id": source if source is not None else pl.Series(checked.target_id).cast(pl.String),
            "ra_deg": ra,
            "dec_deg": dec,
            "mag": checked.mag,
            "priority": checked.priority,
            "wanted_visits": np.where(is_science, checked.wanted_visits, 0),
            "tile_id": np.where(is_science, 0.0, np.nan),
            "_healpix_29": healpix_29(ra, dec),
            "x_mm": checked.x_mm,
            "y_mm": checked.y_mm,
        },
        schema_overrides={"programme": pl.String},
    )
    blank = pl.col("source_id").fill_null(pl.col("target_id").cast(pl.String))
    made = made.with_columns(pl.col("mag").fill_nan(None), pl.col("tile_id").fill_nan(None).cast(pl.Int32), source_id=blank)
    return made.sort("_healpix_29", "target_id")
