"""Legs and routes of a part: where they begin and end, what a leg may be, reach, separation, and times."""

import numpy as np
import polars as pl

from survey_sim.check.faults import FAULT_SCHEMA, MAX_ROWS, FaultLog
from survey_sim.check.inputs import Constants, Run
from survey_sim.check.kernels import least_separations
from survey_sim.check.part import START_TO_TARGET, Part
from survey_sim.check.relations import VISIT, check_refers

POSITION_MM = 1e-6
ANGLE_DEG = 1e-6
TIME_S = 1e-6
# Legs of a robot follow each other: rounding only.
ORDER_S = 1e-9
MAX_TURN_DEG = 45.0


def check_legs(log: FaultLog, part: Part, constants: Constants) -> None:
    """What a leg is: it follows the last, ends where its instruction leads, turns and goes as a robot can."""
    legs, table = part.legs, part.names.legs
    _check_ends_of_legs(log, part)
    numbered = legs.with_columns(place=pl.int_range(pl.len()).over("slot"))
    log.add("legs", table, numbered.filter(pl.col("leg") != pl.col("place")), "legs are not counted from 0 without gaps")
    last_end = pl.col("end_s").shift(1)
    early = legs.with_columns(last_end_s=last_end).filter(~pl.col("is_first") & (pl.col("start_s") < last_end - ORDER_S))
    detail = "leg starts before the robot's last one ends"
    log.add("legs", table, early, detail, value=pl.col("start_s"), limit=pl.col("last_end_s"))
    turn, theta = pl.col("rotate_deg"), pl.col("theta_deg")
    far = legs.filter(turn.abs() > MAX_TURN_DEG + ANGLE_DEG)
    log.add("legs", table, far, "turns further than a robot needs to", value=turn, limit=MAX_TURN_DEG)
    both = legs.filter((turn != 0) & (pl.col("dx_mm") != 0) & (pl.col("dy_mm") != 0))
    log.add("legs", table, both, "turns and goes along both axes", value=turn, limit=0.0)
    nothing = legs.filter((turn == 0) & (pl.col("length_mm") == 0))
    log.add("legs", table, nothing, "neither turns nor goes")
    unwrapped = legs.filter((theta < -180) | (theta >= 180))
    log.add("legs", table, unwrapped, "theta_deg is outside [-180, 180)", value=theta)
    approach = pl.min_horizontal(pl.lit(constants.precise_approach_mm), "length_mm")
    wanted = legs.with_columns(own_precise_mm=pl.when("is_last").then(approach).otherwise(0.0))
    log.compare("legs", table, wanted, {"precise_mm": 1e-9}, "only the last leg ends with the precise approach")


def check_ends(log: FaultLog, part: Part) -> None:
    """Each path ends where it should, or has a reason and stays where it began; dead robots never move."""
    gap = ((pl.col("end_x_mm") - pl.col("goal_x_mm")) ** 2 + (pl.col("end_y_mm") - pl.col("goal_y_mm")) ** 2).sqrt()
    routes, legs = part.routes.with_columns(gap_mm=gap), part.names.legs
    is_dead, moves = pl.col("state") == "dead", pl.col("n_leg") > 0
    is_unrouted, is_to_target = pl.col("reason").is_not_null(), pl.col("path") == START_TO_TARGET
    log.add("ends", legs, routes.filter(is_dead & moves), "a dead robot moves")
    log.add("ends", legs, routes.filter(is_unrouted & moves), "an unrouted robot moves")
    is_away = pl.col("gap_mm") > POSITION_MM
    astray = routes.filter(is_away & ~is_unrouted)
    log.add(
        "ends",
        legs,
        astray,
        "path ends away from where it should, with no reason",
        value=pl.col("gap_mm"),
        limit=POSITION_MM,
    )
    moved = routes.filter(is_away & is_unrouted & is_to_target & ~moves)
    log.add(
        "ends",
        part.names.allocations,
        moved,
        "an unrouted robot is said to end away from where it began",
        value=pl.col("gap_mm"),
        limit=POSITION_MM,
    )
    holds = routes.filter(is_unrouted & is_to_target & pl.col("target_id").is_not_null())
    log.add("ends", part.names.allocations, holds, "an unrouted robot holds a target")


def check_reach(log: FaultLog, part: Part, constants: Constants) -> None:
    """Ends and corners of legs and resting places lie inside the patrol disc and the plate; a dead robot is where it is."""
    columns = ("park_x_mm", "park_y_mm", "patrol_radius_mm")
    row = part.legs["slot"] % max(part.rows.height, 1)
    legs = part.legs.with_columns(part.rows[name][row] for name in columns)
    live = part.rows.filter(pl.col("state") == "live")
    first = live.filter(pl.col("visit_id") == 0)
    _check_inside(log, live, part.names.allocations, "x_mm", "y_mm", constants, "resting place")
    _check_inside(log, first, part.names.allocations, "last_x_mm", "last_y_mm", constants, "first position")
    _check_inside(log, legs, part.names.legs, "x_mm", "y_mm", constants, "end of leg")
    _check_inside(log, legs, part.names.legs, "corner_x_mm", "corner_y_mm", constants, "corner of leg")


