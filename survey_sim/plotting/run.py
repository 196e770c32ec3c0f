"""A run as figures see it: each table read once, only the columns that are drawn, large tables only in aggregate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import polars as pl
from scipy.spatial import cKDTree

from survey_sim import tables
from survey_sim.errors import InputError
from survey_sim.geometry import unit_vectors

VISIT_KEY = ("survey", "tile_id", "visit_id")
_MJD_EPOCH = np.datetime64("1858-11-17T00:00:00", "us")
_DAY_US = 86_400_000_000
# Width of the bins in which robots' travel is counted, mm.
TRAVEL_BIN_MM = 1.0


class Visit(NamedTuple):
    """Key of one visit."""

    survey: str
    tile_id: int
    visit_id: int

    @property
    def label(self) -> str:
        """The key in words."""
        return f"{self.survey}, tile {self.tile_id}, visit {self.visit_id}"


@dataclass(frozen=True)
class ProgrammeRow:
    """A science programme: what it wants, and what it got.

    Attributes
    ----------
    wanted_frac
        Completeness wanted; None if the run does not say.
    n_target, n_allocated, n_observed
        Its targets; those with robots in all wanted visits; those observed in all wanted visits.
    """

    name: str
    survey: str
    wanted_frac: float | None
    n_target: int
    n_allocated: int
    n_observed: int


class RunTables:
    """Tables and record of one run, read when first asked for; a table that the run lacks is empty (but targets).

    Parameters
    ----------
    folder
        The run's folder.

    Raises
    ------
    InputError
        There is no readable run.json in it, or (when it is read) a table is not sound.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.record: dict[str, Any] = _read_record(folder)

    def setting(self, *keys: str) -> Any:
        """A setting of the pipeline by its path of keys; None where the run has none."""
        value: Any = self.record.get("settings", {})
        for key in keys:
            value = value.get(key) if isinstance(value, dict) else None
        return value

    @property
    def name(self) -> str:
        """The run's name."""
        return str(self.record.get("name", self.folder.name))

    @property
    def instrument(self) -> dict[str, Any]:
        """Constants of the instrument."""
        return dict(self.record.get("instrument", {}))

    @property
    def field_radius_deg(self) -> float:
        """Radius of the plate on the sky, deg."""
        return float(self.instrument["plate_radius_mm"] * self.instrument["plate_scale_arcsec_mm"] / 3600.0)

    @property
    def readout_s(self) -> float | None:
        """Readout time of the CCD, s; None if the run has no schedule."""
        value = self.setting("schedule", "telescope", "readout_s")
        return None if value is None else float(value)

    def scan(self, table: str) -> pl.LazyFrame:
        """A table, lazily."""
        if not tables.files(self.folder, table):
            return tables.empty(table).lazy()
        return tables.scan(self.folder, table)

    def has(self, table: str) -> bool:
        """Whether the run has a table."""
        return bool(tables.files(self.folder, table))

    @cached_property
    def visits(self) -> pl.DataFrame:
        """Table `visits`."""
        return self.scan("visits").collect()

    @cached_property
    def paths(self) -> pl.DataFrame:
        """Table `paths`, those on which nobody moves left out."""
        return self.scan("paths").filter(pl.col("configuration_time_s") > 0).collect()

    @property
    def least_separation_mm(self) -> float | None:
        """Least distance between two robots at any instant of any path, mm; None without paths."""
        return None if self.paths.is_empty() else float(self.paths["min_separation_mm"].to_numpy().min())

    @cached_property
    def tiles(self) -> pl.DataFrame:
        """Table `tiles`, and of each tile's targets how many are complete: `n_allocated`, `n_observed`."""
        done = self.science.group_by("survey", "tile_id").agg(
            n_allocated=pl.col("is_allocated").sum(), n_observed=pl.col("is_observed").sum()
        )
        joined = self.scan("tiles").collect().join(done, on=["survey", "tile_id"], how="left", maintain_order="left")
        return joined.with_columns(pl.col("n_allocated", "n_observed").fill_null(0))

    @cached_property
    def nearest_complete(self) -> pl.DataFrame:
        """By tile, as `tiles` lists them: `n_target` targets to which its centre is the nearest, `n_done` of them complete.

        A target's home may be another tile that reaches it too (pooled visits): maps of the sky are of where targets are.
        """
        parts = [pl.DataFrame(schema={"survey": pl.String, "n_target": pl.Int64, "n_done": pl.Int64})]
        for (survey,), tiles in self.tiles.partition_by("survey", as_dict=True, maintain_order=True).items():
            targets = self.science.filter(survey=survey)
            sky = (unit_vectors(rows["ra_deg"].to_numpy(), rows["dec_deg"].to_numpy()) for rows in (tiles, targets))
            nearest = np.asarray(cKDTree(next(sky)).query(next(sky))[1])
            is_done = targets["is_observed" if self.is_scheduled else "is_allocated"].to_numpy()
            counts = {"n_target": nearest, "n_done": nearest[is_done]}
            counted = {name: np.bincount(rows, minlength=len(tiles)) for name, rows in counts.items()}
            parts.append(pl.DataFrame({"survey": [survey] * len(tiles), **counted}))
        return pl.concat(parts)

    @cached_property
    def robots(self) -> pl.DataFrame:
        """Table `robots`."""
        return self.scan("robots").collect()

    @cached_property
    def exposures(self) -> pl.DataFrame:
        """Table `exposures`, with `configuration_time_p95_s`; null where a constant stands for the robots' path."""
        filtered = self.scan("exposure_paths").select("exposure_id", "configuration_time_p95_s")
        return self.scan("exposures").join(filtered, on="exposure_id", how="left", maintain_order="left").collect()

    @cached_property
    def nights(self) -> pl.DataFrame:
        """Table `nights`."""
        return self.scan("nights").collect()

    @property
    def is_scheduled(self) -> bool:
        """Whether the run has a schedule, be it of no night."""
        return self.has("nights")

    @cached_property
    def science(self) -> pl.DataFrame:
        """Science targets with what became of them: `is_allocated`, `is_observed` (all wanted visits), `reason`."""
        is_science = pl.col("kind") == "science"
        columns = ("target_id", "survey", "programme", "tile_id", "ra_deg", "dec_deg", "mag", "wanted_visits")
        targets = tables.scan(self.folder, "targets").filter(is_science).select(columns).collect()
        reached = self.scan("allocations").filter(is_science).select("target_id").collect()["target_id"].to_numpy()
        status = self.scan("target_status").select("target_id", "reason").collect()
        # A target's number is its place among all: looking it up is much cheaper than a join of millions.
        target_id = targets["target_id"].to_numpy()
        n_id = int(target_id.max(initial=-1)) + 1
        n_visit = np.bincount(reached, minlength=n_id)[target_id]
        row = np.full(n_id, len(status))
        row[status["target_id"].to_numpy()] = np.arange(len(status))
        row = row[target_id]
        reason = pl.concat([status["reason"], pl.Series("reason", [None], dtype=pl.String)]).cast(pl.Categorical)[row]
        return targets.select(
            "survey",
            pl.col("programme").fill_null("science").cast(pl.Categorical),
            "tile_id",
            "ra_deg",
            "dec_deg",
            "mag",
            is_allocated=pl.Series(n_visit) >= pl.max_horizontal("wanted_visits", 1),
            is_observed=pl.Series(row < len(status)) & reason.is_null(),
            reason=reason,
        )

    @cached_property
    def surveys(self) -> list[str]:
        """Names of the surveys, in alphabetical order."""
        return self.robots["survey"].unique().sort().to_list()

    @cached_property
    def programmes(self) -> list[ProgrammeRow]:
        """Science programmes, by survey and then as the pipeline lists them."""
        counts = self.science.group_by("survey", "programme").agg(
            pl.len(), pl.col("is_allocated").sum(), pl.col("is_observed").sum()
        )
        counted = {row[1]: row for row in counts.sort("survey", "programme").iter_rows()}
        settings = {p["name"]: p for p in self.setting("programme") or [] if p.get("kind") == "science"}
        rows = []
        for name in [*settings, *(name for name in counted if name not in settings)]:
            given = settings.get(name, {})
            survey, _, *numbers = counted.get(name, (given.get("survey"), name, 0, 0, 0))
            rows.append(ProgrammeRow(name, survey, given.get("completeness_frac"), *numbers))
        return sorted(rows, key=lambda row: row.survey)

    @cached_property
    def lost_counts(self) -> pl.DataFrame:
        """Targets not complete by survey, programme and reason: `n_target`; allocation's reasons without a schedule."""
        lost = self.science.filter(pl.col("reason").is_not_null()).select(
            "survey", "programme", pl.col("reason").cast(pl.String)
        )
        if not self.is_scheduled:
            own = self.scan("targets").select("target_id", "survey", pl.col("programme").fill_null("science"))
            lost = self.scan("unallocated").select("target_id", "reason").join(own, on="target_id").collect()
        counts = lost.with_columns(pl.col("programme").cast(pl.String)).group_by("survey", "programme", "reason")
        return counts.agg(n_target=pl.len()).sort("survey", "programme", "reason")

    @cached_property
    def robot_outcomes(self) -> pl.DataFrame:
        """Robots on all paths by survey, path and reason: `n_robot`, and sums of their turning, moving and waiting, s."""
        times = ("rotating_s", "moving_s", "waiting_s")
        grouped = (
            self.scan("robot_times").group_by("survey", "path", "reason").agg(pl.len().alias("n_robot"), pl.sum(*times))
        )
        return grouped.collect(engine="streaming").sort("survey", "path", "reason")

    @cached_property
    def travel_counts(self) -> pl.DataFrame:
        """Robots that travel, by survey, visit and bin of straight distance: `bin` (of `TRAVEL_BIN_MM`), `n_robot`."""
        travelled = self.scan("allocations").filter(pl.col("travel_mm") > 0)
        binned = travelled.select("survey", "visit_id", bin=(pl.col("travel_mm") / TRAVEL_BIN_MM).floor().cast(pl.Int32))
        grouped = binned.group_by("survey", "visit_id", "bin").agg(n_robot=pl.len())
        return grouped.collect(engine="streaming").sort("survey", "visit_id", "bin")

    @cached_property
    def travel(self) -> pl.DataFrame:
        """Straight travel of all robots in all visits by survey: `travel_mm`."""
        return self.scan("allocations").group_by("survey").agg(pl.col("travel_mm").sum()).collect(engine="streaming")

    @cached_property
    def leg_counts(self) -> dict[str, int]:
        """Number of legs by survey."""
        counts = self.scan("legs").group_by("survey").agg(pl.len()).collect(engine="streaming")
        return dict(counts.iter_rows())

    @property
    def shown_visit(self) -> Visit | None:
        """The visit whose plate is drawn: the one set in `[report]`, else the busiest."""
        chosen = self.setting("report", "plate")
        return Visit(*chosen) if chosen else self.busiest_visit

    @cached_property
    def busiest_visit(self) -> Visit | None:
        """The visit with the most crossings, and of those the one with the most robots on targets."""
        used = pl.col("n_science") + pl.col("n_standard") + pl.col("n_sky") + pl.col("n_guide")
        order = self.visits.with_columns(used=used).sort(
            "crossings", "used", *VISIT_KEY, descending=[True, True, False, False, False]
        )
        return Visit(*order.select(VISIT_KEY).row(0)) if len(order) else None

    @property
    def slowest_visit(self) -> Visit | None:
        """The visit whose configuration takes longest."""
        order = self.visits.sort("configuration_time_s", *VISIT_KEY, descending=[True, False, False, False])
        return Visit(*order.select(VISIT_KEY).row(0)) if len(order) else None

    @property
    def median_visit(self) -> Visit | None:
        """The visit of median configuration time."""
        order = self.visits.sort("configuration_time_s", *VISIT_KEY)
        return Visit(*order.select(VISIT_KEY).row(len(order) // 2)) if len(order) else None

    def rows_of(self, table: str, visit: Visit) -> pl.DataFrame:
        """Rows of one visit of a table; parts whose footers rule it out are not read."""
        wanted = (pl.col(name) == value for name, value in zip(VISIT_KEY, visit, strict=True))
        return self.scan(table).filter(*wanted).collect()


def evening_dates(evening_mjd: npt.NDArray[np.float64]) -> npt.NDArray[np.datetime64]:
    """(n,) instants of modified Julian dates, UTC."""
    return _MJD_EPOCH + (np.asarray(evening_mjd) * _DAY_US).astype("timedelta64[us]")


def _read_record(folder: Path) -> dict[str, Any]:
    record = tables.read_record(folder)
    if "instrument" not in record:
        raise InputError("is not the record of a run", file=folder / "run.json", remedy="run the pipeline again")
    return record
