"""What every router is given, what it gives back, and the door: a start or goal that breaks a rule is refused here."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, field_validator, model_validator

from survey_sim.errors import InputError
from survey_sim.extensions import check_name
from survey_sim.instrument import Plate
from survey_sim.motion import FloatArray, Legs, alone_time_s
from survey_sim.routing.kernels.geometry import has_near, is_legal
from survey_sim.settings import Settings

ROUTER_NAMES = ("simple-vector", "traffic-light", "cooperative-astar", "coordinated")

# Separations down to this much below min_separation_mm are legal everywhere (design tolerance).
SEPARATION_TOLERANCE_MM = 1e-6
# Plans keep this share of that tolerance, and starts and goals are held to the same, so that what is legal to stand in is
# legal to plan from; the rest is for rounding.
PLANNED_TOLERANCE_MM = 0.9 * SEPARATION_TOLERANCE_MM


class UnroutedReason(IntEnum):
    """Why a robot stays where it starts; 0 is a robot that arrived, or had nowhere to go."""

    ARRIVED = 0
    # Simple vector and traffic light: its straight line meets a robot that never leaves it.
    BLOCKED_STRAIGHT = 1
    # The search found no path among the robots planned before it.
    NO_PATH = 2
    # Its goal is held by a robot that could not be routed.
    DEADLOCK = 3
    # Proved: dead robots and the edge of its patrol region part its start from its goal.
    UNREACHABLE = 4

    @property
    def code(self) -> str:
        """Name in tables: `blocked-straight`, `no-path`, ..."""
        return self.name.lower().replace("_", "-")


class RoutingSettings(Settings):
    """Which router, and how it plans."""

    # One of ours, or of an installed package (docs/extending.md).
    router: str = "coordinated"
    # Extra separation planned where starts and goals allow; what cannot be routed so is routed without it.
    margin_mm: float = Field(0.0, ge=0)
    # Coordinated: steps of repair spent on shortening a path that was not found at the bound.
    n_repair: int = Field(300, ge=1)
    # Settings of a router of another package, which knows what they mean.
    options: dict[str, Any] = Field(default_factory=dict)

    @field_validator("router")
    @classmethod
    def _is_known(cls, name: str) -> str:
        return check_name("router", name, ROUTER_NAMES)

    @model_validator(mode="after")
    def _ours_have_no_options(self) -> Self:
        if self.options and self.router in ROUTER_NAMES:
            raise ValueError(f"options are for routers of other packages; {self.router!r} has none")
        return self


class Solution(NamedTuple):
    """What a router gives back.

    Attributes
    ----------
    legs, reason
        Legs of the robots that move; (n_robot,) int8 codes of `UnroutedReason`.
    slow_pair
        The two robots that need longest, were they alone, or, if none does, two that were still in conflict when the search
        at the bound ended; empty where it succeeded, or is not known.
    given_up_s
        About how long the path would take, where only one at the bound was looked for and none was found: then the legs are
        still in conflict. None otherwise.
    """

    legs: Legs
    reason: npt.NDArray[np.int8]
    slow_pair: tuple[int, ...] = ()
    given_up_s: float | None = None


class HeldUp(NamedTuple):
    """A path that was given up, because it would take longer than its bound.

    Attributes
    ----------
    lower_bound_s
        That bound: when the slowest robot that arrives would do so alone.
    configuration_time_s
        About how long it would take.
    held_up
        The robots to blame, as in `RoutedPath`.
    """

    lower_bound_s: float
    configuration_time_s: float
    held_up: tuple[int, ...]


@dataclass(frozen=True)
class RoutedPath:
    """One collision-free path of all robots.

    Attributes
    ----------
    legs
        Legs of the robots that move.
    reason
        (n_robot,) int8 codes of `UnroutedReason`.
    end_mm, end_theta_deg
        (n_robot, 2) mm and (n_robot,) deg, the state at the end; an unrouted robot stays where it starts.
    lower_bound_s
        When the slowest robot that arrives would do so alone.
    configuration_time_s
        When the last robot comes to rest.
    held_up
        Where that is later than the bound, the robots to blame: the two of `Solution.slow_pair`, if the router knows any,
        and the one that comes last. Empty at the bound.
    """

    legs: Legs
    reason: npt.NDArray[np.int8]
    end_mm: FloatArray
    end_theta_deg: FloatArray
    lower_bound_s: float
    configuration_time_s: float
    held_up: tuple[int, ...]


@dataclass(frozen=True)
class Problem:
    """A checked routing problem; arrays C-contiguous, robots in the plate's order."""

    plate: Plate
    start_mm: FloatArray
    start_theta_deg: FloatArray
    goal_mm: FloatArray

    @property
    def n_robot(self) -> int:
        """Number of robots, idle and dead ones included."""
        return len(self.start_mm)

    @cached_property
    def has_to_move(self) -> npt.NDArray[np.bool_]:
        """(n_robot,) whether the goal differs from the start."""
        return (self.goal_mm != self.start_mm).any(axis=1)

    @cached_property
    def alone_s(self) -> FloatArray:
        """(n_robot,) time of each robot alone, s."""
        return alone_time_s(self.plate.instrument, self.start_mm, self.start_theta_deg, self.goal_mm)

    @property
    def separation_mm(self) -> float:
        """Separation that plans keep, mm."""
        return self.plate.instrument.min_separation_mm - PLANNED_TOLERANCE_MM


