"""Two million targets through every reader of a field, which must read them or refuse them in words. `make soak`."""

import os
import resource
import time
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from survey_sim.errors import InputError
from survey_sim.instrument import load_instrument, make_plate
from survey_sim.survey.field.targets import read_targets
from tests.test_fuzz import write_as

N_TARGET = int(os.environ.get("SOAK_TARGETS", "2000000"))


@pytest.mark.parametrize("kind", ["csv", "fits", "parquet", "vot"])
def test_two_million_targets(kind: str, tmp_path: Path) -> None:
    place = np.random.default_rng(1).uniform(-110, 110, (2, N_TARGET))
    frame = pl.DataFrame(
        {"target_id": np.arange(N_TARGET), "x_mm": place[0], "y_mm": place[1], "kind": ["science"] * N_TARGET}
    )
    path = tmp_path / f"targets.{kind}"
    write_as(frame, path, kind)
    begun = time.process_time()
    try:
        found = read_targets(path, make_plate(load_instrument("paper")), None).sort("target_id")
    except InputError as refusal:
        verdict = str(refusal).splitlines()[0].removeprefix(str(path))
        assert kind == "vot", verdict  # larger than a field's exchange file may be
    else:
        verdict = f"{len(found)} rows"
        np.testing.assert_array_equal(found["x_mm"].to_numpy(), place[0])
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{kind}: {verdict}, {path.stat().st_size >> 20} MiB, {time.process_time() - begun:.1f} s CPU, {memory:.0f} MiB")
