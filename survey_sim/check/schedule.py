"""Tables of the whole survey: targets of tiles, the telescope's pointings, nights, and what became of each target."""

import polars as pl

from survey_sim.check.exposures import check_paid
from survey_sim.check.faults import Fault, FaultLog
from survey_sim.check.inputs import Run
from survey_sim.check.relations import TILE, VISIT, check_refers

DAY_S = 86400.0
# An MJD in double precision is good to 1 us; a night's sums of seconds to much better than this.
CLOCK_S = 1e-3
# The telescope counts in whole minutes between the twilights, which are known to the second.
MINUTE_S = 60.0
_FRAC = 1e-9
_PROGRAMME_COLUMN = "completeness_frac_"
_OVERHEADS = ("slew_s", "readout_s", "configuration_time_s")


def check_tiles(log: FaultLog, run: Run) -> None:
    """`n_target` counts the science targets at home in the tile; science targets want a visit, of a tile that exists."""
    science = run.targets.filter(pl.col("kind") == "science")
    own = science.group_by(TILE).agg(own_n_target=pl.len().cast(pl.Int32))
    tiles = run.tiles.join(own, on=TILE, how="left", maintain_order="left").with_columns(pl.col("own_n_target").fill_null(0))
    log.compare("tiles", "tiles", tiles, {"n_target": 0.0})
    check_refers(log, run.targets.filter(pl.col("tile_id").is_not_null()), "targets", run.tiles, "tiles", TILE)
    wantless = science.filter(pl.col("wanted_visits") < 1)
    log.add("schema", "targets", wantless, pl.format("science target {} wants no visit", "target_id"))


def check_schedule(log: FaultLog, run: Run, reached: pl.DataFrame, held: pl.DataFrame | None) -> None:
    """Pointings, nights and target status, as far as the run has them.

    Parameters
    ----------
    reached
        visit_row and target_id of every row that holds a science target.
    held
        exposure_id and target_id of every robot that held a science target at a pointing; None if robots were not
        followed: they held those of the visit.
    """
    exposures, status = run.optional.get("exposures"), run.optional.get("target_status")
    if exposures is None:
        observed = reached.with_columns(night=pl.lit(None, pl.Int32))
    else:
        exposures = exposures.join(run.visits.select(*VISIT, "visit_row"), on=VISIT, how="left").sort("exposure_id")
        _check_order(log, exposures, run)
        if run.schedule.configuration_s is not None:
            own = exposures.with_columns(own_configuration_time_s=pl.lit(run.schedule.configuration_s))
            log.compare("exposures", "exposures", own, {"configuration_time_s": CLOCK_S}, "read from the settings")
        elif (paths := run.optional.get("exposure_paths")) is not None:
            check_paid(log, exposures, paths)
        seen = exposures.filter(pl.col("status") == "observed").select("visit_row", "exposure_id", "night")
        observed = reached.join(seen, on="visit_row") if held is None else held.join(seen, on="exposure_id")
    observed = observed.join(run.targets.select("target_id", "programme", "wanted_visits"), on="target_id")
    nights = run.optional.get("nights")
    if nights is not None and exposures is not None:
        _check_nights(log, nights, exposures)
        _check_completeness(log, nights, observed, status, run)
    if status is not None:
        _check_status(log, status, observed, run)


def _check_order(log: FaultLog, exposures: pl.DataFrame, run: Run) -> None:
    """Pointings name visits and follow each other; between two open shutters there is time for what comes between."""
    check_refers(log, exposures, "exposures", run.visits, "visits", VISIT)
    name = pl.format("exposure {}", "exposure_id")
    counted = exposures.with_columns(place=pl.int_range(pl.len()), last_night=pl.col("night").shift(1))
    miscounted = counted.filter(pl.col("exposure_id") != pl.col("place"))
    log.add("exposures", "exposures", miscounted, pl.format("{} is not counted from 0 without gaps", name))
    backward = counted.filter(pl.col("night") < pl.col("last_night"))
    log.add("exposures", "exposures", backward, pl.format("{} is of an earlier night than the last", name))
    opened = counted.filter(pl.col("exposure_s") > 0).with_columns(
        gap_s=(pl.col("start_mjd") - pl.col("start_mjd").shift(1)) * DAY_S - pl.col("exposure_s").shift(1),
        is_same_night=pl.col("night") == pl.col("night").shift(1),
    )
    gap = pl.col("gap_s")
    overlap = opened.filter(gap < -CLOCK_S)
    log.add("exposures", "exposures", overlap, pl.format("{} begins before the last one ends", name), value=gap, limit=0.0)
    needed = pl.max_horizontal(_OVERHEADS)
    hasty = opened.filter(pl.col("is_same_night") & (gap >= -CLOCK_S) & (gap < needed - CLOCK_S))
    detail = pl.format("{} begins before slew, readout and configuration can end", name)
    log.add("exposures", "exposures", hasty, detail, value=gap, limit=needed)


