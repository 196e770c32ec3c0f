"""What the plate really did: each pointing's configuration and path, from where the last pointing of its night left it."""

from collections.abc import Mapping

import polars as pl

from survey_sim.check.faults import Fault, FaultLog
from survey_sim.check.inputs import EXPOSURE_LARGE, Run
from survey_sim.check.part import START_TO_TARGET, STATE, Names, Part, first_rows, with_begins, with_ends
from survey_sim.check.relations import ROBOT, VISIT, check_present, check_refers
from survey_sim.check.routes import (
    ANGLE_DEG,
    POSITION_MM,
    check_ends,
    check_legs,
    check_reach,
    check_times,
    path_separations,
)
from survey_sim.check.targets import check_targets

OF_EXPOSURES = Names("exposure_allocations", "exposure_legs", "exposure_paths")
KEY = "exposure_id"


def read_exposures(log: FaultLog, run: Run) -> pl.DataFrame | None:
    """Pointings whose paths the run has: with the visit's number, in order; None if robots are not followed.

    A fault where they should be and are not.
    """
    exposures, paths = run.optional.get("exposures"), run.optional.get("exposure_paths")
    if exposures is None:
        return None
    if paths is None:
        if run.schedule.configuration_s is None and len(exposures):
            log.add_one(Fault("exposures", "exposure_paths", detail="is absent, and configuration times are routed"))
        return None
    check_refers(log, paths, "exposure_paths", exposures, "exposures", [KEY])
    check_present(log, exposures.select(*VISIT, KEY), paths, "exposure_paths", [KEY])
    known = exposures.join(run.visits.select(*VISIT, own_visit_row="visit_row"), on=VISIT, how="inner")
    return known.select(KEY, "night", *VISIT, "own_visit_row", "status").sort(KEY)


def check_plate(
    log: FaultLog, tables: Mapping[str, pl.DataFrame], run: Run, exposures: pl.DataFrame, reached: pl.DataFrame
) -> tuple[Part, pl.DataFrame, pl.DataFrame]:
    """Check a part of `EXPOSURE_LARGE`.

    Parameters
    ----------
    exposures
        As `read_exposures` gives them; those that this part should not have left out.
    reached
        visit_row and target_id of every row of `allocations` that holds a target.

    Returns
    -------
    part, separations
        What was looked at.
    held
        exposure_id and target_id of its rows that hold a science target.
    """
    here = exposures.join(tables["exposure_allocations"].select(KEY).unique(), on=KEY, how="semi", maintain_order="left")
    bad = _unsound_nights(log, tables, run, exposures, here)
    sound = {
        name: frame.join(here.select(KEY, "night"), on=KEY, how="inner", maintain_order="left").join(
            bad, on="night", how="anti", maintain_order="left"
        )
        for name, frame in tables.items()
    }
    part = _make_part(sound, here, run)
    check_legs(log, part, run.constants)
    check_ends(log, part)
    _check_states(log, part)
    check_reach(log, part, run.constants)
    separations = path_separations(log, part, run.constants)
    paths = run.optional["exposure_paths"].with_columns(visit_row=pl.col(KEY).cast(pl.UInt32), path=pl.lit(START_TO_TARGET))
    check_times(log, part, paths, separations, run.constants)
    held = check_targets(log, part, run)
    _check_sets(log, part, reached)
    science = held.filter(pl.col("kind") == "science")
    return part, separations, science.select(pl.col("visit_row").cast(pl.Int32).alias(KEY), "target_id")


def check_paid(log: FaultLog, exposures: pl.DataFrame, paths: pl.DataFrame) -> None:
    """Pointings pay the time of their own paths."""
    own = paths.select(KEY, own_configuration_time_s="configuration_time_s")
    both = exposures.join(own, on=KEY, how="inner", maintain_order="left")
    log.compare("exposures", "exposures", both, {"configuration_time_s": 1e-9}, "read from exposure_paths")


def _unsound_nights(
    log: FaultLog, tables: Mapping[str, pl.DataFrame], run: Run, exposures: pl.DataFrame, here: pl.DataFrame
) -> pl.DataFrame:
    """Nights of a part whose rows do not fit together; their faults are logged, and they are not looked at further.

    Every pointing of a night is in the part if one is, and has a row of `exposure_allocations` for each robot; every row
    names a known pointing and robot.
    """
    bad = []
    of_nights = exposures.join(here.select("night").unique(), on="night", how="semi")
    for table in EXPOSURE_LARGE:
        check_refers(log, tables[table], table, exposures, "exposures", [KEY])
        robots = tables[table].join(exposures.select(KEY, "night", *VISIT), on=KEY, how="inner")
        check_refers(log, robots, table, run.robots, "robots", ROBOT)
        bad.append(robots.join(run.robots, on=ROBOT, how="anti").select("night"))
    wanted = of_nights.join(run.robots.select(ROBOT), on="survey")
    lacking = check_present(log, wanted, tables["exposure_allocations"], "exposure_allocations", [KEY, "robot_id"])
    return pl.concat([*bad, lacking.select("night")]).unique()


