"""The paper's algorithms: pairs of robot and target taken one after another (CDA-Basic and CDA-Advanced)."""

import numpy as np

from survey_sim.allocation.field import BoolArray, Field, VisitRequest
from survey_sim.allocation.kernels.choosing import take_in_order
from survey_sim.allocation.targets import GUIDE, SCIENCE, SKY, STANDARD, FloatArray, IntArray

# Assumed: how many mm of travel CDA-Advanced gives for the highest priority, and for the most crowded place.
PRIORITY_WORTH_MM = 24.1
CROWDING_WORTH_MM = 24.1


def choose_basic(field: Field, request: VisitRequest) -> IntArray:
    """CDA-Basic (Goodwin et al. 2014, Table 5): the closest pair of robot and target first, from park.

    The paper's takes science alone and ignores priority and sky. In a survey's visit guides, standards and sky come
    before science, by the same rule, up to the numbers wanted.

    Returns
    -------
        (n_robot,) target of each robot or -1.
    """
    return _take_all_kinds(field, request, key=_pair_distance(field, request.start_mm), shuns_crossings=False)


def choose_advanced(field: Field, request: VisitRequest) -> IntArray:
    """CDA-Advanced (Goodwin et al. 2014, Table 5): as CDA-Basic, from where the robots stand, without crossings.

    Pairs are taken by distance less what the target's priority and its surroundings are worth, so that crowded places are
    begun early and thinned out a target at a time (the paper's series of sparser fields). The paper names these aims and
    gives no formula: the worths are assumed. A pair whose way crosses one taken before is left out.
    """
    distance = _pair_distance(field, request.start_mm)
    target = field.pair_target()
    is_wanted = request.is_open & field.targets.is_science
    crowding = field.sum_near(is_wanted.astype(np.float64))
    priority_rank = (field.value - 1.0) / max(field.settings.priority_gain, np.finfo(float).tiny)
    worth = PRIORITY_WORTH_MM * priority_rank + CROWDING_WORTH_MM * crowding / max(1, crowding.max(initial=0))
    key = np.where(field.targets.is_science[target], distance - worth[target], distance)
    return _take_all_kinds(field, request, key=key, shuns_crossings=True)


def _pair_distance(field: Field, start_mm: FloatArray) -> FloatArray:
    """(n_pair,) distance from the robot's start to the target, mm, of each entry of `field.reach_robot`."""
    apart = field.xy_mm[field.pair_target()] - start_mm[field.reach_robot]
    return np.hypot(apart[:, 0], apart[:, 1])


def _take_all_kinds(field: Field, request: VisitRequest, *, key: FloatArray, shuns_crossings: bool) -> IntArray:
    settings = field.settings
    is_open = request.is_open.copy()
    held = np.full(field.plate.n_robot, -1, dtype=np.int64)
    pairs = np.flatnonzero(request.is_pair_open & is_open[field.pair_target()])
    pairs = pairs[np.argsort(key[pairs], kind="stable")]
    robot, target = field.reach_robot[pairs], field.pair_target()[pairs]
    kind, sector = field.targets.kind[target], field.sector[target]

    def take(chosen: BoolArray, limit: int) -> int:
        return take_in_order(
            robot[chosen], target[chosen], limit, field.near_first, field.near, request.start_mm, field.xy_mm,
            shuns_crossings, is_open, held,
        )  # fmt: skip

    take(kind == GUIDE, settings.wanted_guide)
    take(kind == STANDARD, settings.wanted_standard)
    n_sky = 0
    for region in range(settings.sky_regions):
        n_sky += take(sector == region, min(settings.min_sky_region, settings.wanted_sky - n_sky))
    take(kind == SKY, settings.wanted_sky - n_sky)
    take(kind == SCIENCE, field.plate.n_robot)
    return held