def _check_nights(log: FaultLog, nights: pl.DataFrame, exposures: pl.DataFrame) -> None:
    """Nights hold their pointings and count them."""
    check_refers(log, exposures, "exposures", nights, "nights", ["night"])
    day = exposures.join(nights.select("night", "evening_mjd"), on="night", how="inner", maintain_order="left")
    since = pl.col("start_mjd") - pl.col("evening_mjd")
    outside = day.filter((since < 0) | (since >= 1))
    detail = pl.format("exposure {} is outside its night {}", "exposure_id", "night")
    log.add("nights", "exposures", outside, detail, value=pl.col("start_mjd"), limit=pl.col("evening_mjd"))
    own = exposures.group_by("night").agg(
        own_n_exposure=pl.len().cast(pl.Int32),
        own_exposing_s=pl.col("exposure_s").sum(),
        own_overhead_s=pl.col("overhead_s").sum(),
    )
    counted = nights.join(own, on="night", how="left", maintain_order="left")
    counted = counted.with_columns(pl.col("^own_.*$").fill_null(0))
    log.compare("nights", "nights", counted, {"n_exposure": 0.0, "exposing_s": CLOCK_S, "overhead_s": CLOCK_S})
    clear = pl.col("dark_s") - pl.col("lost_s")
    beyond = nights.filter(pl.col("engineering_s") + pl.col("exposing_s") + pl.col("overhead_s") > clear + MINUTE_S)
    log.add("nights", "nights", beyond, "more time is spent than is clear", value=clear)


def _check_completeness(
    log: FaultLog, nights: pl.DataFrame, observed: pl.DataFrame, status: pl.DataFrame | None, run: Run
) -> None:
    """Completeness of each programme after each night.

    Where targets may fail, their observations are an upper bound of it, it never falls, and it ends as `target_status` does.
    """
    wanted = run.targets.filter(pl.col("kind") == "science").group_by("programme").len("n_wanted")
    nth = observed.sort("night").with_columns(nth=pl.col("target_id").cum_count().over("target_id"))
    done = nth.filter(pl.col("nth") == pl.col("wanted_visits"))
    for programme, n_wanted in wanted.sort("programme").iter_rows():
        column = f"{_PROGRAMME_COLUMN}{programme}"
        if column not in nights.columns:
            log.add_one(Fault("nights", "nights", detail=f"{column} is absent"))
            continue
        ends = done.filter(pl.col("programme") == programme).group_by("night").len("n_done")
        rows = nights.sort("night").join(ends, on="night", how="left", maintain_order="left")
        rows = rows.with_columns((pl.col("n_done").fill_null(0).cum_sum() / n_wanted).alias(f"own_{column}"))
        if programme not in run.schedule.uncertain:
            log.compare("nights", "nights", rows, {column: _FRAC})
            continue
        given, own = pl.col(column), pl.col(f"own_{column}")
        above = rows.filter(given > own + _FRAC)
        detail = f"{column} is above what the observations allow"
        log.add("nights", "nights", above, detail, value=given, limit=own)
        fallen = rows.with_columns(last=given.shift(1)).filter(given < pl.col("last"))
        log.add("nights", "nights", fallen, f"{column} falls", value=given, limit=pl.col("last"))
        if status is not None:
            _check_last_night(log, rows.tail(1).rename({column: "given"}), programme, n_wanted, status, run)


def _check_last_night(
    log: FaultLog, last: pl.DataFrame, programme: str, n_wanted: int, status: pl.DataFrame, run: Run
) -> None:
    own = status.filter(pl.col("programme") == programme).join(
        run.targets.select("target_id", "wanted_visits"), on="target_id"
    )
    complete_frac = own.filter(pl.col("n_observed") >= pl.col("wanted_visits")).height / n_wanted
    other = last.filter((pl.col("given") - complete_frac).abs() > _FRAC)
    detail = f"{_PROGRAMME_COLUMN}{programme} does not end as target_status does"
    log.add("nights", "nights", other, detail, value=pl.col("given"), limit=complete_frac)


def _check_status(log: FaultLog, status: pl.DataFrame, observed: pl.DataFrame, run: Run) -> None:
    """One row a science target: visits observed, first and last night, and a reason just where some are wanting.

    Where targets may fail, they have at most the observations that exposures and allocations give, within their nights.
    """
    science = run.targets.filter(pl.col("kind") == "science")
    check_refers(log, status, "target_status", science, "targets (science)", ["target_id"])
    check_refers(log, science, "target_status", status, "target_status", ["target_id"])
    own = observed.group_by("target_id").agg(
        own_n_observed=pl.len().cast(pl.Int16),
        own_first_night=pl.col("night").min(),
        own_last_night=pl.col("night").max(),
    )
    target = science.select("target_id", "wanted_visits", own_survey="survey", own_programme="programme")
    both = status.join(target, on="target_id", how="inner", maintain_order="left")
    both = both.join(own, on="target_id", how="left", maintain_order="left").with_columns(
        pl.col("own_n_observed").fill_null(0)
    )
    names, figures = ("survey", "programme"), ("n_observed", "first_night", "last_night")
    how = "counted from exposures and allocations"
    log.compare("target_status", "target_status", both, dict.fromkeys(names, 0.0), how)
    is_sure = ~pl.col("own_programme").is_in(run.schedule.uncertain)
    log.compare("target_status", "target_status", both.filter(is_sure), dict.fromkeys(figures, 0.0), how)
    is_more = pl.col("n_observed") > pl.col("own_n_observed")
    is_outside = (pl.col("first_night") < pl.col("own_first_night")) | (pl.col("last_night") > pl.col("own_last_night"))
    is_dateless = (pl.col("n_observed") > 0) != pl.col("first_night").is_not_null()
    beyond = both.filter(~is_sure & (is_more | is_outside.fill_null(value=False) | is_dateless))
    log.add("target_status", "target_status", beyond, pl.format("target {} has more than was observed", "target_id"))
    is_complete = pl.col("n_observed") >= pl.col("wanted_visits")
    reasonless = both.filter(is_complete != pl.col("reason").is_null())
    detail = pl.format("target {}: a reason stands just where visits are wanting", "target_id")
    log.add("target_status", "target_status", reasonless, detail)
