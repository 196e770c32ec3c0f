"""Progress of long work on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

Advance = Callable[[int, int], None]


@contextmanager
def tile_progress(console: Console, n_tile: int, n_kept: int) -> Iterator[Advance]:
    """Bar of tiles done, visits and time left; call what it gives with the tiles and visits of each finished batch."""
    columns = (
        TextColumn("  tiles"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[n_visit]} visits"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    if n_kept:
        console.print(f"  {n_kept} of {n_tile} tiles are kept from before")
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("tiles", total=n_tile, completed=n_kept, n_visit=0)

        def advance(n_more: int, n_visit: int) -> None:
            before = progress.tasks[0].fields["n_visit"]
            progress.update(task, advance=n_more, n_visit=before + n_visit)

        yield advance
