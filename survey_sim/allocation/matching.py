"""One visit, exactly: most value of targets, then least travel, no two targets too close."""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from survey_sim.allocation.field import BoolArray, Field, VisitRequest, close_pair
from survey_sim.allocation.kernels.choosing import pairs_by_distance, pick_apart, take_in_order
from survey_sim.allocation.kernels.lists import nearest_squared
from survey_sim.allocation.kernels.matching import match_open
from survey_sim.allocation.kernels.untangle import untangle
from survey_sim.allocation.targets import GUIDE, PRIORITY_RANGE, SKY, STANDARD, FloatArray, IntArray
from survey_sim.schema import TARGET_KINDS

# Worth of a fibre that the visit must have, in science targets: at most five targets near one are apart from each other, so
# nothing that it displaces is worth as much.
NEEDED_VALUE = 10.0
# Priorities 1 to 9 differ by whole steps of priority_gain / 8; more steps to a unit than this are below the rounding.
PRIORITY_STEPS = PRIORITY_RANGE[1] - PRIORITY_RANGE[0]
MAX_STEPS = 1000.0
# Branchings of the exact search before the best so far is taken (the twelve anchors need at most 31).
MAX_NODES = 60
# Share of the robots that must be without a target for exchanges to be worth it; chosen on the demo's tiles.
SPARE_FRAC = 0.1


def choose_matching(field: Field, request: VisitRequest) -> IntArray:
    """The visit of most priority-weighted science and, of all such, of least travel cost (`match`).

    Standards and sky are picked first, where they stand in the way of the least science. The least acceptable numbers
    displace science; those wanted beyond it count as science of the highest priority, and fill what robots are left.

    Returns
    -------
        (n_robot,) target of each robot or -1.
    """
    is_needed, is_picked = pick_calibration(field, request.is_open, request.start_mm)
    value = np.where(field.targets.is_science, field.value, 1.0 + field.settings.priority_gain)
    value[is_needed] = NEEDED_VALUE
    is_calibration = (field.targets.kind == STANDARD) | (field.targets.kind == SKY)
    is_open = request.is_open & (~is_calibration | is_picked)
    held = match(field, request.start_mm, is_open, request.is_pair_open, value)
    return untangled(field, request, fill_calibration(field, request, held))


def match(field: Field, start_mm: FloatArray, is_open: BoolArray, is_pair_open: BoolArray, value: FloatArray) -> IntArray:
    """(n_robot,) target of each robot or -1: most value, then least travel cost, of the open targets.

    The cost is the sum of travel^travel_power + park_pull (distance from park to target)^travel_power.
    """
    steps = min(MAX_STEPS, max(1.0, PRIORITY_STEPS / max(field.settings.priority_gain, 1e-12)))
    # All travel together costs less than n_robot, so a step of value always comes before it.
    return match_open(
        is_open, is_pair_open, start_mm, field.plate.park_mm, field.xy_mm, value, field.plate.n_robot * steps,
        field.settings.travel_power / 2.0, field.settings.used_park_pull,
        field.reach_first, field.reach_robot, field.near_first, field.near, field.separation_mm, MAX_NODES,
    )  # fmt: skip


