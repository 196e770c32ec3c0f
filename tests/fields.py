"""Chains of matched test fields: uniform targets at least the separation apart, taken by least sum of distance^4."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from survey_sim.instrument import Plate

OUT_OF_REACH = 1e12


@dataclass
class Field:
    """Goals of all robots; `is_assigned` marks those that have a target."""

    goal_mm: np.ndarray
    is_assigned: np.ndarray


def uniform_targets(plate: Plate, n_target: int, rng: np.random.Generator) -> np.ndarray:
    """(n_target, 2) positions at least the separation apart, mm."""
    radius, separation = plate.instrument.plate_radius_mm, plate.instrument.min_separation_mm
    kept = np.empty((0, 2))
    while len(kept) < n_target:
        new = rng.uniform(-radius, radius, size=(n_target, 2))
        new = new[np.hypot(*new.T) <= radius]
        for point in new:
            if len(kept) < n_target and (np.hypot(*(kept - point).T) >= separation).all():
                kept = np.vstack([kept, point])
    return kept


def matched_field(plate: Plate, position_mm: np.ndarray, n_target: int, rng: np.random.Generator, power: float = 4) -> Field:
    """Next goals from `position_mm`; robots without a target stay, and targets too near to one that stays are dropped."""
    target = uniform_targets(plate, n_target, rng)
    live = np.flatnonzero(plate.is_live)
    while True:
        if (~plate.is_live).any():
            target = target[_is_clear(plate, target, position_mm[~plate.is_live])]
        cost = np.hypot(*(position_mm[live, None] - target[None]).transpose(2, 0, 1)) ** power
        reach = np.hypot(*(plate.park_mm[live, None] - target[None]).transpose(2, 0, 1))
        cost[reach > plate.patrol_radius_mm[live, None]] = OUT_OF_REACH
        row, column = linear_sum_assignment(cost)
        kept = cost[row, column] < OUT_OF_REACH
        goal, is_assigned = position_mm.copy(), np.zeros(plate.n_robot, dtype=bool)
        goal[live[row[kept]]] = target[column[kept]]
        is_assigned[live[row[kept]]] = True
        stays = ~is_assigned
        clear = _is_clear(plate, target, position_mm[stays]) if stays.any() else np.ones(len(target), dtype=bool)
        if clear[column[kept]].all():
            return Field(goal, is_assigned)
        used_unclear = np.intersect1d(column[kept], np.flatnonzero(~clear))
        target = np.delete(target, used_unclear, axis=0)


def random_field(plate: Plate, position_mm: np.ndarray, rng: np.random.Generator) -> Field:
    """Goals uniform in each robot's reach, not matched at all; a robot that finds none legal stays."""
    separation = plate.instrument.min_separation_mm
    goal = position_mm.copy()
    placed: list[int] = []
    for robot in rng.permutation(np.flatnonzero(plate.is_live)):
        others = goal[[k for k in range(plate.n_robot) if k != robot]]
        for _ in range(200):
            angle, radius = rng.uniform(0, 2 * np.pi), plate.patrol_radius_mm[robot] * np.sqrt(rng.random())
            point = plate.park_mm[robot] + radius * np.array([np.cos(angle), np.sin(angle)])
            inside = np.hypot(*point) <= plate.instrument.plate_radius_mm
            if inside and (np.hypot(*(others - point).T) >= separation).all():
                goal[robot] = point
                placed.append(robot)
                break
    is_assigned = np.zeros(plate.n_robot, dtype=bool)
    is_assigned[placed] = True
    return Field(goal, is_assigned)


def chain(plate: Plate, n_visit: int, n_target: int, rng: np.random.Generator) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(start, goal) of each visit, the first from park."""
    position = plate.park_mm.copy()
    for _ in range(n_visit):
        goal = matched_field(plate, position, n_target, rng).goal_mm
        yield position, goal
        position = goal


def _is_clear(plate: Plate, target: np.ndarray, others: np.ndarray) -> np.ndarray:
    return cKDTree(others).query(target)[0] >= plate.instrument.min_separation_mm
