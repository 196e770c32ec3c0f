"""Fibres on targets: each robot that holds one stands where it projects, and may hold it."""

import numpy as np
import polars as pl

from survey_sim.check.faults import FaultLog
from survey_sim.check.inputs import Run
from survey_sim.check.part import Part
from survey_sim.check.relations import TILE

ON_TARGET_MM = 1e-3
_COLUMNS = {
    "survey": "home_survey",
    "tile_id": "home_tile_id",
    "kind": "target_kind",
    "ra_deg": "ra_deg",
    "dec_deg": "dec_deg",
}


def check_targets(log: FaultLog, part: Part, run: Run) -> pl.DataFrame:
    """Held targets exist, suit the robot, project where it stands, and have one robot a visit.

    Returns
    -------
        Rows that hold a known target: visit_row, target_id, kind, mag, wanted_visits, is_home (the tile is its home).
    """
    rows, table = part.rows, part.names.allocations
    nameless = rows.filter(pl.col("kind").is_null() != pl.col("target_id").is_null())
    log.add("targets", table, nameless, "target_id and kind are not null together")
    dead = rows.filter((pl.col("state") == "dead") & pl.col("target_id").is_not_null())
    log.add("targets", table, dead, "a dead robot holds a target")
    held = _held(log, rows, table, run)
    name = pl.format("target {}", "target_id")
    for rule, is_broken in {
        "belongs to another survey": pl.col("home_survey") != pl.col("survey"),
        "belongs to another tile": pl.col("home_tile_id") != pl.col("tile_id"),
        "is of another kind than the row says": pl.col("target_kind") != pl.col("kind"),
        "is not for a robot of this kind": (pl.col("target_kind") == "guide") != (pl.col("robot_kind") == "guide"),
        "is held by several robots": pl.struct("visit_row", "target_id").is_duplicated(),
    }.items():
        log.add("targets", table, held.filter(is_broken), pl.format("{} {}", name, pl.lit(rule)))
    _check_places(log, held, table, run)
    is_home = (pl.col("home_tile_id") == pl.col("tile_id")).fill_null(value=False)
    return held.select("visit_row", "target_id", "mag", "wanted_visits", kind="target_kind", is_home=is_home)


def check_wanted(log: FaultLog, reached: pl.DataFrame, run: Run) -> None:
    """No science target is held in more visits than it wants.

    Parameters
    ----------
    reached
        target_id of every row of the run that holds a science target.
    """
    visits = reached.group_by("target_id", maintain_order=True).len("n_held")
    most = visits.join(run.targets, on="target_id").filter(pl.col("n_held") > pl.col("wanted_visits"))
    detail = pl.format("target {} is held in more visits than it wants", "target_id")
    log.add("targets", "allocations", most, detail, value=pl.col("n_held"), limit=pl.col("wanted_visits"))


def check_unallocated(log: FaultLog, reached: pl.DataFrame, run: Run) -> None:
    """`unallocated`, where there is one, holds just the science targets with fewer visits than wanted, of all home tiles."""
    if (given := run.optional.get("unallocated")) is None:
        return
    visits = reached.group_by("target_id").agg(own_n_allocated=pl.len().cast(pl.Int16))
    science = run.targets.filter((pl.col("kind") == "science") & pl.col("tile_id").is_not_null())
    wanting = science.select("target_id", "wanted_visits", own_survey="survey", own_tile_id="tile_id")
    wanting = wanting.join(visits, on="target_id", how="left", maintain_order="left")
    wanting = wanting.with_columns(pl.col("own_n_allocated").fill_null(0))
    wanting = wanting.filter(pl.col("own_n_allocated") < pl.col("wanted_visits"))
    for some, other, rule in ((given, wanting, "wants no more visits"), (wanting, given, "is not listed")):
        odd = some.join(other, on="target_id", how="anti", maintain_order="left")
        log.add("targets", "unallocated", odd, pl.format("target {} {}", "target_id", pl.lit(rule)))
    both = given.join(wanting, on="target_id", how="inner", maintain_order="left")
    log.compare("targets", "unallocated", both, dict.fromkeys(("n_allocated", "survey", "tile_id"), 0.0))


def _held(log: FaultLog, rows: pl.DataFrame, table: str, run: Run) -> pl.DataFrame:
    """Rows that hold a known target, with what the target is; a fault for an unknown one."""
    held = rows.filter(pl.col("target_id").is_not_null())
    target_id = held["target_id"].to_numpy()
    place = np.minimum(np.searchsorted(run.target_ids, target_id), max(len(run.target_ids) - 1, 0))
    is_known = run.target_ids[place] == target_id if len(run.target_ids) else np.zeros(len(place), bool)
    unknown = held.filter(~pl.Series(is_known))
    log.add("schema", table, unknown, pl.format("no row of targets has target_id {}", "target_id"))
    found = run.targets[place[is_known]].select(*_COLUMNS, "mag", "wanted_visits").rename(_COLUMNS)
    return pl.concat([held.filter(pl.Series(is_known)), found], how="horizontal")


def _check_places(log: FaultLog, held: pl.DataFrame, table: str, run: Run) -> None:
    """Robots stand where their targets project: at the angle from the field centre / scale, in the target's direction."""
    centre = run.tiles.select(*TILE, centre_ra=pl.col("ra_deg").radians(), centre_dec=pl.col("dec_deg").radians())
    placed = held.join(centre, on=TILE, how="left", maintain_order="left")
    east, north, toward = _tangent(
        pl.col("ra_deg").radians() - pl.col("centre_ra"), pl.col("dec_deg").radians(), pl.col("centre_dec")
    )
    placed = placed.with_columns(east=east, north=north, toward=toward)
    aside = (pl.col("east") ** 2 + pl.col("north") ** 2).sqrt()
    angle = pl.arctan2(aside, pl.col("toward")).degrees()
    per_unit = angle * 3600.0 / run.constants.plate_scale_arcsec_mm / aside
    stretch = pl.when(aside > 0).then(per_unit).otherwise(0.0)
    miss = ((pl.col("x_mm") - stretch * pl.col("east")) ** 2 + (pl.col("y_mm") - stretch * pl.col("north")) ** 2).sqrt()
    off = placed.with_columns(miss_mm=miss).filter(pl.col("miss_mm") > ON_TARGET_MM)
    detail = pl.format("robot is not where target {} projects on the plate", "target_id")
    log.add("targets", table, off, detail, value=pl.col("miss_mm"), limit=ON_TARGET_MM)


def _tangent(ra: pl.Expr, dec: pl.Expr, centre_dec: pl.Expr) -> tuple[pl.Expr, pl.Expr, pl.Expr]:
    """Unit vector of a direction along east, north, and the field centre; ra from the centre's, all in radians."""
    east = dec.cos() * ra.sin()
    north = dec.sin() * centre_dec.cos() - dec.cos() * centre_dec.sin() * ra.cos()
    return east, north, dec.sin() * centre_dec.sin() + dec.cos() * centre_dec.cos() * ra.cos()
