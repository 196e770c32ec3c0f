"""One part of a run (all visits of some tiles) put together: robots in visits, their routes, and their legs."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import polars as pl

from survey_sim.check.inputs import Constants, Run
from survey_sim.check.relations import ROBOT, VISIT
from survey_sim.schema import PATHS

START_TO_TARGET, START_TO_PARK, PARK_TO_TARGET = PATHS
STATE = ("x_mm", "y_mm", "theta_deg")


class Names(NamedTuple):
    """Tables that a part is of."""

    allocations: str
    legs: str
    paths: str


OF_VISITS = Names("allocations", "legs", "paths")


@dataclass(frozen=True)
class Part:
    """Rows of a part, each with the state that it begins in.

    Attributes
    ----------
    names
        Its tables. What is said here of visits holds of pointings in a part of what the plate did at exposures; their
        `visit_row` is the `exposure_id`.
    paths
        Paths of a visit.
    rows
        `allocations`, sorted by visit and robot, with the robot's park position, kind and state, where the last visit left
        it (`last_x_mm`, `last_y_mm`, `last_theta_deg`), where it is once all are parked (`parked_*`), and where
        `start_to_target` begins (`start_*`).
    routes
        A robot on a path: a block of all `rows` for each path, in the order of `paths`; `slot` is the place. With the start
        state, where the path should end (`goal_*`), `robot_times`, and what its legs come to (`n_leg`, `rest_s`, ...).
    legs
        `legs`, sorted by slot, with the state that each begins in (`begin_*`) and what follows from it.
    first_row
        (n_visit + 1,) rows of each visit.
    """

    names: Names
    paths: tuple[str, ...]
    rows: pl.DataFrame
    routes: pl.DataFrame
    legs: pl.DataFrame
    first_row: npt.NDArray[np.int64]


def make_part(tables: dict[str, pl.DataFrame], run: Run) -> Part:
    """Put sound `allocations`, `legs` and `robot_times` of a part together."""
    rows = tables["allocations"].sort([*VISIT, "robot_id"]).with_row_index("row")
    rows = rows.join(run.visits.select(*VISIT, "visit_row", "start"), on=VISIT, how="left", maintain_order="left")
    robot = run.robots.rename({"kind": "robot_kind"})
    rows = rows.join(robot, on=ROBOT, how="left", maintain_order="left")
    key = rows.select(*VISIT, "robot_id", "row")
    legs = _slots(tables["legs"], key, rows.height).sort("slot", "leg")
    rows = _with_starts(rows, _last_theta(legs, rows.height))
    routes = _routes(rows)
    legs = with_begins(legs, routes, run.constants)
    times = _slots(tables["robot_times"], key, rows.height)
    times = times.select("slot", "rotating_s", "moving_s", "waiting_s", "reason")
    routes = routes.join(times, on="slot", how="left", maintain_order="left")
    return Part(OF_VISITS, PATHS, rows, with_ends(routes, legs), legs, first_rows(rows))


def from_own_axes(theta: pl.Expr, x: pl.Expr, y: pl.Expr) -> tuple[pl.Expr, pl.Expr]:
    """Step in the plate frame of a step along the axes of a robot turned by theta, deg."""
    angle = theta.radians()
    return angle.cos() * x - angle.sin() * y, angle.sin() * x + angle.cos() * y


def first_rows(rows: pl.DataFrame) -> npt.NDArray[np.int64]:
    """(n_visit + 1,) rows of each visit; they are together."""
    counts = rows.group_by("visit_row", maintain_order=True).len()["len"].to_numpy()
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def with_ends(routes: pl.DataFrame, legs: pl.DataFrame) -> pl.DataFrame:
    """Routes with what their legs come to; a robot without legs stays."""
    return routes.join(_totals(legs), on="slot", how="left", maintain_order="left").with_columns(
        pl.col("n_leg", "rest_s", "own_rotating_s", "own_moving_s").fill_null(0),
        end_x_mm=pl.coalesce("end_x_mm", "start_x_mm"),
        end_y_mm=pl.coalesce("end_y_mm", "start_y_mm"),
        end_theta_deg=pl.coalesce("end_theta_deg", "start_theta_deg"),
    )


def _slots(frame: pl.DataFrame, key: pl.DataFrame, n_row: int) -> pl.DataFrame:
    path = pl.col("path").replace_strict({name: i for i, name in enumerate(PATHS)}, return_dtype=pl.Int64)
    numbered = frame.join(key, on=[*VISIT, "robot_id"], how="left", maintain_order="left")
    return numbered.with_columns(slot=path * n_row + pl.col("row").cast(pl.Int64))


def _last_theta(legs: pl.DataFrame, n_row: int) -> pl.DataFrame:
    """Orientation in which each robot that moved ends `start_to_target`; that path's slots are the rows."""
    moved = legs.filter(pl.col("slot") < n_row)
    return moved.group_by(pl.col("slot").cast(pl.UInt32).alias("row")).agg(end_theta_deg=pl.col("theta_deg").last())


