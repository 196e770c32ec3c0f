"""Speed of the allocation of one tile, as ratios to one `linear_sum_assignment` of 150 x 1500 in the same run."""

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from survey_sim.allocation import AllocationSettings, FieldTargets, completeness_bound
from survey_sim.instrument import load_instrument, make_plate
from tests.benchmarks.sessions import all_visits
from tests.benchmarks.yardstick import yardstick_s
from tests.mock_targets import clustered_xy, field_targets, survey_targets, uniform_xy


def timed(benchmark: BenchmarkFixture, targets: FieldTargets, instrument: str, **values: object) -> None:
    plate, settings = make_plate(load_instrument(instrument)), AllocationSettings.load(values)
    result = benchmark.pedantic(all_visits, args=(targets, plate, settings), rounds=5, warmup_rounds=1)
    benchmark.extra_info["completeness_frac"] = result[1]
    benchmark.extra_info["ratio_to_assignment"] = benchmark.stats.stats.min / yardstick_s()


@pytest.mark.parametrize("places", [uniform_xy, clustered_xy])
@pytest.mark.parametrize("algorithm", ["cda-basic", "cda-advanced", "matching", "plan"])
def test_ten_visits_of_1431_targets(benchmark: BenchmarkFixture, algorithm: str, places) -> None:
    timed(benchmark, field_targets(places(1431, 1)), "paper", algorithm=algorithm, visits=10)


def test_one_visit_by_matching(benchmark: BenchmarkFixture) -> None:
    timed(benchmark, field_targets(clustered_xy(1431, 1)), "paper", algorithm="matching", visits=1)


def test_plan_with_guides_standards_and_sky(benchmark: BenchmarkFixture) -> None:
    timed(benchmark, survey_targets(clustered_xy(900, 1), 1), "taipan-150", visits=6)


def test_plan_of_5916_stars_and_300_robots(benchmark: BenchmarkFixture) -> None:
    timed(benchmark, field_targets(uniform_xy(5916, 3)), "taipan-300", visits=20)


@pytest.mark.parametrize("method", ["linear", "fast"])
def test_bound_of_ten_visits(benchmark: BenchmarkFixture, method) -> None:
    targets, plate = field_targets(clustered_xy(1431, 3)), make_plate(load_instrument("paper"))
    benchmark.pedantic(completeness_bound, args=(targets, plate, 10), kwargs={"method": method}, rounds=5, warmup_rounds=1)
    benchmark.extra_info["ratio_to_assignment"] = benchmark.stats.stats.min / yardstick_s()
