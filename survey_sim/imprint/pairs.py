"""Pairs of targets by separation: how many of them are complete, and what that does to the two-point correlation.

DD is the number of pairs in a bin, n the number of targets. The **ratio** (1 + w_observed) / (1 + w_targeted) is the natural
estimator with the same randoms above and below, so that these cancel: DD_o / (n_o (n_o - 1)) over DD_t / (n_t (n_t - 1)).
The correlations themselves are Landy & Szalay's (1993, ApJ 412, 64), (DD - 2 DR + RR) / RR, with randoms uniform in the
footprint. Errors are jackknife ones: the sky in patches of as many targets each, each left out in turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from survey_sim.geometry import chord

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# Patches of the jackknife: two to this power, fewer if they would hold less than so many targets.
PATCH_LEVELS = 5
LEAST_OF_PATCH = 25
# Bins with fewer pairs of randoms have no correlation.
LEAST_RANDOM_PAIRS = 200


@dataclass(frozen=True)
class PairCounts:
    """Ordered pairs of a sample by bin of separation, the whole and with each patch left out.

    Attributes
    ----------
    n_target, n_complete
        (1 + n_patch,) numbers of targets; the first entry is the whole.
    pairs, complete_pairs
        (1 + n_patch, n_bin) ordered pairs of targets, of complete targets.
    random_pairs
        (3, n_bin) normalised pairs of the whole sample with randoms: targets-randoms, complete-randoms, randoms-randoms;
        NaN where there are too few.
    """

    n_target: FloatArray
    n_complete: FloatArray
    pairs: FloatArray
    complete_pairs: FloatArray
    random_pairs: FloatArray


def sky_patches(vectors: FloatArray) -> IntArray:
    """(n,) patch of each position (n, 3): halves of as many targets, cut again and again across where they are widest."""
    patch = np.zeros(len(vectors), dtype=np.int64)
    n_level = min(PATCH_LEVELS, int(np.log2(max(1.0, len(vectors) / LEAST_OF_PATCH))))
    for _ in range(n_level):
        halved = np.empty_like(patch)
        for number in range(int(patch.max(initial=0)) + 1):
            rows = np.flatnonzero(patch == number)
            axis = np.ptp(vectors[rows], axis=0).argmax()
            is_far = np.zeros(len(rows), dtype=np.int64)
            is_far[np.argsort(vectors[rows, axis], kind="stable")[len(rows) // 2 :]] = 1
            halved[rows] = 2 * number + is_far
        patch = halved
    return patch


def count_pairs(
    vectors: FloatArray, is_complete: BoolArray, edges_deg: FloatArray, randoms: FloatArray | None = None
) -> PairCounts:
    """Pairs of one sample.

    Parameters
    ----------
    vectors
        (n, 3) unit vectors of targets.
    is_complete
        (n,) those that are complete.
    edges_deg
        (n_bin + 1,) ascending.
    randoms
        (m, 3) unit vectors, uniform in the footprint of the targets; none: no correlations.
    """
    edges = np.array([chord(edge) for edge in edges_deg])
    patch = sky_patches(vectors)
    kept = np.ones(len(vectors), dtype=bool)
    n_target, pairs = _jackknife(vectors, kept, patch, edges)
    n_complete, complete_pairs = _jackknife(vectors, is_complete, patch, edges)
    random_pairs = np.full((3, len(edges) - 1), np.nan)
    if randoms is not None and len(randoms):
        tree = cKDTree(randoms)
        raw = _ordered(tree, tree, edges)
        random_pairs[2] = np.where(raw >= LEAST_RANDOM_PAIRS, raw / (len(randoms) * (len(randoms) - 1.0)), np.nan)
        for row, chosen in enumerate((kept, is_complete)):
            if chosen.any():
                random_pairs[row] = _ordered(cKDTree(vectors[chosen]), tree, edges) / (chosen.sum() * float(len(randoms)))
    return PairCounts(n_target, n_complete, pairs, complete_pairs, random_pairs)


def pair_table(samples: Sequence[PairCounts]) -> dict[str, FloatArray]:
    """Completeness of pairs, ratio and correlations of samples taken together (realisations of one sky), by bin.

    Returns
    -------
        `n_pair`, `pair_completeness_frac`, `ratio`, both with `_error`, `w_targeted`, `w_observed`: (n_bin,) each, NaN where
        there are no pairs, or for errors fewer than two patches.
    """
    left_out = [
        _estimates(samples, number, patch) for number, one in enumerate(samples) for patch in range(1, len(one.pairs))
    ]
    share, ratio = _estimates(samples, 0, 0)
    with np.errstate(invalid="ignore"):
        weight = np.array([len(one.n_target) - 1 for one in samples])
        errors = _jackknife_errors(np.array(left_out)) if weight.sum() > 1 else np.full((2, len(ratio)), np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        correlations = [_landy_szalay(samples, row) for row in (0, 1)]
    return {
        "n_pair": sum(one.pairs[0] for one in samples) / 2.0,
        "pair_completeness_frac": share,
        "pair_completeness_error_frac": errors[0],
        "ratio": ratio,
        "ratio_error": errors[1],
        "w_targeted": correlations[0],
        "w_observed": correlations[1],
    }


def uniform_sky(
    n: int, ra_deg: tuple[float, float], dec_deg: tuple[float, float], rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Right ascension and declination (n,) of positions uniform on a part of the sphere; ra_deg may wrap through 0."""
    west, east = ra_deg
    width = (east - west) % 360.0 or 360.0
    low, high = np.sin(np.radians(dec_deg))
    dec = np.degrees(np.arcsin(low + (high - low) * rng.random(n)))
    return (west + width * rng.random(n)) % 360.0, dec