def _with_starts(rows: pl.DataFrame, last_theta: pl.DataFrame) -> pl.DataFrame:
    """Where the last visit left each robot, where it is when all are parked (a dead one stays), where this one begins."""
    robot = ["survey", "tile_id", "robot_id"]
    from_park, is_live = pl.col("start") == "park", pl.col("state") == "live"
    turned_back = pl.when(from_park & is_live).then(0.0)
    rows = rows.join(last_theta, on="row", how="left", maintain_order="left").with_columns(
        end_x_mm="x_mm",
        end_y_mm="y_mm",
        end_theta_deg=pl.coalesce(pl.coalesce("end_theta_deg", turned_back).forward_fill().over(robot), "first_theta_deg"),
    )
    rows = rows.with_columns(
        pl.col(f"end_{name}").shift(1).over(robot).fill_null(pl.col(f"first_{name}")).alias(f"last_{name}") for name in STATE
    )
    parked = {"x_mm": pl.col("park_x_mm"), "y_mm": pl.col("park_y_mm"), "theta_deg": pl.lit(0.0)}
    rows = rows.with_columns(
        pl.when(is_live).then(place).otherwise(f"last_{name}").alias(f"parked_{name}") for name, place in parked.items()
    )
    return rows.with_columns(
        pl.when(from_park).then(f"parked_{name}").otherwise(f"last_{name}").alias(f"start_{name}") for name in STATE
    )


def _routes(rows: pl.DataFrame) -> pl.DataFrame:
    target = {"goal_x_mm": "x_mm", "goal_y_mm": "y_mm"}
    ends = {
        START_TO_TARGET: ("start", target),
        START_TO_PARK: ("last", {"goal_x_mm": "parked_x_mm", "goal_y_mm": "parked_y_mm"}),
        PARK_TO_TARGET: ("parked", target),
    }
    kept = [*VISIT, "visit_row", "robot_id", "target_id", "state"]
    blocks = [
        rows.select(*kept, path=pl.lit(path), **{f"start_{name}": f"{begin}_{name}" for name in STATE}, **goal)
        for path, (begin, goal) in ends.items()
    ]
    return pl.concat(blocks).with_columns(slot=pl.int_range(pl.len()))


def with_begins(legs: pl.DataFrame, routes: pl.DataFrame, constants: Constants) -> pl.DataFrame:
    """Legs, sorted by slot, with the state that each begins in and what follows from it."""
    slot = legs["slot"]
    begins = {f"begin_{name}": f"start_{name}" for name in STATE}
    legs = legs.with_columns(routes[column][slot].alias(name) for name, column in begins.items())
    legs = legs.with_columns(
        is_first=(pl.col("slot") != pl.col("slot").shift(1)).fill_null(value=True),
        is_last=(pl.col("slot") != pl.col("slot").shift(-1)).fill_null(value=True),
        length_mm=pl.col("dx_mm").abs() + pl.col("dy_mm").abs(),
        rotating_s=pl.col("rotate_deg").abs() / constants.rotation_speed_deg_s,
    )
    legs = legs.with_columns(
        pl.when("is_first").then(name).otherwise(pl.col(name.removeprefix("begin_")).shift(1)).alias(name) for name in begins
    )
    slow = pl.col("precise_mm")
    moving = (pl.col("length_mm") - slow) / constants.coarse_speed_mm_s + slow / constants.precise_speed_mm_s
    legs = legs.with_columns(own_theta_deg=pl.col("begin_theta_deg") + pl.col("rotate_deg"), moving_s=moving)
    along_x = from_own_axes(pl.col("own_theta_deg"), pl.col("dx_mm"), pl.lit(0.0))
    both = from_own_axes(pl.col("own_theta_deg"), pl.col("dx_mm"), pl.col("dy_mm"))
    return legs.with_columns(
        end_s=pl.col("start_s") + pl.col("rotating_s") + pl.col("moving_s"),
        corner_x_mm=pl.col("begin_x_mm") + along_x[0],
        corner_y_mm=pl.col("begin_y_mm") + along_x[1],
        own_x_mm=pl.col("begin_x_mm") + both[0],
        own_y_mm=pl.col("begin_y_mm") + both[1],
    )


def _totals(legs: pl.DataFrame) -> pl.DataFrame:
    return legs.group_by("slot").agg(
        n_leg=pl.len().cast(pl.Int64),
        rest_s=pl.col("end_s").last(),
        own_rotating_s=pl.col("rotating_s").sum(),
        own_moving_s=pl.col("moving_s").sum(),
        end_x_mm=pl.col("x_mm").last(),
        end_y_mm=pl.col("y_mm").last(),
        end_theta_deg=pl.col("theta_deg").last(),
    )
