"""A run in numbers: how complete, when, at what cost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from survey_sim.plotting.run import ProgrammeRow, RunTables, Visit, evening_dates

# Configuration time that surveys charge every pointing, s: TAIPAN's own simulator; also the most that TAIPAN requires
# (Goodwin et al. 2014, Table 2).
CONSTANT_S = 300.0
# Activities of the table `time_budget`, in the order in which they are shown.
ACTIVITIES = (
    *("exposing", "reading", "slewing", "configuring", "calibrating"),
    *("weather", "engineering", "idle"),
)
# Quantities of the table `completeness`, each with its words.
QUANTITIES = {
    "year": "By the end of the year",
    "mag": "Magnitude",
    "priority": "Priority",
    "density": "Targets per square degree",
    "latitude": "Galactic latitude (deg)",
}


@dataclass(frozen=True)
class ProgrammeNumbers:
    """A programme's completeness.

    Attributes
    ----------
    done_frac
        Share observed in all wanted visits, or allocated if nothing was scheduled; None without targets.
    reached
        Date (UTC, of the evening) of the night that brought the completeness wanted; None if none did.
    """

    row: ProgrammeRow
    done_frac: float | None
    reached: str | None

    @property
    def is_reached(self) -> bool:
        """Whether the completeness wanted was reached."""
        return self.done_frac is not None and self.row.wanted_frac is not None and self.done_frac >= self.row.wanted_frac


@dataclass(frozen=True)
class SurveyNumbers:
    """Totals of one survey; None where there is nothing to take them from.

    Attributes
    ----------
    waited_h, constant_waited_h
        Time of all pointings spent on configuration alone, beyond slew and readout, which go on meanwhile; and what it would
        be at `CONSTANT_S` a pointing.
    n_short_standard, n_short_sky, n_short_sky_region, n_short_guide
        Visits with fewer fibres than the least acceptable, of each kind; None if that is not known.
    """

    name: str
    n_tile: int
    n_target: int
    n_visit: int
    n_pointing: int
    n_observed: int
    n_leg: int
    travel_km: float
    crossings_mean: float | None
    configuration_median_s: float | None
    configuration_p95_s: float | None
    configuration_max_s: float | None
    filtered_median_s: float | None
    bound_frac: float | None
    within_readout_frac: float | None
    pointing_median_s: float | None
    pointing_p95_s: float | None
    pointing_max_s: float | None
    pointing_within_readout_frac: float | None
    pointing_filtered_median_s: float | None
    pointing_filtered_within_readout_frac: float | None
    waited_h: float | None
    constant_waited_h: float | None
    n_collision: int
    n_unrouted: int
    least_separation_mm: float | None
    n_short_standard: int | None
    n_short_sky: int | None
    n_short_sky_region: int | None
    n_short_guide: int | None


@dataclass(frozen=True)
class NightNumbers:
    """What the nights were spent on, h."""

    n_night: int
    first: str
    last: str
    dark_h: float
    lost_h: float
    exposing_h: float
    overhead_h: float
    engineering_h: float
    n_pointing: int
    n_failed: int

    @property
    def unused_h(self) -> float:
        """Hours neither lost nor spent."""
        return max(0.0, self.dark_h - self.lost_h - self.engineering_h - self.exposing_h - self.overhead_h)


@dataclass(frozen=True)
class Summary:
    """All numbers of a run's page.

    Attributes
    ----------
    nights
        None if none were scheduled.
    budget
        Activity, survey ("" for none) and hours by year.
    bins
        By quantity and programme: lower and upper edge, targets and completeness of each bin.
    """

    programmes: list[ProgrammeNumbers]
    surveys: list[SurveyNumbers]
    nights: NightNumbers | None
    budget: list[tuple[str, str, dict[int, float]]]
    bins: dict[str, dict[str, list[tuple[float, float, int, float]]]]
    visits: dict[str, tuple[Visit, float]]

    @property
    def n_visit(self) -> int:
        """Visits of all surveys."""
        return sum(survey.n_visit for survey in self.surveys)


def summarise(run: RunTables) -> Summary:
    """The numbers of a run."""
    return Summary(
        programmes=[_programme(run, row) for row in run.programmes],
        surveys=[_survey(run, survey) for survey in run.surveys],
        nights=_nights(run),
        budget=_budget(run),
        bins={quantity: _bins(run, quantity) for quantity in QUANTITIES},
        visits=_named_visits(run),
    )


def _programme(run: RunTables, row: ProgrammeRow) -> ProgrammeNumbers:
    done = row.n_observed if run.is_scheduled else row.n_allocated
    return ProgrammeNumbers(row, done / row.n_target if row.n_target else None, _reached(run, row))


def _reached(run: RunTables, row: ProgrammeRow) -> str | None:
    column = f"completeness_frac_{row.name}"
    if row.wanted_frac is None or not row.n_target or column not in run.nights.columns:
        return None
    enough = run.nights.filter(pl.col(column) >= row.wanted_frac)["evening_mjd"]
    return _date(enough[0]) if len(enough) else None


def _survey(run: RunTables, survey: str) -> SurveyNumbers:
    visits, exposures = run.visits.filter(survey=survey), run.exposures.filter(survey=survey)
    paths, tiles = run.paths.filter(survey=survey), run.tiles.filter(survey=survey)
    moving = visits.filter(pl.col("configuration_time_s") > 0)
    time, pointing = moving["configuration_time_s"], exposures["configuration_time_s"]
    pointing_filtered = exposures["configuration_time_p95_s"].drop_nulls()
    travel = run.travel.filter(survey=survey)
    return SurveyNumbers(
        name=survey,
        n_tile=len(tiles),
        n_target=int(tiles["n_target"].sum()),
        n_visit=len(visits),
        n_pointing=len(exposures),
        n_observed=int((exposures["status"] == "observed").sum()),
        n_leg=int(run.leg_counts.get(survey, 0)),
        travel_km=float(travel["travel_mm"].sum()) / 1e6,
        crossings_mean=_number(visits["crossings"].mean()),
        configuration_median_s=_number(time.median()),
        configuration_p95_s=_number(time.quantile(0.95, "linear")),
        configuration_max_s=_number(time.max()),
        filtered_median_s=_number(moving["configuration_time_p95_s"].median()),
        bound_frac=_number((time <= moving["lower_bound_s"] * (1.0 + 1e-6)).mean()),
        within_readout_frac=_share_within(time, run.readout_s),
        pointing_median_s=_number(pointing.median()),
        pointing_p95_s=_number(pointing.quantile(0.95, "linear")),
        pointing_max_s=_number(pointing.max()),
        pointing_within_readout_frac=_share_within(pointing, run.readout_s),
        pointing_filtered_median_s=_number(pointing_filtered.median()),
        pointing_filtered_within_readout_frac=_share_within(pointing_filtered, run.readout_s),
        waited_h=_waited_h(exposures, pl.col("configuration_time_s")),
        constant_waited_h=_waited_h(exposures, pl.lit(CONSTANT_S)),
        n_collision=int(paths["collisions"].sum()),
        n_unrouted=int(paths["unrouted"].sum()),
        least_separation_mm=_number(paths["min_separation_mm"].min()),
        n_short_standard=_n_short(visits, "standard"),
        n_short_sky=_n_short(visits, "sky"),
        n_short_sky_region=_n_short(visits, "sky_region"),
        n_short_guide=_n_short(visits, "guide"),
    )


def _n_short(visits: pl.DataFrame, kind: str) -> int | None:
    """Visits that fall short of a minimum; None where nobody knows."""
    short = visits[f"{kind}_shortfall"].drop_nulls()
    return int((short > 0).sum()) if len(short) else None


def _nights(run: RunTables) -> NightNumbers | None:
    nights = run.nights
    if nights.is_empty():
        return None
    hours = {
        name: float(nights[f"{name}_s"].sum()) / 3600.0 for name in ("dark", "lost", "engineering", "exposing", "overhead")
    }
    return NightNumbers(
        n_night=len(nights),
        first=_date(nights["evening_mjd"][0]),
        last=_date(nights["evening_mjd"][-1]),
        dark_h=hours["dark"],
        lost_h=hours["lost"],
        exposing_h=hours["exposing"],
        overhead_h=hours["overhead"],
        engineering_h=hours["engineering"],
        n_pointing=len(run.exposures),
        n_failed=int((run.exposures["status"] != "observed").sum()),
    )


def _budget(run: RunTables) -> list[tuple[str, str, dict[int, float]]]:
    """Activity, survey ("" for none) and hours by year, of the table `time_budget`."""
    order = {name: place for place, name in enumerate(ACTIVITIES)}
    rows: dict[tuple[int, str, str], dict[int, float]] = {}
    for year, survey, activity, time_s in run.scan("time_budget").collect().iter_rows():
        rows.setdefault((order.get(activity, len(order)), activity, survey or ""), {})[year] = time_s / 3600.0
    return [(activity, survey, hours) for (_, activity, survey), hours in sorted(rows.items())]


def _bins(run: RunTables, quantity: str) -> dict[str, list[tuple[float, float, int, float]]]:
    """By programme: lower and upper edge, targets and completeness of each bin of a quantity."""
    rows = run.scan("completeness").filter(quantity=quantity).collect()
    columns = ("low", "high", "n_target", "completeness_frac")
    return {name[0]: own.select(columns).rows() for name, own in rows.group_by("programme", maintain_order=True)}


def _named_visits(run: RunTables) -> dict[str, tuple[Visit, float]]:
    """Visits worth a look, with their configuration times, s."""
    named = {"slowest": run.slowest_visit, "median": run.median_visit, "most crossings": run.busiest_visit}
    times = {}
    for name, visit in named.items():
        if visit is not None:
            row = run.visits.filter(survey=visit.survey, tile_id=visit.tile_id, visit_id=visit.visit_id)
            times[name] = (visit, float(row["configuration_time_s"].sum()))
    return times


def _waited_h(exposures: pl.DataFrame, configuration_s: pl.Expr) -> float | None:
    if exposures.is_empty():
        return None
    alone = (configuration_s - pl.max_horizontal("slew_s", "readout_s")).clip(lower_bound=0.0)
    return float(exposures.select(alone.sum()).item()) / 3600.0


def _share_within(times: pl.Series, limit_s: float | None) -> float | None:
    return None if limit_s is None else _number((times <= limit_s).mean())


def _number(value: Any) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


def _date(mjd: float) -> str:
    return str(evening_dates(np.array([mjd]))[0])[:10]