def _ordered(one: cKDTree, other: cKDTree, edges: FloatArray) -> FloatArray:
    """(n_bin,) ordered pairs by bin of distance."""
    return np.asarray(one.count_neighbors(other, edges, cumulative=False), dtype=np.float64)[1:]


def _jackknife(
    vectors: FloatArray, is_chosen: BoolArray, patch: IntArray, edges: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Numbers of chosen targets, and their ordered pairs, of the whole and with each patch left out."""
    chosen, where = vectors[is_chosen], patch[is_chosen]
    n_patch = int(patch.max(initial=0)) + 1
    number = np.full(1 + n_patch, len(chosen), dtype=np.float64)
    pairs = np.zeros((1 + n_patch, len(edges) - 1))
    if not len(chosen):
        return number, pairs
    whole = cKDTree(chosen)
    pairs[:] = _ordered(whole, whole, edges)
    for k in range(n_patch if n_patch > 1 else 0):
        inside = where == k
        number[1 + k] -= inside.sum()
        if inside.any():
            part = cKDTree(chosen[inside])
            pairs[1 + k] -= 2.0 * _ordered(part, whole, edges) - _ordered(part, part, edges)
    return number, pairs


def _estimates(samples: Sequence[PairCounts], changed: int, patch: int) -> tuple[FloatArray, FloatArray]:
    """Pair completeness and ratio, with a patch of one sample left out (0: none)."""
    rows = [patch if number == changed else 0 for number in range(len(samples))]
    pairs = sum(one.pairs[row] for one, row in zip(samples, rows, strict=True))
    complete = sum(one.complete_pairs[row] for one, row in zip(samples, rows, strict=True))
    norm = sum(one.n_target[row] * (one.n_target[row] - 1.0) for one, row in zip(samples, rows, strict=True))
    norm_complete = sum(one.n_complete[row] * (one.n_complete[row] - 1.0) for one, row in zip(samples, rows, strict=True))
    with np.errstate(invalid="ignore", divide="ignore"):
        share = complete / pairs
        return share, share * (norm / norm_complete)


def _jackknife_errors(left_out: FloatArray) -> FloatArray:
    """(2, n_bin) from (n_patch, 2, n_bin): sqrt((n - 1) / n sum (x_k - mean)^2)."""
    n = len(left_out)
    return np.sqrt((n - 1.0) / n * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0))


def _landy_szalay(samples: Sequence[PairCounts], row: int) -> FloatArray:
    """w of targets (row 0) or complete targets (row 1), mean over samples."""
    values = []
    for one in samples:
        n, pairs = ((one.n_target, one.pairs), (one.n_complete, one.complete_pairs))[row]
        own = pairs[0] / (n[0] * (n[0] - 1.0))
        with_randoms, among_randoms = one.random_pairs[row], one.random_pairs[2]
        values.append((own - 2.0 * with_randoms + among_randoms) / among_randoms)
    return np.mean(values, axis=0)
