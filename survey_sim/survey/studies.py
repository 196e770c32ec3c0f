"""What studies share: jobs done by several processes as their results come."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any, TypeVar

Result = TypeVar("Result")


def do_each(do: Callable[..., Result], jobs: Sequence[tuple[Any, ...]], n_worker: int) -> Iterator[Result]:
    """Results of a function for the arguments of each job, as they finish.

    Parameters
    ----------
    do
        A function of a module: other processes find it by name.
    n_worker
        Processes; 1 = all in this one, in order.
    """
    if n_worker <= 1:
        yield from (do(*job) for job in jobs)
        return
    # Not forked: polars has threads.
    with ProcessPoolExecutor(n_worker, mp_context=get_context("spawn")) as pool:
        yield from (done.result() for done in as_completed([pool.submit(do, *job) for job in jobs]))
