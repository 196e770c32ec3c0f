"""From figure scripts to files: finding, loading, drawing, saving; and the command line that every script has."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure

from survey_sim.errors import InputError
from survey_sim.folders import data_folder
from survey_sim.plotting.run import RunTables
from survey_sim.plotting.style import figure_style
from survey_sim.tables import write_bytes

# Of the tables that the script knows: of a run, a study or a comparison.
Draw = Callable[[Any], Figure]
DEFAULT_DPI = 150
# The same figure gives the same bytes: no date, no version.
_METADATA = {"png": {"Software": None}, "pdf": {"CreationDate": None, "Producer": None, "Creator": None}}


@dataclass(frozen=True)
class Script:
    """A figure script of `reports/`.

    Attributes
    ----------
    name
        Of the script, and of its figure's files.
    title, caption
        First line and rest of the script's docstring.
    """

    name: str
    title: str
    caption: str
    draw: Draw


def find_scripts(folder: Path | None = None) -> dict[str, Script]:
    """The figure scripts of a folder (`reports` by default) by name."""
    scripts = (load_script(path) for path in sorted((folder or data_folder("reports")).glob("*.py")))
    return {script.name: script for script in scripts}


def load_script(path: Path) -> Script:
    """A figure script as a module that no other can import: its docstring and its `draw`.

    Raises
    ------
    InputError
        It has no `draw` or no docstring.
    """
    spec = importlib.util.spec_from_file_location(f"survey_sim_reports_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError("cannot be read as a Python script", file=path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    draw = getattr(module, "draw", None)
    if draw is None or not module.__doc__:
        raise InputError("a figure script has a docstring (title, blank line, caption) and a function draw(run)", file=path)
    title, _, caption = module.__doc__.strip().partition("\n")
    return Script(path.stem, title.rstrip("."), " ".join(caption.split()), draw)


def draw_script(script: Script, data: Any, folder: Path) -> tuple[bytes, tuple[float, float]]:
    """Draw a script's figure and save it as PNG and PDF.

    Parameters
    ----------
    data
        What the script draws: tables of a run, a study or a comparison.

    Returns
    -------
        The PNG's bytes, and the figure's width and height in inches.
    """
    dpi = data.setting("report", "dpi") if isinstance(data, RunTables) else None
    with figure_style():
        figure = script.draw(data)
        png = save_figure(figure, folder / script.name, dpi or DEFAULT_DPI)
    return png, tuple(figure.get_size_inches())


def save_figure(figure: Figure, stem: Path, dpi: int = DEFAULT_DPI) -> bytes:
    """Save a figure as `stem`.png and `stem`.pdf, each whole or not at all; gives the PNG's bytes."""
    if (layout := figure.get_layout_engine()) is not None:
        layout.execute(figure)  # once for both files
    figure.set_layout_engine("none")
    figure.set_dpi(dpi)
    contents = {}
    # `savefig` would draw each file twice, first to lay it out.
    for kind, canvas in {"png": FigureCanvasAgg(figure), "pdf": FigureCanvasPdf(figure)}.items():
        buffer = BytesIO()
        getattr(canvas, f"print_{kind}")(buffer, metadata=_METADATA[kind])
        contents[kind] = buffer.getvalue()
        write_bytes(contents[kind], stem.with_name(f"{stem.name}.{kind}"))
    return contents["png"]


def main(
    script: str, read: Callable[[Path], Any] = RunTables, word: str = "RUN_DIR", figures: str = "report/figures"
) -> None:
    """Command line of a figure script: `python reports/NAME.py DIR [OUT_DIR]`.

    Parameters
    ----------
    read
        Gives the tables of the folder `DIR`, which the usage calls `word`.
    figures
        Where in that folder its figures are.
    """
    path, arguments = Path(script), sys.argv[1:]
    if len(arguments) not in {1, 2} or arguments[0].startswith("-"):
        sys.exit(f"usage: python {script} {word} [OUT_DIR]\n\n{load_script(path).title}.")
    source = Path(arguments[0])
    folder = Path(arguments[1]) if len(arguments) == 2 else source / figures
    try:
        draw_script(load_script(path), read(source), folder)
    except InputError as failure:
        sys.exit(f"error: {failure}")
    print(folder / f"{path.stem}.png")
