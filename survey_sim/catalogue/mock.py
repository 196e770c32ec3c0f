"""Mock galaxies: a lognormal field on the sky with a given angular correlation, sampled at a given number.

The Gaussian field g has the correlation ln(1 + w(theta)), so that exp(g) has w (Coles & Jones 1991, MNRAS 248, 1). Galaxies
are drawn one by one from its density, each uniformly inside its HEALPix cell: Poisson counts whose sum is the number wanted.
Below the cell's width the correlation is that of the cell.
"""

from hashlib import sha256
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
import polars as pl
from pydantic import Field

from survey_sim.region import HEALPIX_ORDER, Declination, abs_galactic_latitude_deg, healpix_positions
from survey_sim.settings import Settings
from survey_sim.tables import checksum, write_bytes, write_plain

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Raised whenever the same recipe would give other rows.
_RECIPE_VERSION = 1
_BATCH_FRAC = 1.02


class MockRecipe(Settings):
    """A mock of a magnitude-limited galaxy survey. Values: measured on SDSS 14 < r < 17, unless said otherwise."""

    kind: Literal["lognormal-galaxies"] = "lognormal-galaxies"
    # P 1.4: the TAIPAN survey (Goodwin et al. 2014).
    n_galaxy: int = Field(500_000, ge=0, le=20_000_000)
    # Footprint: south of this declination, and this far from the Galactic equator, deg.
    dec_max_deg: Declination = 10.0
    abs_b_min_deg: float = Field(10.0, ge=0, lt=89)
    # w(theta) = amplitude (theta / 1 deg)^slope exp(-theta / cutoff), flat below the core.
    correlation_amplitude: float = Field(0.10, ge=0, le=10)
    correlation_slope: float = Field(-0.79, gt=-2, le=0)
    correlation_cutoff_deg: float = Field(8.0, gt=0, le=180)
    correlation_core_deg: float = Field(0.02, gt=0, le=180)
    # Cumulative counts rise as 10^(slope r) between the two magnitudes (SDSS r).
    mag_bright: float = Field(14.0, ge=-30, le=40)
    mag_faint: float = Field(17.0, ge=-30, le=40)
    count_slope_per_mag: float = Field(0.637, gt=0, le=5)
    # The field's cells, 0.115 deg wide: nside = 2^order.
    healpix_order: int = Field(9, ge=4, le=11)
    seed: int = Field(2014, ge=0, lt=2**63)


def make_mock(recipe: MockRecipe, path: Path, seed: int | None = None) -> str:
    """Write the mock's Parquet file (source_id, ra_deg, dec_deg, r_mag, sorted by HEALPix); gives its SHA-256.

    The same recipe and seed give the same bytes on the same kind of machine, whatever its number of cores.
    """
    rng = np.random.default_rng(recipe.seed if seed is None else seed)
    density = np.exp(_gaussian_field(recipe, rng))
    cell = np.sort(_draw_cells(recipe, density, rng))
    ra_deg, dec_deg = healpix_positions(cell, HEALPIX_ORDER)
    frame = pl.DataFrame(
        {
            "source_id": pl.int_range(len(cell), eager=True).cast(pl.String).str.zfill(7).str.replace("^", "m"),
            "ra_deg": ra_deg,
            "dec_deg": dec_deg,
            "r_mag": np.floor(_magnitudes(recipe, len(cell), rng) * 1000.0) / 1000.0,
        }
    )
    return sha256(write_plain(frame, path)).hexdigest()


def cached_mock(recipe: MockRecipe, name: str, cache_dir: Path) -> tuple[Path, str]:
    """The mock's file in the cache and its SHA-256; made if it is absent or not what was written."""
    text = f"{_RECIPE_VERSION} {recipe.model_dump_json()}"
    path = cache_dir / "catalogues" / f"{name}-{sha256(text.encode()).hexdigest()[:16]}.parquet"
    note = path.with_suffix(".sha256")
    if path.is_file() and note.is_file() and note.read_text(encoding="ascii", errors="replace") == (found := checksum(path)):
        return path, found
    made = make_mock(recipe, path)
    write_bytes(made.encode("ascii"), note)
    return path, made


def correlation(recipe: MockRecipe, theta_deg: FloatArray) -> FloatArray:
    """w(theta) of the recipe, for angles in degrees."""
    theta = np.maximum(theta_deg, recipe.correlation_core_deg)
    return recipe.correlation_amplitude * theta**recipe.correlation_slope * np.exp(-theta / recipe.correlation_cutoff_deg)


