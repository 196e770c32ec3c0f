"""Moves of a router file: checked against the rules of ticks, and joined into legs again."""

from pathlib import Path

import numpy as np
import polars as pl

from survey_sim.errors import InputError
from survey_sim.exchange.votable import Document
from survey_sim.instrument import Instrument, Plate
from survey_sim.motion import FloatArray, Legs, wrap_deg

# A move's final state is what its instruction gives, to this much (the round trip's promise).
PLACE_TOLERANCE_MM = 1e-3
ANGLE_TOLERANCE_DEG = 1e-4
# Moves of a tick end before the next begins; rounding of times.
TIME_TOLERANCE_S = 1e-6


def legs_from_moves(document: Document, path: str, plate: Plate, start_mm: FloatArray, start_theta_deg: FloatArray) -> Legs:
    """Legs of one path of a router file.

    Moves that are parts of one leg (column `leg`) are joined; without that column every move is a leg. Without `start_s`
    a tick begins when the last one's moves have ended; without `precise_mm` a robot's last move ends with the instrument's
    precise approach.

    Parameters
    ----------
    start_mm, start_theta_deg
        (n_robot, 2) mm and (n_robot,) deg at the start of the path.

    Raises
    ------
    InputError
        Ticks out of order, two moves of one robot in a tick, an unknown robot, a dead robot that moves, a final state that
        does not follow from the move, a tick that begins before the last has ended.
    """
    moves = document.table(path).with_row_index("row")
    check_moves(moves, plate, start_mm, start_theta_deg, document.file, path)
    moves = _completed(moves, plate.instrument, document.file, path)
    parts = moves.sort("robot_id", "tick").group_by("robot_id", "leg", maintain_order=True)
    joined = parts.agg(
        pl.col("start_s").first(),
        pl.col("dtheta_deg", "dx_mm", "dy_mm", "precise_mm").sum(),
        pl.col("x_mm", "y_mm", "theta_deg").last(),
    )
    robot = np.searchsorted(plate.robot_id, joined["robot_id"].to_numpy()).astype(np.int32)
    names = ("start_s", "dtheta_deg", "dx_mm", "dy_mm", "precise_mm", "x_mm", "y_mm", "theta_deg")
    return Legs(robot, joined["leg"].to_numpy().astype(np.int16), *(joined[name].to_numpy() for name in names))


def check_moves(
    moves: pl.DataFrame,
    plate: Plate,
    start_mm: FloatArray,
    start_theta_deg: FloatArray,
    file: Path | None,
    path: str,
) -> None:
    """Refuse moves (with a column `row`) that break a rule of ticks; see `legs_from_moves`."""

    def refuse_where(is_bad: pl.Expr | np.ndarray, rule: str, column: str, remedy: str | None = None) -> None:
        bad = moves.filter(is_bad)["row"].to_list()
        if bad:
            raise InputError(rule, file=file, place=f"table {path}, {column}", rows=bad, remedy=remedy)

    in_order = "sort the rows by tick, and number ticks from 0"
    refuse_where((pl.col("tick") < 0) | (pl.col("tick").diff() < 0), "ticks out of order", "tick", in_order)
    refuse_where(pl.struct("tick", "robot_id").is_duplicated(), "two moves of one robot in a tick", "robot_id")
    refuse_where(~pl.col("robot_id").is_in(plate.robot_id.tolist()), "robot is not among the initial positions", "robot_id")
    dead = plate.robot_id[~plate.is_live].tolist()
    refuse_where(pl.col("robot_id").is_in(dead), "a dead robot moves", "robot_id")
    refuse_where(pl.col("dtheta_deg").abs() > 180.0 + ANGLE_TOLERANCE_DEG, "turns more than half a turn", "dtheta_deg")
    far, turned = _misfit(moves, plate, start_mm, start_theta_deg)
    remedy = "x, y are the state that dtheta, then dx, dy along the robot's own axes, lead to"
    refuse_where(far > PLACE_TOLERANCE_MM, "final position does not follow from the move", "x_mm", remedy)
    refuse_where(turned > ANGLE_TOLERANCE_DEG, "final angle does not follow from the move", "theta_deg", remedy)


