"""The measures by which scenarios are compared, of one run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from survey_sim.plotting import RunTables, Summary, summarise
from survey_sim.plotting.summary import ProgrammeNumbers, SurveyNumbers

ALL = "all"
_YEAR_NIGHTS = 365
# Units by the ending of a measure's name, and the words of each measure.
_UNITS = {"_frac": "", "_s": "s", "_mm": "mm", "_km": "km", "_h": "h", "_d": "d"}


class Measure(NamedTuple):
    """A measure of a programme, a survey or the whole run; no value: NaN."""

    of: str
    name: str
    value: float


def unit_of(measure: str) -> str:
    """Unit of a measure, by its name's ending; none for numbers and shares."""
    return next((unit for ending, unit in _UNITS.items() if measure.endswith(ending)), "")


def measure_run(run: RunTables) -> pl.DataFrame:
    """All measures of a run: of, measure, unit, value."""
    summary = summarise(run)
    found = [
        *(measure for programme in summary.programmes for measure in _of_programme(run, programme)),
        *(measure for survey in summary.surveys for measure in _of_survey(run, survey)),
        *_of_nights(summary),
    ]
    values = [None if not np.isfinite(measure.value) else float(measure.value) for measure in found]
    return pl.DataFrame(
        {
            "of": [measure.of for measure in found],
            "measure": [measure.name for measure in found],
            "unit": [unit_of(measure.name) for measure in found],
            "value": pl.Series(values, dtype=pl.Float64),
        }
    )


def _of_programme(run: RunTables, programme: ProgrammeNumbers) -> Iterator[Measure]:
    row = programme.row
    yield Measure(row.name, "completeness_frac", _number(programme.done_frac))
    yield Measure(row.name, "allocated_frac", row.n_allocated / row.n_target if row.n_target else np.nan)
    column = f"completeness_frac_{row.name}"
    if not row.n_target or column not in run.nights.columns:
        return
    curve = run.nights[column].to_numpy()
    yield Measure(row.name, "completeness_half_time_frac", curve[(len(curve) - 1) // 2])
    for year in range(1, len(curve) // _YEAR_NIGHTS + 1):
        yield Measure(row.name, f"completeness_year_{year}_frac", curve[year * _YEAR_NIGHTS - 1])
    if row.wanted_frac is not None:
        reached = np.flatnonzero(curve >= row.wanted_frac)
        yield Measure(row.name, "wanted_reached_after_d", reached[0] + 1 if len(reached) else np.nan)


def _of_survey(run: RunTables, survey: SurveyNumbers) -> Iterator[Measure]:
    visits = run.visits.filter(survey=survey.name)
    moving = visits.filter(pl.col("configuration_time_s") > 0)
    to_target = run.paths.filter(survey=survey.name, path="start_to_target")
    filtered = moving["configuration_time_p95_s"]
    for name, value in {
        "n_visit": survey.n_visit,
        "n_tile": survey.n_tile,
        "science_per_visit": visits["n_science"].mean(),
        "n_pointing": survey.n_pointing,
        "n_pointing_observed": survey.n_observed,
        "configuration_median_s": survey.configuration_median_s,
        "configuration_p95_s": survey.configuration_p95_s,
        "configuration_max_s": survey.configuration_max_s,
        "configuration_95_filter_median_s": survey.filtered_median_s,
        "within_readout_frac": survey.within_readout_frac,
        "within_readout_95_filter_frac": None if run.readout_s is None else (filtered <= run.readout_s).mean(),
        "pointing_configuration_median_s": survey.pointing_median_s,
        "pointing_configuration_p95_s": survey.pointing_p95_s,
        "pointing_configuration_max_s": survey.pointing_max_s,
        "pointing_configuration_95_filter_median_s": survey.pointing_filtered_median_s,
        "pointing_within_readout_frac": survey.pointing_within_readout_frac,
        "pointing_within_readout_95_filter_frac": survey.pointing_filtered_within_readout_frac,
        "bound_ratio_mean": (moving["configuration_time_s"] / moving["lower_bound_s"]).mean(),
        "at_bound_frac": survey.bound_frac,
        "travel_mean_mm": visits["travel_mean_mm"].mean(),
        "travel_max_median_mm": visits["travel_max_mm"].median(),
        "crossings_mean": survey.crossings_mean,
        "n_unrouted": to_target["unrouted"].sum(),
        "configuration_alone_h": survey.waited_h,
    }.items():
        yield Measure(survey.name, name, _number(value))


def _of_nights(summary: Summary) -> Iterator[Measure]:
    nights = summary.nights
    if nights is None:
        return
    for name, value in {
        "dark_h": nights.dark_h,
        "weather_lost_h": nights.lost_h,
        "exposing_h": nights.exposing_h,
        "overhead_h": nights.overhead_h,
        "unused_h": nights.unused_h,
        "n_pointing": nights.n_pointing,
        "n_pointing_failed": nights.n_failed,
    }.items():
        yield Measure(ALL, name, _number(value))


def _number(value: Any) -> float:
    return np.nan if value is None else float(value)
