"""The door for what an allocator of another package chooses: each rule of a visit, before any robot moves."""

from typing import Any

import numpy as np

from survey_sim.allocation.field import Field, VisitRequest
from survey_sim.allocation.targets import IntArray
from survey_sim.errors import InputError


def checked_choice(field: Field, request: VisitRequest, held: Any) -> IntArray:
    """(n_robot,) index into the field's targets or -1, whole numbers in an array of its own.

    Raises
    ------
    InputError
        Another shape or kind; a target that is unknown, not open, held twice, or not among those that its robot may serve;
        two targets nearer than the separation.
    """
    plate, n_target = field.plate, field.targets.n_target

    def refuse(rule: str, robots: np.ndarray | None = None) -> None:
        rows = None if robots is None else [f"robot {robot}" for robot in plate.robot_id[robots]]
        algorithm = field.settings.algorithm
        raise InputError(
            f"allocator {algorithm!r} gave {rule}", place="allocation.algorithm", rows=rows, remedy="mend that package"
        )

    held = np.asarray(held)
    if held.shape != (plate.n_robot,) or held.dtype.kind not in "iu":
        refuse(f"an array {held.dtype} {held.shape}, not ({plate.n_robot},) whole numbers")
    held = held.astype(np.int64)
    if (is_unknown := (held < -1) | (held >= n_target)).any():
        refuse(f"targets that are not -1 to {n_target - 1}", is_unknown)
    robots = np.flatnonzero(held >= 0)
    target = held[robots]
    if (is_closed := ~request.is_open[target]).any():
        refuse("targets that are not open", robots[is_closed])
    if (is_twice := np.bincount(target, minlength=n_target)[target] > 1).any():
        refuse("one target to two robots", robots[is_twice])
    pairs = np.column_stack([field.pair_target(), field.reach_robot])[request.is_pair_open]
    is_served = np.isin(target * plate.n_robot + robots, pairs[:, 0] * plate.n_robot + pairs[:, 1])
    if not is_served.all():
        refuse("targets that the robot may not serve", robots[~is_served])
    if (is_near := _is_near_another(field, target)).any():
        refuse(f"targets nearer to each other than {field.separation_mm} mm", robots[is_near])
    return held


def _is_near_another(field: Field, target: IntArray) -> np.ndarray:
    """(n,) whether each of these targets is too close to another of them."""
    is_held = np.zeros(field.targets.n_target, dtype=bool)
    is_held[target] = True
    return np.array([is_held[field.near[field.near_first[t] : field.near_first[t + 1]]].any() for t in target], dtype=bool)
