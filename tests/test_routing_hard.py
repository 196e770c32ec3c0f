"""Fields made to break routers: no collision, and a reason for every robot that stays."""

from dataclasses import replace

import numpy as np
import pytest

from survey_sim.routing import ROUTERS, RoutingSettings, UnroutedReason, route
from tests.hard_fields import KINDS, SEPARATION_MM, assert_sound, hard_field


def routed(field, router: str, seed: int):
    rng = np.random.default_rng(seed)
    return route(field.plate, field.start_mm, field.theta_deg, field.goal_mm, RoutingSettings(router=router), rng)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("router", sorted(ROUTERS))
def test_no_collision_and_a_reason_for_every_failure(router: str, kind: str) -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        field = hard_field(kind, int(rng.choice([2, 5, 7])), rng)
        path = routed(field, router, seed)
        assert_sound(field, path)
        assert all(UnroutedReason(code).code for code in path.reason[path.reason != 0])


@pytest.mark.parametrize("kind", KINDS)
def test_the_fields_are_what_they_say(kind: str) -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        field = hard_field(kind, 13, rng)
        for place in (field.start_mm, field.goal_mm):
            gap = np.hypot(*(place[:, None] - place).transpose(2, 0, 1))
            least = gap[~np.eye(13, dtype=bool)].min()
            assert least >= SEPARATION_MM
            if "cluster" in kind and place is field.goal_mm:
                assert least == pytest.approx(SEPARATION_MM, abs=1e-6)


def test_the_checker_of_these_tests_sees_a_collision() -> None:
    field = hard_field("all idle but one", 7, np.random.default_rng(1))
    path = routed(field, "coordinated", 1)
    assert_sound(field, path)
    in_the_way = field.start_mm.copy()
    in_the_way[1] = [-60.0, 0.0]  # on the way of the one that moves
    goal = field.goal_mm.copy()
    goal[1] = in_the_way[1]
    planted = replace(field, start_mm=in_the_way, goal_mm=goal)
    with pytest.raises(AssertionError):
        assert_sound(planted, path)
