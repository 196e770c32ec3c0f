"""Optimal reciprocal collision avoidance (van den Berg et al. 2011, 10.1007/978-3-642-19457-3_1) by `pyrvo`, as a baseline.

Holonomic discs without turns, so its times are against straight lines at full speed; pairs may come nearer than the
separation, and robots may never arrive.
"""

from dataclasses import dataclass

import numpy as np

STEP_S = 0.1
NEIGHBOURS, NEIGHBOUR_MM, HORIZON_S = 20, 40.0, 10.0
# A robot this near its goal has arrived, mm.
ARRIVED_MM = 0.05
# Given up after this many times the longest straight way.
PATIENCE = 4


@dataclass(frozen=True)
class OrcaPath:
    """When the last robot arrived (or was given up), over the longest straight way; who did not; the least separation."""

    ratio: float
    n_away: int
    min_separation_mm: float


def steer(pyrvo, start: np.ndarray, goal: np.ndarray, speed: float, separation: float) -> OrcaPath:
    """Let all robots go to their goals; (n, 2) mm, mm/s, mm."""
    world = pyrvo.RVOSimulator()
    world.set_time_step(STEP_S)
    world.set_agent_defaults(NEIGHBOUR_MM, NEIGHBOURS, HORIZON_S, HORIZON_S, separation / 2, speed)
    for point in start:
        world.add_agent(tuple(point))
    longest_s = np.hypot(*(goal - start).T).max() / speed
    now, last_s, least = start.copy(), 0.0, np.inf
    is_away = np.ones(len(start), dtype=bool)
    upper = np.triu_indices(len(start), 1)
    for k in range(int(PATIENCE * longest_s / STEP_S)):
        wanted = goal - now
        away = np.hypot(*wanted.T)
        fastest = np.minimum(speed, away / STEP_S) / np.maximum(away, 1e-12)
        for robot, velocity in enumerate(wanted * fastest[:, None]):
            world.set_agent_pref_velocity(robot, tuple(velocity))
        world.do_step()
        now = np.array([[*_xy(world.get_agent_position(robot))] for robot in range(len(start))])
        least = min(least, np.hypot(*(now[upper[0]] - now[upper[1]]).T).min())
        is_away = np.hypot(*(goal - now).T) > ARRIVED_MM
        last_s = (k + 1) * STEP_S
        if not is_away.any():
            break
    return OrcaPath(last_s / longest_s, int(is_away.sum()), float(least))


def _xy(vector) -> tuple[float, float]:
    """Coordinates of a `pyrvo` vector, whichever way this version gives them."""
    return (vector.x, vector.y) if hasattr(vector, "x") else (vector[0], vector[1])
