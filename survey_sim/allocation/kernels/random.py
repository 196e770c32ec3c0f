"""A stream of random numbers for searches."""

# mypy: allow-untyped-defs

import numpy as np

from survey_sim.kernel import inlined_kernel


@inlined_kernel
def next_random(state):
    """Next of a stream of random numbers, 0 to 2^31 (xorshift64*; Vigna 2016, ACM TOMS 42, 30)."""
    x = state[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    state[0] = x
    return np.int64((x * np.uint64(2685821657736338717)) >> np.uint64(33))


@inlined_kernel
def draw(n, state):
    """One of the numbers 0 to n - 1, n below 2^31."""
    return (next_random(state) * n) >> 31
