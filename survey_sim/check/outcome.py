"""What the schedule came to: completeness in bins, and where the time went, added up again."""

import numpy as np
import polars as pl

from survey_sim.check.faults import FaultLog
from survey_sim.check.inputs import Run

TIME_S = 1e-3
# North Galactic pole, ICRS, deg (Hipparcos catalogue, volume 1, section 1.5.3).
_POLE_DEG = (192.85948, 27.12825)
_NSIDE = 64
_SKY_SQ_DEG = 360.0**2 / np.pi
# Activities in which the time before the shutter opens is spent, in the order in which it is counted.
_BEFORE = {"reading": "readout_s", "slewing": "slew_s", "configuring": "configuration_time_s"}
# A target so near to the edge of a bin may be in either: rounding.
_EDGE = 1e-9


def check_outcome(log: FaultLog, run: Run) -> None:
    """`time_budget` and `completeness`, as far as the run has them."""
    nights, exposures, status = (run.optional.get(table) for table in ("nights", "exposures", "target_status"))
    if nights is None or exposures is None or status is None:
        return
    nights = nights.with_columns(year=_year(nights))
    if (budget := run.optional.get("time_budget")) is not None:
        _check_budget(log, budget, nights, exposures)
    if (completeness := run.optional.get("completeness")) is not None:
        _check_completeness(log, completeness, nights, status, run)


def _year(nights: pl.DataFrame) -> pl.Series:
    days = np.floor(nights["evening_mjd"].to_numpy()).astype("timedelta64[D]")
    years = (np.datetime64("1858-11-17") + days).astype("datetime64[Y]").astype(np.int64) + 1970
    return pl.Series("year", years, dtype=pl.Int16)


def _check_budget(log: FaultLog, budget: pl.DataFrame, nights: pl.DataFrame, exposures: pl.DataFrame) -> None:
    """Each activity again, one pointing and night at a time; and all activities of a year fill its nights."""
    rows: dict[tuple[int, str | None, str], float] = {}
    year_of = dict(nights.select("night", "year").iter_rows())
    for exposure in exposures.iter_rows(named=True):
        key = (year_of.get(exposure["night"], 0), exposure["survey"])
        done = 0.0
        for activity, column in _BEFORE.items():
            until = max(done, min(exposure[column], exposure["overhead_s"]))
            rows[*key, activity] = rows.get((*key, activity), 0.0) + until - done
            done = until
        rest = {"calibrating": exposure["overhead_s"] - done, "exposing": exposure["exposure_s"]}
        for activity, spent in rest.items():
            rows[*key, activity] = rows.get((*key, activity), 0.0) + spent
    for night in nights.iter_rows(named=True):
        left = night["dark_s"] - night["lost_s"] - night["engineering_s"] - night["exposing_s"] - night["overhead_s"]
        for activity, spent in (
            ("weather", night["lost_s"]),
            ("engineering", night["engineering_s"]),
            ("idle", max(left, 0.0)),
        ):
            rows[night["year"], None, activity] = rows.get((night["year"], None, activity), 0.0) + spent
    schema = {"year": pl.Int16, "survey": pl.String, "activity": pl.String, "own_time_s": pl.Float64}
    own = pl.DataFrame([(*key, spent) for key, spent in rows.items()], schema=schema, orient="row")
    _compare(log, "time_budget", budget, own, ["year", "survey", "activity"], {"time_s": TIME_S})


