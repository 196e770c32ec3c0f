"""Batches of tiles: the unit of work and of storage.

A batch's tables are one part each, made by a worker and written by who asked for it, so that workers need no shared disk.
The result does not depend on who did it, nor in which order.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain, islice

from survey_sim import tables
from survey_sim.survey.tile import TileJob, simulate_tile, simulate_tiles
from survey_sim.survey.workers import Workers


@dataclass(frozen=True)
class Batch:
    """Tiles of one part, and a digest of all that they depend on."""

    name: str
    signature: str
    jobs: tuple[TileJob, ...]


@dataclass(frozen=True)
class BatchResult:
    """The parts of a batch: Parquet bytes by table."""

    name: str
    signature: str
    parts: dict[str, bytes]
    n_tile: int
    n_visit: int


def run_batch(batch: Batch) -> BatchResult:
    """Do all tiles of a batch."""
    frames = simulate_tiles(batch.jobs)
    parts = {table: tables.encode(frame, table) for table, frame in frames.items()}
    return BatchResult(batch.name, batch.signature, parts, len(batch.jobs), len(frames["visits"]))


def run_batches(batches: Iterable[Batch], workers: Workers) -> Iterator[BatchResult]:
    """Results of batches as they come."""
    batches = iter(batches)
    first = list(islice(batches, 1))
    if workers.are_elsewhere and first:
        _compile_kernels(first[0].jobs[0])
    yield from workers.stream(run_batch, chain(first, batches))


def _compile_kernels(job: TileJob) -> None:
    """Fill the kernels' cache on disk once, so that workers read it rather than all compile the same: a small tile does."""
    one_visit = job.allocation.model_copy(update={"visits": 1})
    simulate_tile(replace(job, targets=job.targets.head(100), allocation=one_visit, plan=None))
