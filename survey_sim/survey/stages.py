"""The stages of a run: tables in, tables out. Each reads what earlier stages wrote, and writes its own."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from io import BytesIO
from itertools import groupby
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import polars as pl

from survey_sim import tables
from survey_sim.allocation import AllocationSettings
from survey_sim.catalogue import load_card, make_targets
from survey_sim.folders import cache_folder, data_folder
from survey_sim.instrument import robots_table
from survey_sim.schema import TABLES
from survey_sim.survey.batches import Batch, BatchResult, run_batches
from survey_sim.survey.nights import WAY_ROOMS, made_tables, schedule_run, way_parameters
from survey_sim.survey.pooling import PLAN, PoolRules, pool_survey
from survey_sim.survey.progress import tile_progress
from survey_sim.survey.rows import TILE_TABLES
from survey_sim.survey.run import Run, code_digest
from survey_sim.survey.tile import TileJob
from survey_sim.tiling import Members, Planned, make_tiles, members

# Rooms whose code each stage runs: a change there makes the stage run again.
STAGE_ROOMS = {
    "targets": ("catalogue", "packed"),
    "tiles": ("tiling",),
    "pool": ("tiling", "allocation", "survey/pooling", "survey/tile"),
    "visits": ("allocation", "routing", "simulation", "survey/exchanges", "survey/rows", "survey/tile"),
    "schedule": ("schedule", "survey/nights", *WAY_ROOMS),
    "report": ("plotting", "player", "survey/report"),
}
# What a programme says that does not change which targets it has.
_NOT_OF_TARGETS = ("exposure_s", "completeness_frac")
# Settings of allocation that pooling goes by: not those that say how robots get to what they are given.
_OF_POOLING = (
    *("wanted_standard", "wanted_sky", "wanted_guide", "min_standard", "min_sky", "min_guide", "min_sky_region"),
    *("sky_regions", "priority_gain", "effort", "min_gain", "mag_ranges"),
)
# Columns of `targets` that a tile needs.
_OF_JOB = ("target_id", "kind", "programme", "ra_deg", "dec_deg", "mag", "priority", "wanted_visits")
# Tables of the schedule that every run has.
NIGHT_TABLES = ("exposures", "nights", "target_status", "completeness", "time_budget")
# Tables of the tile stage that are one row a visit or path, or few: gathered into one file each.
GATHERED = tuple(table for table in TILE_TABLES if not TABLES[table].is_in_parts)


def select_targets(run: Run) -> None:
    """Catalogues -> selected targets (no tile yet) and rejected rows."""
    settings = run.settings
    made = make_targets(
        settings.programme,
        settings.tiling.region,
        settings.run.seed,
        data_folder("catalogues"),
        cache_folder(),
        calibration_reach_deg=2.0 * run.instrument.field_radius_deg,
        mock_seed=run.settings.run.mock_seed,
    )
    tables.write(made.targets, "targets", selected_path(run))
    tables.write(made.rejected, "rejected", run.table("rejected"))
    run.record(catalogues={"counts": made.counts, "sha256": made.checksums}, targets=made.n_target)
    _warn(run, "targets", made.warnings)


def place_tiles(run: Run) -> None:
    """Selected targets -> tile centres, targets with the nearest of them."""
    selected = pl.read_parquet(selected_path(run))
    tiles, targets = make_tiles(selected, run.settings.tiling, run.instrument.field_radius_deg)
    centres, covered = covered_paths(run)
    tables.write(tiles, "tiles", centres)
    tables.write(targets, "targets", covered)
    _warn(run, "tiles", [f"survey {name} has no tile" for name in run.settings.surveys if name not in set(tiles["survey"])])


def pool_tiles(run: Run) -> None:
    """Tile centres, targets -> targets with their home tiles, tiles, plans of the surveys whose visits are pooled."""
    centres, covered = covered_paths(run)
    tiles, targets = pl.read_parquet(centres), pl.read_parquet(covered)
    plans = [pl.DataFrame(schema=PLAN)]
    for survey in run.settings.surveys:
        rules = _pool_rules(run, survey)
        if rules is not None and (tiles["survey"] == survey).any():
            targets, plan = pool_survey(rules, targets, tiles.filter(survey=survey), run.workers)
            plans.append(plan)
    n_home = targets.filter(kind="science").group_by("survey", "tile_id").agg(n_target=pl.len().cast(pl.Int32))
    tiles = (
        tiles.drop("n_target")
        .join(n_home, on=["survey", "tile_id"], how="left")
        .with_columns(pl.col("n_target").fill_null(0))
    )
    tables.write(targets, "targets", run.table("targets"))
    tables.write(tiles, "tiles", run.table("tiles"))
    content = BytesIO()
    pl.concat(plans).write_parquet(content, compression="zstd")
    tables.write_bytes(content.getvalue(), plans_path(run))


def simulate_visits(run: Run) -> None:
    """Tiles -> robots, visits, allocations, paths, legs, robot times; a part for each batch, those whole are kept."""
    robots = pl.concat([robots_table(run.plate, survey) for survey in run.settings.surveys])
    tables.write(robots, "robots", run.table("robots"))
    for table in set(TILE_TABLES).difference(GATHERED):
        run.table(table).mkdir(exist_ok=True)  # a survey without tiles has tables too, without rows
    names = {name: rows.height for _, name, rows in _chunks(run)}
    _drop_stale_parts(run, names)
    n_tile, n_done = sum(names.values()), 0
    with tile_progress(run.console, n_tile) as advance:

        def wanted() -> Iterator[Batch]:
            for batch in make_batches(run):
                if is_whole(run, batch):
                    advance(len(batch.jobs), 0)
                else:
                    yield batch

        for result in run_batches(wanted(), run.workers):
            _keep(run, result)
            advance(result.n_tile, result.n_visit)
            n_done += result.n_tile
    if n_done < n_tile:
        run.console.print(f"  {n_tile - n_done} of {n_tile} tiles were kept from before")
    for table in GATHERED:
        parts = [pl.read_parquet(_part(run, table, name)) for name in sorted(names)]
        tables.write(pl.concat([tables.empty(table), *parts]), table, run.table(table))


def make_batches(run: Run) -> Iterator[Batch]:
    """All tiles in batches, with a digest of all that each batch depends on; one is made when it is asked for."""
    fixed = _digest(parameters(run, "visits"), code_digest(*STAGE_ROOMS["visits"]))
    for survey, chunks in groupby(_chunks(run), key=lambda chunk: chunk[0]):
        sky = _SurveySky.read(run, survey)
        for _, name, rows in chunks:
            jobs = tuple(sky.job(run, tile) for tile in rows.iter_rows(named=True))
            content = [part for job in jobs for part in _content(job)]
            centres = json.dumps([(job.tile_id, job.centre_deg) for job in jobs])
            yield Batch(name, _digest(fixed, centres, *content), jobs)


def _chunks(run: Run) -> Iterator[tuple[str, str, pl.DataFrame]]:
    """Survey, name and tiles of each batch; `place` is a tile's among those of its survey."""
    tiles = tables.read(run.folder, "tiles")
    for survey in run.settings.surveys:
        of_survey = tiles.filter(survey=survey).with_row_index("place")
        for rows in of_survey.iter_slices(run.settings.output.tiles_per_part):
            if rows.height:
                yield survey, f"{survey}-{rows['tile_id'][0]:05d}", rows


