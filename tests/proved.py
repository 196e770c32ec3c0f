"""Routes proved by the checker's kernel, which shares no code with the routers. Shared by tests, soaks and benchmarks."""

import numpy as np

from survey_sim.check.kernels import least_separations
from survey_sim.instrument import Plate
from survey_sim.motion import Legs

SEPARATION_TOLERANCE_MM = 1e-6


def count_too_near(plate: Plate, start_mm: np.ndarray, legs: Legs) -> int:
    """Pairs of robots nearer than the separation at some instant of one path."""
    instrument, n = plate.instrument, plate.n_robot
    theta, turn_s = np.radians(legs.theta_deg), np.abs(legs.rotate_deg) / instrument.rotation_speed_deg_s
    way = (legs.start_s, turn_s, legs.dx_mm, legs.dy_mm, legs.precise_mm)
    rows = np.column_stack([*way, np.cos(theta), np.sin(theta), legs.x_mm, legs.y_mm])
    first_leg = np.searchsorted(legs.robot, np.arange(n + 1)).astype(np.int64)
    speeds = instrument.coarse_speed_mm_s, instrument.precise_speed_mm_s
    limit = instrument.min_separation_mm - SEPARATION_TOLERANCE_MM
    near = np.full((1, 4), np.nan)
    _, n_near = least_separations(1, np.array([0, n]), start_mm, first_leg, rows, *speeds, limit, near)
    return int(n_near.sum())
