"""Tiles: an even covering, every target on its home's plate, and what else a plate can see."""

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, cKDTree

from survey_sim import tables
from survey_sim.geometry import sky_to_plate, unit_vectors
from survey_sim.region import healpix_29
from survey_sim.tiling import TilingSettings, covering, icosahedral_grid, make_tiles, members, pairs_within
from tests import naive_catalogue as naive

FIELD_DEG = 3.052


def covering_radius_deg(grid: np.ndarray) -> float:
    """Largest distance of a place from the nearest centre: the largest circumscribed circle of the Delaunay triangles."""
    hull = ConvexHull(grid)
    a, b, c = (grid[hull.simplices[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return float(np.degrees(np.arccos(np.abs((normal * a).sum(axis=1)).min())))


def make_targets(places, survey="s", kind="science") -> pl.DataFrame:
    ra_deg, dec_deg = (np.array(values, dtype=float).reshape(-1) for values in zip(*places, strict=True))
    n = len(ra_deg)
    frame = pl.DataFrame(
        {
            "target_id": np.arange(n),
            "survey": [survey] * n,
            "programme": ["p"] * n,
            "kind": [kind] * n,
            "source_id": [f"{survey}{kind}{i}" for i in range(n)],
            "ra_deg": ra_deg,
            "dec_deg": dec_deg,
            "mag": np.full(n, 10.0),
            "priority": np.full(n, 5),
            "wanted_visits": np.full(n, 1),
            "tile_id": pl.Series([None] * n, dtype=pl.Int32),
            "_healpix_29": healpix_29(ra_deg, dec_deg),
        }
    )
    return tables.conform(frame, "targets")


def random_places(n, seed, dec=(-90.0, 90.0), ra=(0.0, 360.0)):
    rng = np.random.default_rng(seed)
    sine = rng.uniform(*np.sin(np.radians(dec)), n)
    return list(zip(rng.uniform(*ra, n) % 360.0, np.degrees(np.arcsin(sine)), strict=True))


@pytest.mark.parametrize(("a", "b"), [(1, 0), (1, 1), (2, 0), (2, 1), (3, 2), (7, 5), (9, 6), (13, 1), (14, 0), (30, 7)])
def test_grid_has_its_number_of_centres_all_different(a, b):
    grid = icosahedral_grid(a, b)
    assert len(grid) == 10 * (a * a + a * b + b * b) + 2
    np.testing.assert_allclose(np.linalg.norm(grid, axis=1), 1.0, rtol=1e-14)
    distance = pairs_within(grid, cKDTree(grid), 360.0 / max(a + b, 2) / 5)[2]
    assert (distance > 1e-6).sum() + len(grid) == len(distance)


@pytest.mark.parametrize("radius_deg", [30.0, 12.0, 6.1, 4.0, 3.5, 3.2, 3.1, FIELD_DEG, 3.0, 2.9, 2.7, 2.5, 2.0, 1.0])
def test_covering_leaves_no_gap_and_wastes_little(radius_deg):
    grid = covering(radius_deg)
    assert covering_radius_deg(grid) <= radius_deg
    if radius_deg < 5:
        assert len(grid) * (1 - np.cos(np.radians(radius_deg))) / 2 < 1.38


@pytest.fixture(scope="module")
def whole_sky():
    targets = make_targets(random_places(40_000, 1))
    tiles, with_home = make_tiles(targets, TilingSettings(drop_redundant=False), FIELD_DEG)
    return targets, tiles, with_home


def test_home_is_the_nearest_centre(whole_sky):
    _, tiles, targets = whole_sky
    centres = tiles.select("ra_deg", "dec_deg").rows()
    for row in targets.sort("dec_deg").gather_every(1000).iter_rows(named=True):
        assert row["tile_id"] == naive.nearest((row["ra_deg"], row["dec_deg"]), centres)


def check_plates(tiles: pl.DataFrame, targets: pl.DataFrame) -> None:
    """Every science target on the plate of its home, by the projection; counts as they are."""
    science = targets.filter(kind="science")
    assert science["tile_id"].null_count() == 0
    for tile in tiles.iter_rows(named=True):
        home = science.filter(survey=tile["survey"], tile_id=tile["tile_id"])
        assert home.height == tile["n_target"] > 0
        place = sky_to_plate(home["ra_deg"].to_numpy(), home["dec_deg"].to_numpy(), (tile["ra_deg"], tile["dec_deg"]), 67.2)
        assert np.hypot(*place.T).max() <= 163.5


def test_every_target_is_on_its_plate(whole_sky):
    before, tiles, targets = whole_sky
    check_plates(tiles, targets)
    assert tiles.height == len(covering(FIELD_DEG * TilingSettings().max_distance_frac))
    assert targets.drop("tile_id").equals(before.drop("tile_id"))
    tables.conform(targets, "targets")


@pytest.mark.parametrize(
    ("ra", "dec"), [((350.0, 370.0), (-10.0, 10.0)), ((0.0, 360.0), (80.0, 90.0)), ((0.0, 360.0), (-90.0, -86.0))]
)
def test_poles_and_wrap(ra, dec):
    targets = make_targets(random_places(3000, 2, dec=dec, ra=ra))
    tiles, with_home = make_tiles(targets, TilingSettings(), FIELD_DEG)
    check_plates(tiles, with_home)
    area = 2 * np.pi * np.degrees(np.ptp(np.sin(np.radians(dec)))) * (180 / np.pi) / 6.283185307 * np.radians(ra[1] - ra[0])
    assert tiles.height <= 1.4 * area / (np.pi * FIELD_DEG**2) + 12


def test_redundant_tiles_go(whole_sky):
    targets = make_targets(random_places(5000, 3, dec=(-30.0, -10.0), ra=(40.0, 60.0)))
    every, _ = make_tiles(targets, TilingSettings(drop_redundant=False), FIELD_DEG)
    fewer, with_home = make_tiles(targets, TilingSettings(), FIELD_DEG)
    assert fewer.height < every.height
    check_plates(fewer, with_home)


def test_the_best_of_many_orientations_takes_fewer_tiles():
    targets = make_targets(random_places(4000, 3, dec=(-10.0, 10.0), ra=(350.0, 370.0)))
    one, _ = make_tiles(targets, TilingSettings(n_orientation=1), FIELD_DEG)
    best, with_home = make_tiles(targets, TilingSettings(), FIELD_DEG)
    assert best.height < one.height
    check_plates(best, with_home)


def test_overlap_is_a_setting():
    targets = make_targets(random_places(20_000, 4))
    more, with_home = make_tiles(targets, TilingSettings(max_distance_frac=0.75), FIELD_DEG)
    fewer, _ = make_tiles(targets, TilingSettings(), FIELD_DEG)
    assert more.height > 1.4 * fewer.height
    check_plates(more, with_home)


def test_surveys_have_their_own_tiles_and_supplies_no_home():
    places = random_places(2000, 5, dec=(-30, -20), ra=(10, 30))
    sky = random_places(2000, 6, dec=(-34, -16), ra=(6, 34))
    parts = [
        make_targets(places, "a"),
        make_targets(places[:50], "b"),
        make_targets(sky, "a", "sky"),
        make_targets(sky, "b", "guide"),
    ]
    targets = pl.concat(parts).with_columns(target_id=pl.int_range(pl.len()))
    tiles, with_home = make_tiles(targets, TilingSettings(), FIELD_DEG)
    check_plates(tiles, with_home)
    assert with_home.filter(pl.col("kind") != "science")["tile_id"].null_count() == 4000
    for survey in "ab":
        mine = tiles.filter(survey=survey)
        assert mine["tile_id"].to_list() == list(range(mine.height))
    found = members(tiles, with_home, FIELD_DEG)
    for i, tile in enumerate(tiles.iter_rows(named=True)):
        kind = {"a": "sky", "b": "guide"}[tile["survey"]]
        expected = [
            row
            for row, (survey, its_kind, ra, dec) in enumerate(with_home.select("survey", "kind", "ra_deg", "dec_deg").rows())
            if (survey, its_kind) == (tile["survey"], kind)
            and naive.angle_deg((ra, dec), (tile["ra_deg"], tile["dec_deg"])) < FIELD_DEG
        ]
        assert found.of(i).tolist() == expected


def test_no_target_gives_no_tile():
    tiles, targets = make_tiles(tables.empty("targets"), TilingSettings(), FIELD_DEG)
    assert tiles.height == targets.height == 0
    assert members(tiles, targets, FIELD_DEG).start.tolist() == [0]
    guides = make_targets([(1.0, 2.0)], kind="guide")
    tiles, targets = make_tiles(guides, TilingSettings(), FIELD_DEG)
    assert (tiles.height, targets["tile_id"].to_list()) == (0, [None])


def test_a_field_of_twenty_arcmin():
    targets = make_targets(random_places(2000, 7, dec=(-1, 1), ra=(0, 2)))
    tiles, with_home = make_tiles(targets, TilingSettings(), 600 / 3600)
    assert 40 < tiles.height < 90
    assert with_home["tile_id"].null_count() == 0


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 359.999), st.floats(-90, 90)), min_size=1, max_size=30, unique=True))
def test_any_targets_are_covered(places):
    tiles, with_home = make_tiles(make_targets(places), TilingSettings(), FIELD_DEG)
    check_plates(tiles, with_home)
    assert tiles.height <= len(places)


def test_pairs_within_is_complete_where_many_centres_overlap():
    points, centres = (
        np.array(random_places(200, 8, dec=(0, 5), ra=(0, 5))),
        np.array(random_places(60, 9, dec=(0, 5), ra=(0, 5))),
    )
    point, centre, _ = pairs_within(unit_vectors(*points.T), cKDTree(unit_vectors(*centres.T)), 2.0)
    expected = {(i, j) for i in range(200) for j in range(60) if naive.angle_deg(points[i], centres[j]) <= 2.0}
    assert set(zip(point.tolist(), centre.tolist(), strict=True)) == expected
