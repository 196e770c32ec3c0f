"""One visit, exactly: most value of targets, then least travel, no two targets too close."""

import numpy as np

from survey_sim.allocation.field import BoolArray, Field
from survey_sim.allocation.kernels import pick_apart, take_in_order
from survey_sim.allocation.matching_kernels import match_apart
from survey_sim.allocation.targets import GUIDE, PRIORITY_RANGE, SKY, STANDARD, FloatArray, IntArray

# Worth of a fibre that the visit must have, in science targets: at most five targets near one are apart from each other, so
# nothing that it displaces is worth as much.
NEEDED_VALUE = 10.0
# Priorities 1 to 9 differ by whole steps of priority_gain / 8; more steps to a unit than this are below the rounding.
PRIORITY_STEPS = PRIORITY_RANGE[1] - PRIORITY_RANGE[0]
MAX_STEPS = 1000.0
# Branchings of the exact search before the best so far is taken (the twelve anchors need at most 31).
MAX_NODES = 60


def choose_matching(field: Field, start_mm: FloatArray, is_open: BoolArray, is_pair_open: BoolArray) -> IntArray:
    """The visit of most priority-weighted science and, of all such, of least sum of travel^travel_power.

    Standards and sky are picked first, where they stand in the way of the least science. The least acceptable numbers
    displace science; those wanted beyond it count as science of the highest priority, and fill what robots are left.

    Parameters
    ----------
    start_mm
        (n_robot, 2) where the robots start, mm.
    is_open
        (n_target,) targets that may be taken; not changed.
    is_pair_open
        (n_pair,) entries of `field.reach_robot` that may be used.

    Returns
    -------
        (n_robot,) target of each robot or -1.
    """
    picked, value = pick_calibration(field, is_open)
    is_calibration = (field.targets.kind == STANDARD) | (field.targets.kind == SKY)
    held = match(field, start_mm, is_open & (~is_calibration | picked), is_pair_open, value)
    return fill_calibration(field, start_mm, is_open, is_pair_open, held)


def match(field: Field, start_mm: FloatArray, is_open: BoolArray, is_pair_open: BoolArray, value: FloatArray) -> IntArray:
    """(n_robot,) target of each robot or -1: most value, then least sum of travel^travel_power, of the open targets."""
    n_robot = field.plate.n_robot
    target = field.pair_target()
    is_usable = is_pair_open & is_open[target]
    apart = field.xy_mm[target] - start_mm[field.reach_robot]
    distance2 = (apart**2).sum(axis=1)
    farthest2 = max(distance2[is_usable].max(initial=0.0), 1e-12)
    travel = (distance2 / farthest2) ** (field.settings.travel_power / 2.0)
    # All travel together costs less than n_robot: value comes first if its unit is more, and its steps are coarse.
    greatest = value[is_open].max(initial=1.0)
    step = n_robot * min(MAX_STEPS, max(1.0, PRIORITY_STEPS / max(field.settings.priority_gain, 1e-12)))
    pair, _, _ = match_apart(
        n_robot, greatest * step, field.reach_first, field.reach_robot, is_usable, target,
        (greatest - value[target]) * step + travel, field.near_first, field.near, field.xy_mm, field.separation_mm,
        MAX_NODES,
    )  # fmt: skip
    held = np.full(n_robot, -1, dtype=np.int64)
    held[pair >= 0] = target[pair[pair >= 0]]
    return held


def pick_calibration(field: Field, is_open: BoolArray) -> tuple[BoolArray, FloatArray]:
    """Standards and sky to be matched, where they displace the least science, and what every target is worth.

    Returns
    -------
    is_picked
        (n_target,) as many as are wanted, apart from each other; sky first in every plate region.
    value
        (n_target,) worth: needed fibres (guides, least acceptable numbers) above all, the rest as science of priority 9.
    """
    settings, kind = field.settings, field.targets.kind
    displaced = np.append(np.where(is_open & field.targets.is_science, field.value, 0.0)[field.near], 0.0)
    displaced = np.add.reduceat(displaced, field.near_first[:-1]) * (np.diff(field.near_first) > 0)
    is_served = is_open & (np.diff(field.reach_first) > 0)
    is_picked = np.zeros(field.targets.n_target, dtype=bool)

    def pick(is_candidate: BoolArray, limit: int) -> int:
        candidates = np.flatnonzero(is_candidate & is_served)
        candidates = candidates[np.argsort(displaced[candidates], kind="stable")]
        return pick_apart(candidates, limit, field.near_first, field.near, is_open, is_picked)

    pick(kind == STANDARD, min(settings.min_standard, settings.wanted_standard))
    n_sky = 0
    for region in range(settings.sky_regions):
        n_sky += pick(field.sector == region, min(settings.min_sky_region, settings.wanted_sky - n_sky))
    n_sky += pick(kind == SKY, min(settings.min_sky, settings.wanted_sky) - n_sky)
    is_needed = is_picked | (kind == GUIDE)
    pick(kind == STANDARD, settings.wanted_standard - min(settings.min_standard, settings.wanted_standard))
    pick(kind == SKY, settings.wanted_sky - n_sky)
    value = np.where(field.targets.is_science, field.value, 1.0 + settings.priority_gain)
    return is_picked, np.where(is_needed, NEEDED_VALUE, value)


def fill_calibration(
    field: Field, start_mm: FloatArray, is_open: BoolArray, is_pair_open: BoolArray, held: IntArray
) -> IntArray:
    """Give idle robots the standards and sky that are still wanted, closest first; guides beyond those wanted are let go."""
    settings, kind = field.settings, field.targets.kind
    travel = np.hypot(*(field.xy_mm[held] - start_mm).T)
    guides = np.flatnonzero((held >= 0) & (kind[held] == GUIDE))
    extra = guides[np.argsort(travel[guides], kind="stable")][settings.wanted_guide :]
    held = held.copy()
    held[extra] = -1
    is_open = is_open & ~field.near_any(held[held >= 0])
    target = field.pair_target()
    pairs = np.flatnonzero(is_pair_open & is_open[target] & (held[field.reach_robot] < 0))
    apart = field.xy_mm[target[pairs]] - start_mm[field.reach_robot[pairs]]
    pairs = pairs[np.argsort((apart**2).sum(axis=1), kind="stable")]
    for code, wanted in ((STANDARD, settings.wanted_standard), (SKY, settings.wanted_sky)):
        chosen = pairs[kind[target[pairs]] == code]
        n_missing = wanted - int((kind[held[held >= 0]] == code).sum())
        take_in_order(
            field.reach_robot[chosen], target[chosen], n_missing, field.near_first, field.near, start_mm, field.xy_mm,
            False, is_open, held,
        )  # fmt: skip
    return held
