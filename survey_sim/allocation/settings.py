"""What a scientist may change about the allocation, and the reasons it gives."""

from enum import IntEnum
from itertools import pairwise
from typing import Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from survey_sim.extensions import check_name
from survey_sim.settings import Settings

ALGORITHMS = ("ideal", "cda-basic", "cda-advanced", "matching", "plan")


# Measured (docs/allocation.md).
PARK_PULL = 0.3


class LostReason(IntEnum):
    """Why a science target is not complete."""

    NONE = 0
    OUT_OF_REACH = 1
    BLOCKED_BY_DEAD = 2
    TOO_CLOSE_PAIR = 3
    CROWDED = 4
    LOW_PRIORITY = 5
    NO_FIBRE_LEFT = 6
    UNROUTED = 7
    NO_VISIT = 8

    @property
    def label(self) -> str:
        """The code as tables spell it ("out-of-reach")."""
        return self.name.lower().replace("_", "-")


class AllocationSettings(Settings):
    """How fibres are given to targets, visit by visit."""

    # One of ours, or of an installed package (docs/extending.md).
    algorithm: str = "plan"
    # Cost of a move of d mm is d^travel_power: 4 is nearly the shortest configuration, 1 the least travel.
    travel_power: float = Field(4.0, gt=0, le=8)
    # `matching` and `plan`: to that is added so much of the same power of the distance from the robot's park to its target.
    # Robots stay near their parks: the ways from and to park are shorter, and easier to route. Absent: 0.3 in `plan`; 0 in
    # `matching`, which it costs targets, and at a travel_power of 1 or less, which asks for the least travel alone.
    park_pull: float | None = Field(None, ge=0, le=100)
    # Visits of a tile; None = as many as the wanted completeness needs, and no more.
    visits: int | None = Field(None, ge=1)
    max_visits: int = Field(100, ge=1)
    # A further visit is worth its time only if it brings at least so many science targets.
    min_gain: int = Field(1, ge=1)
    # Fibres wanted in every visit besides science (TAIPAN's tiling code, 2017: 10, 20, 9).
    wanted_standard: int = Field(10, ge=0)
    wanted_sky: int = Field(20, ge=0)
    wanted_guide: int = Field(9, ge=0)
    # The least that is acceptable (TAIPAN's tiling code, 2020); met by giving up the least valuable science.
    min_standard: int = Field(5, ge=0)
    min_sky: int = Field(10, ge=0)
    min_guide: int = Field(3, ge=0)
    # Least sky fibres in each of so many equal sectors of the plate (assumed).
    sky_regions: int = Field(6, ge=1)
    min_sky_region: int = Field(1, ge=0)
    # A target of priority p is worth 1 + priority_gain (p - 1) / 8 (assumed: number first, then priority).
    priority_gain: float = Field(0.1, ge=0)
    # Ties between targets of one priority are broken at random: each is worth a random part of so many steps of priority
    # more, drawn for each tile by the seed. 0: as the search falls. Selection weights need it above 0 (docs/imprint.md).
    sub_priority: float = Field(0.0, ge=0, le=1)
    # `plan`: what a visit's delay of a target of the highest priority costs, as a move of so many mm (assumed).
    delay_worth_mm: float = Field(10.0, ge=0)
    # `plan`: length of its searches, as a multiple of the usual one.
    effort: float = Field(1.0, gt=0)
    # Ranges of magnitude of which one exposure serves one, bright end included, faint end not; they may overlap. The first
    # has all brighter targets too, the last all fainter ones. Empty: any visit may hold any target.
    # TAIPAN's tiling code, for FunnelWeb: 5 to 8, 7 to 10, 9 to 12.
    mag_ranges: tuple[tuple[float, float], ...] = ()
    # Upper bound of completeness given beside every visit: "linear" is tight and slow, "fast" loose.
    bound: Literal["none", "fast", "linear"] = "fast"

    # Settings of an allocator of another package, which knows what they mean.
    options: dict[str, Any] = Field(default_factory=dict)

    @field_validator("algorithm")
    @classmethod
    def _is_known(cls, name: str) -> str:
        return check_name("allocator", name, ALGORITHMS)

    @model_validator(mode="after")
    def _ours_have_no_options(self) -> Self:
        if self.options and self.algorithm in ALGORITHMS:
            raise ValueError(f"options are for allocators of other packages; {self.algorithm!r} has none")
        return self

    @property
    def used_park_pull(self) -> float:
        """`park_pull`, or what stands for it where it is absent."""
        if self.park_pull is not None:
            return self.park_pull
        return PARK_PULL if self.algorithm == "plan" and self.travel_power > 1.0 else 0.0

    @field_validator("mag_ranges")
    @classmethod
    def _ranges_ascend(cls, ranges: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        if any(bright >= faint for bright, faint in ranges):
            raise ValueError("each range is [bright, faint], the smaller magnitude first")
        for before, after in pairwise(ranges):
            if not (before[0] < after[0] <= before[1] < after[1]):
                raise ValueError(f"ranges go from bright to faint without a gap, unlike {list(before)}, {list(after)}")
        return ranges