def _gaussian_field(recipe: MockRecipe, rng: np.random.Generator) -> FloatArray:
    """(12 nside^2,) Gaussian field, nested order; as healpy.synfast draws it, but from our own generator."""
    import healpy  # noqa: PLC0415 - 0.5 s that the command line's help need not pay

    nside = 2**recipe.healpix_order
    l_max = 3 * nside - 1
    power = _power(recipe, l_max)
    degree, order = healpy.Alm.getlm(l_max)
    real, imaginary = rng.standard_normal((2, len(degree)))
    scale = np.sqrt(power[degree] / 2.0)
    alm = np.where(order == 0, np.sqrt(2.0) * real, real + 1j * imaginary) * scale
    return healpy.reorder(healpy.alm2map(alm, nside, lmax=l_max), r2n=True)


def _power(recipe: MockRecipe, l_max: int) -> FloatArray:
    """(l_max + 1,) C_l = 2 pi integral ln(1 + w) P_l(cos theta) d cos theta, in ln theta where w lives; 0 at l = 0.

    Negative values, noise of the transform, are cut.
    """
    theta_deg = np.concatenate([np.linspace(0, 0.05, 51)[1:], np.geomspace(0.05, 180.0, 12_000)[1:]])
    theta = np.radians(theta_deg)
    weight = np.gradient(theta) * np.sin(theta) * 2.0 * np.pi * np.log1p(correlation(recipe, theta_deg))
    cosine = np.cos(theta)
    power = np.empty(l_max + 1)
    before, now = np.ones_like(cosine), cosine
    power[0], power[1] = 0.0, np.sum(weight * now)
    for degree in range(2, l_max + 1):
        before, now = now, ((2 * degree - 1) * cosine * now - (degree - 1) * before) / degree
        power[degree] = np.sum(weight * now)  # not a BLAS product, whose last digits depend on the number of threads
    return power.clip(min=0.0)


def _draw_cells(recipe: MockRecipe, density: FloatArray, rng: np.random.Generator) -> IntArray:
    """(n_galaxy,) cells of order 29 drawn from the density, uniform inside each cell of the field, inside the footprint."""
    cumulative = np.cumsum(np.where(_may_overlap(recipe, len(density)), density, 0.0))
    shift = 2 * (HEALPIX_ORDER - recipe.healpix_order)
    drawn = np.empty(0, dtype=np.int64)
    while len(drawn) < recipe.n_galaxy:
        n_more = int((recipe.n_galaxy - len(drawn)) * _BATCH_FRAC) + 100
        coarse = np.searchsorted(cumulative, rng.random(n_more) * cumulative[-1], side="right")
        fine = (coarse.astype(np.int64) << shift) + rng.integers(0, 1 << shift, n_more)
        drawn = np.concatenate([drawn, fine[_in_footprint(recipe, *healpix_positions(fine, HEALPIX_ORDER))]])
    return drawn[: recipe.n_galaxy]


def _may_overlap(recipe: MockRecipe, n_cell: int) -> npt.NDArray[np.bool_]:
    """(n_cell,) whether a cell of the field may hold a part of the footprint: its centre is in, or within a cell of it."""
    ra_deg, dec_deg = healpix_positions(np.arange(n_cell), recipe.healpix_order)
    width_deg = np.degrees(np.sqrt(4.0 * np.pi / n_cell))
    return _in_footprint(recipe, ra_deg, dec_deg, margin_deg=width_deg)


def _in_footprint(
    recipe: MockRecipe, ra_deg: FloatArray, dec_deg: FloatArray, margin_deg: float = 0.0
) -> npt.NDArray[np.bool_]:
    latitude = abs_galactic_latitude_deg(ra_deg, dec_deg)
    return (dec_deg < recipe.dec_max_deg + margin_deg) & (latitude > recipe.abs_b_min_deg - margin_deg)


def _magnitudes(recipe: MockRecipe, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) magnitudes whose cumulative counts rise as 10^(slope m), from bright to faint."""
    lowest = 10.0 ** (recipe.count_slope_per_mag * (recipe.mag_bright - recipe.mag_faint))
    return recipe.mag_faint + np.log10(lowest + (1.0 - lowest) * rng.random(n)) / recipe.count_slope_per_mag
