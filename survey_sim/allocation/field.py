"""One tile's targets on one plate, made ready for the kernels: who is near whom, who reaches what."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from survey_sim.allocation.kernels.lists import near_among, near_any, near_lists, nearest_squared, reach_lists, sum_near
from survey_sim.allocation.minima import Minima, sectors
from survey_sim.allocation.settings import AllocationSettings
from survey_sim.allocation.targets import GUIDE, PRIORITY_RANGE, SKY, FieldTargets, FloatArray, IntArray
from survey_sim.instrument import Plate

BoolArray = npt.NDArray[np.bool_]

# What stands for `priority_gain` in sub-priorities where it is 0.
LEAST_PRIORITY_GAIN = 0.1


@dataclass(frozen=True)
class Field:
    """What an allocator reads and never changes.

    Attributes
    ----------
    xy_mm
        (n_target, 2) mm, plate frame.
    is_on_plate
        (n_target,) the others are set aside.
    value
        (n_target,) what a visit to a science target is worth: 1 + priority_gain (p - 1) / 8.
    sector
        (n_target,) plate region of each sky target, -1 for the other kinds.
    near_first, near
        Lists of the targets nearer than the separation to each target.
    reach_first, reach_robot
        Lists of the live robots that may serve each target.
    """

    targets: FieldTargets
    plate: Plate
    settings: AllocationSettings
    minima: Minima
    xy_mm: FloatArray
    is_on_plate: BoolArray
    value: FloatArray
    sector: IntArray
    near_first: IntArray
    near: npt.NDArray[np.int32]
    reach_first: IntArray
    reach_robot: npt.NDArray[np.int32]

    @property
    def separation_mm(self) -> float:
        """Least distance between two robots, mm."""
        return self.plate.instrument.min_separation_mm

    @property
    def is_reached(self) -> BoolArray:
        """(n_target,) whether a live robot may serve each target."""
        return np.asarray(np.diff(self.reach_first) > 0)

    def pair_target(self) -> IntArray:
        """(n_pair,) target of each entry of `reach_robot`."""
        return np.repeat(np.arange(self.targets.n_target), np.diff(self.reach_first))

    def pairs_of(self, chosen: IntArray) -> tuple[IntArray, IntArray]:
        """Entries of `reach_robot` of some targets, one after another: where each begins (n + 1,), and they (n_pair,)."""
        n_own = np.diff(self.reach_first)[chosen]
        first = np.concatenate([[0], np.cumsum(n_own)])
        return first, np.arange(first[-1]) + np.repeat(self.reach_first[chosen] - first[:-1], n_own)

    def sum_near(self, worth: FloatArray) -> FloatArray:
        """(n_target,) sum of `worth` (n_target,) over the targets near each target."""
        return sum_near(worth, self.near_first, self.near)

    def shortfall(self, held: IntArray) -> dict[str, int]:
        """By how much (n_robot,) held targets, -1 for none, fall short of the visit's minima."""
        target = held[held >= 0]
        return self.minima.shortfall(self.targets.kind[target], self.targets.x_mm[target], self.targets.y_mm[target])

    def near_any(self, target: IntArray) -> BoolArray:
        """(n_target,) targets that are one of those given, or too close to one."""
        return near_any(target, self.near_first, self.near, self.targets.n_target)

    def blocked_by(self, position_mm: FloatArray) -> BoolArray:
        """(n_target,) targets nearer than the separation to any of the (n, 2) positions, mm."""
        return nearest_squared(self.xy_mm, position_mm) < self.separation_mm**2


def with_sub_priority(field: Field, rng: np.random.Generator, worth: float) -> Field:
    """The field with the worth of each science target raised by a random part of a step of priority.

    So ties between targets of one priority are broken at random, as by DESI's sub-priorities, and no priority is overtaken.

    Parameters
    ----------
    worth
        The most that is added, in steps of priority.
    """
    low, high = PRIORITY_RANGE
    step = (field.settings.priority_gain or LEAST_PRIORITY_GAIN) / (high - low)
    drawn = rng.random(field.targets.n_target)
    return replace(field, value=field.value + np.where(field.targets.is_science, worth * step * drawn, 0.0))


@dataclass(frozen=True)
class VisitRequest:
    """What one visit starts from.

    Attributes
    ----------
    visit_id
        Counted from 0 in the session.
    start_mm
        (n_robot, 2) where the robots start, mm.
    is_open
        (n_target,) targets that may be held: on the plate, still wanted, not near a dead robot.
    is_pair_open
        (n_pair,) entries of `Field.reach_robot` that may be used: those that the router has not failed.
    missing
        (n_target,) visits that each science target still wants; 0 for the other kinds.
    """

    visit_id: int
    start_mm: FloatArray
    is_open: BoolArray
    is_pair_open: BoolArray
    missing: IntArray


def make_field(targets: FieldTargets, plate: Plate, settings: AllocationSettings) -> Field:
    """Lists of neighbours and of robots in reach, and the worth of each target."""
    xy = np.ascontiguousarray(np.column_stack([targets.x_mm, targets.y_mm]))
    is_on_plate = targets.is_on_plate(plate.instrument.plate_radius_mm)
    near = near_lists(targets.x_mm, targets.y_mm, plate.instrument.min_separation_mm)
    reach_mm = plate.patrol_radius_mm * np.where(plate.is_live, 1.0, np.nan)
    reach = reach_lists(plate.park_mm, reach_mm, plate.is_guide, xy, targets.kind == GUIDE, is_on_plate)
    return _with_lists(targets, plate, settings, xy, is_on_plate, near, reach)


def close_pair(
    reach_first: IntArray, reach_robot: npt.NDArray[np.int32], robot: int, target: int, is_pair_open: BoolArray
) -> None:
    """A robot shall not hold a target: note it in `is_pair_open` (n_pair,), in the order of the lists of `reach_lists`."""
    pairs = slice(reach_first[target], reach_first[target + 1])
    is_pair_open[pairs] &= reach_robot[pairs] != robot


def part_of_field(field: Field, chosen: IntArray, targets: FieldTargets, settings: AllocationSettings) -> Field:
    """What `make_field` makes of some of the targets of a field, from its lists.

    Parameters
    ----------
    chosen
        (n,) their places in the field, ascending.
    targets
        They themselves, where they stood before; priority, programme and completeness wanted may be others.
    """
    near = near_among(chosen, field.targets.n_target, field.near_first, field.near)
    first, pair = field.pairs_of(chosen)
    xy, is_on_plate = field.xy_mm[chosen], field.is_on_plate[chosen]
    return _with_lists(targets, field.plate, settings, xy, is_on_plate, near, (first, field.reach_robot[pair]))


def _with_lists(
    targets: FieldTargets,
    plate: Plate,
    settings: AllocationSettings,
    xy_mm: FloatArray,
    is_on_plate: BoolArray,
    near: tuple[IntArray, npt.NDArray[np.int32]],
    reach: tuple[IntArray, npt.NDArray[np.int32]],
) -> Field:
    low, high = PRIORITY_RANGE
    return Field(
        targets=targets,
        plate=plate,
        settings=settings,
        minima=Minima.of(settings, plate),
        xy_mm=xy_mm,
        is_on_plate=is_on_plate,
        value=1.0 + settings.priority_gain * (targets.priority - low) / (high - low),
        sector=np.where(targets.kind == SKY, sectors(targets.x_mm, targets.y_mm, settings.sky_regions), -1),
        near_first=near[0],
        near=near[1],
        reach_first=reach[0],
        reach_robot=reach[1],
    )
