"""Small things that axes of many figures need: empty panels, bands against visit, cumulative shares, dates, percents."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import polars as pl
from matplotlib import dates
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import Formatter, FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from survey_sim.plotting.style import MUTED

FloatArray = npt.NDArray[np.float64]

# Logarithmic axes shorter than this have numbers at 1, 2 and 5, not only at 1.
_FEW_DECADES = 2.5


def say_empty(axes: Axes, text: str) -> None:
    """Say in the middle of a panel why there is nothing in it."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=MUTED, wrap=True)
    axes.set(xticks=[], yticks=[])
    axes.grid(False)


def empty_figure(figure: Figure, text: str) -> Figure:
    """The figure, as low as a line of text, with one panel that says why there is nothing in it."""
    figure.set_size_inches(figure.get_figwidth(), 1.0)
    axes = figure.add_subplot()
    axes.spines[:].set_visible(False)
    say_empty(axes, text)
    return figure


def panels(figure: Figure, titles: Sequence[str], *, share_y: bool = True) -> list[Axes]:
    """Panels side by side with titles, y axes alike; at least one."""
    axes = figure.subplots(1, max(1, len(titles)), sharey=share_y, squeeze=False)[0]
    for one, title in zip(axes, titles, strict=False):
        one.set_title(title)
    return list(axes)


class Percents(Formatter):
    """Shares as percents, with as many decimals as the ticks need."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """One share by itself."""
        return f"{100.0 * x:.4g}%"

    def format_ticks(self, values: Sequence[float]) -> list[str]:
        """All ticks of an axis."""
        percents = 100.0 * np.asarray(values, dtype=np.float64) + 0.0
        decimals = next((n for n in range(4) if np.allclose(percents, percents.round(n), rtol=0.0, atol=1e-6)), 4)
        return [f"{percent:.{decimals}f}%" for percent in percents]


def as_percent(axis: Any) -> None:
    """Show shares as percents on an axis."""
    axis.set_major_formatter(Percents())


def whole_numbers(axis: Any, n_max: int = 9) -> None:
    """Ticks at whole numbers only, so many at most."""
    axis.set_major_locator(MaxNLocator(n_max, integer=True, min_n_ticks=1))


def log_scale(axes: Axes, direction: str, *, percent: bool = False) -> None:
    """A logarithmic axis with numbers as they are spoken (0.1, 20, 300), of what is drawn so far; linear if nothing is."""
    axis: Any = getattr(axes, f"{direction}axis")
    if not np.isfinite(getattr(axes.dataLim, f"minpos{direction}")):
        return
    getattr(axes, f"set_{direction}scale")("log")
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if np.log10(high / low) < _FEW_DECADES else (1.0,)))
    axis.set_minor_formatter(NullFormatter())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{100 * value:,.10g}%" if percent else f"{value:,.10g}"))


def add_legend(axes: Axes, **options: Any) -> None:
    """A legend, if anything in the panel has a name."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(**options)


def legend_above(figure: Figure, panels: Iterable[Axes]) -> None:
    """One legend above all panels, of everything that has a name in any of them."""
    handles: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if handles:
        figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=min(6, len(handles)))


def date_axis(axes: Axes) -> None:
    """An x axis of evenings, as short as the dates allow."""
    locator = dates.AutoDateLocator(minticks=3, maxticks=9)
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator))
    axes.set_xlabel("Evening (UTC date)")


def by_visit(visits: pl.DataFrame, column: str) -> pl.DataFrame:
    """Over tiles, by `visit`, of a column of `visits`: quantiles 0.1 `low`, 0.5 `middle`, 0.9 `high`, and the `mean`."""
    value = pl.col(column)
    return (
        visits.group_by(visit="visit_id")
        .agg(low=value.quantile(0.1, "linear"), middle=value.median(), high=value.quantile(0.9, "linear"), mean=value.mean())
        .sort("visit")
    )


def draw_band(axes: Axes, bands: pl.DataFrame, colour: str, label: str, middle: str = "middle", **line: Any) -> None:
    """Median (or mean) against visit, and the band that holds 80 % of the tiles."""
    axes.fill_between(bands["visit"], bands["low"], bands["high"], color=colour, alpha=0.16, linewidth=0)
    axes.plot(bands["visit"], bands[middle], color=colour, label=label, marker="o", markersize=3, **line)


def draw_cumulative(axes: Axes, values: FloatArray, **line: Any) -> None:
    """Share of values at most x, as steps; nothing of no values."""
    if not len(values):
        return
    ordered = np.sort(values)
    share = np.arange(1, len(ordered) + 1) / len(ordered)
    step = max(1, len(ordered) // 2000)  # more steps than pixels would only make the file large
    keep = np.r_[np.arange(0, len(ordered), step), len(ordered) - 1]
    axes.step(np.r_[ordered[0], ordered[keep]], np.r_[0.0, share[keep]], where="post", **line)


def binned(x: FloatArray, y: FloatArray, edges: FloatArray, least: int = 1) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean of y in bins of x that hold at least so many: middles (mean x), means, and their binomial-like errors.

    Parameters
    ----------
    x, y
        (n,) values; y may be bool.
    edges
        (n_bin + 1,) ascending.

    Returns
    -------
        Three (n_kept,) arrays: mean x of the bin, mean y, standard error of that mean.
    """
    place = np.digitize(x, edges) - 1
    place[x == edges[-1]] = len(edges) - 2
    inside = (place >= 0) & (place < len(edges) - 1)
    place, x, y = place[inside], x[inside], y[inside].astype(np.float64)
    n = np.bincount(place, minlength=len(edges) - 1)
    kept = n >= max(1, least)
    sum_x, sum_y, sum_y2 = (np.bincount(place, weights=w, minlength=len(edges) - 1)[kept] for w in (x, y, y * y))
    n = n[kept]
    mean = sum_y / n
    error = np.sqrt(np.maximum(sum_y2 / n - mean**2, 0.0) / n)
    return sum_x / n, mean, error


def draw_binned(axes: Axes, points: tuple[FloatArray, FloatArray, FloatArray], **line: Any) -> None:
    """Means of bins, joined, with a bar of one standard error each."""
    x, mean, error = points
    axes.errorbar(x, mean, yerr=error, marker="o", markersize=3.2, elinewidth=1.0, **line)


def note(axes: Axes, text: str, *, where: str = "upper left") -> None:
    """A small remark in a corner of a panel."""
    vertical, horizontal = where.split()
    axes.text(
        0.02 if horizontal == "left" else 0.98,
        0.97 if vertical == "upper" else 0.03,
        text,
        transform=axes.transAxes,
        ha=horizontal,
        va="top" if vertical == "upper" else "bottom",
        fontsize=8,
        color=MUTED,
    )
