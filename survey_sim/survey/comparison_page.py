"""A comparison in words: aligned text for the terminal, and one HTML page with its figures."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from survey_sim import __version__, tables
from survey_sim.folders import data_folder
from survey_sim.plotting.comparison import KEY_MEASURES, ComparisonTables, draw_comparison, words_of
from survey_sim.survey.report import NOTHING, environment, html_figure

_MOST_DECIMALS = 3


@dataclass(frozen=True)
class Cell:
    """Mean of a measure in a scenario, and its difference from the reference, in words."""

    mean: str
    difference: str


@dataclass(frozen=True)
class Row:
    """A measure of all scenarios."""

    of: str
    measure: str
    words: str
    cells: list[Cell]


def rows_of(comparison: ComparisonTables) -> Iterator[Row]:
    """The measures, key ones first, each with a cell a scenario."""
    table, n_seed = comparison.table("comparison"), int(comparison.about["n_seed"])
    known = table["measure"].unique(maintain_order=True).to_list()
    order = [*(name for name in KEY_MEASURES if name in known), *sorted(name for name in known if name not in KEY_MEASURES)]
    for measure in order:
        for of in table.filter(measure=measure)["of"].unique().sort().to_list():
            own = {row["scenario"]: row for row in table.filter(measure=measure, of=of).iter_rows(named=True)}
            unit = next(iter(own.values()))["unit"]
            words = words_of(measure) + (" (%)" if measure.endswith("_frac") else f" ({unit})" if unit else "")
            yield Row(of, measure, words, [_cell(own.get(name), n_seed) for name in comparison.scenarios])


def text_of(comparison: ComparisonTables, *, is_all: bool = False) -> str:
    """Aligned text: the scenarios, what they share with the reference, and key (or all) measures."""
    about = comparison.about
    lines = [
        f"{about['title']}: {len(comparison.scenarios)} scenarios, {about['n_seed']} seeds; reference {comparison.reference}"
    ]
    lines += [f"  {name}: {words}" for name, words in about["shared"].items()]
    if about["n_seed"] == 1:
        lines.append("  one seed: differences have no uncertainty, none is shown")
    else:
        lines.append("  differences: mean over seeds of paired differences +- half width of the 95 % t interval")
    rows = [row for row in rows_of(comparison) if is_all or row.measure in KEY_MEASURES]
    cells = [["of", "measure", *comparison.scenarios]]
    for row in rows:
        cells.append(
            [row.of, row.words, *(f"{cell.mean} {f'[{cell.difference}]' if cell.difference else ''}" for cell in row.cells)]
        )
    widths = [max(len(line[k]) for line in cells) for k in range(len(cells[0]))]
    lines += ["  ".join(part.ljust(width) for part, width in zip(line, widths, strict=True)).rstrip() for line in cells]
    return "\n".join(lines) + "\n"


def write_comparison(folder: Path) -> Path:
    """Draw the figures of a comparison, and write comparison.txt and index.html; gives the page's path."""
    comparison = ComparisonTables(folder)
    tables.write_bytes(text_of(comparison, is_all=True).encode(), folder / "comparison.txt")
    reports = data_folder("reports")
    rows = list(rows_of(comparison))
    page = environment(reports / "comparison").get_template("page.html.jinja")
    text = page.render(
        title=comparison.about["title"],
        scenarios=comparison.scenarios,
        reference=comparison.reference,
        n_seed=comparison.about["n_seed"],
        shared=comparison.about["shared"],
        changes=comparison.about["changes"],
        key_rows=[row for row in rows if row.measure in KEY_MEASURES],
        all_rows=rows,
        figures=[html_figure(*drawn) for drawn in draw_comparison(folder)],
        style=Markup((reports / "page.css").read_text(encoding="utf-8")),
        version=__version__,
    )
    tables.write_bytes(text.encode(), folder / "index.html")
    return folder / "index.html"


def _cell(row: dict[str, Any] | None, n_seed: int) -> Cell:
    """A measure of a scenario; of how many seeds is said where some have no value."""
    if row is None or row["mean"] is None:
        return Cell(NOTHING, "")
    scale = 100.0 if row["measure"].endswith("_frac") else 1.0
    mean = _number(scale * row["mean"]) + (f" in {row['n_seed']} of {n_seed}" if row["n_seed"] < n_seed else "")
    if row["scenario"] == row["reference"] or row["difference"] is None:
        return Cell(mean, "")
    difference = scale * row["difference"]
    if row["difference_high"] is None:
        return Cell(mean, _number(difference, sign="+"))
    return Cell(mean, difference_text(difference, scale * row["difference_high"] - difference))


def difference_text(value: float, error: float) -> str:
    """A difference and the half width of its interval: two digits of that, and as many decimals of the other."""
    if error == 0.0:
        return f"{_number(value, sign='+')} ± 0"
    decimals = min(max(0, 1 - math.floor(math.log10(error))), _MOST_DECIMALS)
    return f"{value:+,.{decimals}f} ± {error:,.{decimals}f}"


def _number(value: float, sign: str = "") -> str:
    """Three digits or so: as many decimals as that needs, no sign of a zero."""
    size = abs(value)
    decimals = 0 if size >= 1000 else 1 if size >= 100 else 2 if size >= 1 else 3
    text = f"{value:{sign},.{decimals}f}"
    return text if float(text.replace(",", "")) != 0.0 else "0"
