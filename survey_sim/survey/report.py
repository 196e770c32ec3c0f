"""The report of a run: every figure of `reports/` as PNG and PDF, one HTML page that holds them all, and field players."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any
from uuid import uuid4

import jinja2
import polars as pl
from markupsafe import Markup

from survey_sim import tables
from survey_sim.folders import data_folder
from survey_sim.plotting import RunTables, Script, Summary, draw_script, find_scripts, load_script, summarise
from survey_sim.plotting.style import programme_lines, survey_colours
from survey_sim.plotting.summary import QUANTITIES
from survey_sim.schema import TABLES
from survey_sim.survey.field import view_field
from survey_sim.survey.workers import Workers

# What stands in a table where there is no number: an en dash.
NOTHING = "\u2013"
PAGE, STYLE, PLAYERS = "page.html.jinja", "page.css", "players"
# Pixels of a screen to the inch, by which a figure is shown at the size for which it was drawn.
SCREEN_DPI = 96

# A figure's PNG, and its width and height in inches.
Image = tuple[bytes, tuple[float, float]]


@dataclass(frozen=True)
class Drawing:
    """A figure that some process draws.

    Attributes
    ----------
    name, reports
        Of its script, and the scripts' folder.
    run_dir, folder
        What it draws, and where to.
    report
        Name of the report that it is for, which no other has: a process keeps a run's tables for one report.
    """

    name: str
    reports: Path
    run_dir: Path
    folder: Path
    report: str

    def draw(self) -> tuple[str, Image]:
        """Draw and save it; gives its name too."""
        script = load_script(self.reports / f"{self.name}.py")
        return self.name, draw_script(script, _run_tables(self.run_dir, self.report), self.folder)


@lru_cache(maxsize=1)
def _run_tables(run_dir: Path, report: str) -> RunTables:
    """The tables of a run, as far as this process has read them for a report."""
    return RunTables(run_dir)


@dataclass
class Figures:
    """Figures drawn for a page; the page asks for them by name, and at its end for those that it has not named."""

    scripts: Mapping[str, Script]
    images: Mapping[str, Image]
    _shown: set[str] = field(default_factory=set)

    def show(self, name: str) -> Markup:
        """An HTML figure: the image itself, its title and its caption."""
        self._shown.add(name)
        return html_figure(self.scripts[name], *self.images[name])

    def rest(self) -> Iterator[Markup]:
        """Figures that the page has not shown yet."""
        for name in self.scripts:
            if name not in self._shown:
                yield self.show(name)


def html_figure(script: Script, png: bytes, size_in: tuple[float, float]) -> Markup:
    """An HTML figure that holds the image itself, with its script's title and caption; `size_in` is its width and height."""
    width, height = (round(inches * SCREEN_DPI) for inches in size_in)
    image = Markup('<img src="data:image/png;base64,{}" width="{}" height="{}" alt="{}">').format(
        b64encode(png).decode(), width, height, script.title
    )
    words = Markup("<figcaption><strong>{}.</strong> {}</figcaption>").format(script.title, script.caption)
    return Markup('<figure id="{}">{}{}</figure>').format(script.name, image, words)


def make_report(run_dir: Path, workers: Workers | None = None) -> Path:
    """Draw all figures of a run and write its page, `report/index.html`; gives the page's path.

    Parameters
    ----------
    workers
        Who draws; by default this process.

    Raises
    ------
    InputError
        The folder holds no run, or a table is not sound.
    """
    reports, folder, report = data_folder("reports"), run_dir / "report", uuid4().hex
    run, scripts = _run_tables(run_dir, report), find_scripts(reports)
    drawings = [Drawing(name, reports, run_dir, folder / "figures", report) for name in scripts]
    near = workers if workers is not None and workers.are_near else Workers()  # a cluster may lack the files
    drawn = near.stream(Drawing.draw, drawings)
    summary = summarise(run)
    players = _write_players(run, summary, folder)
    page = environment(reports).get_template(PAGE)
    text = page.render(
        run=run,
        summary=summary,
        quantities=QUANTITIES,
        players=players,
        figures=Figures(scripts, dict(drawn)),
        style=Markup((reports / STYLE).read_text(encoding="utf-8")),
        record=run.record,
        colours={name: line.color for name, line in programme_lines(run).items()},
        survey_colours=survey_colours(run),
        lost=run.lost_counts,
        sizes=_sizes(run),
    )
    tables.write_bytes(text.encode(), folder / "index.html")
    return folder / "index.html"


def _write_players(run: RunTables, summary: Summary, folder: Path) -> dict[str, str]:
    """Field players of the visits worth a look, beside the page: path from the page, by what the visit is named for."""
    if not run.has("legs"):
        return {}
    places = {}
    for name, (visit, _) in summary.visits.items():
        places[name] = f"{PLAYERS}/{name.replace(' ', '-')}.html"
        survey, tile_id, visit_id = visit
        view_field([run.folder], folder / places[name], survey=survey, tile_id=tile_id, visit_ids=[visit_id])
    return places


def environment(folder: Path) -> jinja2.Environment:
    """Templates of a folder; every string that is put into a page is escaped."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(count=_count, number=_number, percent=_percent, json=_json)
    return environment


def _sizes(run: RunTables) -> list[tuple[str, int, int]]:
    """Name, rows and bytes of each table that the run has."""
    rows = []
    for name in TABLES:
        files = tables.files(run.folder, name)
        if files:
            n_row = run.scan(name).select(pl.len()).collect().item()
            rows.append((name, n_row, sum(file.stat().st_size for file in files)))
    return rows


def _count(value: int | None) -> str:
    return NOTHING if value is None else f"{value:,}"


def _number(value: float | None, decimals: int = 1, unit: str = "") -> str:
    """A number with its unit after a space that does not break; a dash for none."""
    return NOTHING if value is None else f"{value:,.{decimals}f}" + (f"\u00a0{unit}" if unit else "")


def _percent(value: float | None, decimals: int = 1) -> str:
    return NOTHING if value is None else f"{100 * value:.{decimals}f}\u00a0%"


def _json(value: Any) -> str:
    return json.dumps(value, indent=2, sort_keys=True)