def parameters(run: Run, stage: str) -> dict[str, Any]:
    """Settings that a stage uses, as plain values: a change in one makes the stage run again."""
    dump = run.settings.model_dump(mode="json")
    instrument = run.instrument.model_dump(mode="json")
    sections: dict[str, dict[str, Any]] = {
        "targets": {
            "seed": dump["run"]["seed"],
            "mock_seed": dump["run"]["mock_seed"],
            "programme": [{key: p[key] for key in p if key not in _NOT_OF_TARGETS} for p in dump["programme"]],
            "region": dump["tiling"]["region"],
            "field_radius_deg": run.instrument.field_radius_deg,
        },
        "tiles": {"tiling": {**dump["tiling"], "pool": None}, "field_radius_deg": run.instrument.field_radius_deg},
        "pool": {
            "seed": dump["run"]["seed"],
            "pool": dump["tiling"]["pool"],
            "instrument": instrument,
            "dead_robots": run.plate.robot_id[~run.plate.is_live].tolist(),
            "allocation": {
                survey: run.settings.allocation.of(survey).model_dump(mode="json", include={*_OF_POOLING, "visits"})
                for survey in run.settings.surveys
            },
            "wanted": {p.name: p.completeness_frac for p in run.settings.science},
        },
        "visits": {
            "seed": dump["run"]["seed"],
            "instrument": instrument,
            "dead_robots": run.plate.robot_id[~run.plate.is_live].tolist(),
            "allocation": dump["allocation"],
            "routing": dump["routing"],
            "simulation": dump["simulation"],
            "extensions": run.settings.extensions,
            "wanted": {p.name: p.completeness_frac for p in run.settings.science},
            "tiles_per_part": dump["output"]["tiles_per_part"],
        },
        "schedule": {
            "seed": dump["run"]["seed"],
            "schedule": dump["schedule"],
            "programme": [(p.name, p.survey, p.exposure_s, p.completeness_frac) for p in run.settings.science],
            "ways": way_parameters(run),
            "nights_per_part": dump["output"]["nights_per_part"],
        },
        "report": {"report": dump["report"], "name": dump["run"]["name"]},
    }
    return sections[stage]


