"""Speed of five years of nights: 25 thousand visits of two surveys, 2.5 million targets."""

import numpy as np
import pytest

from survey_sim.schedule import ScheduleSettings, make_schedule
from tests.synthetic_schedule import both_surveys


@pytest.fixture(scope="module")
def inputs():
    return both_surveys(n_taipan_tile=1_000, n_funnelweb_tile=1_700, n_visit=25_000)


def test_bench_yardstick_sort(benchmark):
    """Sorting four million numbers: what the other is compared to."""
    values = np.random.default_rng(1).random(4_000_000)
    benchmark.pedantic(np.sort, args=(values,), rounds=5)


def test_bench_five_years(benchmark, inputs):
    """Everything, from tables to tables."""
    settings = ScheduleSettings()
    schedule = benchmark.pedantic(
        make_schedule, args=(*inputs.arguments(), settings, 1), rounds=3, warmup_rounds=1, iterations=1
    )
    assert len(schedule.exposures) > 24_000