def _misfit(
    moves: pl.DataFrame, plate: Plate, start_mm: FloatArray, start_theta_deg: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """How far each row's final state is from what its instruction gives: mm, and deg."""
    begun = pl.DataFrame(
        {
            "robot_id": plate.robot_id,
            "begin_x": start_mm[:, 0],
            "begin_y": start_mm[:, 1],
            "begin_theta": start_theta_deg,
        }
    )
    whole = moves.join(begun, on="robot_id", how="left", maintain_order="left")
    whole = whole.with_columns(
        pl.col(end).shift(1).over("robot_id").fill_null(pl.col(begin)).alias(begin)
        for end, begin in (("x_mm", "begin_x"), ("y_mm", "begin_y"), ("theta_deg", "begin_theta"))
    )
    column = {name: whole[name].to_numpy() for name in whole.columns}
    theta = column["begin_theta"] + column["dtheta_deg"]
    cosine, sine = np.cos(np.radians(theta)), np.sin(np.radians(theta))
    x = column["begin_x"] + cosine * column["dx_mm"] - sine * column["dy_mm"]
    y = column["begin_y"] + sine * column["dx_mm"] + cosine * column["dy_mm"]
    return np.hypot(x - column["x_mm"], y - column["y_mm"]), np.abs(wrap_deg(theta - column["theta_deg"]))


def _completed(moves: pl.DataFrame, instrument: Instrument, file: Path | None, path: str) -> pl.DataFrame:
    """The moves with leg, precise_mm and start_s, and the proof that no tick begins before the last has ended."""
    if "leg" not in moves.columns:
        moves = moves.with_columns(leg=(pl.col("tick").rank("ordinal").over("robot_id") - 1).cast(pl.Int16))
    length = pl.col("dx_mm").abs() + pl.col("dy_mm").abs()
    if "precise_mm" not in moves.columns:
        is_last = pl.col("tick") == pl.col("tick").max().over("robot_id")
        approach = pl.min_horizontal(length, pl.lit(instrument.precise_approach_mm))
        moves = moves.with_columns(precise_mm=pl.when(is_last).then(approach).otherwise(0.0))
    odd = moves.filter((pl.col("precise_mm") < 0) | (pl.col("precise_mm") > length + PLACE_TOLERANCE_MM))["row"].to_list()
    if odd:
        raise InputError("outside the move", file=file, place=f"table {path}, precise_mm", rows=odd)
    duration = (
        pl.col("dtheta_deg").abs() / instrument.rotation_speed_deg_s
        + (length - pl.col("precise_mm")) / instrument.coarse_speed_mm_s
        + pl.col("precise_mm") / instrument.precise_speed_mm_s
    )
    ticks = moves.group_by("tick").agg(lasts=duration.max()).sort("tick")
    if "start_s" not in moves.columns:
        ticks = ticks.with_columns(start_s=pl.col("lasts").cum_sum() - pl.col("lasts"))
        return moves.join(ticks.select("tick", "start_s"), on="tick", how="left", maintain_order="left")
    _check_times(moves, ticks, file, path)
    return moves


def _check_times(moves: pl.DataFrame, ticks: pl.DataFrame, file: Path | None, path: str) -> None:
    begun = moves.group_by("tick").agg(pl.col("start_s").min(), span=pl.col("start_s").max() - pl.col("start_s").min())
    timed = ticks.join(begun, on="tick").sort("tick")
    end = (timed["start_s"] + timed["lasts"]).shift(1, fill_value=0.0)
    is_early = (timed["start_s"] < end - TIME_TOLERANCE_S) | (timed["span"] > TIME_TOLERANCE_S)
    if is_early.any():
        bad = moves.filter(pl.col("tick").is_in(timed["tick"].filter(is_early).to_list()))["row"].to_list()
        rule = "tick begins before the moves of the last have ended"
        raise InputError(rule, file=file, place=f"table {path}, start_s", rows=bad)
