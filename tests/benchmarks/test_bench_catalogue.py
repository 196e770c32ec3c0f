"""Speed of targets and tiles at the size of the five-year survey."""

import numpy as np
import pytest

from survey_sim.catalogue import MockRecipe, ProgrammeSettings, Region, make_mock, make_targets
from survey_sim.folders import data_folder
from survey_sim.tiling import TilingSettings, make_tiles, members

FIELD_DEG = 3.052


def programmes() -> list[ProgrammeSettings]:
    """FunnelWeb to V = 12 and the TAIPAN mock, with all supplies: 4.5 million targets."""
    values = [
        {"name": "stars", "survey": "funnelweb", "catalogue": "tycho2", "mag_bright": 5.7, "mag_faint": 12.0},
        {"name": "galaxies", "survey": "taipan", "catalogue": "taipan-mock"},
    ]
    for survey in ("funnelweb", "taipan"):
        values += [{"name": kind, "survey": survey, "kind": kind, "catalogue": "tycho2"} for kind in ("guide", "standard")]
        values.append({"name": "sky", "survey": survey, "kind": "sky"})
    return [ProgrammeSettings.load(value) for value in values]


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def targets(cache):
    return make_targets(programmes(), Region(), 1, data_folder("catalogues"), cache).targets


def test_bench_yardstick_sort(benchmark):
    """Sorting four million numbers: what the others are compared to."""
    values = np.random.default_rng(1).random(4_000_000)
    benchmark.pedantic(np.sort, args=(values,), rounds=5)


def test_bench_mock(benchmark, tmp_path):
    benchmark.pedantic(make_mock, args=(MockRecipe(), tmp_path / "mock.parquet"), rounds=3)


def test_bench_targets(benchmark, targets, cache):
    arguments = (programmes(), Region(), 1, data_folder("catalogues"), cache)
    made = benchmark.pedantic(make_targets, args=arguments, rounds=3)
    assert made.targets.equals(targets)


def test_bench_tiles(benchmark, targets):
    benchmark.pedantic(make_tiles, args=(targets, TilingSettings(), FIELD_DEG), rounds=3)


def test_bench_members(benchmark, targets):
    tiles, with_home = make_tiles(targets, TilingSettings(n_orientation=1), FIELD_DEG)
    benchmark.pedantic(members, args=(tiles, with_home, FIELD_DEG), rounds=3)
