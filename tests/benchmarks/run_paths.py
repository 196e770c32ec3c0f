"""Paths as a run has them, against their bounds: `python -m tests.benchmarks.run_paths [TILES]`.

Tiles of clustered galaxies with all calibration fibres (`taipan-150`, `plan`, `coordinated`), with the exchanges of robots
that hold a path up and without them.
"""

import sys

import numpy as np
import polars as pl
from rich.progress import track

from survey_sim.survey import tile
from tests.benchmarks.tiles import tile_job

AT_BOUND = 1 + 1e-9
N_SCIENCE = 900


def ratios(paths: pl.DataFrame) -> np.ndarray:
    """(n_path,) configuration time over bound, where anybody moves."""
    moving = paths.filter(pl.col("lower_bound_s") > 0)
    return (moving["configuration_time_s"] / moving["lower_bound_s"]).to_numpy()


def row(name: str, paths: pl.DataFrame) -> str:
    """A row of the printed table."""
    ratio = ratios(paths)
    figures = f"{100 * (ratio <= AT_BOUND).mean():.1f} | {np.quantile(ratio, 0.999):.3f} | {ratio.max():.3f}"
    return f"| {name} | {len(ratio)} | {figures} | {paths['configuration_time_s'].mean():.2f} | {paths['unrouted'].sum()} |"


def main(n_tile: int = 40) -> None:
    """Print a row a path, with exchanges and without."""
    print("| paths | number | at bound % | ratio p99.9 | max | mean time s | unrouted |\n|---|---|---|---|---|---|---|")
    for what, n_exchange, n_again in (("with exchanges", tile.N_EXCHANGE, tile.N_AGAIN), ("without", 0, 0)):
        tile.N_EXCHANGE, tile.N_AGAIN = n_exchange, n_again
        made = [tile.simulate_tile(tile_job(N_SCIENCE, tile_id=k))["paths"] for k in track(range(n_tile), what)]
        paths = pl.concat(made)
        for path in ("start_to_target", "park_to_target", "start_to_park"):
            print(row(f"{what}, {path}", paths.filter(path=path)))
        print(row(f"{what}, all", paths), flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
