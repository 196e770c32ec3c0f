"""`survey-sim view`: the field player of a run, of router files, or of several side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl

from survey_sim import tables
from survey_sim.errors import InputError
from survey_sim.exchange import RoutedVisit, read_router
from survey_sim.geometry import sky_to_plate
from survey_sim.instrument import Plate, load_instrument, make_plate
from survey_sim.player import PlayerRun, make_page
from survey_sim.survey.field.rows import plate_of_run, visits_of_run
from survey_sim.survey.field.targets import targets_of_files

_TARGET_COLUMNS = ("target_id", "kind", "priority", "mag", "x_mm", "y_mm")


def view_field(
    sources: Sequence[Path],
    out: Path | None = None,
    *,
    survey: str | None = None,
    tile_id: int | None = None,
    visit_ids: Sequence[int] | None = None,
    instrument: str | Path | None = None,
) -> Path:
    """Write the player's page.

    Parameters
    ----------
    sources
        Run folders and router files. Each folder is a run; so are the files of one folder together. Several runs are played
        side by side.
    out
        By default `view.html` in the first folder, or beside the first file under its name.
    survey, tile_id, visit_ids
        What to show of run folders; by default all visits of the tile in which most targets are reached.

    Returns
    -------
        The page's path.
    """
    page = view_page(sources, survey=survey, tile_id=tile_id, visit_ids=visit_ids, instrument=instrument)
    first = sources[0]
    out = out or (first / "view.html" if first.is_dir() else first.with_suffix(".html"))
    tables.write_bytes(page.encode(), out)
    return out


def view_page(
    sources: Sequence[Path],
    *,
    survey: str | None = None,
    tile_id: int | None = None,
    visit_ids: Sequence[int] | None = None,
    instrument: str | Path | None = None,
) -> str:
    """The player's page as text; see `view_field`."""
    runs = []
    given = None if instrument is None else make_plate(load_instrument(instrument))
    for folder in (path for path in sources if path.is_dir()):
        runs.append(_run_of_tables(folder, survey, tile_id, visit_ids))
    by_folder: dict[Path, list[Path]] = {}
    for path in (path for path in sources if not path.is_dir()):
        by_folder.setdefault(path.parent, []).append(path)
    runs += [_run_of_files(paths, given) for paths in by_folder.values()]
    if not runs:
        raise InputError("nothing to show", place="view", remedy="name a run folder or router files")
    _check_comparable(runs)
    first = runs[0].visits[0].params
    title = f"{first.get('survey', 'field')}, tile {first.get('tile_id', 0)}"
    return make_page(runs, title)


def _run_of_tables(run_dir: Path, survey: str | None, tile_id: int | None, visit_ids: Sequence[int] | None) -> PlayerRun:
    survey, tile_id = choose_tile(run_dir, survey, tile_id)
    visits = visits_of_run(run_dir, survey, tile_id, visit_ids)
    targets = tile_targets(run_dir, plate_of_run(run_dir, survey), survey, tile_id)
    return PlayerRun(_name(visits[0], run_dir.name), visits, targets)


def _run_of_files(paths: Sequence[Path], given: Plate | None) -> PlayerRun:
    visits = [read_router(path, given) for path in paths]
    targets, _ = targets_of_files(visits)
    parent = paths[0].resolve().parent
    return PlayerRun(_name(visits[0], parent.parent.name if parent.name == "xml" else parent.name), visits, targets)


def choose_tile(run_dir: Path, survey: str | None, tile_id: int | None) -> tuple[str, int]:
    """The tile asked for, or the one in which most science targets are reached."""
    visits = tables.scan(run_dir, "visits")
    if survey is not None:
        visits = visits.filter(survey=survey)
    if tile_id is not None:
        visits = visits.filter(tile_id=tile_id)
    science = visits.group_by("survey", "tile_id").agg(pl.col("n_science").sum())
    best = science.sort("n_science", "survey", "tile_id", descending=[True, False, False]).collect()
    if best.is_empty():
        raise InputError("has no visit there", file=run_dir, place="--survey, --tile", remedy="visits.parquet lists them")
    return best["survey"][0], best["tile_id"][0]


def tile_targets(run_dir: Path, plate: Plate, survey: str, tile_id: int) -> pl.DataFrame:
    """Targets on the plate of a tile: its own, and those that any tile may use."""
    tile = tables.scan(run_dir, "tiles").filter(survey=survey, tile_id=tile_id).collect().row(0, named=True)
    is_here = (pl.col("tile_id") == tile_id) | pl.col("tile_id").is_null()
    # Nothing further in declination alone can be on the plate: few are left to project.
    is_near = (pl.col("dec_deg") - tile["dec_deg"]).abs() <= 1.01 * plate.instrument.field_radius_deg
    targets = tables.scan(run_dir, "targets").filter(is_here, is_near, survey=survey).collect()
    ra, dec = (targets[name].to_numpy() for name in ("ra_deg", "dec_deg"))
    position = sky_to_plate(ra, dec, (tile["ra_deg"], tile["dec_deg"]), plate.instrument.plate_scale_arcsec_mm)
    is_on_plate = np.hypot(*position.T) <= plate.instrument.plate_radius_mm
    placed = targets.with_columns(x_mm=position[:, 0], y_mm=position[:, 1]).filter(is_on_plate)
    return placed.select(_TARGET_COLUMNS)


def _name(visit: RoutedVisit, folder: str) -> str:
    router = visit.params.get("router")
    return f"{folder} ({router})" if router else folder


def _check_comparable(runs: Sequence[PlayerRun]) -> None:
    n_robots = {visit.plate.n_robot for run in runs for visit in run.visits}
    if len(n_robots) > 1:
        rule = f"runs of instruments with {sorted(n_robots)} robots cannot be played side by side"
        raise InputError(rule, place="view", remedy="give runs of one instrument")