def _make_part(tables: Mapping[str, pl.DataFrame], exposures: pl.DataFrame, run: Run) -> Part:
    """Robots at pointings, each with the state that the last pointing of the night left it in, or park with theta 0."""
    rows = tables["exposure_allocations"].drop("night").sort(KEY, "robot_id").with_row_index("row")
    rows = rows.join(exposures.drop("status"), on=KEY, how="left", maintain_order="left")
    rows = rows.join(run.robots.rename({"kind": "robot_kind"}), on=ROBOT, how="left", maintain_order="left")
    parked = {"x_mm": pl.col("park_x_mm"), "y_mm": pl.col("park_y_mm"), "theta_deg": pl.lit(0.0)}
    starts = {
        name: pl.coalesce(pl.col(name).shift(1).over("night", "robot_id"), park).alias(f"start_{name}")
        for name, park in parked.items()
    }
    rows = rows.with_columns(pl.col(KEY).cast(pl.UInt32).alias("visit_row"), *starts.values())
    rows = rows.with_columns(pl.col(f"start_{name}").alias(f"last_{name}") for name in STATE)
    kept = [KEY, *VISIT, "visit_row", "robot_id", "target_id", "state", "reason", *(f"start_{name}" for name in STATE)]
    goals = {"goal_x_mm": "x_mm", "goal_y_mm": "y_mm", "goal_theta_deg": "theta_deg"}
    routes = rows.select(*kept, **goals, path=pl.lit(START_TO_TARGET)).with_columns(slot=pl.int_range(pl.len()))
    place = rows.select(KEY, "robot_id", pl.col("row").cast(pl.Int64).alias("slot"), *VISIT, path=pl.lit(START_TO_TARGET))
    legs = tables["exposure_legs"].drop("night").join(place, on=[KEY, "robot_id"], how="inner")
    legs = with_begins(legs.sort("slot", "leg"), routes, run.constants)
    return Part(OF_EXPOSURES, (START_TO_TARGET,), rows, with_ends(routes, legs), legs, first_rows(rows))


def _check_states(log: FaultLog, part: Part) -> None:
    """Orientations are those of the last legs, travel is straight, a reason stands where a target was missed."""
    table = part.names.allocations
    turned = (pl.col("end_theta_deg") - pl.col("goal_theta_deg") + 180.0).mod(360.0) - 180.0
    off = part.routes.with_columns(turned_deg=turned.abs()).filter(pl.col("turned_deg") > ANGLE_DEG)
    detail = "theta_deg is not that in which the robot's path ends"
    log.add("ends", table, off, detail, value=pl.col("turned_deg"), limit=ANGLE_DEG)
    travel = ((pl.col("x_mm") - pl.col("start_x_mm")) ** 2 + (pl.col("y_mm") - pl.col("start_y_mm")) ** 2).sqrt()
    log.compare("exposures", table, part.rows.with_columns(own_travel_mm=travel), {"travel_mm": POSITION_MM})
    missed = part.rows.filter(pl.col("missed_target_id").is_not_null() & pl.col("reason").is_null())
    log.add("ends", table, missed, "a target is missed for no reason")


def _check_sets(log: FaultLog, part: Part, reached: pl.DataFrame) -> None:
    """A pointing's targets, held and missed, are those of its visit."""
    table = part.names.allocations
    columns = [KEY, *VISIT, "own_visit_row", "robot_id"]
    given = pl.concat(
        [
            part.rows.select(*columns, target_id=name).filter(pl.col("target_id").is_not_null())
            for name in ("target_id", "missed_target_id")
        ]
    )
    twice = given.filter(pl.struct(KEY, "target_id").is_duplicated())
    log.add("targets", table, twice, pl.format("target {} stands for several robots of a pointing", "target_id"))
    of_visit = reached.rename({"visit_row": "own_visit_row"})
    foreign = given.join(of_visit, on=["own_visit_row", "target_id"], how="anti", maintain_order="left")
    log.add("targets", table, foreign, pl.format("target {} is not of the visit", "target_id"))
    pointings = part.rows.select(KEY, *VISIT, "own_visit_row").unique(maintain_order=True)
    wanted = pointings.join(of_visit, on="own_visit_row", how="inner", maintain_order="left")
    lacking = wanted.join(given, on=[KEY, "target_id"], how="anti", maintain_order="left")
    log.add("targets", table, lacking, pl.format("target {} of the visit is neither held nor missed", "target_id"))
