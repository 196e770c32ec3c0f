"""The imprint: pair counts against plain loops, what a known loss does to them, bins, and bitwise weights."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from survey_sim.geometry import unit_vectors
from survey_sim.imprint import (
    completeness_by_bin,
    count_pairs,
    local_density,
    nearest_park_mm,
    pack_bits,
    pair_table,
    pair_weights,
    plate_squares,
    popcount,
    sky_patches,
    target_weights,
    uniform_sky,
    unpack_bits,
)
from tests.naive_imprint import pairs_by_bin

EDGES_DEG = np.geomspace(0.05, 5.0, 6)


def _sky(n: int, seed: int = 1, ra: tuple[float, float] = (350.0, 10.0)) -> np.ndarray:
    return unit_vectors(*uniform_sky(n, ra, (-40.0, -25.0), np.random.default_rng(seed)))


def test_pairs_and_their_jackknife_are_those_of_plain_loops() -> None:
    vectors = _sky(120)
    is_complete = np.random.default_rng(2).random(120) < 0.6
    patch = sky_patches(vectors)
    counts = count_pairs(vectors, is_complete, EDGES_DEG)
    assert patch.max() + 1 == len(counts.pairs) - 1 == 4
    assert np.bincount(patch).tolist() == [30, 30, 30, 30]
    everything = np.ones(120, dtype=bool)
    np.testing.assert_array_equal(counts.pairs[0], pairs_by_bin(vectors, everything, EDGES_DEG))
    np.testing.assert_array_equal(counts.complete_pairs[0], pairs_by_bin(vectors, is_complete, EDGES_DEG))
    for k in range(4):
        kept = patch != k
        np.testing.assert_array_equal(counts.pairs[1 + k], pairs_by_bin(vectors, kept, EDGES_DEG))
        np.testing.assert_array_equal(counts.complete_pairs[1 + k], pairs_by_bin(vectors, kept & is_complete, EDGES_DEG))
        assert counts.n_complete[1 + k] == (kept & is_complete).sum()


def test_losses_at_random_leave_no_imprint() -> None:
    vectors = _sky(4000)
    is_complete = np.random.default_rng(3).random(4000) < 0.7
    table = pair_table([count_pairs(vectors, is_complete, EDGES_DEG, _sky(6000, seed=9))])
    assert np.all(np.abs(table["ratio"] - 1.0) < 4.0 * table["ratio_error"])
    assert np.all(table["ratio_error"][1:] < 0.02)
    np.testing.assert_allclose(table["pair_completeness_frac"][1:], 0.49, atol=0.03)
    assert np.all(np.abs(table["w_targeted"][1:]) < 0.05)


def test_pairs_that_are_never_both_complete_show_at_their_separation_alone() -> None:
    first = _sky(1500)
    ra, dec = np.degrees(np.arctan2(first[:, 1], first[:, 0])), np.degrees(np.arcsin(first[:, 2]))
    vectors = np.concatenate([first, unit_vectors(ra, dec + 0.07)])
    is_complete = np.arange(3000) < 1500
    table = pair_table([count_pairs(vectors, is_complete, EDGES_DEG)])
    assert table["ratio"][0] < 0.5
    assert table["ratio"][2:].min() > 0.9
    assert table["n_pair"][0] >= 1500


def test_samples_together_are_weighted_by_their_pairs() -> None:
    one, two = _sky(200), _sky(300, seed=5)
    chosen = [np.random.default_rng(k).random(n) < 0.5 for k, n in ((1, 200), (2, 300))]
    counts = [count_pairs(vectors, some, EDGES_DEG) for vectors, some in zip((one, two), chosen, strict=True)]
    together = pair_table(counts)
    complete = counts[0].complete_pairs[0] + counts[1].complete_pairs[0]
    np.testing.assert_allclose(together["pair_completeness_frac"], complete / (2 * together["n_pair"]))
    single = pair_table(counts[:1])
    assert np.nanmean(together["ratio_error"]) < np.nanmean(single["ratio_error"])


def test_bins_of_density_plate_and_park() -> None:
    vectors = unit_vectors(np.array([0.0, 0.1, 40.0]), np.array([0.0, 0.0, 0.0]))
    density = local_density(vectors, vectors, 1.0)
    assert density[0] == density[1] == pytest.approx(1.0 / np.pi, rel=1e-3)
    assert density[2] == 0.0
    square, middles = plate_squares(np.array([[1.0, 1.0], [14.0, 2.0], [-1.0, 1.0]]), 15.0)
    assert middles[square].tolist() == [[7.5, 7.5], [7.5, 7.5], [-7.5, 7.5]]
    assert nearest_park_mm(np.array([[3.0, 4.0]]), np.array([[0.0, 0.0], [50.0, 0.0]])).tolist() == [5.0]
    n, frac, error = completeness_by_bin(np.array([0, 0, 2, 2]), np.array([True, False, True, True]), 3)
    assert n.tolist() == [2, 0, 2]
    assert frac[0] == 0.5
    assert np.isnan(frac[1])
    assert error.tolist()[2] == 0.0
    assert error[0] == pytest.approx(np.sqrt(0.125))


def test_uniform_sky_wraps_and_is_even_in_area() -> None:
    ra, dec = uniform_sky(20_000, (350.0, 10.0), (0.0, 60.0), np.random.default_rng(1))
    assert ((ra >= 350.0) | (ra < 10.0)).all()
    assert (np.sin(np.radians(dec)) < np.sin(np.radians(60.0)) / 2).mean() == pytest.approx(0.5, abs=0.02)


def test_bits_stand_where_the_convention_says() -> None:
    is_complete = np.zeros((2, 128), dtype=bool)
    is_complete[0, [0, 3, 63]] = True
    is_complete[1, 64] = True
    bits = pack_bits(is_complete)
    assert bits.dtype == np.int64
    assert bits.tolist() == [[(1 | 8) - 2**63, 0], [0, 1]]
    assert popcount(bits).tolist() == [3, 1]


@given(st.integers(1, 130), st.integers(0, 4), st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_bits_come_back(n_realisation: int, n_target: int, seed: int) -> None:
    is_complete = np.random.default_rng(seed).random((n_target, n_realisation)) < 0.5
    bits = pack_bits(is_complete)
    assert bits.shape == (n_target, -(-n_realisation // 64))
    np.testing.assert_array_equal(unpack_bits(bits, n_realisation), is_complete)
    np.testing.assert_array_equal(popcount(bits), is_complete.sum(axis=1))


def test_weights_are_inverse_shares_of_realisations() -> None:
    bits = pack_bits(np.array([[True, True, True], [True, False, False], [False, False, False]]))
    assert target_weights(bits, 3).tolist() == [1.0, 2.0, 4.0]
    assert pair_weights(bits[[0, 0]], bits[[1, 2]], 3).tolist() == [2.0, 4.0]
