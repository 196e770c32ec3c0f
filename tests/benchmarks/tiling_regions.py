"""Visits that regions of the sky need: `python -m tests.benchmarks.tiling_regions [NUMBER ...]` (all regions by default).

Of square regions at the densities that TAIPAN's own tiler was run on: targets, tiles, ideal number of visits (95 % of the
targets / 126 science fibres), and visits / ideal: of each tile by itself, pooled, and pooled on interior tiles (those whose
plate lies wholly within the region) and the others apart, with the targets at home on them; completeness of the visits made,
their robots routed; CPU seconds of tiling and pooling, and of all visits.
"""

import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import polars as pl

from survey_sim.allocation import AllocationSettings
from survey_sim.catalogue import MockRecipe, ProgrammeSettings, Region, make_mock, make_targets
from survey_sim.folders import cache_folder, data_folder
from survey_sim.geometry import plate_to_sky
from survey_sim.instrument import load_instrument, make_plate
from survey_sim.routing import RoutingSettings
from survey_sim.survey.pooling import PoolRules, pool_survey
from survey_sim.survey.tile import TileJob, simulate_tile
from survey_sim.survey.workers import Workers
from survey_sim.tiling import Planned, TilingSettings, make_tiles, members

WANTED_FRAC = 0.95
PLATE = make_plate(load_instrument("taipan-150"))
# 24 of 150 science robots stand on standards and sky: 126 are left for science.
ALLOCATION = AllocationSettings.load({"wanted_standard": 4, "wanted_sky": 20, "min_gain": 5, "bound": "none"})
N_FIBRE = 126
# Name, catalogue, side of the square (deg), targets per square degree, centre (deg).
REGIONS = (
    ("Tycho-2", "tycho2", 6.0, 24.0, (220.0, -25.0)),
    ("Tycho-2", "tycho2", 12.0, 24.0, (220.0, -25.0)),
    ("Tycho-2", "tycho2", 20.0, 24.0, (220.0, -25.0)),
    ("Tycho-2", "tycho2", 20.0, 24.0, (40.0, -45.0)),
    ("galaxies", "mock", 12.0, 24.0, (200.0, -25.0)),
    ("galaxies", "mock", 20.0, 24.0, (200.0, -25.0)),
    ("galaxies", "mock", 20.0, 24.0, (20.0, -40.0)),
    ("Tycho-2", "tycho2", 6.0, 97.0, (270.0, -30.0)),
    ("Tycho-2", "tycho2", 20.0, 97.0, (270.0, -30.0)),
    ("galaxies", "mock", 20.0, 97.0, (200.0, -25.0)),
)


def square(side_deg: float, centre_deg: tuple[float, float]) -> Region:
    """A region of side^2 square degrees between two declinations."""
    ra, dec = centre_deg
    south, north = dec - side_deg / 2, dec + side_deg / 2
    width = np.radians(side_deg**2) / (np.sin(np.radians(north)) - np.sin(np.radians(south)))
    return Region(ra_deg=(ra - width / 2, ra + width / 2), dec_deg=(south, north))


def select(catalogue: str, region: Region, n_target: int) -> pl.DataFrame:
    """The brightest targets of a region, with all calibration targets."""
    values = [{"name": "science", "survey": "s", "catalogue": catalogue, "completeness_frac": WANTED_FRAC}]
    values += [{"name": kind, "survey": "s", "kind": kind, "catalogue": "tycho2"} for kind in ("guide", "standard")]
    values.append({"name": "sky", "survey": "s", "kind": "sky", "density_per_sq_deg": 12.0})
    programmes = [ProgrammeSettings.load(value) for value in values]
    targets = make_targets(programmes, region, 1, data_folder("catalogues"), cache_folder()).targets
    bright = targets.filter(kind="science").sort("mag", "target_id").head(n_target)["target_id"]
    return targets.filter((pl.col("kind") != "science") | pl.col("target_id").is_in(bright.implode()))


def dense_mock(folder: Path) -> str:
    """Galaxies as of the mock that is shipped, at 100 per square degree."""
    raw, table = folder / "raw.parquet", folder / "mock.csv"
    make_mock(MockRecipe(n_galaxy=2_018_000), raw)
    pl.read_parquet(raw).rename({"r_mag": "mag"}).write_csv(table)
    return str(table)


