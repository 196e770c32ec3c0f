"""Selection weights of a run: its allocation realised many times, tile by tile, by several processes; what is done is kept.

A realisation draws the sub-priority of every science target anew (`survey_sim.allocation.Realisations`) and allocates each
tile by itself, with the home tiles, robots and settings of the run. Nights and routing have no part in it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from functools import partial
from hashlib import sha256
from pathlib import Path

import numpy as np
import numpy.typing as npt
import polars as pl
from rich.console import Console

from survey_sim import tables
from survey_sim.allocation import FieldTargets, Realisations
from survey_sim.errors import InputError
from survey_sim.imprint import pack_bits
from survey_sim.survey.batches import Batch
from survey_sim.survey.progress import tile_progress
from survey_sim.survey.run import Run, code_digest
from survey_sim.survey.settings import recorded_pipeline
from survey_sim.survey.stages import make_batches
from survey_sim.survey.tile import TileJob, field_of, group_as_planned, magnitude_groups, stream
from survey_sim.survey.workers import Workers

IntArray = npt.NDArray[np.int64]
MOST_REALISATIONS = 4096


def weigh_run(
    run_dir: Path, n_realisation: int, workers: Workers, console: Console, surveys: Sequence[str] = ()
) -> tuple[Path, list[str]]:
    """Write `bitweights.parquet` of a run: parts that were done before are kept.

    Parameters
    ----------
    surveys
        Surveys that are weighed; all by default.

    Returns
    -------
        The table's path, and what the user should know about the weights.
    """
    if not 1 <= n_realisation <= MOST_REALISATIONS:
        raise InputError(f"outside [1, {MOST_REALISATIONS}]", place="--realisations")
    run = open_recorded(run_dir, console)
    chosen = list(surveys) or list(run.settings.surveys)
    unknown = [name for name in chosen if name not in run.settings.surveys]
    if unknown:
        raise InputError(
            f"no such survey: {unknown[0]}", place="--survey", remedy=f"known: {', '.join(run.settings.surveys)}"
        )
    batches = [batch for batch in make_batches(run) if batch.jobs[0].survey in chosen]
    parts = {batch.name: _part(run, batch, n_realisation) for batch in batches}
    wanted = [batch for batch in batches if not parts[batch.name].is_file()]
    n_tile, n_wanted = (sum(len(batch.jobs) for batch in some) for some in (batches, wanted))
    with tile_progress(console, n_tile, n_tile - n_wanted) as advance:
        for name, n_done, content in workers.stream(partial(realise_batch, n_realisation=n_realisation), wanted):
            tables.write_bytes(content, parts[name])
            advance(n_done, 0)
    path = run.folder / "bitweights.parquet"
    words = [pl.Series(dtype=pl.Int64).alias(f"bits_{k}") for k in range(-(-n_realisation // 64))]
    nothing = tables.empty("bitweights").with_columns(*words)
    frames = [pl.read_parquet(parts[name]) for name in sorted(parts)]
    tables.write(pl.concat([nothing, *(frame.select(nothing.columns) for frame in frames)]), "bitweights", path)
    return path, _remarks(run, chosen, is_pooled=any(job.plan is not None for batch in batches for job in batch.jobs))


def realise_batch(batch: Batch, n_realisation: int) -> tuple[str, int, bytes]:
    """Name of a batch, its number of tiles, and their rows of `bitweights` as a Parquet file."""
    rows = pl.concat([realise_tile(job, n_realisation) for job in batch.jobs])
    return batch.name, len(batch.jobs), tables.encode(rows, "bitweights")


def realise_tile(job: TileJob, n_realisation: int) -> pl.DataFrame:
    """Rows of `bitweights` of one tile."""
    field = field_of(job)
    tiles = list(_groups(job, field))
    is_complete = np.zeros((field.n_target, n_realisation), dtype=bool)
    for number in range(n_realisation):
        rng = stream(job.seed, "weights", job.survey, job.tile_id, number)
        n_done = np.zeros(field.n_target, dtype=np.int64)
        for chosen, realisations in tiles:
            n_done[chosen] = realisations.draw(rng, n_done[chosen])
        is_complete[:, number] = n_done >= field.wanted_visits
    science = np.flatnonzero(field.is_science)
    bits = pack_bits(is_complete[science])
    names = np.array([*field.programmes, ""], dtype=object)
    return pl.DataFrame(
        {
            "target_id": field.target_id[science],
            "survey": [job.survey] * len(science),
            "programme": names[field.programme[science]].tolist(),
            "n_realisation": [n_realisation] * len(science),
            "probability_frac": is_complete[science].mean(axis=1),
            **{f"bits_{k}": bits[:, k] for k in range(bits.shape[1])},
        },
        schema_overrides={"survey": pl.String, "programme": pl.String, "n_realisation": pl.Int32},
    )


def open_recorded(run_dir: Path, console: Console) -> Run:
    """A finished run from its record, which holds all constants of the instrument."""
    file = run_dir / "run.json"
    return Run(run_dir, file, recorded_pipeline(tables.read_record(run_dir), file), Workers(), console)


def _part(run: Run, batch: Batch, n_realisation: int) -> Path:
    """Where the rows of a batch are kept: the name says on what they depend."""
    code = code_digest("allocation", "imprint", "survey/weights", "survey/tile")
    digest = sha256(json.dumps([batch.signature, n_realisation, code]).encode()).hexdigest()
    return run.state / "weights" / f"{batch.name}-{digest[:32]}.parquet"


def _groups(job: TileJob, field: FieldTargets) -> Iterator[tuple[IntArray, Realisations]]:
    """Places of the targets of each group of visits, and its realisations: of about as many visits as in a run."""
    nothing = np.zeros(field.n_target, dtype=np.int64)
    for number, (chosen, group) in enumerate(magnitude_groups(field, job.allocation.mag_ranges)):
        settings, targets, is_planned = group_as_planned(job, number, group, field.programme[chosen], nothing[chosen])
        n_planned = 0 if is_planned is None else is_planned.shape[1]
        if settings.max_visits:
            yield chosen, Realisations(targets, job.plate, settings, n_planned)


def _remarks(run: Run, surveys: Sequence[str], *, is_pooled: bool) -> list[str]:
    """Why the weights may not be those of the run itself."""
    remarks = []
    for survey in surveys:
        if not run.settings.allocation.of(survey).sub_priority:
            rule = f"{survey}: the run's own allocation broke ties without chance (allocation.sub_priority = 0)"
            remarks.append(f"{rule}: it is no draw of these realisations; run with 1 for weights of its pairs")
    if is_pooled:
        rule = "home tiles and numbers of visits come from pooling among tiles, which is not realised anew"
        remarks.append(f"{rule}: probabilities are given these; run with tiling.pool = false for whole ones")
    return remarks
