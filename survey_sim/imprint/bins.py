"""Completeness in bins: of local density, of place on the plate, of distance from the nearest robot's park."""

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from survey_sim.geometry import chord

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


def local_density(vectors: FloatArray, all_vectors: FloatArray, radius_deg: float) -> FloatArray:
    """(n,) targets of `all_vectors` (m, 3) within a radius of each position (n, 3), itself left out, per square degree."""
    near = cKDTree(all_vectors).query_ball_point(vectors, chord(radius_deg), return_length=True)
    area_sq_deg = 2.0 * np.pi * (1.0 - np.cos(np.radians(radius_deg))) * np.degrees(1.0) ** 2
    return (np.asarray(near, dtype=np.float64) - 1.0) / area_sq_deg


def plate_squares(xy_mm: FloatArray, width_mm: float) -> tuple[IntArray, FloatArray]:
    """Square of the plate that each place (n, 2) is in: its number (n,), and the middles (n_square, 2) of all squares."""
    cell = np.floor(xy_mm / width_mm).astype(np.int64)
    squares, place = np.unique(cell, axis=0, return_inverse=True)
    return place.ravel().astype(np.int64), (squares.astype(np.float64) + 0.5) * width_mm


def nearest_park_mm(xy_mm: FloatArray, park_mm: FloatArray) -> FloatArray:
    """(n,) distance from each place to the nearest of the park positions (n_robot, 2), mm."""
    return np.asarray(cKDTree(park_mm).query(xy_mm)[0])


def completeness_by_bin(place: IntArray, is_complete: BoolArray, n_bin: int) -> tuple[IntArray, FloatArray, FloatArray]:
    """Number (n_bin,), share complete and its binomial standard error in each bin; NaN where there is nothing."""
    n = np.bincount(place, minlength=n_bin).astype(np.int64)
    with np.errstate(invalid="ignore", divide="ignore"):
        frac: FloatArray = np.bincount(place, weights=is_complete, minlength=n_bin) / n
        error: FloatArray = np.sqrt(frac * (1.0 - frac) / n)
    return n, frac, error