def check_problem(plate: Plate, start_mm: FloatArray, start_theta_deg: FloatArray, goal_mm: FloatArray) -> Problem:
    """The problem as contiguous arrays, or InputError that names the robots and the rule."""
    n = plate.n_robot
    start = _array(start_mm, (n, 2), "start_mm")
    theta = _array(start_theta_deg, (n,), "start_theta_deg")
    goal = _array(goal_mm, (n, 2), "goal_mm")
    tolerance, least = SEPARATION_TOLERANCE_MM, plate.instrument.min_separation_mm - PLANNED_TOLERANCE_MM
    reach, radius = plate.patrol_radius_mm + tolerance, plate.instrument.plate_radius_mm + tolerance
    if not is_legal(start, goal, theta, plate.park_mm, reach, plate.is_live, radius, least):
        _refuse_what_is_wrong(plate, start, theta, goal)
    return Problem(plate, start, theta, goal)


def _refuse_what_is_wrong(plate: Plate, start: FloatArray, theta: FloatArray, goal: FloatArray) -> None:
    """Raise the InputError that `is_legal` found need of."""
    for place, values in (("start_mm", start), ("start_theta_deg", theta), ("goal_mm", goal)):
        is_bad = np.asarray(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))
        if is_bad.any():
            _refuse(plate, is_bad, place, "not a finite number")
    for place, position in (("start_mm", start), ("goal_mm", goal)):
        _check_inside(plate, position, place)
        _check_separation(plate, position, place)
    moved = ~plate.is_live & (goal != start).any(axis=1)
    if moved.any():
        _refuse(plate, moved, "goal_mm", "a dead robot's goal must be its start")


def _array(values: FloatArray, shape: tuple[int, ...], place: str) -> FloatArray:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != shape:
        raise InputError(f"shape {array.shape}, not {shape}: one row a robot of the plate", place=place)
    return array


def _check_inside(plate: Plate, position: FloatArray, place: str) -> None:
    tolerance = SEPARATION_TOLERANCE_MM
    # A dead robot never moves, so wherever it stands is legal.
    out_of_plate = np.hypot(*position.T) > plate.instrument.plate_radius_mm + tolerance
    if (out_of_plate & plate.is_live).any():
        _refuse(plate, out_of_plate & plate.is_live, place, f"outside the plate, {plate.instrument.plate_radius_mm} mm")
    out_of_reach = np.hypot(*(position - plate.park_mm).T) > plate.patrol_radius_mm + tolerance
    if (out_of_reach & plate.is_live).any():
        _refuse(plate, out_of_reach & plate.is_live, place, "further from park than the patrol radius")


def _check_separation(plate: Plate, position: FloatArray, place: str) -> None:
    least = plate.instrument.min_separation_mm
    near = has_near(position, least - PLANNED_TOLERANCE_MM)
    if near.any():
        _refuse(plate, near, place, f"robots nearer to each other than min_separation_mm = {least}")


def _refuse(plate: Plate, bad: np.ndarray, place: str, rule: str) -> None:
    raise InputError(rule, place=place, rows=[f"robot {robot}" for robot in plate.robot_id[bad]])