def made(targets: pl.DataFrame, tiles: pl.DataFrame, plan: Mapping[tuple, pl.DataFrame] | None) -> tuple[np.ndarray, int]:
    """(n_tile,) visits made on each tile, and targets completed by all."""
    shared = members(tiles, targets, PLATE.instrument.field_radius_deg)
    own = targets.filter(kind="science").partition_by("tile_id", as_dict=True)
    n_visit, n_complete = [], 0
    for place, tile in enumerate(tiles.iter_rows(named=True)):
        key = (tile["tile_id"],)
        mine = own.get(key, targets.clear())
        made = simulate_tile(
            TileJob(
                survey="s",
                tile_id=tile["tile_id"],
                centre_deg=(tile["ra_deg"], tile["dec_deg"]),
                targets=pl.concat([mine, targets[shared.of(place)]]).sort("target_id"),
                wanted_frac={"science": WANTED_FRAC},
                plate=PLATE,
                allocation=ALLOCATION,
                routing=RoutingSettings(),
                seed=1,
                plan=None if plan is None else _planned(plan.get(key)),
            )
        )
        n_visit.append(made["visits"].height)
        n_complete += mine.height - made["unallocated"].height
    return np.array(n_visit), n_complete


def _planned(rows: pl.DataFrame | None) -> Planned:
    return Planned.empty() if rows is None else Planned(*(rows[n].to_numpy() for n in ("target_id", "group", "visit")))


def is_interior(tile: Mapping, region: Region) -> bool:
    """Whether the edge of a plate lies wholly within the region."""
    angle = np.radians(np.arange(0.0, 360.0, 5.0))
    edge = PLATE.instrument.plate_radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    sky = plate_to_sky(edge, (tile["ra_deg"], tile["dec_deg"]), PLATE.instrument.plate_scale_arcsec_mm)
    return bool(region.contains(sky[:, 0], sky[:, 1]).all())


def row_of(catalogue: str, side_deg: float, density: float, centre_deg: tuple[float, float]) -> list[str]:
    """The figures of one region."""
    region = square(side_deg, centre_deg)
    targets = select(catalogue, region, round(density * side_deg**2))
    radius = PLATE.instrument.field_radius_deg
    n_target = targets.filter(kind="science").height
    ideal = WANTED_FRAC * n_target / N_FIBRE
    alone = made(*make_tiles(targets, TilingSettings(), radius)[::-1], None)[0].sum()
    begun = time.process_time()
    tiles, targets = make_tiles(targets, TilingSettings(), radius)
    rules = PoolRules("s", {"science": WANTED_FRAC}, PLATE, ALLOCATION, seed=1)
    targets, plan = pool_survey(rules, targets, tiles, Workers())
    pooled = time.process_time()
    n_visit, n_complete = made(targets, tiles, plan.partition_by("tile_id", as_dict=True))
    done = time.process_time()
    interior = np.array([is_interior(tile, region) for tile in tiles.iter_rows(named=True)])
    home = np.bincount(targets.filter(kind="science")["tile_id"].to_numpy(), minlength=tiles.height)

    def ratio(some: np.ndarray) -> str:
        return f"{n_visit[some].sum() / (WANTED_FRAC * home[some].sum() / N_FIBRE):.2f}" if home[some].any() else "-"

    return [
        f"{n_target}", f"{tiles.height} ({interior.sum()})", f"{ideal:.1f}", f"{alone / ideal:.2f}", f"{n_visit.sum()}",
        f"{n_visit.sum() / ideal:.2f}", ratio(interior), ratio(~interior), f"{n_complete / n_target:.3f}",
        f"{pooled - begun:.1f}", f"{done - pooled:.1f}",
    ]  # fmt: skip


def main() -> None:
    """Print the table."""
    chosen = [int(number) for number in sys.argv[1:]] or range(len(REGIONS))
    head = (
        "region | per sq deg | targets | tiles (interior) | ideal | each tile by itself | visits | visits / ideal | interior"
    )
    head += " | edge | complete | tiling and pooling, s | visits, s"
    print(f"| {head} |", "|---" * (head.count("|") + 1) + "|", sep="\n")
    with tempfile.TemporaryDirectory() as folder:
        mock = dense_mock(Path(folder)) if any(REGIONS[number][1] == "mock" for number in chosen) else ""
        for number in chosen:
            name, catalogue, side_deg, density, centre_deg = REGIONS[number]
            row = row_of(mock if catalogue == "mock" else catalogue, side_deg, density, centre_deg)
            print(f"| {name}, {side_deg:.0f} x {side_deg:.0f} deg | {density:.0f} | {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
