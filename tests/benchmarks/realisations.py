"""Realisations of the allocation: their time, and whether the lighter search has the probabilities of whole sessions.

    python -m tests.benchmarks.realisations RUN_DIR [N_REALISATION] [N_TILE]

of the tiles of a finished run's first survey whose name is taipan (or of its first survey). CPU times; the yardstick is one
`linear_sum_assignment` of 150 x 1500 in the same run. `as the run` is with the numbers of visits that pooling gave the
tiles. `noise` is the root mean square that two samples of the same probabilities would differ by.
"""

import sys
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy.optimize import linear_sum_assignment

from survey_sim.allocation import Realisations, start_allocation
from survey_sim.survey.stages import make_batches
from survey_sim.survey.tile import TileJob, field_of
from survey_sim.survey.weights import open_recorded, realise_tile


def yardstick_ms() -> float:
    cost = np.random.default_rng(1).random((150, 1500))
    times = []
    for _ in range(5):
        begun = time.process_time()
        linear_sum_assignment(cost)
        times.append(1e3 * (time.process_time() - begun))
    return min(times)


def compare(job: TileJob, n: int) -> None:
    """One tile by whole sessions and by realisations."""
    field = field_of(job)
    settings = job.allocation.model_copy(update={"sub_priority": 1.0})
    light = Realisations(field, job.plate, settings)
    nothing = np.zeros(field.n_target, dtype=np.int64)

    def session(rng: np.random.Generator) -> np.ndarray:
        whole = start_allocation(field, job.plate, settings, rng)
        position = job.plate.park_mm
        while (visit := whole.next_visit(position)) is not None:
            whole.record(visit, np.ones(job.plate.n_robot, dtype=bool))
            position = visit.goal_mm
        return whole.n_done

    shares, times = [], []
    for number, draw in enumerate((session, lambda rng: light.draw(rng, nothing))):
        draw(np.random.default_rng(0))
        begun = time.process_time()
        drawn = [draw(np.random.default_rng([number, k])) >= field.wanted_visits for k in range(n)]
        times.append(1e3 * (time.process_time() - begun) / n)
        shares.append(np.mean(drawn, axis=0)[field.is_science])
    whole, own = shares
    begun = time.process_time()
    realise_tile(job, n)
    as_run_ms = 1e3 * (time.process_time() - begun) / n
    rms = np.sqrt(np.mean((whole - own) ** 2))
    noise = np.sqrt(np.mean((whole * (1 - whole) + own * (1 - own)) / (n - 1)))
    certain = f"{100 * (own == 1).mean():.0f} | {100 * (own == 0).mean():.1f}"
    spent = f"{times[0]:.0f} | {times[1]:.0f} | {as_run_ms:.1f}"
    complete = f"{100 * whole.mean():.1f} | {100 * own.mean():.1f}"
    print(f"| {job.tile_id} | {len(own)} | {spent} | {complete} | {rms:.3f} | {noise:.3f} | {certain} |")


def main() -> None:
    run_dir, n, n_tile = (*sys.argv[1:], "40", "4")[:3] if len(sys.argv) == 2 else (*sys.argv[1:], "4")[:3]
    run = open_recorded(Path(run_dir), Console(quiet=True))
    survey = "taipan" if "taipan" in run.settings.surveys else run.settings.surveys[0]
    jobs = [job for batch in make_batches(run) for job in batch.jobs if job.survey == survey]
    print(f"yardstick {yardstick_ms():.2f} ms")
    print("| tile | targets | session, ms | realisation, ms | as the run, ms | % | % | rms | noise | always % | never % |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for job in jobs[: int(n_tile)]:
        compare(job, int(n))


if __name__ == "__main__":
    main()
