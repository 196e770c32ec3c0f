"""Kill a run a hundred times at random moments; it must end as if nothing had happened. `make soak`."""

import os
import random
import resource
from pathlib import Path

from tests.faults import COMMAND, assert_same_run, kill_at_random, run_to_the_end
from tests.small_survey import write_small_survey

N_KILL = int(os.environ.get("SOAK_KILLS", "100"))
# Kills come within so many times the CPU time of an undisturbed run, so that every stage is met, and some runs end.
LONGEST = 1.1


def test_killed_again_and_again(tmp_path: Path) -> None:
    pipeline = write_small_survey(tmp_path / "sky")
    run_to_the_end(COMMAND, pipeline, tmp_path / "undisturbed")
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    longest_s = LONGEST * (spent.ru_utime + spent.ru_stime)
    rng = random.Random(int(os.environ.get("SOAK_SEED", "2014")))
    n_kill = n_run = 0
    while n_kill < N_KILL:
        out = tmp_path / f"run{n_run}"
        more = ("--workers", "2") if n_run % 2 else ("--serial",)
        while n_kill < N_KILL and kill_at_random(COMMAND, pipeline, out, rng, longest_s, *more):
            n_kill += 1
        run_to_the_end(COMMAND, pipeline, out)
        assert_same_run(out, tmp_path / "undisturbed")
        n_run += 1
    print(f"{n_kill} kills in {n_run} runs: every table as undisturbed")
