"""The study of execution errors as figures see it: its table, a style for each mode, and a panel for each margin."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import polars as pl
from matplotlib.figure import Figure

from survey_sim.errors import InputError
from survey_sim.folders import data_folder
from survey_sim.plotting.axes import as_percent
from survey_sim.plotting.figures import draw_script, find_scripts, main
from survey_sim.plotting.study import from_zero, make_grid, one_legend
from survey_sim.plotting.style import DASHES

# Okabe and Ito's colours, with dashes and marks of their own, so that a print in grey is still read.
MODE_STYLES: dict[str, dict[str, Any]] = {
    "open-loop": {"color": "#D55E00", "linestyle": DASHES[1], "marker": "s"},
    "resync": {"color": "#009E73", "linestyle": DASHES[2], "marker": "^"},
    "keep-order": {"color": "#0072B2", "linestyle": DASHES[0], "marker": "o"},
}


def read_executions(folder: Path) -> pl.DataFrame:
    """The table `executions` of a study.

    Raises
    ------
    InputError
        There is none.
    """
    file = folder / "executions.parquet"
    if not file.is_file():
        remedy = f"make one: survey-sim figures --study execution --out {folder}"
        raise InputError("no study of execution errors here", file=file, remedy=remedy)
    return pl.read_parquet(file)


def draw_executions(folder: Path, out: Path) -> Iterator[Path]:
    """Draw every script of `reports/execution` as PNG and PDF; gives each PNG when it is done."""
    rows = read_executions(folder)
    for name, script in find_scripts(data_folder("reports") / "execution").items():
        draw_script(script, rows, out)
        yield out / f"{name}.png"


def execution_main(script: str) -> None:
    """Command line of a script: `python reports/execution/NAME.py STUDY_DIR [OUT_DIR]`."""
    main(script, read_executions, "STUDY_DIR", "")


def draw_by_margin(rows: pl.DataFrame, panels: dict[str, pl.Expr]) -> Figure:
    """A row of panels for each quantity, a column for each margin, a line for each mode against the size of the error.

    Parameters
    ----------
    panels
        By label of the ordinate: a share of paths, aggregated.
    """
    margins = rows["margin_mm"].unique().sort().to_list()
    grid = make_grid(list(panels), margins, sharex=True, sharey="row")
    for (label, margin), axes in grid.panels.items():
        own = rows.filter(margin_mm=margin).group_by("mode", "scatter_frac").agg(value=panels[label]).sort("scatter_frac")
        for mode, style in MODE_STYLES.items():
            line = own.filter(mode=mode)
            axes.plot(line["scatter_frac"], line["value"], label=mode, markersize=4, linewidth=1.4, **style)
        as_percent(axes.xaxis)
        as_percent(axes.yaxis)
        if label == next(iter(panels)):
            axes.set_title(f"planned with {margin:g} mm more" if margin else "planned at the separation")
        if label == list(panels)[-1]:
            axes.set_xlabel("Scatter of speed, each leg (%)")
        if margin == margins[0]:
            axes.set_ylabel(label)
    from_zero(grid)
    one_legend(grid)
    return grid.figure
