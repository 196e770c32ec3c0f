"""The door for what a router of another package gives: its form is checked here, its truth by `survey-sim check`."""

from dataclasses import fields
from typing import Any

import numpy as np

from survey_sim.errors import InputError
from survey_sim.motion import Legs
from survey_sim.routing.problem import Problem, RoutingSettings, Solution, UnroutedReason

# How far from its goal a robot that arrives may end: rounding.
END_TOLERANCE_MM = 1e-6


def checked_routes(problem: Problem, settings: RoutingSettings, result: Any) -> Solution:
    """Legs and reasons as the tables need them.

    Raises
    ------
    InputError
        Not a pair of legs and reasons, or of another shape or kind; legs that are not finite, not in the order of robot and
        leg, or of robots that are dead, unknown or unrouted; robots that arrive elsewhere than at their goals.
    """

    def refuse(rule: str, robots: Any = None) -> None:
        raise InputError(
            f"router {settings.router!r} gave {rule}", place="routing.router", rows=robots, remedy="mend that package"
        )

    if not (isinstance(result, tuple) and len(result) == 2 and isinstance(result[0], Legs)):
        refuse(f"{type(result).__name__}, not (Legs, reasons)")
    legs, reasons = result
    columns = {field.name: np.asarray(getattr(legs, field.name)) for field in fields(Legs)}
    if any(column.shape != columns["robot"].shape or column.ndim != 1 for column in columns.values()):
        refuse("leg columns of different lengths")
    if np.shape(reasons) != (problem.n_robot,) or not np.isin(reasons, [code.value for code in UnroutedReason]).all():
        refuse(f"reasons that are not {problem.n_robot} codes of UnroutedReason")
    if not all(np.isfinite(column).all() for column in columns.values()):
        refuse("legs that are not finite")
    robot = columns["robot"]
    if ((robot < 0) | (robot >= problem.n_robot)).any():
        refuse("legs of robots that the plate does not have")
    is_free = problem.plate.is_live & (np.asarray(reasons) == UnroutedReason.ARRIVED)
    if not is_free[robot].all():
        refuse(
            "legs to robots that are dead or unrouted", np.unique(problem.plate.robot_id[robot[~is_free[robot]]]).tolist()
        )
    is_next = np.diff(robot, prepend=-1) == 0
    expected = np.where(is_next, np.roll(columns["leg"], 1) + 1, 0)
    if (np.diff(robot) < 0).any() or (columns["leg"] != expected).any():
        refuse("legs that are not sorted by robot and leg, counted from 0")
    ends = problem.start_mm.copy()
    last = np.flatnonzero(np.diff(robot, append=-1) != 0)
    ends[robot[last]] = np.column_stack([columns["x_mm"][last], columns["y_mm"][last]])
    is_lost = (np.asarray(reasons) == UnroutedReason.ARRIVED) & (np.hypot(*(ends - problem.goal_mm).T) > END_TOLERANCE_MM)
    if is_lost.any():
        refuse("no reason for robots that do not end at their goals", problem.plate.robot_id[is_lost].tolist())
    typed = {field.name: np.float64 for field in fields(Legs)} | {"robot": np.int32, "leg": np.int16}
    whole = Legs(**{name: np.ascontiguousarray(column, dtype=typed[name]) for name, column in columns.items()})
    return Solution(whole, np.asarray(reasons, dtype=np.int8))