def path_separations(log: FaultLog, part: Part, constants: Constants) -> pl.DataFrame:
    """Least distance and number of collisions of every path (`own_min_separation_mm`, `own_collisions`).

    A fault for every pair that comes nearer than the separation at any instant.
    """
    legs, routes = part.legs, part.routes
    theta = np.radians(legs["own_theta_deg"].to_numpy())
    columns = [legs[c].to_numpy() for c in ("start_s", "rotating_s", "dx_mm", "dy_mm", "precise_mm")]
    columns += [np.cos(theta), np.sin(theta), legs["x_mm"].to_numpy(), legs["y_mm"].to_numpy()]
    first_leg = np.searchsorted(legs["slot"].to_numpy(), np.arange(routes.height + 1))
    start = np.column_stack([routes["start_x_mm"].to_numpy(), routes["start_y_mm"].to_numpy()])
    limit = constants.min_separation_mm - POSITION_MM
    near = np.full((MAX_ROWS, 4), np.nan)
    speeds = (constants.coarse_speed_mm_s, constants.precise_speed_mm_s)
    least, n_near = least_separations(
        len(part.paths), part.first_row, start, first_leg, np.column_stack(columns), *speeds, limit, near
    )
    near = near[np.isfinite(near[:, 0])]
    slots, other = near[:, 0].astype(np.int64), near[:, 1].astype(np.int64)
    names = [name for name in FAULT_SCHEMA if name in routes.columns]
    pairs = routes[slots].select(names).with_columns(routes["robot_id"][other].alias("other_robot_id"))
    pairs = pairs.with_columns(pl.Series("distance_mm", near[:, 2]), pl.Series("when_s", near[:, 3]))
    detail = pl.format("robots nearer than the separation at {} s", pl.col("when_s").round(3))
    n_hidden = int(n_near.sum()) - pairs.height
    least_mm = constants.min_separation_mm
    log.add("separation", part.names.legs, pairs, detail, value=pl.col("distance_mm"), limit=least_mm, n_hidden=n_hidden)
    n_visit = len(part.first_row) - 1
    visit_row = part.rows["visit_row"].gather(part.first_row[:-1])
    return pl.DataFrame(
        {
            "visit_row": np.tile(visit_row.to_numpy(), len(part.paths)),
            "path": np.repeat(part.paths, n_visit).tolist(),
            "own_min_separation_mm": least.ravel(),
            "own_collisions": n_near.ravel().astype(np.int32),
        },
        schema_overrides={"visit_row": pl.UInt32, "path": pl.String},
    )


def check_robot_times(log: FaultLog, part: Part) -> None:
    """Times of robots, derived again."""
    waiting = pl.col("rest_s") - pl.col("own_rotating_s") - pl.col("own_moving_s")
    routes = part.routes.with_columns(own_waiting_s=waiting)
    log.compare("times", "robot_times", routes, dict.fromkeys(("rotating_s", "moving_s", "waiting_s"), TIME_S))


def check_times(log: FaultLog, part: Part, paths: pl.DataFrame, separations: pl.DataFrame, constants: Constants) -> None:
    """Times of paths, ticks, unrouted, least separation and collisions, each derived again.

    Parameters
    ----------
    paths
        With `visit_row`.
    separations
        As `path_separations` gives them.
    """
    routes = part.routes.with_columns(alone_s=_alone_s(constants))
    key = ["visit_row", "path"]
    own = routes.group_by(key).agg(**_path_figures())
    place = part.legs["slot"]
    ticks = part.legs.with_columns(part.routes["visit_row"][place])
    ticks = ticks.group_by(key).agg(own_ticks=pl.col("start_s").n_unique().cast(pl.Int32))
    own = own.join(ticks, on=key, how="left").with_columns(pl.col("own_ticks").fill_null(0))
    both = paths.join(own.join(separations, on=key), on=key, how="inner", maintain_order="left")
    columns = [f"configuration_time{suffix}_s" for suffix in ("", "_p95", "_median")] + ["lower_bound_s"]
    log.compare("times", part.names.paths, both, dict.fromkeys(columns, TIME_S) | {"ticks": 0, "unrouted": 0})
    log.compare("separation", part.names.paths, both, {"min_separation_mm": POSITION_MM, "collisions": 0})


def check_executions(log: FaultLog, run: Run) -> None:
    """Paths played with errors are paths of the run, their times add up, and pairs in contact are nearer than allowed."""
    if (given := run.optional.get("executions")) is None:
        return
    check_refers(log, given, "executions", run.paths, "paths", [*VISIT, "path"])
    own = given.with_columns(own_configuration_time_s=pl.col("moving_time_s") + pl.col("metrology_time_s"))
    log.compare("times", "executions", own, {"configuration_time_s": TIME_S}, "its parts are added up")
    odd = given.filter(pl.col("contacts") > pl.col("collisions"))
    detail = "more pairs in contact than nearer than the separation"
    log.add("separation", "executions", odd, detail, value=pl.col("contacts"), limit=pl.col("collisions"))


