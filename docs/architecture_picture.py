"""Draws the picture of ARCHITECTURE.md: `python docs/architecture_picture.py docs/images/architecture.svg`."""

import sys

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch

from survey_sim.plotting import figure_style, new_figure
from survey_sim.plotting.style import INK, MUTED

STAGE, TILE, TABLE, PROOF = "#DCE9F5", "#EDF4E4", "#FFFFFF", "#F7E6DC"
# Centre x, y, width, fill, text.
BOXES = {
    "catalogue": (1.0, 3.0, 1.5, STAGE, "catalogue"),
    "tiling": (3.0, 3.0, 1.3, STAGE, "tiling"),
    "allocation": (5.3, 3.0, 1.5, STAGE, "allocation"),
    "routing": (7.3, 3.0, 1.3, STAGE, "routing"),
    "simulation": (9.3, 3.0, 1.5, STAGE, "simulation"),
    "schedule": (11.7, 3.0, 1.4, STAGE, "schedule"),
    "reports": (14.0, 3.0, 1.4, STAGE, "plotting"),
    "tables": (7.5, 0.55, 14.4, TABLE, "Parquet tables of the run, declared in schema.py"),
    "check": (14.0, -1.2, 1.4, PROOF, "check"),
}
ARROWS = (
    ("catalogue", "tiling", "->"), ("tiling", "allocation", "->"), ("allocation", "routing", "<->"),
    ("routing", "simulation", "->"), ("simulation", "schedule", "->"), ("schedule", "reports", "->"),
)  # fmt: skip
# What each stage writes (or, for figures, reads).
WRITTEN = {
    "catalogue": "targets\nrejected",
    "tiling": "tiles, robots",
    "allocation": "allocations\nunallocated",
    "routing": "paths, legs",
    "simulation": "visits\nrobot_times",
    "schedule": "exposures, nights\ntarget_status",
}


def draw(axes: Axes) -> None:
    """Boxes from left to right, tables below, the checker apart."""
    axes.add_patch(_box(7.3, 3.15, 6.0, 1.75, TILE, edge=MUTED))
    axes.text(7.3, 3.8, "one tile, visit by visit; batches of tiles on workers (survey/tile.py)", ha="center", fontsize=8.5)
    for x, y, width, fill, text in BOXES.values():
        axes.add_patch(_box(x, y, width, 0.8, fill))
        axes.text(x, y, text, ha="center", va="center", fontsize=10, weight="bold")
    for begin, end, style in ARROWS:
        (x0, y0, w0, *_), (x1, y1, w1, *_) = BOXES[begin], BOXES[end]
        _arrow(axes, (x0 + w0 / 2, y0), (x1 - w1 / 2, y1), style)
    for name, text in WRITTEN.items():
        x, y = BOXES[name][:2]
        _arrow(axes, (x, y - 0.4), (x, 0.95), "->")
        axes.text(x + 0.1, 1.5, text, fontsize=8, va="center")
    _arrow(axes, (14.0, 0.95), (14.0, 2.6), "->")
    _arrow(axes, (14.0, 0.15), (14.0, -0.8), "->")
    words = "proves all of it again from the tables alone; shares no code with the stages"
    axes.text(13.1, -1.2, words, ha="right", va="center", fontsize=9)
    axes.text(0.25, 4.25, "catalogues/*.toml", fontsize=9, family="monospace")
    axes.text(3.8, 4.25, "pipelines/*.toml: settings of every stage", fontsize=9, family="monospace")
    axes.text(13.1, 4.25, "reports/*.py", fontsize=9, family="monospace")
    axes.set(xlim=(0, 15), ylim=(-1.8, 4.6), aspect="equal")
    axes.set_axis_off()


def _box(x: float, y: float, width: float, height: float, fill: str, edge: str = INK) -> FancyBboxPatch:
    corner = (x - width / 2, y - height / 2)
    return FancyBboxPatch(corner, width, height, boxstyle="round,pad=0,rounding_size=0.1", facecolor=fill, edgecolor=edge)


def _arrow(axes: Axes, begin: tuple[float, float], end: tuple[float, float], style: str) -> None:
    axes.annotate("", end, begin, arrowprops={"arrowstyle": style, "color": INK, "shrinkA": 0, "shrinkB": 0})


if __name__ == "__main__":
    # Texts as texts, and ids that do not change from drawing to drawing.
    with figure_style(), mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "survey-sim"}):
        figure = new_figure(11.0, 4.7)
        draw(figure.add_subplot())
        figure.savefig(sys.argv[1], metadata={"Date": None})
