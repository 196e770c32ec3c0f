"""Progress of long work on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

Advance = Callable[[int, int], None]


@contextmanager
def tile_progress(console: Console, n_tile: int, n_kept: int = 0) -> Iterator[Advance]:
    """Bar of tiles done, visits and time left; call what it gives with the tiles and visits of each finished batch.

    Parameters
    ----------
    n_kept
        Tiles that are known to be kept from before; those that turn out to be are told as done, without visits.
    """
    if n_kept:
        console.print(f"  {n_kept} of {n_tile} tiles are kept from before")
    with _bar(console, ("tiles", n_tile), "visits", n_kept) as advance:
        yield advance


@contextmanager
def night_progress(console: Console, n_night: int) -> Iterator[Advance]:
    """Bar of nights done, pointings and time left; call what it gives with the nights and pointings that are done."""
    with _bar(console, ("nights", n_night), "pointings", 0) as advance:
        yield advance


@contextmanager
def _bar(console: Console, what: tuple[str, int], within: str, n_done: int) -> Iterator[Advance]:
    """Bar of things done, of so many, and of what they hold."""
    name, total = what
    columns = (
        TextColumn(f"  {name}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(f"{{task.fields[held]}} {within}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(name, total=total, completed=n_done, held=0)

        def advance(n_more: int, n_held: int) -> None:
            before = progress.tasks[0].fields["held"]
            progress.update(task, advance=n_more, held=before + n_held)

        yield advance
