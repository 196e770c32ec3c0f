"""Blank sky: positions evenly spread, away from every catalogued object, the same whatever part of the sky is asked for."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import polars as pl
from scipy.spatial import cKDTree

from survey_sim.geometry import chord, unit_vectors
from survey_sim.region import HEALPIX_ORDER, healpix_positions

IntArray = npt.NDArray[np.int64]
FloatArray = npt.NDArray[np.float64]

# Cells with a random stream each: 3.36 sq deg. A run on a region draws only its own, so that they are those of a whole run.
CELL_ORDER = 5
CELL_SQ_DEG = 41_252.961 / (12 * 4**CELL_ORDER)
# Candidates drawn for each position wanted; where stars are so many that too few are clear, there are fewer positions.
_SPARE_FRAC = 1.5
_STREAM = 0x5C1


def sky_positions(
    cells: IntArray, density_per_sq_deg: float, clearance_arcsec: float, objects: FloatArray, seed: int
) -> pl.DataFrame:
    """Sky positions in HEALPix cells of order `CELL_ORDER`.

    Each cell is divided into at least as many sub-cells as candidates, and a candidate put at random into as many of them,
    chosen at random: evener than independent positions, which leave holes and clumps.

    Parameters
    ----------
    cells
        (n_cell,) nested cells.
    objects
        (n_object, 2) right ascension and declination of everything to keep away from, deg.

    Returns
    -------
        source_id (`sky-<cell>-<candidate>`), ra_deg, dec_deg, `_healpix_29`; the density, rounded to a number a cell.
    """
    n_wanted = max(1, round(density_per_sq_deg * CELL_SQ_DEG))
    n_candidate = int(np.ceil(n_wanted * _SPARE_FRAC)) + 4
    fine = np.concatenate([_candidates(int(cell), n_candidate, seed) for cell in cells] or [np.empty(0, dtype=np.int64)])
    ra_deg, dec_deg = healpix_positions(fine, HEALPIX_ORDER)
    clear = _is_clear(ra_deg, dec_deg, objects, clearance_arcsec / 3600.0).reshape(-1, n_candidate)
    chosen = (clear & (np.cumsum(clear, axis=1) <= n_wanted)).ravel()
    drawn = pl.DataFrame(
        {
            "cell": np.repeat(cells, n_candidate),
            "candidate": np.tile(np.arange(n_candidate), len(cells)),
            "ra_deg": ra_deg,
            "dec_deg": dec_deg,
            "_healpix_29": fine,
        }
    ).filter(chosen)
    return drawn.select(pl.format("sky-{}-{}", "cell", "candidate").alias("source_id"), "ra_deg", "dec_deg", "_healpix_29")


def _candidates(cell: int, n: int, seed: int) -> IntArray:
    """(n,) cells of order 29 inside a cell, each in a sub-cell of its own."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, _STREAM, cell]))
    depth = int(np.ceil(np.log(n) / np.log(4)))
    sub = rng.choice(4**depth, n, replace=False)
    shift = 2 * (HEALPIX_ORDER - CELL_ORDER - depth)
    return (((cell << (2 * depth)) + sub) << shift) + rng.integers(0, 1 << shift, n)


def _is_clear(ra_deg: FloatArray, dec_deg: FloatArray, objects: FloatArray, clearance_deg: float) -> npt.NDArray[np.bool_]:
    """(n,) whether no object is nearer to a position than the clearance."""
    if not len(objects) or not len(ra_deg):
        return np.ones(len(ra_deg), dtype=np.bool_)
    tree = cKDTree(unit_vectors(*objects.T), balanced_tree=False)
    nearest, _ = tree.query(unit_vectors(ra_deg, dec_deg), distance_upper_bound=chord(clearance_deg))
    return np.isinf(nearest)


def cells_of(
    dec_limits_deg: tuple[float, float], keep: Callable[[FloatArray, FloatArray], npt.NDArray[np.bool_]]
) -> IntArray:
    """Cells of order `CELL_ORDER` that may hold a position kept, in a range of declination."""
    sixteenths = np.arange(12 * 4 ** (CELL_ORDER + 2))
    ra_deg, dec_deg = healpix_positions(sixteenths, CELL_ORDER + 2)
    margin_deg = np.sqrt(CELL_SQ_DEG)
    inside = (dec_deg > dec_limits_deg[0] - margin_deg) & (dec_deg < dec_limits_deg[1] + margin_deg)
    return np.unique(sixteenths[inside & keep(ra_deg, dec_deg)] >> 4)