def pick_calibration(field: Field, is_open: BoolArray, start_mm: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Standards and sky where they displace the least science, apart from each other, sky first in every plate region.

    Of those that displace as much, the ones nearest to a robot come first.

    Returns
    -------
    is_needed, is_picked
        (n_target,) the least acceptable numbers, with all guides; as many standards and sky as are wanted.
    """
    settings, minima, kind = field.settings, field.minima, field.targets.kind
    displaced = field.sum_near(np.where(is_open & field.targets.is_science, field.value, 0.0))
    is_served = is_open & field.is_reached
    is_picked = np.zeros(field.targets.n_target, dtype=bool)
    robot_mm = start_mm[~field.plate.is_guide & field.plate.is_live]

    def pick(is_candidate: BoolArray, limit: int) -> int:
        candidates = np.flatnonzero(is_candidate & is_served)
        nearest = nearest_squared(field.xy_mm[candidates], robot_mm)
        candidates = candidates[np.lexsort((nearest, displaced[candidates]))]
        return pick_apart(candidates, limit, field.near_first, field.near, is_open, is_picked)

    pick(kind == STANDARD, minima.min_standard)
    n_sky = sum(pick(field.sector == region, minima.min_sky_region) for region in range(minima.sky_regions))
    n_sky += pick(kind == SKY, minima.min_sky - n_sky)
    is_needed = is_picked | (kind == GUIDE)
    pick(kind == STANDARD, settings.wanted_standard - minima.min_standard)
    pick(kind == SKY, settings.wanted_sky - n_sky)
    return is_needed, is_picked


def fill_calibration(field: Field, request: VisitRequest, held: IntArray) -> IntArray:
    """Add the standards and sky that are still wanted, those closest to idle robots first, and match all robots anew.

    Guides beyond those wanted are let go.
    """
    settings, minima, kind = field.settings, field.minima, field.targets.kind
    guides = np.flatnonzero((held >= 0) & (kind[held] == GUIDE))
    held = held.copy()
    if len(guides) > settings.wanted_guide:
        travel = np.hypot(*(field.xy_mm[held[guides]] - request.start_mm[guides]).T)
        held[guides[np.argsort(travel, kind="stable")][settings.wanted_guide :]] = -1
    is_open = request.is_open & ~field.near_any(held[held >= 0])
    robot, pair_target = pairs_by_distance(
        is_open & ((kind == STANDARD) | (kind == SKY)), request.is_pair_open, held < 0,
        field.reach_first, field.reach_robot, request.start_mm, field.xy_mm,
    )  # fmt: skip
    pair_kind, pair_sector = kind[pair_target], field.sector[pair_target]

    def take(chosen: BoolArray, limit: int) -> int:
        if limit <= 0:
            return 0
        n_taken: int = take_in_order(
            robot[chosen], pair_target[chosen], limit, field.near_first, field.near, request.start_mm, field.xy_mm,
            False, is_open, held,
        )  # fmt: skip
        return n_taken

    n_taken = take(pair_kind == STANDARD, settings.wanted_standard - int((kind[held[held >= 0]] == STANDARD).sum()))
    in_region = sky_by_region(field, held)
    n_sky = int(in_region.sum())
    n_before = n_sky
    for region, n in enumerate(in_region):
        n_sky += take(pair_sector == region, min(settings.wanted_sky - n_sky, minima.min_sky_region - n))
    n_sky += take(pair_kind == SKY, settings.wanted_sky - n_sky)
    if n_taken + n_sky == n_before:
        return held
    is_held = np.zeros(field.targets.n_target, dtype=bool)
    is_held[held[held >= 0]] = True
    return match(field, request.start_mm, is_held, request.is_pair_open, np.ones(len(is_held)))


def untangled(field: Field, request: VisitRequest, held: IntArray) -> IntArray:
    """The same targets, some by other robots, so that fewer robots are in each other's way (`untangle`).

    Guides may take other stars. Only where robots are to spare: else exchanges lengthen the ways of later visits by more
    than is won. A travel power of 1 or less asks for the least travel and nothing else.
    """
    is_idle = field.plate.is_live & (held < 0)
    if field.settings.travel_power <= 1.0 or is_idle.sum() < SPARE_FRAC * field.plate.is_live.sum():
        return held
    held = held.copy()
    guides = np.flatnonzero(request.is_open & (field.targets.kind == GUIDE))
    untangle(
        request.start_mm, field.plate.park_mm, field.plate.is_live, field.xy_mm, field.settings.travel_power / 2.0,
        field.settings.used_park_pull, field.reach_first, field.reach_robot, request.is_pair_open,
        field.near_first, field.near, guides, field.separation_mm, held,
    )  # fmt: skip
    return held


def exchanged(
    field: Field, request: VisitRequest, held: IntArray, barred: Collection[tuple[int, int]], *, may_lengthen: bool
) -> IntArray | None:
    """The targets that a visit holds, some barred to some robots: matched anew at least cost, as many as before.

    Guides may take other stars. None if a target would be lost, or if least travel is all that is wanted.

    Parameters
    ----------
    barred
        Pairs of robot and target.
    may_lengthen
        Whether ways may grow beyond the longest there are, from where the robots stand and from park.
    """
    if field.settings.travel_power <= 1.0:
        return None
    kind, plate = field.targets.kind, field.plate
    is_open = request.is_open & (kind == GUIDE)
    is_open[held[held >= 0]] = True
    is_idle_guide = plate.is_guide & (held < 0)
    wanted = np.flatnonzero(is_open)
    first, pairs = field.pairs_of(wanted)
    pair_robot, pair_target = field.reach_robot[pairs], np.repeat(wanted, np.diff(first))
    is_usable = ~is_idle_guide[pair_robot]
    for place_mm in () if may_lengthen else (request.start_mm, plate.park_mm):
        longest = np.hypot(*(field.xy_mm[held] - place_mm)[held >= 0].T).max(initial=0.0)
        is_usable &= np.hypot(*(field.xy_mm[pair_target] - place_mm[pair_robot]).T) <= longest
    is_pair_open = request.is_pair_open.copy()
    is_pair_open[pairs] &= is_usable
    for robot, target in barred:
        close_pair(field.reach_first, field.reach_robot, robot, target, is_pair_open)
    found = match(field, request.start_mm, is_open, is_pair_open, np.ones(len(is_open)))
    n_kind = len(TARGET_KINDS)
    n_found, n_held = (np.bincount(kind[some[some >= 0]], minlength=n_kind) for some in (found, held))
    if (n_found < n_held).any():
        return None
    return untangled(field, replace(request, is_pair_open=is_pair_open), found)


def sky_by_region(field: Field, held: IntArray) -> IntArray:
    """(sky_regions,) sky fibres in each plate region."""
    sector = field.sector[held[held >= 0]]
    return np.bincount(sector[sector >= 0], minlength=field.settings.sky_regions)


def lacks_calibration(field: Field, held: IntArray) -> bool:
    """Whether a visit holds fewer standards or sky than the least acceptable number, in all or in a region."""
    short = field.shortfall(held)
    return bool(short["standard"] or short["sky"] or short["sky_region"])