def make_night_schedule(run: Run) -> None:
    """Visits -> exposures and what the plate did at each, nights, status of every science target."""
    made = schedule_run(run)
    for table, frame in made_tables(run, made).items():
        tables.write(frame, table, run.table(table))
    _warn(run, "schedule", made.warnings)


def scheduled_tables(run: Run) -> tuple[str, ...]:
    """Tables of one file each that the schedule makes."""
    followed = ("exposure_paths",) if run.settings.schedule.configuration_s == "routed" else ()
    return (*NIGHT_TABLES, *followed)


def draw_report(run: Run) -> None:
    """Tables -> figures and the page."""
    from survey_sim.survey.report import make_report  # noqa: PLC0415

    make_report(run.folder, run.workers)


def catalogue_files(run: Run) -> list[Path]:
    """Cards and tables that the run's programmes read; a mock depends on its card alone."""
    names = {programme.catalogue for programme in run.settings.programme if programme.catalogue is not None}
    cards = [load_card(name, data_folder("catalogues")) for name in sorted(names)]
    return sorted({path for card in cards for path in (card.path, card.data) if path is not None})


def report_files() -> list[Path]:
    """Scripts, style sheets and templates of the report."""
    folder = data_folder("reports")
    return sorted(path for path in folder.rglob("*") if path.suffix in {".py", ".mplstyle", ".jinja", ".css"})


def selected_path(run: Run) -> Path:
    """Targets before they have tiles."""
    return run.state / "selected.parquet"


def covered_paths(run: Run) -> tuple[Path, Path]:
    """Tiles, and targets with the nearest of them, before visits are pooled."""
    return run.state / "centres.parquet", run.state / "covered.parquet"


def plans_path(run: Run) -> Path:
    """What each pooled visit shall hold."""
    return run.state / "plans.parquet"


def are_parts_whole(run: Run) -> bool:
    """Whether every part that the manifests name is there, byte for byte."""
    manifests = sorted((run.state / "parts").glob("*.json"))
    return all(_is_whole(run, tables.read_manifest(manifest)) for manifest in manifests)


def is_whole(run: Run, batch: Batch) -> bool:
    """Whether the parts of a batch are there, made from the same input, byte for byte."""
    kept = tables.read_manifest(_manifest(run, batch.name))
    return kept.get("signature") == batch.signature and _is_whole(run, kept)


def _warn(run: Run, stage: str, warnings: Sequence[str]) -> None:
    """Print what the user should know, and keep it in run.json."""
    run.record(warnings={stage: list(warnings)})
    for warning in warnings:
        run.console.print(f"  [yellow]warning:[/yellow] {warning}")


def _content(job: TileJob) -> list[bytes]:
    """What a tile depends on besides its place and the run's settings."""
    plan = [] if job.plan is None else [job.plan.row, job.plan.group, job.plan.visit]
    # Texts in the layout that is the same however the frame was made.
    targets = job.targets.write_ipc(None, compat_level=pl.CompatLevel.oldest()).getvalue()
    return [targets, *(np.ascontiguousarray(column).tobytes() for column in plan)]


