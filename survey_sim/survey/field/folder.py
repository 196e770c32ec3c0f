"""The folder of a single-field run: tables, exchange files, run.json; written when all of them are known."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import polars as pl

from survey_sim import __version__, tables
from survey_sim.errors import InputError
from survey_sim.exchange import CATALOGUE, Document, plate_documents, to_bytes
from survey_sim.instrument import Plate, robots_table
from survey_sim.schema import SCHEMA_VERSION, TABLES
from survey_sim.survey.field.targets import CATALOGUE_FILE, NOWHERE_DEG, SURVEY, targets_table

XML = "xml"
# The way home from the last visit, so that any order of visits has a way to park.
STOW_FILE = "stow.xml"
# Why run.json of a single field is told from that of a pipeline.
KIND = "field"
# What a command writes beside the tables; a backup file of where the robots stopped is kept.
_OWN_FILE = re.compile(
    r"(allocation|router|positions)_\d+\.xml|(system_parameters|starbugs|catalogue|stow)\.xml|(paths|robot_times)\.csv"
)


def file_name(model: str, visit_id: int) -> str:
    """Name of a visit's exchange file: `allocation_0003.xml`."""
    return f"{model}_{visit_id:04d}.xml"


def find_files(sources: Sequence[Path], model: str) -> list[Path]:
    """The exchange files of one kind: those named, or those of the run folder named.

    Raises
    ------
    InputError
        The folder holds none, or one is not there.
    """
    if len(sources) == 1 and sources[0].is_dir():
        found = sorted((sources[0] / XML).glob(f"{model}_*.xml"))
        if not found:
            rule = f"holds no {XML}/{model}_*.xml"
            raise InputError(rule, file=sources[0], remedy="name the folder of a single-field run, or the files")
        return found
    for path in sources:
        if not path.is_file():
            raise InputError("no such file", file=path, remedy="name one run folder, or exchange files")
    return list(sources)


def check_out(out: Path) -> None:
    """Refuse to write a single field over anything else."""
    if not out.exists():
        return
    if not out.is_dir():
        raise InputError("is a file, not a folder", file=out, remedy="choose another --out")
    record = out / "run.json"
    is_field = record.is_file() and f'"kind": "{KIND}"' in record.read_text(encoding="utf-8", errors="replace")
    if any(out.iterdir()) and not is_field:
        raise InputError("holds other things than a single field", file=out, remedy="choose another --out")


def write_folder(
    out: Path,
    plate: Plate,
    frames: Mapping[str, pl.DataFrame],
    files: Mapping[str, bytes],
    record: Mapping[str, Any],
) -> None:
    """Write a run's tables, other files (by their path in the folder) and run.json; what an earlier run left there goes.

    Parameters
    ----------
    frames
        Rows of each table, already of the schema.
    """
    encoded = {table_path(out, name): tables.encode(frame, name) for name, frame in frames.items()}
    encoded |= {out / place: content for place, content in files.items()}
    tables.clean_up(out)
    # Until all is written, run.json gives no instrument, and no command takes the folder for a run.
    _write_record(out, {})
    for path, content in encoded.items():
        tables.write_bytes(content, path, aside=out)
    _remove_others(out, encoded.keys())
    _write_record(out, {"instrument": plate.instrument.model_dump(mode="json"), **record})


def table_path(out: Path, table: str) -> Path:
    """File of a table of a single field."""
    return out / (f"{table}/{SURVEY}-00000.parquet" if TABLES[table].is_in_parts else f"{table}.parquet")


def common_tables(plate: Plate, targets: pl.DataFrame, centre_deg: tuple[float, float] | None) -> dict[str, pl.DataFrame]:
    """robots, targets and tiles of one field."""
    ra, dec = centre_deg or NOWHERE_DEG
    n_target = targets.filter(kind="science").height
    tile = {"survey": SURVEY, "tile_id": 0, "ra_deg": ra, "dec_deg": dec, "n_target": n_target}
    frames = {"robots": robots_table(plate, SURVEY), "targets": targets_table(targets), "tiles": pl.DataFrame([tile])}
    return {name: tables.conform(frame, name) for name, frame in frames.items()}


def common_files(plate: Plate, targets: pl.DataFrame, centre_deg: tuple[float, float] | None) -> dict[str, bytes]:
    """The exchange files of the instrument and of the catalogue."""
    system, starbugs = plate_documents(plate)
    columns = [column.name for column in CATALOGUE.tables[0].columns]
    params = {"survey": SURVEY, "tile_id": 0, **centre_params(centre_deg)}
    catalogue = Document(CATALOGUE, {**system.params, **params}, {"targets": targets.select(columns)})
    named = {"system_parameters.xml": system, "starbugs.xml": starbugs, CATALOGUE_FILE: catalogue}
    return {f"{XML}/{name}": to_bytes(document) for name, document in named.items()}


def centre_params(centre_deg: tuple[float, float] | None) -> dict[str, float]:
    """PARAMs of the field centre, if it is known."""
    return {} if centre_deg is None else {"centre_ra_deg": centre_deg[0], "centre_dec_deg": centre_deg[1]}


def _write_record(out: Path, entries: Mapping[str, Any]) -> None:
    about = {"package": "survey-sim", "version": __version__, "schema_version": SCHEMA_VERSION}
    whole = {**about, "kind": KIND, "name": out.name, **entries}
    tables.write_bytes((json.dumps(whole, indent=2, sort_keys=True) + "\n").encode(), out / "run.json")


def _remove_others(out: Path, kept: Collection[Path]) -> None:
    """Remove tables and exchange files of an earlier single-field run."""
    old = [path for name in TABLES for path in tables.files(out, name)]
    old += [path for path in [*out.glob("*.csv"), *(out / XML).glob("*.xml")] if _OWN_FILE.fullmatch(path.name)]
    for path in old:
        if path not in kept:
            path.unlink()
