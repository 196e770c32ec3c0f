"""The allocation study as figures see it: its tables, its algorithms' lines, and grids of panels.

Algorithms have Okabe and Ito's colours, and dashes and marks of their own, so that a print in grey is still read.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim.errors import InputError
from survey_sim.folders import data_folder
from survey_sim.plotting.axes import as_percent, legend_above, whole_numbers
from survey_sim.plotting.figures import draw_script, find_scripts, main
from survey_sim.plotting.style import BOUND, BOUND_DASHES, DASHES, IDEAL, IDEAL_DASHES, new_figure

ALGORITHM_STYLES: dict[str, dict[str, Any]] = {
    "cda-basic": {"color": "#D55E00", "linestyle": DASHES[1], "marker": "s"},
    "cda-advanced": {"color": "#CC79A7", "linestyle": DASHES[2], "marker": "^"},
    "matching": {"color": "#009E73", "linestyle": DASHES[3], "marker": "D"},
    "plan": {"color": "#0072B2", "linestyle": DASHES[0], "marker": "o"},
}
# Priorities from low to high: light to dark, so that the highest stand out (viridis, the same in every colour vision).
THRESHOLD_COLOURS = ("#B8A90D", "#5EC962", "#21918C", "#3B528B", "#440154")
# The paper's plate: patrol radius and separation, mm.
PAPER_PLATE = {"patrol_radius_mm": 50.0, "min_separation_mm": 9.0}


class Grid(NamedTuple):
    """A figure and its panels by row and column name."""

    figure: Figure
    panels: dict[tuple[Any, Any], Axes]


class StudyTables:
    """Tables of one study.

    Attributes
    ----------
    sources, algorithms
        Names, in order of appearance in tables and legends.
    """

    def __init__(self, folder: Path) -> None:
        if not (folder / "visits.parquet").is_file():
            remedy = f"make one: survey-sim figures --out {folder}"
            raise InputError("no allocation study here: it has no visits.parquet", file=folder, remedy=remedy)
        self.folder = folder
        self._read = cache(lambda name: pl.read_parquet(folder / f"{name}.parquet"))
        self.sources = self.table("targets")["source"].unique().sort().to_list()
        found = set(self.table("visits")["algorithm"])
        self.algorithms = [name for name in ALGORITHM_STYLES if name in found]

    def table(self, name: str, **where: Any) -> pl.DataFrame:
        """A table, or its rows in which columns have these values."""
        return self._read(name).filter(**where) if where else self._read(name)

    def n_science(self, source: str) -> int:
        """Science targets of a field."""
        return len(self.table("targets", source=source, kind="science"))

    def n_robot(self) -> int:
        """Science robots of the plate: what a visit of the ideal positioner completes."""
        row = self.table("priorities").row(0, named=True)
        return round(row["completeness_frac"] * row["n_target"] / row["efficiency_frac"] / row["visit"])


def draw_study(folder: Path, out: Path) -> Iterator[Path]:
    """Draw every script of `reports/allocation` as PNG and PDF; gives each PNG when it is done."""
    study = StudyTables(folder)
    for name, script in find_scripts(data_folder("reports") / "allocation").items():
        draw_script(script, study, out)
        yield out / f"{name}.png"


def study_main(script: str) -> None:
    """Command line of a script: `python reports/allocation/NAME.py STUDY_DIR [OUT_DIR]`."""
    main(script, StudyTables, "STUDY_DIR", "")


def make_grid(rows: Sequence[Any], columns: Sequence[Any], row_height_in: float = 2.5, **shared: Any) -> Grid:
    """Panels for every row and column; axes are shared as `Figure.subplots` is told."""
    figure = new_figure(height_in=row_height_in * len(rows) + 0.6)
    grid = figure.subplots(len(rows), len(columns), squeeze=False, **shared)
    return Grid(figure, dict(zip(product(rows, columns), grid.ravel(), strict=True)))


def from_zero(grid: Grid) -> None:
    """All axes from zero on; when everything is drawn, since shared axes would else keep the first panel's range."""
    for axes in grid.panels.values():
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)


def one_legend(grid: Grid) -> None:
    """One legend above all panels of a grid."""
    legend_above(grid.figure, grid.panels.values())


def draw_algorithms(axes: Axes, rows: pl.DataFrame, column: str, **options: Any) -> None:
    """A line an algorithm against visit."""
    for name, style in ALGORITHM_STYLES.items():
        own = rows.filter(algorithm=name).sort("visit")
        if own.height:
            line = {"markersize": 3.2, "linewidth": 1.4, "markevery": max(1, own.height // 12), **style, **options}
            axes.plot(own["visit"], own[column], label=name, **line)


def ideal_frac(study: StudyTables, n_target: int, visit: pl.Series) -> pl.Series:
    """Completeness of a positioner whose every robot takes a new target at every visit."""
    return (visit * (study.n_robot() / max(1, n_target))).clip(upper_bound=1.0)


def draw_ideal(axes: Axes, study: StudyTables, n_target: int, n_visit: int, **line: Any) -> None:
    """The ideal positioner's completeness against visit."""
    visit = pl.int_range(n_visit + 1, eager=True)
    style = {"color": IDEAL, "linestyle": IDEAL_DASHES, "linewidth": 1.1, **line}
    axes.plot(visit, ideal_frac(study, n_target, visit), label="ideal positioner", zorder=1.5, **style)


def draw_bound(axes: Axes, limits: pl.DataFrame) -> None:
    """Proven upper bound of completeness against visit."""
    own = limits.sort("visit")
    axes.plot(own["visit"], own["bound_frac"], color=BOUND, linestyle=BOUND_DASHES, linewidth=1.6, label="proven bound")


def completeness_axes(axes: Axes, n_visit: int) -> None:
    """Completeness from 0 to 100 % against visit."""
    axes.set(ylim=(0, 1.03), xlim=(0, n_visit + 0.3))
    as_percent(axes.yaxis)
    whole_numbers(axes.xaxis)


def draw_thresholds(axes: Axes, rows: pl.DataFrame, x: str, y: str) -> None:
    """A line a threshold of priority, the darker the higher."""
    for limit, colour in zip((1, 3, 5, 7, 9), THRESHOLD_COLOURS, strict=True):
        own = rows.filter(priority_min=limit).sort("visit")
        if own.height:
            dashes = DASHES[(limit // 2) % 2]
            axes.plot(own[x], own[y], color=colour, linestyle=dashes, linewidth=1.5, label=f"priority ≥ {limit}")


def plates_of(study: StudyTables) -> list[tuple[float, float]]:
    """Patrol radius and separation, mm, of all plates of the study."""
    return study.table("limits").select("patrol_radius_mm", "min_separation_mm").unique().sort(pl.all()).rows()