def rank_95(value: pl.Expr) -> pl.Expr:
    """The k-th smallest of n values, k = ceil(0.95 n) in whole numbers; 0 if there is none."""
    return value.sort().get((95 * value.len().cast(pl.Int64) + 99) // 100 - 1, null_on_oob=True).fill_null(0.0)


def _path_figures() -> dict[str, pl.Expr]:
    moving = pl.col("rest_s").filter(pl.col("n_leg") > 0)
    return {
        "own_configuration_time_s": moving.max().fill_null(0.0),
        "own_configuration_time_p95_s": pl.when(moving.len() > 0).then(rank_95(moving)).otherwise(0.0),
        "own_configuration_time_median_s": moving.median().fill_null(0.0),
        "own_lower_bound_s": pl.col("alone_s").max(),
        "own_unrouted": ((pl.col("state") == "live") & pl.col("reason").is_not_null()).sum().cast(pl.Int32),
    }


def _alone_s(constants: Constants) -> pl.Expr:
    """Time of a live robot that arrives, were it alone: the quicker of a turn onto the line and x then y; else 0."""
    step_x, step_y = pl.col("goal_x_mm") - pl.col("start_x_mm"), pl.col("goal_y_mm") - pl.col("start_y_mm")
    own = _own_lengths(pl.col("start_theta_deg"), step_x, step_y)
    near_axis, far_axis = pl.min_horizontal(*own), pl.max_horizontal(*own)
    turn_s = pl.arctan2(near_axis, far_axis).degrees() / constants.rotation_speed_deg_s
    straight = (step_x**2 + step_y**2).sqrt()
    alone = pl.min_horizontal(turn_s + _travel_s(straight, constants), _travel_s(near_axis + far_axis, constants))
    return pl.when((pl.col("state") == "live") & pl.col("reason").is_null() & (straight > 0)).then(alone).otherwise(0.0)


def _own_lengths(theta: pl.Expr, x: pl.Expr, y: pl.Expr) -> tuple[pl.Expr, pl.Expr]:
    """Lengths along the axes of a robot turned by theta (deg) of a step in the plate frame."""
    angle = theta.radians()
    return (angle.cos() * x + angle.sin() * y).abs(), (angle.cos() * y - angle.sin() * x).abs()


def _travel_s(length: pl.Expr, constants: Constants) -> pl.Expr:
    slow = pl.min_horizontal(pl.lit(constants.precise_approach_mm), length)
    return (length - slow) / constants.coarse_speed_mm_s + slow / constants.precise_speed_mm_s


def _check_ends_of_legs(log: FaultLog, part: Part) -> None:
    """A leg's instruction leads from the state where the robot is to the state that the row gives."""
    legs, table = part.legs, part.names.legs
    miss = ((pl.col("own_x_mm") - pl.col("x_mm")) ** 2 + (pl.col("own_y_mm") - pl.col("y_mm")) ** 2).sqrt()
    turned = (pl.col("own_theta_deg") - pl.col("theta_deg") + 180.0).mod(360.0) - 180.0
    missed = legs.with_columns(miss_mm=miss, miss_deg=turned.abs())
    for check, rows, begin in (("starts", "is_first", "where the last visit or park left it"), ("legs", "", "the last leg")):
        some = missed.filter(pl.col("is_first") if rows else ~pl.col("is_first"))
        far = some.filter(pl.col("miss_mm") > POSITION_MM)
        detail = f"the leg, begun at {begin}, does not end at x_mm, y_mm"
        log.add(check, table, far, detail, value=pl.col("miss_mm"), limit=POSITION_MM)
        turned_away = some.filter(pl.col("miss_deg") > ANGLE_DEG)
        detail = f"the leg, begun at {begin}, does not end at theta_deg"
        log.add(check, table, turned_away, detail, value=pl.col("miss_deg"), limit=ANGLE_DEG)


def _check_inside(log: FaultLog, rows: pl.DataFrame, table: str, x: str, y: str, constants: Constants, what: str) -> None:
    from_park = ((pl.col(x) - pl.col("park_x_mm")) ** 2 + (pl.col(y) - pl.col("park_y_mm")) ** 2).sqrt()
    radius = (pl.col(x) ** 2 + pl.col(y) ** 2).sqrt()
    measured = rows.with_columns(from_park_mm=from_park, radius_mm=radius)
    patrol = pl.col("patrol_radius_mm")
    beyond = measured.filter(pl.col("from_park_mm") > patrol + POSITION_MM)
    log.add("reach", table, beyond, f"{what} outside the patrol disc", value=pl.col("from_park_mm"), limit=patrol)
    plate_mm = constants.plate_radius_mm
    off = measured.filter(pl.col("radius_mm") > plate_mm + POSITION_MM)
    log.add("reach", table, off, f"{what} outside the plate", value=pl.col("radius_mm"), limit=plate_mm)
