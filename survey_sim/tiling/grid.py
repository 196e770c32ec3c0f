"""Tile centres: an even covering of the sphere.

An icosahedral grid (Goldberg's, by Caspar & Klug's (a, b) construction): a hexagonal lattice on each of the 20 faces. It
exists for 10 T + 2 centres, T = a^2 + a b + b^2: 12, 32, 42, ... 1832, 1892, 1922, ..., so about any number. Circles that
leave no gap cover the sphere 1.31 to 1.33 times with it, 1.86 times with a Fibonacci spiral, 2.00 times with HEALPix cells
(measured at 1700 to 1900 centres); the least on a plane is 1.21 times.
"""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
import numpy.typing as npt

from survey_sim.geometry import chord, unit_vectors

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# How often plates on the grid cover the sphere at most, if they leave no gap: measured (tests/test_tiling.py).
COVERING_DENSITY = 1.33
# The grid's faces are mapped to the sphere by sines of the barycentric coordinates, at this multiple of the edge's angle:
# found by scanning it for the least covering radius (gnomonic projection: 1.46 times instead of 1.33).
_WARP = 1.06


def covering(radius_deg: float) -> FloatArray:
    """(n, 3) unit vectors: the smallest grid that leaves no place on the sphere further from a centre than an angle."""
    n_least = COVERING_DENSITY * 2.0 / (1.0 - np.cos(np.radians(min(radius_deg, 90.0))))
    return icosahedral_grid(*_smallest_lattice((n_least - 2.0) / 10.0))


def _smallest_lattice(t_least: float) -> tuple[int, int]:
    """The pair a >= b of least T = a^2 + a b + b^2 >= t_least; of equals the one nearest to b = 0."""
    reach = int(np.sqrt(max(t_least, 1.0))) + 2
    a, b = np.meshgrid(np.arange(1, reach + 1), np.arange(0, reach + 1), indexing="ij")
    t = np.where(a >= b, a * a + a * b + b * b, np.iinfo(np.int64).max)
    t = np.where(t >= t_least, t, np.iinfo(np.int64).max)
    best = np.flatnonzero(t.ravel() == t.min())[0]
    return int(a.ravel()[best]), int(b.ravel()[best])


def icosahedral_grid(a: int, b: int) -> FloatArray:
    """(10 T + 2, 3) unit vectors of the grid whose face corners are a steps and, turned by 60 deg, b steps apart.

    References
    ----------
    Caspar & Klug 1962, Cold Spring Harb. Symp. Quant. Biol. 27, 1; Goldberg 1937, Tohoku Math. J. 43, 104.
    """
    corners, faces = _icosahedron()
    t = a * a + a * b + b * b
    step = np.arange(-a - b, a + b + 1)
    i, j = (index.ravel() for index in np.meshgrid(step, step))
    u, v = i * (a + b) + j * b, j * a - i * b
    weights = np.column_stack([t - u - v, u, v])
    inside = weights[(weights > 0).all(axis=1)]
    # Points of an edge belong to two faces: they are taken from the face that runs along it from the lower corner.
    on_edge = weights[(weights[:, 2] == 0) & (weights[:, 0] > 0) & (weights[:, 1] > 0)]
    parts = [corners]
    for face in faces:
        parts.append(_on_sphere(inside / t, corners[face]))
        for turn in range(3):
            turned = np.roll(face, -turn)
            if turned[0] < turned[1]:
                parts.append(_on_sphere(on_edge / t, corners[turned]))
    return np.ascontiguousarray(np.vstack(parts))


def _on_sphere(weights: FloatArray, corners: FloatArray) -> FloatArray:
    """(n, 3) unit vectors of barycentric coordinates on a face; see `_WARP`."""
    sines = np.sin(weights * _WARP * np.arccos(corners[0] @ corners[1]))
    points = np.einsum("nk,kj->nj", sines, corners)  # not by BLAS, whose last digits depend on the number of threads
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def _icosahedron() -> tuple[FloatArray, list[IntArray]]:
    """(12, 3) corners, one at the north pole and one at the south, and the 20 faces, counter-clockwise seen from outside."""
    ring_dec = np.degrees(np.arctan(0.5))
    ra_deg = np.concatenate([[0.0], np.arange(5) * 72.0, np.arange(5) * 72.0 + 36.0, [0.0]])
    dec_deg = np.concatenate([[90.0], np.full(5, ring_dec), np.full(5, -ring_dec), [-90.0]])
    corners = unit_vectors(ra_deg, dec_deg)
    return corners, [np.array(face, dtype=np.int64) for face in _faces(corners)]


def _faces(corners: FloatArray) -> Iterator[tuple[int, int, int]]:
    edge = 1.01 * chord(np.degrees(np.arctan(2.0)))
    for i, j, k in combinations(range(len(corners)), 3):
        sides = np.linalg.norm(corners[[i, j, k]] - corners[[j, k, i]], axis=1)
        if (sides < edge).all():
            yield (i, j, k) if np.linalg.det(corners[[i, j, k]]) > 0 else (i, k, j)