def _check_completeness(log: FaultLog, given: pl.DataFrame, nights: pl.DataFrame, status: pl.DataFrame, run: Run) -> None:
    """Targets and complete ones of each bin, counted again; `completeness_frac` is their share."""
    share = given.with_columns(own_completeness_frac=pl.col("n_complete") / pl.col("n_target"))
    log.compare("completeness", "completeness", share, {"completeness_frac": _EDGE})
    science = run.targets.filter(pl.col("kind") == "science").join(
        status.select("target_id", is_complete=pl.col("reason").is_null()), on="target_id", maintain_order="left"
    )
    science = science.with_columns(
        density=pl.len().over("survey", pl.col("_healpix_29") // 2**46) * (12 * _NSIDE**2 / _SKY_SQ_DEG),
        latitude=pl.Series(_latitude_deg(science)),
    )
    ends = nights.sort("night").group_by("year", maintain_order=True).last()
    year_of = {row["year"]: row for row in ends.iter_rows(named=True)}
    columns = {name: science[name].cast(pl.Float64) for name in ("mag", "priority", "density", "latitude")}
    counts: list[tuple[int, ...]] = []
    for row in given.iter_rows(named=True):
        own = science["programme"] == row["programme"]
        quantity, low, high = row["quantity"], row["low"], row["high"]
        n_target, n_complete = int(own.sum()), 0
        if quantity == "year":
            share_then = year_of.get(int(low), {}).get(f"completeness_frac_{row['programme']}", 0.0)
            n_complete = round(share_then * n_target)
            counts.append((n_target, n_target, n_complete, n_complete))
            continue
        inner = outer = own
        if quantity in columns:
            value, edge = columns[quantity], 0.0 if quantity == "priority" else _EDGE * max(abs(low), 1.0)
            inner = own & (value >= low + edge) & (value < high - edge)
            outer = own & (value >= low - edge) & (value < high + edge)
        n_complete = int((inner & science["is_complete"]).fill_null(value=False).sum())
        most = int((outer & science["is_complete"]).fill_null(value=False).sum())
        in_bin = [int(some.fill_null(value=False).sum()) for some in (inner, outer)]
        counts.append((*in_bin, n_complete, most))
    schema = dict.fromkeys(("least_target", "most_target", "least_complete", "most_complete"), pl.Int64)
    counted = given.hstack(pl.DataFrame(counts, schema=schema, orient="row"))
    for counted_name, low_name, high_name in (
        ("n_target", "least_target", "most_target"),
        ("n_complete", "least_complete", "most_complete"),
    ):
        wrong = counted.filter(~pl.col(counted_name).is_between(pl.col(low_name), pl.col(high_name)))
        detail = pl.format(f"{counted_name} of {{}}, {{}} is not what is counted", "programme", "quantity")
        log.add("completeness", "completeness", wrong, detail, value=pl.col(counted_name), limit=pl.col(low_name))
    _check_whole(log, given, science)


def _check_whole(log: FaultLog, given: pl.DataFrame, science: pl.DataFrame) -> None:
    """The bins of each quantity hold all targets of each programme that have the quantity, once."""
    total = science.group_by("programme").agg(
        pl.len().alias("all"),
        pl.col("mag").count().alias("mag"),
        *(pl.len().alias(q) for q in ("priority", "density", "latitude")),
    )
    wanted = total.unpivot(index="programme", variable_name="quantity", value_name="n_wanted").filter(pl.col("n_wanted") > 0)
    held = given.group_by("programme", "quantity").agg(n_held=pl.col("n_target").sum())
    both = wanted.join(held, on=["programme", "quantity"], how="left", maintain_order="left")
    wrong = both.filter(pl.col("n_held").fill_null(0) != pl.col("n_wanted"))
    detail = pl.format("bins of {}, {} do not hold every target once", "programme", "quantity")
    log.add("completeness", "completeness", wrong, detail, value=pl.col("n_held"), limit=pl.col("n_wanted"))


def _latitude_deg(targets: pl.DataFrame) -> np.ndarray:
    ra, dec = (np.radians(targets[name].to_numpy()) for name in ("ra_deg", "dec_deg"))
    pole_ra, pole_dec = np.radians(_POLE_DEG)
    sine = np.sin(dec) * np.sin(pole_dec) + np.cos(dec) * np.cos(pole_dec) * np.cos(ra - pole_ra)
    return np.abs(np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0))))


def _compare(
    log: FaultLog, table: str, given: pl.DataFrame, own: pl.DataFrame, key: list[str], columns: dict[str, float]
) -> None:
    """Rows of a table against those derived here: the same rows, the same figures."""
    both = given.join(own, on=key, how="inner", nulls_equal=True, maintain_order="left")
    log.compare(table, table, both, columns)
    extra = given.join(own, on=key, how="anti", nulls_equal=True, maintain_order="left")
    log.add(table, table, extra, pl.format("a row for nothing: {}", pl.col(key[-1])))
    lacking = own.join(given, on=key, how="anti", nulls_equal=True, maintain_order="left")
    log.add(table, table, lacking, pl.format("row is missing: {}", pl.col(key[-1])))
