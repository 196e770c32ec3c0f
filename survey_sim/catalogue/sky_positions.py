"""Blank sky: positions evenly spread, away from every catalogued object, the same whatever part of the sky is asked for."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import polars as pl
from scipy.spatial import cKDTree

from survey_sim.geometry import chord, unit_vectors
from survey_sim.region import HEALPIX_ORDER, SPHERE_SQ_DEG, healpix_positions

IntArray = npt.NDArray[np.int64]
FloatArray = npt.NDArray[np.float64]

# Cells with a random stream each: 3.36 sq deg. A run on a region draws only its own, so that they are those of a whole run.
CELL_ORDER = 5
CELL_SQ_DEG = SPHERE_SQ_DEG / (12 * 4**CELL_ORDER)
# Candidates drawn for each position wanted; where stars are so many that too few are clear, there are fewer positions.
_SPARE_FRAC = 1.5


def sky_positions(
    cells: IntArray, density_per_sq_deg: float, clearance_arcsec: float, objects: cKDTree, seed: int
) -> pl.DataFrame:
    """Sky positions in HEALPix cells of order `CELL_ORDER`.

    Each cell is divided into at least as many sub-cells as candidates, and a candidate put at random into as many of them,
    chosen at random: evener than independent positions, which leave holes and clumps.

    Parameters
    ----------
    cells
        (n_cell,) nested cells.
    objects
        Tree of the unit vectors of everything to keep away from.

    Returns
    -------
        source_id (`sky-<cell>-<candidate>`), ra_deg, dec_deg, `_healpix_29`; the density, rounded to a number a cell.
    """
    n_wanted = max(1, round(density_per_sq_deg * CELL_SQ_DEG))
    fine = _candidates(cells, int(np.ceil(n_wanted * _SPARE_FRAC)) + 4, seed)
    ra_deg, dec_deg = healpix_positions(fine.ravel(), HEALPIX_ORDER)
    nearest, _ = objects.query(unit_vectors(ra_deg, dec_deg), distance_upper_bound=chord(clearance_arcsec / 3600.0))
    clear = np.isinf(nearest).reshape(fine.shape)
    chosen = np.flatnonzero(clear & (np.cumsum(clear, axis=1) <= n_wanted))
    drawn = pl.DataFrame(
        {
            "cell": cells[chosen // fine.shape[1]],
            "candidate": chosen % fine.shape[1],
            "ra_deg": ra_deg[chosen],
            "dec_deg": dec_deg[chosen],
            "_healpix_29": fine.ravel()[chosen],
        }
    )
    return drawn.select(pl.format("sky-{}-{}", "cell", "candidate").alias("source_id"), "ra_deg", "dec_deg", "_healpix_29")


def cells_of(
    dec_limits_deg: tuple[float, float], keep: Callable[[FloatArray, FloatArray], npt.NDArray[np.bool_]]
) -> IntArray:
    """Cells of order `CELL_ORDER` that may hold a position kept, in a range of declination."""
    sixteenths = np.arange(12 * 4 ** (CELL_ORDER + 2))
    ra_deg, dec_deg = healpix_positions(sixteenths, CELL_ORDER + 2)
    margin_deg = np.sqrt(CELL_SQ_DEG)
    inside = (dec_deg > dec_limits_deg[0] - margin_deg) & (dec_deg < dec_limits_deg[1] + margin_deg)
    return np.unique(sixteenths[inside & keep(ra_deg, dec_deg)] >> 4)


def _candidates(cells: IntArray, n: int, seed: int) -> IntArray:
    """(n_cell, n) cells of order 29 inside each cell, each in a sub-cell of its own."""
    depth = int(np.ceil(np.log(n) / np.log(4)))
    sub = (cells[:, None] << (2 * depth)) + np.arange(4**depth)
    draw = _hashed(sub.astype(np.uint64) ^ _hashed(np.array([seed], dtype=np.uint64)))
    first = np.argsort(draw, axis=1, kind="stable")[:, :n]
    offset_bits = 2 * (HEALPIX_ORDER - CELL_ORDER - depth)
    offset = _hashed(np.take_along_axis(draw, first, axis=1)) >> np.uint64(64 - offset_bits)
    return (np.take_along_axis(sub, first, axis=1) << offset_bits) + offset.astype(np.int64)


def _hashed(values: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Uniform 64-bit numbers, independent for different numbers: a random stream a cell without thousands of generators.

    References
    ----------
    Steele, Lea & Flood 2014, OOPSLA, doi:10.1145/2660193.2660195: SplitMix64.
    """
    mixed = values + np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return mixed ^ (mixed >> np.uint64(31))
