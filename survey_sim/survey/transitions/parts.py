"""What the plate did, as tables: a part for each group of nights."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import polars as pl

from survey_sim import tables
from survey_sim.schema import TABLES
from survey_sim.survey.run import Run
from survey_sim.survey.transitions.chains import EXPOSURE_TABLES
from survey_sim.survey.transitions.robots import PlateRobots, read_ways

_IN_PARTS = tuple(table for table in EXPOSURE_TABLES if TABLES[table].is_in_parts)


@dataclass(frozen=True)
class _Part:
    """One part of each table, to be made.

    Attributes
    ----------
    signature
        Digest of the names of its steps and of the number of its first exposure.
    steps
        Files of ways that hold its steps (`Ways.source`): places in the file, and the exposures that they are.
    """

    name: str
    signature: str
    steps: tuple[tuple[bytes | Path, pl.DataFrame], ...]

    def rows(self, table: str) -> pl.DataFrame:
        """Its rows of a table."""
        return pl.concat([tables.empty(table), *(_numbered(read_ways(source, table), some) for source, some in self.steps)])


@dataclass(frozen=True)
class _Made:
    """A part made: its file of each table, and its rows of `exposure_paths`."""

    name: str
    signature: str
    contents: dict[str, bytes]
    paths: pl.DataFrame


def write_parts(run: Run, robots: PlateRobots) -> None:
    """Write `EXPOSURE_TABLES` of the nights that the robots have been through; parts that are as they shall be stay."""
    begins = range(0, len(robots.nights), run.settings.output.nights_per_part)
    names = [f"nights-{begin:05d}" for begin in begins]
    _drop(run, set(names))
    for table in _IN_PARTS:
        run.table(table).mkdir(parents=True, exist_ok=True)
    paths = [tables.empty("exposure_paths")]

    def stale() -> Iterator[_Part]:
        """Parts to be made; what is found on the way goes to `paths`."""
        first = 0
        for begin, name in zip(begins, names, strict=True):
            keys = [key for night in robots.nights[begin : begin + begins.step] for key in night]
            signature = sha256(json.dumps([first, *keys]).encode()).hexdigest()
            places, is_whole = _places(robots, keys, first), _is_whole(run, name, signature)
            is_near = is_whole or run.workers.are_near
            steps = tuple((robots.ways.source(file, is_near=is_near), some) for file, some in places.items())
            part = _Part(name, signature, steps)
            if is_whole:
                paths.append(part.rows("exposure_paths"))
            else:
                yield part
            first += len(keys)

    for made in run.workers.stream(_make, stale()):
        _write(run, made)
        paths.append(made.paths)
    tables.write(pl.concat(paths), "exposure_paths", run.table("exposure_paths"))
    robots.ways.prune({key for night in robots.nights for key in night})


def drop_parts(run: Run) -> None:
    """Remove `EXPOSURE_TABLES`, of a schedule in which robots are not followed."""
    _drop(run, set())
    run.table("exposure_paths").unlink(missing_ok=True)


def are_parts_whole(run: Run) -> bool:
    """Whether every part that the manifests name is there, byte for byte."""
    return all(_is_whole(run, manifest.stem) for manifest in sorted(_manifests(run)))


def _places(robots: PlateRobots, keys: list[str], first: int) -> dict[str, pl.DataFrame]:
    """Places of steps in files of ways, and the exposures that they are, counted from `first`; by file."""
    by_file: dict[str, list[tuple[int, int]]] = {}
    for number, key in enumerate(keys):
        step = robots.ways.steps[key]
        by_file.setdefault(step.file, []).append((step.place, first + number))
    schema = {"exposure_id": pl.Int32, "own": pl.Int32}
    return {file: pl.DataFrame(places, schema=schema, orient="row") for file, places in by_file.items()}


def _numbered(rows: pl.DataFrame, places: pl.DataFrame) -> pl.DataFrame:
    """Rows of the steps at some places of a file, by the exposures that they are."""
    found = rows.join(places, on="exposure_id", how="inner")
    return found.with_columns(exposure_id="own").drop("own")


def _make(part: _Part) -> _Made:
    """Make a part: work for another process."""
    contents = {table: tables.encode(part.rows(table), table) for table in _IN_PARTS}
    return _Made(part.name, part.signature, contents, part.rows("exposure_paths"))


def _write(run: Run, made: _Made) -> None:
    """Write a part of each table, and last the manifest that says they are whole."""
    for table, content in made.contents.items():
        tables.write_bytes(content, run.table(table) / f"{made.name}.parquet", aside=run.folder)
    checksums = {table: sha256(content).hexdigest() for table, content in made.contents.items()}
    kept = {"name": made.name, "signature": made.signature, "sha256": checksums}
    tables.write_bytes(json.dumps(kept, sort_keys=True).encode(), run.state / "nights" / f"{made.name}.json")


def _is_whole(run: Run, name: str, signature: str | None = None) -> bool:
    """Whether a part is there, byte for byte, made of the same steps."""
    kept = tables.read_manifest(run.state / "nights" / f"{name}.json")
    if not kept:
        return False
    parts = {run.table(table) / f"{name}.parquet": checksum for table, checksum in kept["sha256"].items()}
    is_same = signature is None or kept["signature"] == signature
    return is_same and all(path.is_file() and tables.checksum(path) == checksum for path, checksum in parts.items())


def _manifests(run: Run) -> Iterator[Path]:
    return (run.state / "nights").glob("*.json")


def _drop(run: Run, names: set[str]) -> None:
    """Remove all parts but those named."""
    for table in _IN_PARTS:
        for path in run.table(table).glob("*.parquet"):
            if path.stem not in names:
                path.unlink()
    for path in _manifests(run):
        if path.stem not in names:
            path.unlink()
