"""Fields made to break routers: dense clusters at exactly the separation, rings, swaps, crowds, idle and dead robots."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from survey_sim.instrument import Instrument, Plate, load_instrument, make_plate
from survey_sim.routing import RoutedPath
from tests.proved import count_too_near

SEPARATION_MM = 9.0
# A separation that rounding does not undercut.
TIGHT_MM = SEPARATION_MM * (1 + 1e-9)
PARK_PITCH_MM = 24.1
PLATE_MM = 100.0


@dataclass(frozen=True)
class HardField:
    """One routing problem."""

    kind: str
    plate: Plate
    start_mm: np.ndarray
    theta_deg: np.ndarray
    goal_mm: np.ndarray


def hexagons(n: int, pitch_mm: float) -> np.ndarray:
    """(n, 2) the innermost points of a hexagonal lattice, mm."""
    reach = int(np.ceil(np.sqrt(n))) + 1
    row, column = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    point = pitch_mm * np.column_stack([column + 0.5 * row, row * np.sqrt(3) / 2])
    return point[np.lexsort((point[:, 0], point[:, 1], np.round(np.hypot(*point.T), 6)))][:n]


@cache
def _instrument(n: int) -> Instrument:
    parks = tuple((float(x), float(y)) for x, y in hexagons(n, PARK_PITCH_MM))
    overrides = {"guides": "none", "n_science": n, "park_positions_mm": parks, "patrol_radius_mm": 2 * PLATE_MM}
    return load_instrument("paper", {**overrides, "plate_radius_mm": PLATE_MM})


def _scattered(n: int, radius_mm: float, rng: np.random.Generator) -> np.ndarray:
    """(n, 2) random places in a disc, at least the separation apart."""
    while True:
        place = rng.uniform(-radius_mm, radius_mm, (60 * n, 2))
        kept: list[np.ndarray] = []
        for point in place[np.hypot(*place.T) <= radius_mm]:
            if all(np.hypot(*(point - other)) >= SEPARATION_MM for other in kept):
                kept.append(point)
            if len(kept) == n:
                return np.array(kept)
        radius_mm *= 1.1


def _random(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    radius = rng.uniform(6.0, 14.0) * np.sqrt(n)
    return _scattered(n, radius, rng), _scattered(n, radius, rng)


def _cluster(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """From park to a cluster in which neighbours stand at exactly the separation, taken in any order."""
    return hexagons(n, PARK_PITCH_MM), rng.permutation(hexagons(n, TIGHT_MM)) + rng.uniform(-20, 20, 2)


def _between_clusters(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """From one cluster at exactly the separation to another."""
    side = np.array([25.0, 0.0])
    return hexagons(n, TIGHT_MM) - side, rng.permutation(hexagons(n, TIGHT_MM)) + side


def _ring(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """One robot in a closed ring of others wants out, one that is outside wants in."""
    start = hexagons(n, TIGHT_MM * rng.choice([1.0, 1.05, 1.5]))
    goal = start.copy()
    goal[[0, -1]] = start[[-1, 0]]
    return start, goal


def _to_one_side(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """All go to a wall of places at the edge."""
    column, row = np.divmod(np.arange(n), 5)
    wall = np.column_stack([70.0 - TIGHT_MM * column, TIGHT_MM * (row - 2)])
    return hexagons(n, PARK_PITCH_MM if n <= 19 else 15.0), rng.permutation(wall)


def _swaps(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Neighbours swap places."""
    start = hexagons(n, rng.choice([TIGHT_MM, 10.0, 13.0, PARK_PITCH_MM]) if n <= 19 else 13.0)
    order = np.arange(n)
    for i in range(0, n - 1, 2):
        order[[i, i + 1]] = order[[i + 1, i]]
    return start, start[order]


def _one_among_many(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """One robot goes from one side to the other; all others rest between."""
    rest = hexagons(n - 1, rng.choice([TIGHT_MM, 12.0, 18.0, 19.5]))
    edge = np.array([[-PLATE_MM + 5, 0.0]])
    start = np.vstack([edge, rest])
    goal = start.copy()
    goal[0] = [PLATE_MM - 5, rng.uniform(-4, 4)]
    return start, goal


KINDS: dict[str, Callable[[int, np.random.Generator], tuple[np.ndarray, np.ndarray]]] = {
    "random": _random,
    "cluster": _cluster,
    "between clusters": _between_clusters,
    "ring": _ring,
    "to one side": _to_one_side,
    "swaps": _swaps,
    "all idle but one": _one_among_many,
    "all dead but one": _one_among_many,
}


def hard_field(kind: str, n: int, rng: np.random.Generator) -> HardField:
    """A field of this kind with n robots."""
    start, goal = KINDS[kind](n, rng)
    dead = tuple(range(2, n + 1)) if kind == "all dead but one" else ()
    return HardField(kind, make_plate(_instrument(n), dead), start, rng.uniform(-180, 180, n), goal)


def assert_sound(field: HardField, path: RoutedPath) -> None:
    """By the checker's kernel: never nearer than the separation, everybody at the goal, or at the start for a reason."""
    plate, legs = field.plate, path.legs
    assert np.isin(np.unique(legs.robot), np.flatnonzero(plate.is_live)).all(), "a dead robot moves"
    arrived = path.reason == 0
    end = field.start_mm.copy()
    is_last = np.diff(legs.robot, append=-1) != 0
    end[legs.robot[is_last]] = np.column_stack([legs.x_mm, legs.y_mm])[is_last]
    np.testing.assert_array_equal(end, np.where(arrived[:, None], field.goal_mm, field.start_mm))
    assert count_too_near(plate, field.start_mm, legs) == 0
