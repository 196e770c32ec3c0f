"""What the schedule came to: completeness by year, magnitude, priority, density and latitude, and where the time went."""

from __future__ import annotations

import polars as pl

from survey_sim.region import abs_galactic_latitude_deg
from survey_sim.tables import conform

# Widths of bins, mag and deg; densities go up by the square root of 2.
MAG_STEP, LATITUDE_STEP = 0.5, 10.0
_DENSITIES_TO_DOUBLE = 2
# Cells in which targets are counted: HEALPix of order 6, 0.9 deg across, by `_healpix_29` of order 29.
_CELL_ORDER, _HEALPIX_ORDER = 6, 29
_CELL_SQ_DEG = 41_252.961_249_419_27 / (12 * 4**_CELL_ORDER)
_PROGRAMME_COLUMN = "completeness_frac_"
_MJD_EPOCH = pl.date(1858, 11, 17)


def make_completeness(targets: pl.DataFrame, status: pl.DataFrame, nights: pl.DataFrame) -> pl.DataFrame:
    """Table `completeness`.

    Parameters
    ----------
    targets
        Science targets; those of `status`.
    status
        Table `target_status`.
    nights
        Table `nights`.
    """
    cell = pl.col("_healpix_29").cast(pl.Int64) // 4 ** (_HEALPIX_ORDER - _CELL_ORDER)
    latitude = abs_galactic_latitude_deg(targets["ra_deg"].to_numpy(), targets["dec_deg"].to_numpy())
    science = targets.select(
        "target_id",
        "programme",
        "survey",
        "mag",
        "priority",
        density=pl.len().over("survey", cell) / _CELL_SQ_DEG,
        latitude=pl.Series(latitude),
    )
    science = science.join(status.select("target_id", is_complete=pl.col("reason").is_null()), on="target_id")
    steps = pl.col("density").log(2.0) * _DENSITIES_TO_DOUBLE
    found = [
        _counted(science, "all", pl.lit(0), pl.lit(None), pl.lit(None)),
        _by_year(science, nights),
        _counted(science, "mag", (pl.col("mag") / MAG_STEP).floor(), *_edges(MAG_STEP)),
        _counted(science, "priority", pl.col("priority"), *_edges(1.0)),
        _counted(science, "density", steps.floor(), *(2.0 ** (e / _DENSITIES_TO_DOUBLE) for e in _edges(1.0))),
        _counted(science, "latitude", (pl.col("latitude") / LATITUDE_STEP).floor(), *_edges(LATITUDE_STEP)),
    ]
    return conform(
        pl.concat(found).with_columns(completeness_frac=pl.col("n_complete") / pl.col("n_target")), "completeness"
    )


def make_time_budget(exposures: pl.DataFrame, nights: pl.DataFrame) -> pl.DataFrame:
    """Table `time_budget`, of tables `exposures` and `nights`; what goes on at once is counted once.

    Readout goes first, since it is always paid; then what the slew takes beyond it, then what the robots take beyond both.
    """
    nights = nights.with_columns(year=_year())
    spent = exposures.join(nights.select("night", "year"), on="night", how="left", maintain_order="left")
    until = [pl.min_horizontal(name, "overhead_s") for name in ("readout_s", "slew_s", "configuration_time_s")]
    until = [pl.max_horizontal(*until[: n + 1]) for n in range(len(until))] + [pl.col("overhead_s")]
    own = {
        "exposing": pl.col("exposure_s"),
        "reading": until[0],
        "slewing": until[1] - until[0],
        "configuring": until[2] - until[1],
        "calibrating": until[3] - until[2],
    }
    used = pl.col("lost_s", "engineering_s", "exposing_s", "overhead_s")
    nobody = {
        "weather": pl.col("lost_s"),
        "engineering": pl.col("engineering_s"),
        "idle": (pl.col("dark_s") - pl.sum_horizontal(used)).clip(lower_bound=0.0),
    }
    by_survey = spent.group_by("year", "survey", maintain_order=True).agg(**{k: v.sum() for k, v in own.items()})
    by_nobody = nights.group_by("year", maintain_order=True).agg(**{k: v.sum() for k, v in nobody.items()})
    found = [
        frame.unpivot(list(activities), index=["year", "survey"], variable_name="activity", value_name="time_s")
        for frame, activities in (
            (by_survey, own),
            (by_nobody.with_columns(survey=pl.lit(None, dtype=pl.String)), nobody),
        )
    ]
    return conform(pl.concat(found), "time_budget")


def _edges(step: float) -> tuple[pl.Expr, pl.Expr]:
    return pl.col("bin") * step, (pl.col("bin") + 1) * step


def _counted(science: pl.DataFrame, quantity: str, place: pl.Expr, low: pl.Expr, high: pl.Expr) -> pl.DataFrame:
    """Targets and complete ones of each programme in each bin."""
    groups = science.with_columns(bin=place.cast(pl.Float64)).filter(pl.col("bin").is_not_null())
    counts = groups.group_by("programme", "survey", "bin").agg(n_target=pl.len(), n_complete=pl.col("is_complete").sum())
    return _rows(counts, quantity, low, high)


def _by_year(science: pl.DataFrame, nights: pl.DataFrame) -> pl.DataFrame:
    """Complete ones of each programme by the end of each year."""
    total = science.group_by("programme", "survey").agg(n_target=pl.len())
    names = [name for name in nights.columns if name.startswith(_PROGRAMME_COLUMN)]
    ends = nights.sort("night").with_columns(bin=_year().cast(pl.Float64)).group_by("bin").agg(pl.col(names).last())
    shares = ends.unpivot(names, index="bin", variable_name="programme", value_name="share")
    counts = shares.with_columns(pl.col("programme").str.strip_prefix(_PROGRAMME_COLUMN)).join(total, on="programme")
    counts = counts.with_columns(n_complete=(pl.col("share") * pl.col("n_target")).round().cast(pl.UInt32))
    return _rows(counts, "year", *_edges(1.0))


def _rows(counts: pl.DataFrame, quantity: str, low: pl.Expr, high: pl.Expr) -> pl.DataFrame:
    return counts.select(
        "programme",
        "survey",
        pl.lit(quantity).alias("quantity"),
        low.cast(pl.Float64).alias("low"),
        high.cast(pl.Float64).alias("high"),
        pl.col("n_target").cast(pl.Int32),
        pl.col("n_complete").cast(pl.Int32),
    )


def _year() -> pl.Expr:
    """Year of a night's evening."""
    return (_MJD_EPOCH + pl.duration(days=pl.col("evening_mjd").floor().cast(pl.Int64))).dt.year()
