"""Speed of the closed-form separation: 159 robots, from a random field to the next."""

import numpy as np
from pytest_benchmark.fixture import BenchmarkFixture

from survey_sim.check.kernels import least_separations

N_ROBOT, N_PATH, PITCH_MM, TRAVEL_MM = 159, 1000, 24.1, 25.0


def fields(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Starts and legs (turn, then one axis) of robots on a lattice that each go up to 25 mm."""
    side = int(np.ceil(np.sqrt(N_ROBOT)))
    park = np.array([(x, y) for x in range(side) for y in range(side)][:N_ROBOT]) * PITCH_MM
    n = N_ROBOT * N_PATH
    start = np.tile(park, (N_PATH, 1)) + rng.uniform(-7.0, 7.0, (n, 2))
    angle, length = rng.uniform(0.0, 2 * np.pi, n), TRAVEL_MM * np.sqrt(rng.random(n))
    goal = start + length[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    zero = np.zeros(n)
    turn_s = rng.uniform(0.0, 45.0, n) / 35.0
    legs = [rng.uniform(0.0, 5.0, n), turn_s, length, zero, np.full(n, 0.02), np.cos(angle), np.sin(angle), *goal.T]
    return start, np.column_stack(legs)


def test_least_separations_of_1000_paths(benchmark: BenchmarkFixture) -> None:
    start, legs = fields(np.random.default_rng(1))
    first_row = np.arange(0, N_ROBOT * N_PATH + 1, N_ROBOT)
    first_leg = np.arange(N_ROBOT * N_PATH + 1)
    near = np.full((1000, 4), np.nan)
    least, _ = benchmark(least_separations, 1, first_row, start, first_leg, legs, 2.0, 0.3, 9.0, near)
    assert least.shape == (1, N_PATH)
