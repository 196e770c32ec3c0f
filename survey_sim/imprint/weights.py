"""Selection probabilities and bitwise weights of targets and pairs.

The convention is DESI's (Bianchi & Percival 2017, MNRAS 472, 1106; Lasker et al. 2025, JCAP 01, 127): a bit for each
realisation of the allocation, set if it completes the target, in 64-bit integers.
"""

import numpy as np
import numpy.typing as npt

IntArray = npt.NDArray[np.int64]
FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

WORD = 64


def pack_bits(is_complete: BoolArray) -> IntArray:
    """Words of bits: realisation r is bit r mod 64 (0: the least) of word r div 64, bit 63 being the sign.

    Parameters
    ----------
    is_complete
        (n_target, n_realisation).

    Returns
    -------
        (n_target, n_word) int64.
    """
    n_target, n_realisation = is_complete.shape
    n_word = -(-n_realisation // WORD)
    padded = np.zeros((n_target, n_word * WORD), dtype=np.uint8)
    padded[:, :n_realisation] = is_complete
    packed = np.packbits(padded.reshape(-1, 8), axis=1, bitorder="little")
    return np.ascontiguousarray(packed.reshape(n_target, n_word * 8)).view("<u8").astype(np.uint64).view(np.int64)


def unpack_bits(bits: IntArray, n_realisation: int) -> BoolArray:
    """(n_target, n_realisation) whether each realisation completes each target: the inverse of `pack_bits`."""
    content = np.ascontiguousarray(bits).astype("<i8").view(np.uint8).reshape(len(bits), 8 * bits.shape[1])
    return np.unpackbits(content, axis=1, count=n_realisation, bitorder="little").astype(bool)


def popcount(bits: IntArray) -> IntArray:
    """(n,) bits set in each row of (n, n_word) words."""
    content = np.ascontiguousarray(bits).view(np.uint8).reshape(len(bits), 8 * bits.shape[1])
    return np.unpackbits(content, axis=1).sum(axis=1, dtype=np.int64)


def target_weights(bits: IntArray, n_realisation: int) -> FloatArray:
    """(n,) inverse probability weights of targets that the run completed: (N + 1) / (bits set + 1).

    The run itself counts as one more realisation, in which they are complete, so that no weight is infinite.
    """
    return np.asarray((n_realisation + 1.0) / (popcount(bits) + 1.0))


def pair_weights(bits: IntArray, other_bits: IntArray, n_realisation: int) -> FloatArray:
    """(n,) the same for pairs of completed targets: (N + 1) / (bits set in both + 1)."""
    return np.asarray((n_realisation + 1.0) / (popcount(bits & other_bits) + 1.0))
