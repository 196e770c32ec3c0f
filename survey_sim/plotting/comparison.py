"""Scenarios side by side as figures see them: the tables of a comparison, and one colour and dash for each scenario."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim.errors import InputError
from survey_sim.folders import data_folder
from survey_sim.plotting.axes import note
from survey_sim.plotting.figures import Script, draw_script, find_scripts, main
from survey_sim.plotting.study import ALGORITHM_STYLES
from survey_sim.plotting.style import DASHES, new_figure

# Okabe and Ito's colours, and marks, so that a print in grey is still read.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#56B4E9", "#E69F00")
_MARKS = ("o", "s", "^", "D", "v", "P", "X")

# Measures in words, and whether their differences are shown in percentage points.
WORDS = {
    "completeness_frac": "completeness at the end",
    "allocated_frac": "allocated",
    "completeness_half_time_frac": "completeness at half time",
    "wanted_reached_after_d": "nights until it is as wanted",
    "n_tile": "tiles",
    "n_visit": "visits (configurations)",
    "science_per_visit": "science targets a visit",
    "n_pointing": "pointings",
    "n_pointing_observed": "pointings observed",
    "n_pointing_failed": "pointings failed",
    "configuration_median_s": "configuration time, median",
    "configuration_p95_s": "configuration time, 95 % of visits",
    "configuration_max_s": "configuration time, slowest",
    "configuration_95_filter_median_s": "configuration time, median, 95 % of robots at rest",
    "within_readout_frac": "visits within the readout",
    "within_readout_95_filter_frac": "visits within the readout, 95 % filter",
    "pointing_configuration_median_s": "configuration at the telescope, median",
    "pointing_configuration_p95_s": "configuration at the telescope, 95 % of pointings",
    "pointing_configuration_max_s": "configuration at the telescope, slowest",
    "pointing_configuration_95_filter_median_s": "configuration at the telescope, median, 95 % of robots at rest",
    "pointing_within_readout_frac": "pointings within the readout",
    "pointing_within_readout_95_filter_frac": "pointings within the readout, 95 % filter",
    "bound_ratio_mean": "configuration time / lower bound",
    "at_bound_frac": "visits at the lower bound",
    "travel_mean_mm": "mean straight travel",
    "travel_max_median_mm": "largest travel, median of visits",
    "crossings_mean": "crossings a visit",
    "n_unrouted": "unrouted robots",
    "configuration_alone_h": "time spent on configuration alone",
    "dark_h": "time between twilights",
    "weather_lost_h": "lost to weather",
    "exposing_h": "shutter open",
    "overhead_h": "overheads",
    "unused_h": "not used",
}

# Measures that are shown first, in this order; all others stand in the tables.
KEY_MEASURES = (
    "completeness_frac",
    "wanted_reached_after_d",
    "n_visit",
    "science_per_visit",
    "n_pointing_observed",
    "configuration_median_s",
    "configuration_p95_s",
    "configuration_max_s",
    "pointing_within_readout_frac",
    "bound_ratio_mean",
    "travel_mean_mm",
    "crossings_mean",
    "n_unrouted",
    "configuration_alone_h",
    "weather_lost_h",
)


class ComparisonTables:
    """The tables of one comparison, or of a run's imprint alone.

    Attributes
    ----------
    about
        `comparison.json`.
    scenarios
        Names, the reference first.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            self.about: dict[str, Any] = json.loads((folder / "comparison.json").read_text(encoding="utf-8"))
        except (FileNotFoundError, json.JSONDecodeError):
            remedy = "make one: survey-sim compare RUN_DIR RUN_DIR, or survey-sim imprint RUN_DIR"
            raise InputError("no comparison here: it has no comparison.json", file=folder, remedy=remedy) from None
        self.scenarios: list[str] = list(self.about["scenarios"])
        self._read = cache(lambda name: pl.read_parquet(folder / f"{name}.parquet"))

    @property
    def reference(self) -> str:
        """The scenario that the others are compared to."""
        return self.scenarios[0]

    def has(self, name: str) -> bool:
        """Whether the comparison has a table."""
        return (self.folder / f"{name}.parquet").is_file()

    def table(self, name: str, **where: Any) -> pl.DataFrame:
        """A table, or its rows in which columns have these values."""
        return self._read(name).filter(**where) if where else self._read(name)

    def programmes(self, name: str) -> list[str]:
        """Programmes of a table, in alphabetical order."""
        return self.table(name)["programme"].unique().sort().to_list()

    def style(self, scenario: str) -> dict[str, Any]:
        """Colour, dashes and mark of a scenario: an allocation algorithm has its own everywhere."""
        if scenario in ALGORITHM_STYLES:
            return dict(ALGORITHM_STYLES[scenario])
        place = self.scenarios.index(scenario)
        n = len(_COLOURS)
        return {"color": _COLOURS[place % n], "linestyle": DASHES[place % len(DASHES)], "marker": _MARKS[place % n]}


def words_of(measure: str) -> str:
    """A measure in words."""
    if measure.startswith("completeness_year_"):
        return f"completeness after year {measure.split('_')[2]}"
    return WORDS.get(measure, measure)


def draw_comparison(folder: Path, only: Sequence[str] = ()) -> Iterator[tuple[Script, bytes, tuple[float, float]]]:
    """Draw the scripts of `reports/comparison` (or some) as PNG and PDF into `figures/`; gives each PNG with its inches."""
    comparison = ComparisonTables(folder)
    for name, script in find_scripts(data_folder("reports") / "comparison").items():
        if not only or name in only:
            yield script, *draw_script(script, comparison, folder / "figures")


def comparison_main(script: str) -> None:
    """Command line of a script: `python reports/comparison/NAME.py COMPARISON_DIR [OUT_DIR]`."""
    main(script, ComparisonTables, "COMPARISON_DIR", "figures")


def note_if_alike(axes: Axes, rows: pl.DataFrame, *columns: str, where: str = "lower right") -> None:
    """Say so where the lines of several scenarios lie on one another; `rows` have their column `scenario`."""
    lines = rows.group_by("scenario", maintain_order=True).agg(columns)
    if len(lines) > 1 and lines.select(columns).n_unique() == 1:
        note(axes, "all scenarios alike", where=where)


def grid_of(n_panel: int, n_column: int, height_in: float, **shared: Any) -> tuple[Figure, list[Axes]]:
    """A figure with so many panels, row by row; what is left over is not drawn."""
    n_column = max(1, min(n_column, n_panel))
    n_row = max(1, -(-n_panel // n_column))
    figure = new_figure(height_in=height_in * n_row + 0.5)
    axes = list(figure.subplots(n_row, n_column, squeeze=False, **shared).ravel())
    for spare in axes[n_panel:]:
        spare.remove()
    return figure, axes[:n_panel]