@dataclass(frozen=True)
class _SurveySky:
    """Targets of one survey by tiles, as little of them as tiles need.

    Attributes
    ----------
    science, plans
        Science targets, and what is planned of them, by home tile; `first_science`, `first_plan` where each tile's begin.
    supply
        Targets of the other kinds; `shared` has their rows by tiles.
    """

    science: pl.DataFrame
    first_science: npt.NDArray[np.int64]
    plans: pl.DataFrame
    first_plan: npt.NDArray[np.int64]
    supply: pl.DataFrame
    shared: Members

    @classmethod
    def read(cls, run: Run, survey: str) -> Self:
        """Those of a run."""
        tiles = tables.read(run.folder, "tiles").filter(survey=survey)
        known = tables.scan(run.folder, "targets").filter(pl.col("survey") == survey).select("survey", "tile_id", *_OF_JOB)
        is_science = pl.col("kind") == "science"
        science = known.filter(is_science).sort("tile_id", "target_id").collect()
        supply = known.filter(~is_science).collect()
        plans = (
            pl.scan_parquet(plans_path(run))
            .filter(pl.col("survey") == survey)
            .collect()
            .sort("tile_id", maintain_order=True)
        )
        tile_id = tiles["tile_id"].to_numpy()
        ends = np.append(tile_id, tile_id[-1] + 1)
        return cls(
            science.select(_OF_JOB),
            np.searchsorted(science["tile_id"].to_numpy(), ends),
            plans,
            np.searchsorted(plans["tile_id"].to_numpy(), ends),
            supply.select(_OF_JOB),
            members(tiles, supply, run.instrument.field_radius_deg),
        )

    def job(self, run: Run, tile: dict[str, Any]) -> TileJob:
        """All that one tile needs."""
        settings, survey, place = run.settings, tile["survey"], tile["place"]
        science = self.science[self.first_science[place] : self.first_science[place + 1]]
        planned = self.plans[self.first_plan[place] : self.first_plan[place + 1]]
        return TileJob(
            survey=survey,
            tile_id=tile["tile_id"],
            centre_deg=(tile["ra_deg"], tile["dec_deg"]),
            targets=pl.concat([science, self.supply[self.shared.of(place)]]).sort("target_id"),
            wanted_frac={p.name: p.completeness_frac for p in settings.science if p.survey == survey},
            plate=run.plate,
            allocation=settings.allocation.of(survey),
            routing=settings.routing,
            simulation=settings.simulation,
            seed=settings.run.seed,
            plan=_plan(planned) if _is_planned(run, survey) else None,
        )


def _plan(rows: pl.DataFrame) -> Planned:
    return Planned(*(rows[name].to_numpy().astype(np.int64) for name in ("target_id", "group", "visit")))


def _pool_rules(run: Run, survey: str) -> PoolRules | None:
    """How a survey's visits are pooled; None if they are not."""
    settings = run.settings.allocation.of(survey)
    if not run.settings.tiling.pool or settings.visits is not None:
        return None
    return PoolRules(
        survey=survey,
        wanted_frac={p.name: p.completeness_frac for p in run.settings.science if p.survey == survey},
        plate=run.plate,
        allocation=AllocationSettings.load({key: getattr(settings, key) for key in _OF_POOLING}),
        seed=run.settings.run.seed,
    )


def _is_planned(run: Run, survey: str) -> bool:
    """Whether a survey's tiles make the visits that pooling planned."""
    return run.settings.allocation.of(survey).algorithm == "plan" and _pool_rules(run, survey) is not None


def _keep(run: Run, result: BatchResult) -> None:
    """Write the parts of a batch, and last the manifest that says they are whole."""
    for table, content in result.parts.items():
        path = _part(run, table, result.name)
        tables.write_bytes(content, path, aside=path.parent.parent)
    kept = {
        "name": result.name,
        "signature": result.signature,
        "n_visit": result.n_visit,
        "sha256": {table: sha256(content).hexdigest() for table, content in result.parts.items()},
    }
    tables.write_bytes(json.dumps(kept, sort_keys=True).encode(), _manifest(run, result.name))


def _is_whole(run: Run, kept: dict[str, Any]) -> bool:
    if not kept:
        return False
    parts = {table: _part(run, table, kept["name"]) for table in kept["sha256"]}
    return all(path.is_file() and tables.checksum(path) == kept["sha256"][table] for table, path in parts.items())


def _drop_stale_parts(run: Run, names: Iterable[str]) -> None:
    """Remove parts of tiles that the run no longer has."""
    known = set(names)
    stale = {path for table in TILE_TABLES for path in _part(run, table, "any").parent.glob("*.parquet")}
    stale |= set((run.state / "parts").glob("*.json"))
    for path in stale:
        if path.stem not in known:
            path.unlink(missing_ok=True)


def _part(run: Run, table: str, name: str) -> Path:
    folder = run.folder if TABLES[table].is_in_parts else run.state / "parts"
    return folder / table / f"{name}.parquet"


def _manifest(run: Run, name: str) -> Path:
    return run.state / "parts" / f"{name}.json"


def _digest(*parts: Any) -> str:
    digest = sha256()
    for part in parts:
        digest.update(part if isinstance(part, bytes) else json.dumps(part, sort_keys=True).encode())
    return digest.hexdigest()
