"""The look of figures: the style sheet, and one colour for each thing in all of them.

Colours are Okabe and Ito's (Color Universal Design, 2008), told apart by readers of every colour vision. A survey has a hue;
its programmes have shades of it and dashes of their own, so that a print in grey is still read.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import matplotlib as mpl
from matplotlib import colors, style
from matplotlib.figure import Figure

from survey_sim.folders import data_folder
from survey_sim.plotting.run import RunTables

SURVEY_HUES = ("#0072B2", "#D55E00", "#7B3F98", "#5F6B1F", "#8C1C4F", "#20707A")
DASHES: tuple[str | tuple[int, tuple[float, ...]], ...] = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (5, 1.5, 1.5, 1.5)))

INK = "#222222"
MUTED = "#767676"
FAINT = "#D9D9D9"
# What a fibre is on; science takes the colour of its survey.
KIND_COLOURS = {"standard": "#F0E442", "sky": "#56B4E9", "guide": "#CC79A7", "idle": "#BDBDBD"}
# What a robot does on a path (the paper's Figure 16).
MOTION_COLOURS = {"rotating_s": "#CC79A7", "moving_s": "#009E73", "waiting_s": "#E69F00"}
# What a night is spent on; open shutter takes the colour of its survey.
OVERHEAD, WEATHER, UNUSED = "#5A5A5A", "#B8C4CF", "#F1EEE4"
IDEAL, BOUND, LIMIT = "#444444", "#000000", "#000000"
IDEAL_DASHES, BOUND_DASHES, LIMIT_DASHES = (0, (4, 2)), (0, (1, 1)), (0, (6, 1.5, 1, 1.5))
COMPLETENESS_MAP = "viridis"

# Inches; shown at this size on the page.
FULL_WIDTH = 9.6


class Line(NamedTuple):
    """How a line is drawn."""

    color: str
    linestyle: str | tuple[int, tuple[float, ...]]


@contextmanager
def figure_style() -> Iterator[None]:
    """The style sheet of `reports/` for what is drawn and saved inside."""
    with mpl.rc_context(), style.context(data_folder("reports") / "figures.mplstyle"):
        yield


def new_figure(width_in: float = FULL_WIDTH, height_in: float = 3.6) -> Figure:
    """An empty figure that lays itself out; no window, no global state."""
    return Figure(figsize=(width_in, height_in), layout="constrained")


def survey_colours(run: RunTables) -> dict[str, str]:
    """Colour of each survey."""
    return {survey: SURVEY_HUES[number % len(SURVEY_HUES)] for number, survey in enumerate(run.surveys)}


def programme_lines(run: RunTables) -> dict[str, Line]:
    """Line of each programme: a shade of its survey's colour, and dashes."""
    hues = survey_colours(run)
    lines = {}
    for survey, hue in hues.items():
        names = [programme.name for programme in run.programmes if programme.survey == survey]
        for number, (name, colour) in enumerate(zip(names, shades(hue, len(names)), strict=True)):
            lines[name] = Line(colour, DASHES[number % len(DASHES)])
    return lines


def shades(colour: str, n: int) -> Sequence[str]:
    """`n` shades of a colour from dark to light; the colour itself if one is asked for."""
    if n <= 1:
        return [colour] * n
    return [_mixed(colour, -0.4 + 0.8 * i / (n - 1)) for i in range(n)]


def _mixed(colour: str, share: float) -> str:
    """A colour with so much white (share above 0) or black (below 0)."""
    other = 1.0 if share > 0 else 0.0
    return colors.to_hex([(1 - abs(share)) * part + abs(share) * other for part in colors.to_rgb(colour)])
