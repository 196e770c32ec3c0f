"""The mock of TAIPAN's galaxies: numbers, clustering, and the same bytes for the same seed."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.spatial import cKDTree

from survey_sim.catalogue import MockRecipe, load_card, make_mock, read_catalogue
from survey_sim.catalogue.mock import cached_mock, correlation
from survey_sim.folders import data_folder
from survey_sim.geometry import chord, unit_vectors
from survey_sim.region import abs_galactic_latitude_deg, healpix_29, healpix_positions

SMALL = MockRecipe(n_galaxy=20_000, healpix_order=6)
# Footprint of the recipe, sq deg (the shared table of facts gives 20,179).
AREA_SQ_DEG = 20_179.0


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    """The mock of the shipped card, at full size."""
    card = load_card("taipan-mock", data_folder("catalogues"))
    return read_catalogue(card, tmp_path_factory.mktemp("cache")).rows


@pytest.fixture(scope="module")
def vectors(full):
    return unit_vectors(full["ra_deg"].to_numpy(), full["dec_deg"].to_numpy())


def inner_places(margin_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """Even places whose surroundings lie inside the footprint."""
    ra_deg, dec_deg = healpix_positions(np.arange(12 * 4**5), 5)
    inside = (dec_deg < 10 - margin_deg) & (abs_galactic_latitude_deg(ra_deg, dec_deg) > 10 + margin_deg)
    return ra_deg[inside], dec_deg[inside]


def test_number_and_footprint(full):
    assert full.height == 500_000
    assert full["dec_deg"].max() < 10
    assert abs_galactic_latitude_deg(full["ra_deg"].to_numpy(), full["dec_deg"].to_numpy()).min() > 10
    assert full["source_id"].is_unique().all()
    assert np.all(np.diff(healpix_29(full["ra_deg"].to_numpy(), full["dec_deg"].to_numpy())) >= 0)


def test_magnitude_counts(full):
    """Cumulative counts rise as 10^(0.637 r)."""
    assert full["mag"].is_between(14, 17, closed="left").all()
    lowest = 10 ** (0.637 * (14 - 17))
    for mag in (15.0, 16.0, 16.5):
        expected = (10 ** (0.637 * (mag - 17)) - lowest) / (1 - lowest)
        assert (full["mag"] < mag).mean() == pytest.approx(expected, abs=0.003)


def test_counts_in_fields(vectors):
    """A 6-degree field holds 698 +- 146 galaxies."""
    count = cKDTree(vectors).query_ball_point(unit_vectors(*inner_places(3.0)), chord(3.0), return_length=True)
    assert count.mean() == pytest.approx(698, rel=0.02)
    assert count.std() == pytest.approx(146, rel=0.12)


def test_correlation(full, vectors):
    """w(theta) of pairs, from galaxies whose rings lie inside the footprint: 15 % down to the field's cells of 0.115 deg."""
    ring_deg = np.array([0.1, 0.2, 0.4, 0.8, 1.6, 2.4])
    ra_deg, dec_deg = full["ra_deg"].to_numpy(), full["dec_deg"].to_numpy()
    inside = np.flatnonzero((dec_deg < 7.5) & (abs_galactic_latitude_deg(ra_deg, dec_deg) > 12.5))[::10]
    tree = cKDTree(vectors)
    within = [tree.query_ball_point(vectors[inside], chord(r), return_length=True).mean() for r in ring_deg]
    cap_sq_deg = 2 * np.pi * (1 - np.cos(np.radians(ring_deg))) * (180 / np.pi) ** 2
    found = np.diff(within) / np.diff(cap_sq_deg) / (len(vectors) / AREA_SQ_DEG) - 1
    np.testing.assert_allclose(found, ring_mean(ring_deg), rtol=0.20)


def ring_mean(ring_deg: np.ndarray) -> np.ndarray:
    """w averaged over the area of each ring."""
    means = []
    for low, high in pairwise(ring_deg):
        theta = np.linspace(low, high, 200)
        means.append(np.average(correlation(MockRecipe(), theta), weights=theta))
    return np.array(means)


def test_same_seed_same_bytes(tmp_path):
    digests = [make_mock(SMALL, tmp_path / f"{i}.parquet", seed) for i, seed in enumerate([None, None, SMALL.seed, 3])]
    assert digests[0] == digests[1] == digests[2] != digests[3]
    assert (tmp_path / "0.parquet").read_bytes() == (tmp_path / "1.parquet").read_bytes()


def test_other_footprints_and_sizes(tmp_path):
    cap = MockRecipe(n_galaxy=500, dec_max_deg=-80, abs_b_min_deg=0, healpix_order=5, correlation_amplitude=0)
    make_mock(cap, tmp_path / "cap.parquet")
    rows = pl.read_parquet(tmp_path / "cap.parquet")
    assert rows.height == 500
    assert rows["dec_deg"].max() < -80
    make_mock(cap.model_copy(update={"n_galaxy": 0}), tmp_path / "none.parquet")
    assert pl.read_parquet(tmp_path / "none.parquet").height == 0


def test_cache_is_made_once_and_mended(tmp_path):
    path, digest = cached_mock(SMALL, "small", tmp_path)
    written = path.stat().st_mtime_ns
    assert cached_mock(SMALL, "small", tmp_path) == (path, digest)
    assert path.stat().st_mtime_ns == written
    path.write_bytes(path.read_bytes()[:1000])
    assert cached_mock(SMALL, "small", tmp_path) == (path, digest)
    assert path.stat().st_size > 1000
    other, _ = cached_mock(SMALL.model_copy(update={"seed": 5}), "small", tmp_path)
    assert other != path
    assert {file.suffix for file in Path(tmp_path, "catalogues").iterdir()} == {".parquet", ".sha256"}
