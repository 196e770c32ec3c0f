"""Time budget.

Left: hours between twilights, by night, month or quarter of a year: shutter open for each survey; slews, configuration,
readout and calibration; weather; engineering; and the rest, with no field to observe. Right: what a pointing
takes before its shutter opens, the median and the range of 90 % of the pointings: slew, configuration and readout of
the last exposure go on together, calibration follows.
"""

from datetime import datetime
from typing import Any

import numpy as np
import polars as pl
from matplotlib import dates
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim.plotting import RunTables, main, new_figure
from survey_sim.plotting.axes import add_legend, date_axis, empty_figure, say_empty
from survey_sim.plotting.run import evening_dates
from survey_sim.plotting.style import INK, OVERHEAD, UNUSED, WEATHER, survey_colours

# Nights gathered in a bar, by the most nights for which that is done; more are gathered by quarter.
GATHERED = {62: ("1d", "night"), 750: ("1mo", "month")}
STEPS = {"readout_s": "readout", "configuration_time_s": "configuration", "slew_s": "slew"}


def draw(run: RunTables) -> Figure:
    """Where the nights went, and where a pointing's time goes."""
    if run.nights.is_empty():
        return empty_figure(new_figure(), "no nights were scheduled")
    figure = new_figure(height_in=4.0)
    left, right = figure.subplots(1, 2, width_ratios=[1.7, 1.0])
    _draw_nights(left, run)
    _draw_pointing(right, run)
    return figure


def _draw_nights(axes: Axes, run: RunTables) -> None:
    if not run.nights["dark_s"].sum():
        axes.set_title("Nights")
        say_empty(axes, "it was never dark")
        return
    step, word = next((kind for most, kind in GATHERED.items() if len(run.nights) <= most), ("1q", "quarter of a year"))
    evening = pl.Series("evening", evening_dates(run.nights["evening_mjd"].to_numpy()))
    nights = run.nights.with_columns(evening.dt.truncate(step))
    by_survey = (
        run.exposures.group_by("night", "survey")
        .agg(pl.col("exposure_s").sum())
        .join(nights.select("night", "evening"), on="night")
    )
    total = (
        nights.group_by("evening")
        .agg(pl.col("dark_s", "lost_s", "engineering_s", "overhead_s", "exposing_s").sum())
        .sort("evening")
    )
    begins = total["evening"].to_list()
    place = dates.date2num(begins)
    width = np.diff([*place, dates.date2num(_next(begins[-1], step))])
    below = np.zeros(len(place))
    parts = []
    for survey, colour in survey_colours(run).items():
        own = by_survey.filter(survey=survey).group_by("evening").agg(pl.col("exposure_s").sum())
        spent = (
            total.select("evening").join(own, on="evening", how="left", maintain_order="left")["exposure_s"].fill_null(0.0)
        )
        parts.append((f"{survey}: shutter open", spent.to_numpy(), colour, ""))
    parts.append(("slew, configuration, ...", total["overhead_s"].to_numpy(), OVERHEAD, ""))
    parts.append(("weather", total["lost_s"].to_numpy(), WEATHER, "////"))
    parts.append(("engineering", total["engineering_s"].to_numpy(), UNUSED, "...."))
    used = sum(part[1] for part in parts)
    parts.append(("not used", (total["dark_s"].to_numpy() - used).clip(min=0.0), UNUSED, ""))
    for label, seconds, colour, hatch in parts:
        share = seconds.sum() / sum(part[1].sum() for part in parts)
        style: dict[str, Any] = {"color": colour, "hatch": hatch, "edgecolor": INK, "linewidth": 0.3, "align": "edge"}
        axes.bar(place, seconds / 3600.0, 0.94 * width, bottom=below, label=f"{label}: {share:.0%}", **style)
        below = below + seconds / 3600.0
    axes.set(title=f"Nights, by {word}", ylabel="Time (h)")
    axes.xaxis_date()
    date_axis(axes)
    axes.grid(False, axis="x")
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles[::-1], labels[::-1], loc="upper left", bbox_to_anchor=(0.0, -0.16), ncol=2)


def _next(begin: datetime, step: str) -> datetime:
    """Begin of the bar after the last."""
    return pl.Series([begin]).dt.offset_by(step)[0]


def _draw_pointing(axes: Axes, run: RunTables) -> None:
    axes.set_title("Before the shutter opens")
    if run.exposures.is_empty():
        say_empty(axes, "no exposures")
        return
    surveys = run.exposures["survey"].unique().sort().to_list()
    for number, survey in enumerate(surveys):
        own = run.exposures.filter((pl.col("survey") == survey) & (pl.col("status") == "observed"))
        if own.is_empty():
            continue
        low, middle, high = (own.select(pl.col(*STEPS).quantile(q, "linear")).row(0) for q in (0.05, 0.5, 0.95))
        place = np.arange(len(STEPS)) + 0.22 * (number - (len(surveys) - 1) / 2)
        errors = np.array([np.subtract(middle, low), np.subtract(high, middle)])
        label = f"{survey}: {len(own):,} pointings, shutter open {np.median(own['exposure_s']):,.0f} s"
        style: dict[str, Any] = {"fmt": "o", "color": survey_colours(run)[survey], "markersize": 5, "capsize": 2.5}
        axes.errorbar(middle, place, xerr=errors, label=label, **style)
        calibration_s = run.setting("schedule", "surveys", survey, "calibration_s")
        if calibration_s is not None:
            axes.errorbar([calibration_s], [place[0] - 1.0], **style)
    axes.set_yticks(np.arange(-1, len(STEPS)), ["calibration", *STEPS.values()])
    axes.set_xlabel("Time (s)")
    axes.set_xlim(left=-0.02 * axes.get_xlim()[1])
    axes.grid(False, axis="y")
    add_legend(axes, loc="upper left", bbox_to_anchor=(-0.3, -0.16))


if __name__ == "__main__":
    main(__file__)
