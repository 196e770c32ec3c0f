"""One night.

The night with the most surveys, and of those the one with the longest open shutter. Above: airmass of each exposure,
thin where it did not count. Below: what the telescope did; gaps between exposures go to slews, configuration, readout,
calibration and cloud. Grey: altitude of the Moon at the exposures.
"""

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim.plotting import RunTables, main, new_figure
from survey_sim.plotting.axes import add_legend, empty_figure
from survey_sim.plotting.run import evening_dates
from survey_sim.plotting.style import MUTED, OVERHEAD, survey_colours

# Above each other below the exposures, with their columns.
PREPARATIONS = {"slew": "slew_s", "configuration": "configuration_time_s", "readout": "readout_s"}


def draw(run: RunTables) -> Figure:
    """Timeline of a busy night."""
    if run.exposures.is_empty():
        return empty_figure(new_figure(), "no exposures: nothing was observed")
    night = _busiest(run.exposures)
    row = run.nights.filter(night=night).row(0, named=True)
    log = run.exposures.filter(night=night).with_columns(
        start_h=(pl.col("start_mjd") - row["evening_mjd"] - 0.5) * 24.0, length_h=pl.col("exposure_s") / 3600.0
    )
    figure = new_figure(height_in=4.2)
    above, middle, below = figure.subplots(3, 1, sharex=True, height_ratios=[2.2, 1.1, 1.3])
    _draw_airmass(above, run, log)
    _draw_shutter(middle, run, log)
    _draw_moon(below, log)
    date = str(evening_dates(np.array([row["evening_mjd"]]))[0])[:10]
    spent = {"dark": row["dark_s"], "lost to weather": row["lost_s"], "shutter open": row["exposing_s"]}
    hours = ", ".join(f"{seconds / 3600:.1f} h {what}" for what, seconds in spent.items())
    above.set_title(f"Night {night} ({date}): {len(log)} pointings; {hours}")
    return figure


def _busiest(exposures: pl.DataFrame) -> int:
    nights = exposures.group_by("night").agg(pl.col("survey").n_unique(), pl.col("exposure_s").sum())
    return int(nights.sort("survey", "exposure_s", "night", descending=[True, True, False])["night"][0])


def _draw_airmass(axes: Axes, run: RunTables, log: pl.DataFrame) -> None:
    for survey in log["survey"].unique().sort():
        own = log.filter(survey=survey)
        good = (own["status"] == "observed").to_numpy()
        ends = own["start_h"] + own["length_h"]
        axes.hlines(
            own["airmass"], own["start_h"], ends, color=survey_colours(run)[survey], linewidth=np.where(good, 4.0, 1.2)
        )
        axes.plot([], [], color=survey_colours(run)[survey], linewidth=4.0, label=f"{survey} ({len(own)})")
    axes.set_ylabel("Airmass\nat mid-exposure")
    axes.invert_yaxis()
    add_legend(axes, loc="center left", bbox_to_anchor=(1.0, 0.5))


def _draw_shutter(axes: Axes, run: RunTables, log: pl.DataFrame) -> None:
    """Open shutter, and before each exposure the longest of slew, configuration and readout."""
    for survey in log["survey"].unique().sort():
        own = log.filter(survey=survey)
        colour = survey_colours(run)[survey]
        axes.broken_barh(list(own.select("start_h", "length_h").iter_rows()), (0.0, 1.0), color=colour, linewidth=0)
    for number, column in enumerate(PREPARATIONS.values(), start=1):
        hours = log[column] / 3600.0
        axes.broken_barh(
            list(zip(log["start_h"] - hours, hours, strict=True)), (-0.8 * number, 0.6), color=OVERHEAD, linewidth=0
        )
    axes.set_yticks([0.5, *(-0.8 * n + 0.3 for n in range(1, len(PREPARATIONS) + 1))], ["exposing", *PREPARATIONS])
    axes.grid(False, axis="y")


def _draw_moon(axes: Axes, log: pl.DataFrame) -> None:
    middle = log["start_h"] + log["length_h"] / 2
    axes.plot(middle, log["moon_alt_deg"], color=MUTED, linewidth=1.2, marker=".", markersize=3)
    axes.axhline(0.0, color=MUTED, linewidth=0.8)
    axes.set(
        ylabel="Moon's\naltitude (deg)",
        xlabel="Local mean solar time, from midnight (h)",
        ylim=(-90, 90),
        yticks=[-60, 0, 60],
    )


if __name__ == "__main__":
    main(__file__)
