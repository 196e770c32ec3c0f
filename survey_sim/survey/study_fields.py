"""Stand-ins for the fields that the paper tried its algorithms on (Goodwin et al. 2014, Table 4), which are not public."""

from __future__ import annotations

import numpy as np
import polars as pl

from survey_sim.catalogue import MockRecipe, load_card, read_catalogue
from survey_sim.catalogue.mock import cached_mock
from survey_sim.errors import InputError
from survey_sim.folders import cache_folder, data_folder
from survey_sim.geometry import FloatArray, sky_to_plate
from survey_sim.instrument import Instrument, load_instrument

FIELD_RADIUS_DEG = 3.0
# ICRS, deg: (l, b) = (298, 0), where the stars are nearly as many as in Star-1; the south Galactic pole.
PLANE_DEG = (182.14340, -62.46058)
POLE_DEG = (12.85948, -27.12825)
N_GALAXY = 1431
# So many on the mock's whole sky that a field holds more than enough; the brightest N_GALAXY of it are taken.
N_MOCK = 1_300_000
STAR_V_MAG = (9.0, 12.0)
# Table 4: p9 down to magnitude 11, p7 fainter.
STAR_BRIGHT_V_MAG = 11.0
# Mock sky positions, as the paper's: evenly over the plate, this far from every target (assumed).
N_SKY = 400
SKY_CLEARANCE_MM = 0.5


def galaxy_field(seed: int) -> pl.DataFrame:
    """Galaxy-1: 1,431 clustered galaxies, priorities 1 to 9 alike, from the mock of the TAIPAN survey."""
    path, _ = cached_mock(MockRecipe(n_galaxy=N_MOCK), "allocation-study", cache_folder())
    xy, galaxies = _on_plate(pl.read_parquet(path), POLE_DEG)
    if len(galaxies) < N_GALAXY:
        raise InputError(f"the mock has {len(galaxies)} galaxies in the field, not {N_GALAXY}", place="galaxy-1")
    brightest = np.sort(np.argsort(galaxies["r_mag"].to_numpy(), kind="stable")[:N_GALAXY])
    rng = np.random.default_rng(seed)
    return _with_sky(xy[brightest], rng.integers(1, 10, N_GALAXY), rng)


def star_field(centre_deg: tuple[float, float], seed: int) -> pl.DataFrame:
    """Tycho-2 stars of 9 <= V < 12 around a place, priority 9 down to V = 11, 7 beyond."""
    card = load_card("tycho2", data_folder("catalogues"))
    xy, stars = _on_plate(read_catalogue(card, cache_folder()).rows, centre_deg)
    mag = stars["mag"].to_numpy()
    is_wanted = (mag >= STAR_V_MAG[0]) & (mag < STAR_V_MAG[1])
    priority = np.where(mag[is_wanted] <= STAR_BRIGHT_V_MAG, 9, 7)
    return _with_sky(xy[is_wanted], priority, np.random.default_rng(seed))


def paper_fields(*, quick: bool = False, seed: int = 1) -> dict[str, pl.DataFrame]:
    """Targets by source: target_id, kind, priority, x_mm, y_mm; without the thousands of Star-1 if quick."""
    fields = {"galaxy-1": galaxy_field(seed), "star-2": star_field(POLE_DEG, seed)}
    if not quick:
        fields["star-1"] = star_field(PLANE_DEG, seed)
    return dict(sorted(fields.items()))


def _on_plate(rows: pl.DataFrame, centre_deg: tuple[float, float]) -> tuple[FloatArray, pl.DataFrame]:
    """Rows within the field's radius of a place, and their plate positions (n, 2), mm."""
    scale = _paper().plate_scale_arcsec_mm
    xy = sky_to_plate(rows["ra_deg"].to_numpy(), rows["dec_deg"].to_numpy(), centre_deg, scale)
    is_inside = np.hypot(*xy.T) <= FIELD_RADIUS_DEG * 3600.0 / scale
    return xy[is_inside], rows.filter(pl.Series(is_inside))


def _with_sky(xy_mm: FloatArray, priority: np.ndarray, rng: np.random.Generator) -> pl.DataFrame:
    """Science targets and mock sky positions away from them."""
    radius = (_paper().plate_radius_mm - SKY_CLEARANCE_MM) * np.sqrt(rng.random(8 * N_SKY))
    turn = 2.0 * np.pi * rng.random(8 * N_SKY)
    drawn = np.column_stack([radius * np.cos(turn), radius * np.sin(turn)])
    nearest = np.array([((xy_mm - place) ** 2).sum(axis=1).min(initial=np.inf) for place in drawn])
    sky = drawn[nearest >= SKY_CLEARANCE_MM**2][:N_SKY]
    xy = np.vstack([xy_mm, sky])
    return pl.DataFrame(
        {
            "target_id": np.arange(len(xy)),
            "kind": ["science"] * len(xy_mm) + ["sky"] * len(sky),
            "priority": np.append(priority, np.full(len(sky), 1)),
            "x_mm": xy[:, 0],
            "y_mm": xy[:, 1],
        }
    )


def _paper() -> Instrument:
    return load_instrument("paper")
