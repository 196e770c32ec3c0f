"""Batches of tiles, done in this process, by workers of this machine, or by a cluster.

A batch is the unit of work and of storage: its tables are one part each, made in a worker and written here, so that
workers need no shared disk. The result does not depend on who did it, nor in which order.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import polars as pl

from survey_sim import tables
from survey_sim.errors import InputError
from survey_sim.survey.rows import TILE_TABLES
from survey_sim.survey.tile import TileJob, simulate_tile

if TYPE_CHECKING:
    from distributed import Client

# Batches handed out ahead of what is written, for each worker: enough to keep them busy, few enough to bound memory.
AHEAD = 2


@dataclass(frozen=True)
class Workers:
    """Who does the batches: this process (n = 0), n processes on this machine, or a dask scheduler."""

    n: int = 0
    scheduler: str | None = None


@dataclass(frozen=True)
class Batch:
    """Tiles of one part, and a digest of all that they depend on."""

    name: str
    signature: str
    jobs: tuple[TileJob, ...]


@dataclass(frozen=True)
class BatchResult:
    """The parts of a batch: Parquet bytes by table; who made them, and in how much CPU time."""

    name: str
    signature: str
    parts: dict[str, bytes]
    n_tile: int
    n_visit: int
    cpu_s: float
    process: tuple[str, int]

    @property
    def is_elsewhere(self) -> bool:
        """Whether another process made it, whose CPU time is not counted in this one's."""
        return self.process != _this_process()


def run_batch(batch: Batch) -> BatchResult:
    """Do all tiles of a batch."""
    begun = time.process_time()
    done = [simulate_tile(job) for job in batch.jobs]
    frames = {table: pl.concat([tile[table] for tile in done]) for table in TILE_TABLES}
    parts = {table: tables.encode(frame, table) for table, frame in frames.items()}
    cpu_s = time.process_time() - begun
    return BatchResult(batch.name, batch.signature, parts, len(batch.jobs), len(frames["visits"]), cpu_s, _this_process())


def _this_process() -> tuple[str, int]:
    return platform.node(), os.getpid()


def run_batches(batches: Sequence[Batch], workers: Workers) -> Iterator[BatchResult]:
    """Results of batches as they come.

    Raises
    ------
    InputError
        The scheduler cannot be reached, or has gone away; results given before are whole.
    """
    if workers.scheduler is None and (workers.n == 0 or len(batches) <= 1):
        yield from map(run_batch, batches)
        return
    _quiet_dask()
    _compile_kernels(batches[0].jobs[0])
    with _client(workers, len(batches)) as client:
        yield from _stream_results(client, batches)


def _compile_kernels(job: TileJob) -> None:
    """Fill the kernels' cache on disk once, so that workers read it rather than all compile the same: a small tile does."""
    one_visit = job.allocation.model_copy(update={"visits": 1})
    simulate_tile(replace(job, targets=job.targets.head(100), allocation=one_visit))


def _stream_results(client: Client, batches: Sequence[Batch]) -> Iterator[BatchResult]:
    """Keep a bounded number of batches in flight."""
    from distributed import as_completed  # noqa: PLC0415
    from distributed.client import FutureCancelledError  # noqa: PLC0415

    waiting = iter(batches)
    n_ahead = AHEAD * max(1, len(client.scheduler_info()["workers"]))
    futures = as_completed()
    for _ in range(n_ahead):
        _submit_next(client, futures, waiting)
    for future in futures:
        try:
            result = future.result()
        except FutureCancelledError:
            raise InputError(
                "the scheduler has gone away", place="--scheduler", remedy="run again: finished tiles are kept"
            ) from None
        future.release()
        _submit_next(client, futures, waiting)
        yield result


def _submit_next(client: Client, futures: object, waiting: Iterator[Batch]) -> None:
    batch = next(waiting, None)
    if batch is not None:
        futures.add(client.submit(run_batch, batch, pure=False, retries=2))  # type: ignore[attr-defined]


@contextmanager
def _client(workers: Workers, n_batch: int) -> Iterator[Client]:
    from distributed import Client, LocalCluster  # noqa: PLC0415

    if workers.scheduler is not None:
        try:
            client = Client(workers.scheduler, timeout=10)
        except (OSError, TimeoutError, ValueError) as failure:
            rule = f"no dask scheduler at {workers.scheduler}: {failure}"
            raise InputError(rule, place="--scheduler", remedy="start one with `dask scheduler`, or use --workers") from None
        with client:
            yield client
        return
    cluster = LocalCluster(
        n_workers=min(workers.n, n_batch),
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address=None,
        memory_limit=0,
    )
    try:
        with Client(cluster) as client:
            yield client
    finally:
        with suppress(TimeoutError):
            cluster.close(timeout=5)


def _quiet_dask() -> None:
    """Library settings that keep the terminal ours and the workers small."""
    import logging  # noqa: PLC0415

    import dask  # noqa: PLC0415

    # A worker that kernels keep busy is no fault; libraries of a worker shall not start threads of their own.
    dask.config.set({"distributed.worker.daemon": True, "distributed.admin.tick.limit": "1h"})
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "POLARS_MAX_THREADS"):
        os.environ.setdefault(name, "1")
    for name in ("distributed", "distributed.worker", "distributed.nanny", "distributed.scheduler", "distributed.core"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
