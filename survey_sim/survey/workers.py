"""Workers: this process, other processes on this machine, or a dask cluster. They are started when first needed.

What a stage gives them are functions of plain values, so that the result depends neither on who did the work nor on when.
"""

from __future__ import annotations

import logging
import os
import platform
import resource
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from survey_sim import interrupts
from survey_sim.errors import InputError

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

# Tasks handed out ahead of what is taken back, for each worker: enough to keep them busy, few enough to bound memory.
AHEAD = 2

# What a worker frees it keeps for its next arrays (glibc's malloc; thresholds in bytes). As dask sets it, pages go back to
# the system at once and are asked for again by every path, which takes one part in twenty of its time.
_KEPT_MEMORY = {"MALLOC_TRIM_THRESHOLD_": 1 << 28, "MALLOC_MMAP_THRESHOLD_": 1 << 25}

Task = TypeVar("Task")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Spent:
    """What a task took: CPU seconds, and the process's largest memory so far, MiB."""

    process: tuple[str, int]
    cpu_s: float
    memory_mib: float


@dataclass
class Workers:
    """Who does the work: this process (n = 0), n processes on this machine, or those of a dask scheduler."""

    n: int = 0
    scheduler: str | None = None
    # Of other processes: CPU seconds so far, and the largest memory of each, MiB.
    cpu_s: float = 0.0
    memory_mib: dict[tuple[str, int], float] = field(default_factory=dict)
    _client: Client | None = field(default=None, repr=False)
    _cluster: LocalCluster | None = field(default=None, repr=False)

    @property
    def are_elsewhere(self) -> bool:
        """Whether there are processes besides this one."""
        return self.n > 0 or not self.are_near

    @property
    def are_near(self) -> bool:
        """Whether all are on this machine, and may read the run's files."""
        return self.scheduler is None

    def begin(self, function: Callable[[Any], Any]) -> None:
        """Start processes on this machine, and have them load the module of a function that they will be given.

        They do so while this process goes on.
        """
        if self.n > 0 and self.are_near:
            from distributed import fire_and_forget  # noqa: PLC0415

            client = self._open()
            for address in client.scheduler_info()["workers"]:
                fire_and_forget(client.submit(_load, function, workers=[address], pure=False))

    def stream(self, function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """Results of the tasks as they come; a bounded number is under way, and no other is made.

        Other processes begin at once, this one when it is asked for a result.

        Raises
        ------
        InputError
            The scheduler cannot be reached, or has gone away; results given before are whole.
        """
        waiting = iter(tasks)
        first = list(islice(waiting, 2))
        waiting = chain(first, waiting)
        if not self.are_elsewhere or (self.are_near and len(first) <= 1):
            return _stream_here(function, waiting)
        from distributed import as_completed  # noqa: PLC0415

        client = self._open()
        futures: Any = as_completed()

        def submit_next() -> None:
            for task in waiting:
                futures.add(client.submit(_measured, function, task, pure=False, retries=2))
                return

        for _ in range(AHEAD * max(1, len(client.scheduler_info()["workers"]))):
            submit_next()
        return self._stream_from(futures, submit_next)

    def _stream_from(self, futures: Any, submit_next: Callable[[], None]) -> Iterator[Any]:
        """Results of futures as they are done; for each another task is submitted."""
        from distributed.client import FutureCancelledError  # noqa: PLC0415
        from distributed.comm import CommClosedError  # noqa: PLC0415

        for future in futures:
            interrupts.stop_if_asked()
            try:
                result, spent = future.result()
            except (FutureCancelledError, CommClosedError):
                raise InputError(
                    "the scheduler has gone away", place="--scheduler", remedy="run again: what is finished is kept"
                ) from None
            future.release()
            self.cpu_s += spent.cpu_s
            self.memory_mib[spent.process] = max(spent.memory_mib, self.memory_mib.get(spent.process, 0.0))
            submit_next()
            yield result

    def close(self) -> None:
        """End the processes that were started, or leave the cluster."""
        if self._client is not None:
            with suppress(TimeoutError):
                self._client.close()
        if self._cluster is not None:
            with suppress(TimeoutError):
                self._cluster.close(timeout=5)
        self._client = self._cluster = None

    def _open(self) -> Client:
        if self._client is None:
            _quiet_dask()
            self._client = self._start() if self.are_near else self._join()
        return self._client

    def _join(self) -> Client:
        from distributed import Client  # noqa: PLC0415

        try:
            return Client(self.scheduler, timeout=10)
        except (OSError, TimeoutError, ValueError) as failure:
            rule = f"no dask scheduler at {self.scheduler}: {failure}"
            raise InputError(rule, place="--scheduler", remedy="start one with `dask scheduler`, or use --workers") from None

    def _start(self) -> Client:
        from distributed import Client, LocalCluster  # noqa: PLC0415

        with deaf_to_interrupt():
            self._cluster = LocalCluster(
                n_workers=self.n,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address=None,
                memory_limit=0,
            )
        return Client(self._cluster)


def memory_mib() -> float:
    """Largest memory of this process so far, MiB.

    By `getrusage` a process begins with the largest memory of the one that started it, so Linux is asked otherwise.
    """
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _load(function: Callable[[Any], Any]) -> None:
    """Nothing: a process that was given a function has loaded its module."""


def _stream_here(function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
    for task in tasks:
        interrupts.stop_if_asked()
        yield function(task)


def _measured(function: Callable[[Task], Result], task: Task) -> tuple[Result, Spent]:
    begun = time.process_time()
    result = function(task)
    return result, Spent((platform.node(), os.getpid()), time.process_time() - begun, memory_mib())


@contextmanager
def deaf_to_interrupt() -> Iterator[None]:
    """Processes begun in the block do not hear Ctrl-C, which a terminal sends to all: this process ends them."""
    if threading.current_thread() is not threading.main_thread():  # only that one may say who hears
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _quiet_dask() -> None:
    """Library settings that keep the terminal ours and the workers small."""
    import dask  # noqa: PLC0415
    import distributed  # noqa: F401, PLC0415 - sets levels of its loggers when it is first imported

    # A worker that kernels keep busy is no fault; nobody looks at what dask measures of itself, which takes 3 % of a worker.
    admin = {
        "tick.limit": "1h",
        "tick.interval": "1s",
        "system-monitor.interval": "5s",
        "large-graph-warning-threshold": "1 GiB",
    }
    dask.config.set(
        {
            "distributed.worker.daemon": True,
            "distributed.worker.profile.enabled": False,
            **{f"distributed.admin.{key}": value for key, value in admin.items()},
            **{f"distributed.nanny.pre-spawn-environ.{key}": value for key, value in _KEPT_MEMORY.items()},
        }
    )
    # Libraries of a worker shall not start threads of their own.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "POLARS_MAX_THREADS"):
        os.environ.setdefault(name, "1")
    # Its server of figures about itself listens on this machine alone, and on any port.
    warnings.filterwarnings("ignore", message="Port .* is already in use", module="distributed")
    # Workers set up their loggers by this; what goes wrong there comes back as an error of the task.
    os.environ.setdefault("DASK_LOGGING__DISTRIBUTED", "critical")
    for name in ("", ".client", ".worker", ".nanny", ".scheduler", ".core"):
        logging.getLogger(f"distributed{name}").setLevel(logging.CRITICAL)
