"""A hundred thousand hard fields through the routers, each proved by the checker's kernel. `make soak`."""

import os
from collections import Counter

import numpy as np

from survey_sim.routing import ROUTERS, RoutingSettings, UnroutedReason, route
from tests.hard_fields import KINDS, assert_sound, hard_field

N_FIELD = int(os.environ.get("SOAK_FIELDS", "100000"))
FIRST = int(os.environ.get("SOAK_FIRST", "0"))
# Our router goes on trying where others give up, so it is given every fourth field, and those of many robots seldom; fields
# of 19 robots only if they are random: crowded ones cost it up to 20 s each.
NAMES = ("coordinated", *sorted(set(ROUTERS) - {"coordinated"}))
SIZES, SHARES = (2, 3, 5, 7, 12, 19), (0.3, 0.3, 0.25, 0.1, 0.04, 0.01)
MOST_CROWDED = 12


def test_hard_fields() -> None:
    reasons: Counter[tuple[str, str]] = Counter()
    n_robot = 0
    for seed in range(FIRST, N_FIELD):
        rng = np.random.default_rng(seed)
        kind = "random" if seed % 2 else str(rng.choice(list(KINDS)))
        name = NAMES[(seed // 2) % len(NAMES)]
        n = int(rng.choice(SIZES, p=SHARES))
        field = hard_field(kind, n if kind == "random" or name != "coordinated" else min(n, MOST_CROWDED), rng)
        path = route(field.plate, field.start_mm, field.theta_deg, field.goal_mm, RoutingSettings(router=name), rng)
        assert_sound(field, path)
        n_robot += field.plate.n_robot
        for code in path.reason[path.reason != 0]:
            reasons[name, UnroutedReason(code).code] += 1
    print(f"{N_FIELD - FIRST} fields, {n_robot} robots: no two nearer than the separation")
    for (name, reason), n in sorted(reasons.items()):
        print(f"  {name}: {n} unrouted, {reason}")
