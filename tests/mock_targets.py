"""Targets of one field for tests and benchmarks: uniform, or clustered like galaxies."""

import numpy as np
import polars as pl

from survey_sim.allocation import FieldTargets

PLATE_RADIUS_MM = 163.5
SCALE_ARCSEC_MM = 67.2


def uniform_xy(n: int, seed: int, radius_mm: float = PLATE_RADIUS_MM) -> np.ndarray:
    """(n, 2) places spread evenly over the plate, mm."""
    rng = np.random.default_rng(seed)
    radius, angle = radius_mm * np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def clustered_xy(n: int, seed: int) -> np.ndarray:
    """(n, 2) places drawn from a lognormal field with w = 0.10 (theta / 1 deg)^-0.79 exp(-theta / 8 deg), mm."""
    rng = np.random.default_rng(seed)
    n_cell, box_deg = 512, 16.0
    cell = box_deg / n_cell
    k = np.fft.fftfreq(n_cell) * n_cell
    theta = np.maximum(cell * np.hypot(k[:, None], k[None]), 0.02)
    power = np.maximum(np.fft.fft2(np.log1p(0.10 * theta**-0.79 * np.exp(-theta / 8))).real, 0.0)
    field = np.fft.ifft2(np.fft.fft2(rng.standard_normal((n_cell, n_cell))) * np.sqrt(power)).real
    centre = (np.arange(n_cell) + 0.5) * cell - box_deg / 2
    x, y = (grid.ravel() for grid in np.meshgrid(centre, centre, indexing="ij"))
    density = np.where(np.hypot(x, y) < PLATE_RADIUS_MM * SCALE_ARCSEC_MM / 3600 + 2 * cell, np.exp(field).ravel(), 0.0)
    places = np.empty((0, 2))
    while len(places) < n:
        drawn = rng.choice(n_cell**2, size=n, p=density / density.sum())
        offset = cell * (rng.random((n, 2)) - 0.5)
        xy = (np.column_stack([x[drawn], y[drawn]]) + offset) * 3600 / SCALE_ARCSEC_MM
        places = np.vstack([places, xy[np.hypot(*xy.T) < PLATE_RADIUS_MM]])
    return places[:n]


def clumped_xy(n: int, seed: int, clumped_frac: float, n_clump: int, sigma_mm: float) -> np.ndarray:
    """(n, 2) places, so many of them in Gaussian clumps and the rest spread evenly, mm: denser than galaxies cluster."""
    rng = np.random.default_rng(seed)
    centre = uniform_xy(n_clump, seed + 1000)
    n_in = round(clumped_frac * n)
    places = np.empty((0, 2))
    while len(places) < n_in:
        drawn = centre[rng.integers(0, n_clump, n_in)] + rng.normal(0.0, sigma_mm, (n_in, 2))
        places = np.vstack([places, drawn[np.hypot(*drawn.T) < PLATE_RADIUS_MM]])
    return np.vstack([places[:n_in], uniform_xy(n - n_in, seed + 2000)])


def field_targets(xy_mm: np.ndarray, **columns: object) -> FieldTargets:
    """Targets at the places given, with ids by row and any further columns."""
    x, y = np.asarray(xy_mm, dtype=float).reshape(-1, 2).T
    return FieldTargets.from_table(pl.DataFrame({"target_id": np.arange(len(x)), "x_mm": x, "y_mm": y, **columns}))


def survey_targets(xy_mm: np.ndarray, seed: int) -> FieldTargets:
    """Science of all priorities at the places given, with 150 sky positions, 40 standards and 110 guide stars."""
    rng = np.random.default_rng(seed)
    n = len(xy_mm)
    kind = ["science"] * n + ["sky"] * 150 + ["standard"] * 40 + ["guide"] * 110
    priority = np.append(rng.integers(1, 10, n), np.full(300, 9))
    return field_targets(np.vstack([xy_mm, uniform_xy(300, seed + 1)]), kind=kind, priority=priority)
