"""Errors at the door: what is wrong, where, by which rule, and what mends it."""

from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from pathlib import Path

N_ROWS_SHOWN = 10


class InputError(ValueError):
    """Input that cannot be used; the message names the place, the rule and the remedy.

    Parameters
    ----------
    rule
        What the input breaks, as one phrase ("outside [-90, 90]").
    file
        The file at fault, if there is one.
    place
        Column, key or argument at fault ("targets.dec_deg").
    rows
        All rows at fault (ids or 0-based row numbers); the message shows the first ten and their number.
    remedy
        What the user can do.
    """

    def __init__(
        self,
        rule: str,
        *,
        file: str | Path | None = None,
        place: str | None = None,
        rows: Sequence[object] | None = None,
        remedy: str | None = None,
    ) -> None:
        self.rule, self.file, self.place, self.rows, self.remedy = rule, file, place, rows, remedy
        where = ", ".join(str(part) for part in (file, place) if part is not None)
        text = f"{where}: {rule}" if where else rule
        if rows is not None:
            text += f" at {_rows(rows)}"
        if remedy:
            text += f"\n  remedy: {remedy}"
        super().__init__(text)

    def of_file(self, file: str | Path) -> "InputError":
        """The same error, with the file at fault where it names none."""
        return InputError(self.rule, file=self.file or file, place=self.place, rows=self.rows, remedy=self.remedy)


def _rows(rows: Sequence[object]) -> str:
    shown = ", ".join(str(row) for row in rows[:N_ROWS_SHOWN])
    more = f", ... ({len(rows)} in all)" if len(rows) > N_ROWS_SHOWN else ""
    return f"rows [{shown}{more}]"


def did_you_mean(word: str, options: Iterable[str]) -> str:
    """Sentence that names the nearest of `options`, or all of them when none is near."""
    known = sorted(options)
    near = get_close_matches(word, known, n=1)
    return f"did you mean '{near[0]}'?" if near else f"known: {', '.join(known)}"
