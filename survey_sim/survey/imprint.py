"""The imprint of runs: tables of completeness against pair separation, local density, place on the plate, and park."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt
import polars as pl

from survey_sim import tables
from survey_sim.geometry import sky_to_plate, unit_vectors
from survey_sim.imprint import (
    PairCounts,
    completeness_by_bin,
    count_pairs,
    local_density,
    nearest_park_mm,
    pair_table,
    plate_squares,
    uniform_sky,
)
from survey_sim.plotting import RunTables
from survey_sim.region import Region, abs_galactic_latitude_deg

FloatArray = npt.NDArray[np.float64]

# 10 arcsec to 6 deg, six bins a decade.
EDGES_DEG = np.geomspace(10.0 / 3600.0, 6.0, 21)
# Pairs wider than this are counted among evenly drawn targets, if there are more than so many.
WIDE_DEG = 0.3
N_WIDE = 40_000
# Randoms of the correlations, for each target and at most.
N_RANDOM, MOST_RANDOM = 3, 20_000
DENSITY_RADIUS_DEG = 0.5
N_DENSITY_BIN = 10
SQUARE_MM = 15.0
PARK_BIN_MM = 1.0
# Bins of fewer targets say nothing.
LEAST = 20
IMPRINT_TABLES = ("imprint_pairs", "imprint_density", "imprint_plate", "imprint_park")


def imprint_runs(runs: Sequence[tuple[str, RunTables]]) -> dict[str, pl.DataFrame]:
    """The tables of the imprint of runs: scenario and run, those of one scenario taken together."""
    frames: dict[str, list[pl.DataFrame]] = {name: [tables.empty(name)] for name in IMPRINT_TABLES}
    for scenario in dict.fromkeys(name for name, _ in runs):
        own = [run for name, run in runs if name == scenario]
        samples = [_prepared(run) for run in own]
        for programme in dict.fromkeys(row.name for run in own for row in run.programmes):
            rows = _skies(own, samples, programme)
            for outcome in _outcomes(run for run, _ in rows):
                keys = {"scenario": scenario, "programme": programme, "outcome": outcome}
                for name, made in _imprint(rows, f"is_{outcome}").items():
                    tagged = made.with_columns(**{key: pl.lit(value) for key, value in keys.items()})
                    frames[name].append(tagged.select(frames[name][0].columns).cast(frames[name][0].schema))
    return {name: pl.concat(parts) for name, parts in frames.items()}


def _skies(
    runs: Sequence[RunTables], samples: Sequence[pl.DataFrame], programme: str
) -> list[tuple[RunTables, pl.DataFrame]]:
    """Runs and their targets of a programme, the first of each sky: the same sky again would only make errors too small."""
    skies: dict[bytes, tuple[RunTables, pl.DataFrame]] = {}
    for run, sample in zip(runs, samples, strict=True):
        targets = sample.filter(programme=programme)
        if len(targets) > 1:
            skies.setdefault(targets.select("ra_deg", "dec_deg").to_numpy().tobytes(), (run, targets))
    return list(skies.values())


def _outcomes(runs: Iterable[RunTables]) -> list[str]:
    found = list(runs)
    return [] if not found else ["allocated", *(["observed"] if all(len(run.nights) for run in found) else [])]


def _prepared(run: RunTables) -> pl.DataFrame:
    """Science targets with their place on their home plate, x_mm and y_mm, and local density."""
    science = run.science.with_columns(pl.col("programme").cast(pl.String))
    parts = []
    scale = float(run.instrument["plate_scale_arcsec_mm"])
    tiles = run.tiles.select("survey", "tile_id", tile_ra="ra_deg", tile_dec="dec_deg")
    placed = science.join(tiles, on=["survey", "tile_id"], how="inner", maintain_order="left")
    for rows in placed.partition_by("survey", "tile_id", maintain_order=True):
        centre = (rows["tile_ra"][0], rows["tile_dec"][0])
        xy = sky_to_plate(rows["ra_deg"].to_numpy(), rows["dec_deg"].to_numpy(), centre, scale)
        parts.append(rows.with_columns(x_mm=pl.Series(xy[:, 0]), y_mm=pl.Series(xy[:, 1])))
    if not parts:
        return placed.with_columns(x_mm=pl.lit(0.0), y_mm=pl.lit(0.0), density=pl.lit(0.0))
    dense = []
    for rows in pl.concat(parts).partition_by("survey", maintain_order=True):
        vectors = unit_vectors(rows["ra_deg"].to_numpy(), rows["dec_deg"].to_numpy())
        dense.append(rows.with_columns(density=pl.Series(local_density(vectors, vectors, DENSITY_RADIUS_DEG))))
    return pl.concat(dense)


def _imprint(rows: Sequence[tuple[RunTables, pl.DataFrame]], outcome: str) -> dict[str, pl.DataFrame]:
    """The tables of one programme and outcome, without their keys."""
    sample = pl.concat([targets for _, targets in rows])
    is_complete = sample[outcome].to_numpy()
    xy = sample.select("x_mm", "y_mm").to_numpy()
    square, middles = plate_squares(xy, SQUARE_MM)
    density = sample["density"].to_numpy()
    edges = np.unique(np.quantile(density, np.linspace(0, 1, N_DENSITY_BIN + 1)[1:-1]))
    place = np.searchsorted(edges, density, side="right")
    park = np.concatenate([_park_distance(run, targets) for run, targets in rows])
    ring = np.floor(park / PARK_BIN_MM).astype(np.int64)
    return {
        "imprint_pairs": _pairs(rows, outcome),
        "imprint_density": _binned({"density_per_sq_deg": density}, place, is_complete),
        "imprint_plate": _binned({"x_mm": middles[square, 0], "y_mm": middles[square, 1]}, square, is_complete),
        "imprint_park": _binned({"park_distance_mm": park}, ring, is_complete),
    }


def _binned(means: dict[str, FloatArray], place: npt.NDArray[np.int64], is_complete: npt.NDArray[np.bool_]) -> pl.DataFrame:
    """Completeness by bin, with the means of some quantities of the targets in it; bins of few targets are left out."""
    n_bin = int(place.max(initial=0)) + 1
    n, frac, error = completeness_by_bin(place, is_complete, n_bin)
    kept = n >= LEAST
    mean = {name: np.bincount(place, weights=value, minlength=n_bin)[kept] / n[kept] for name, value in means.items()}
    return pl.DataFrame({**mean, "n": n[kept], "completeness_frac": frac[kept], "completeness_error_frac": error[kept]})


def _park_distance(run: RunTables, targets: pl.DataFrame) -> FloatArray:
    survey = targets["survey"][0]
    parks = run.robots.filter(survey=survey, kind="science", state="live").select("park_x_mm", "park_y_mm").to_numpy()
    return nearest_park_mm(targets.select("x_mm", "y_mm").to_numpy(), parks)


def _pairs(rows: Sequence[tuple[RunTables, pl.DataFrame]], outcome: str) -> pl.DataFrame:
    is_wide = EDGES_DEG[1:] > WIDE_DEG
    first_wide = int(np.argmax(is_wide))
    is_large = max(len(targets) for _, targets in rows) > N_WIDE
    counted: list[tuple[PairCounts, ...]] = []
    for run, targets in rows:
        vectors = unit_vectors(targets["ra_deg"].to_numpy(), targets["dec_deg"].to_numpy())
        is_complete = targets[outcome].to_numpy()
        randoms = _randoms(run, targets)
        if not is_large:
            counted.append((count_pairs(vectors, is_complete, EDGES_DEG, randoms),))
        else:
            n_some = min(N_WIDE, len(vectors))
            some = np.sort(np.random.default_rng(0).choice(len(vectors), n_some, replace=False))
            near = count_pairs(vectors, is_complete, EDGES_DEG[: first_wide + 1], randoms)
            counted.append((near, count_pairs(vectors[some], is_complete[some], EDGES_DEG[first_wide:], randoms)))
    # All samples of one range of separations together; a range has its own estimates, since its targets are others.
    parts = [_pair_frame(samples) for samples in zip(*counted, strict=True)]
    edges = [EDGES_DEG[: first_wide + 1], EDGES_DEG[first_wide:]] if is_large else [EDGES_DEG]
    return pl.concat(
        part.with_columns(separation_low_deg=pl.Series(edge[:-1]), separation_high_deg=pl.Series(edge[1:]))
        for part, edge in zip(parts, edges, strict=True)
    )


def _pair_frame(samples: Sequence[PairCounts]) -> pl.DataFrame:
    frame = pl.DataFrame(pair_table(samples)).with_columns(pl.col("n_pair").round(0).cast(pl.Int64))
    return frame.with_columns(pl.col(pl.Float64).fill_nan(None))


def _randoms(run: RunTables, targets: pl.DataFrame) -> FloatArray:
    """(n, 3) unit vectors, uniform in the footprint of a programme."""
    rng = np.random.default_rng(1)
    region = Region.load(run.setting("tiling", "region") or {})
    name = targets["programme"][0]
    programme: dict[str, float] = next((p for p in run.setting("programme") or [] if p["name"] == name), {})
    south = max(region.dec_deg[0], programme.get("dec_min_deg", -90.0))
    north = min(region.dec_deg[1], programme.get("dec_max_deg", 90.0))
    n = min(MOST_RANDOM, N_RANDOM * len(targets))
    ra, dec = uniform_sky(2 * n, region.ra_deg or (0.0, 360.0), (south, north), rng)
    inside = abs_galactic_latitude_deg(ra, dec) > programme.get("abs_b_min_deg", 0.0)
    return unit_vectors(ra[inside][:n], dec[inside][:n])
