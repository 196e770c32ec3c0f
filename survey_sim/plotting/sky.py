"""Sky maps: a region in the zenithal equal-area projection, the whole sky in Mollweide's; tiles painted as cells.

Tiles overlap, so each place on the sky takes the colour of the tile whose centre is nearest, out to the field's radius.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import polars as pl
from astropy import units
from astropy.visualization.wcsaxes import WCSAxes
from astropy.visualization.wcsaxes.frame import EllipticalFrame
from astropy.wcs import WCS
from matplotlib import patheffects
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from survey_sim.geometry import chord, unit_vectors
from survey_sim.plotting.axes import as_percent
from survey_sim.plotting.run import RunTables
from survey_sim.plotting.style import COMPLETENESS_MAP, INK, MUTED
from survey_sim.region import GALACTIC_POLE_DEG

FloatArray = npt.NDArray[np.float64]

# A map that reaches further than this from its centre shows the whole sky, deg.
_REACH_MAX_DEG = 60.0
# Share of the targets that may lie in cells less complete than the colours go.
_BELOW_FRAC = 0.02
# Pixels across a map: of a region, of the whole sky.
_N_PIXEL = {"ZEA": 480, "MOL": 900}


@dataclass(frozen=True)
class SkyFrame:
    """Projection and size of a map.

    Attributes
    ----------
    wcs
        From pixels to ICRS, deg.
    shape
        Pixels, rows and columns.
    is_whole
        Whether it shows the whole sky.
    """

    wcs: WCS
    shape: tuple[int, int]
    is_whole: bool


def sky_frame(ra_deg: FloatArray, dec_deg: FloatArray, radius_deg: float) -> SkyFrame:
    """The frame that shows fields of a radius at these centres, right ascension to the left."""
    vectors = unit_vectors(ra_deg, dec_deg)
    middle = vectors.mean(axis=0)
    length = np.linalg.norm(middle)
    centre = middle / length if length > 1e-6 else vectors[0]
    reach = np.degrees(np.arccos((vectors @ centre).clip(-1.0, 1.0))).max() + radius_deg
    if reach > _REACH_MAX_DEG:
        return _frame("MOL", (180.0, 0.0), 2 * 81.03 * 2, 81.03 * 2)
    lon, lat = np.degrees(np.arctan2(centre[1], centre[0])) % 360.0, np.degrees(np.arcsin(centre[2].clip(-1, 1)))
    frame = _frame("ZEA", (float(lon), float(lat)), 2 * reach, 2 * reach)
    # Cut to what the fields cover.
    x, y = frame.wcs.wcs_world2pix(ra_deg, dec_deg, 0)
    pad = 1.12 * radius_deg / frame.wcs.wcs.cdelt[1]
    width, height = np.ptp(x) + 2 * pad, np.ptp(y) + 2 * pad
    frame.wcs.wcs.crpix = [frame.wcs.wcs.crpix[0] - (x.min() - pad), frame.wcs.wcs.crpix[1] - (y.min() - pad)]
    return SkyFrame(frame.wcs, (int(np.ceil(height)), int(np.ceil(width))), False)


def add_sky(figure: Figure, place: Any, frame: SkyFrame) -> WCSAxes:
    """A map's axes at a place of the figure (a subplot spec), with graticule and labels."""
    options = {"frame_class": EllipticalFrame} if frame.is_whole else {}
    axes = figure.add_subplot(place, projection=frame.wcs, **options)
    axes.set_xlim(-0.5, frame.shape[1] - 0.5)
    axes.set_ylim(-0.5, frame.shape[0] - 0.5)
    axes.set_aspect("equal")
    ra, dec = axes.coords
    for coordinate in (ra, dec):
        coordinate.set_major_formatter("d")
        coordinate.grid(color="#9A9A9A", alpha=0.35, linewidth=0.5)
        coordinate.set_ticklabel(size=8, exclude_overlapping=True)
    if frame.is_whole:
        _label_whole(axes, ra, dec)
    else:
        ra.set_axislabel("Right ascension (deg, ICRS)", minpad=0.6)
        dec.set_axislabel("Declination (deg, ICRS)", minpad=0.4)
    return axes


def _label_whole(axes: WCSAxes, ra: Any, dec: Any) -> None:
    """Labels of a map of the whole sky: right ascensions along the equator, declinations along the middle."""
    ra.set_ticks(spacing=60 * units.deg)
    dec.set_ticks(spacing=30 * units.deg)
    dec.set_ticks_position("v")
    dec.set_ticklabel_position("v")
    halo = [patheffects.withStroke(linewidth=2.0, foreground="white")]
    for coordinate in (ra, dec):
        coordinate.set_ticklabel(color=INK, path_effects=halo)
        coordinate.set_axislabel(" ")
    axes.text(
        0.5,
        -0.06,
        "Right ascension along the equator, declination along the middle (deg, ICRS)",
        transform=axes.transAxes,
        ha="center",
        va="top",
        fontsize=8.5,
    )


def paint_tiles(
    axes: WCSAxes, frame: SkyFrame, tiles: pl.DataFrame, values: FloatArray, radius_deg: float, **image: Any
) -> Any:
    """Colour the cells of tiles by a value each; gives the image, for its colour bar.

    Parameters
    ----------
    tiles
        Columns `ra_deg`, `dec_deg`.
    values
        (n_tile,); NaN: not coloured.
    """
    row, column = np.indices(frame.shape)
    ra, dec = frame.wcs.wcs_pix2world(column.ravel(), row.ravel(), 0)
    is_sky = np.isfinite(ra) & np.isfinite(dec)
    tree = cKDTree(unit_vectors(tiles["ra_deg"].to_numpy(), tiles["dec_deg"].to_numpy()))
    distance, nearest = tree.query(unit_vectors(ra[is_sky], dec[is_sky]), distance_upper_bound=chord(radius_deg))
    painted = np.full(row.size, np.nan)
    painted[is_sky] = np.where(np.isfinite(distance), np.append(values, np.nan)[nearest], np.nan)
    return axes.imshow(painted.reshape(frame.shape), origin="lower", **image)


def galactic_parallel(latitude_deg: float, n: int = 721) -> tuple[FloatArray, FloatArray]:
    """Right ascension and declination, deg, along a Galactic latitude."""
    pole = unit_vectors(np.array([GALACTIC_POLE_DEG[0]]), np.array([GALACTIC_POLE_DEG[1]]))[0]
    east = np.cross(pole, [0.0, 0.0, 1.0])
    east /= np.linalg.norm(east)
    north = np.cross(pole, east)
    turn, b = np.linspace(0.0, 2 * np.pi, n)[:, None], np.radians(latitude_deg)
    points = np.cos(b) * (np.cos(turn) * east + np.sin(turn) * north) + np.sin(b) * pole
    return np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360.0, np.degrees(np.arcsin(points[:, 2].clip(-1, 1)))


def draw_galactic(axes: WCSAxes, frame: SkyFrame) -> None:
    """Lines of Galactic latitude 0 (solid) and 10 deg either side (dashed), where the map shows them."""
    for latitude, linestyle in ((0.0, "-"), (-10.0, "--"), (10.0, "--")):
        ra, dec = galactic_parallel(latitude)
        x, y = frame.wcs.wcs_world2pix(ra, dec, 0)
        jump = np.hypot(np.diff(x, prepend=x[0]), np.diff(y, prepend=y[0])) > 0.2 * frame.shape[1]
        x = np.where(jump, np.nan, x)
        axes.plot(x, y, color=MUTED, linewidth=0.9, linestyle=linestyle, scalex=False, scaley=False)


def _frame(projection: str, centre_deg: tuple[float, float], width_deg: float, height_deg: float) -> SkyFrame:
    pixel_deg = max(width_deg, height_deg) / _N_PIXEL[projection]
    shape = int(np.ceil(height_deg / pixel_deg)), int(np.ceil(width_deg / pixel_deg))
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = [f"RA---{projection}", f"DEC--{projection}"]
    wcs.wcs.crval = centre_deg
    wcs.wcs.crpix = [(shape[1] + 1) / 2, (shape[0] + 1) / 2]
    wcs.wcs.cdelt = [-pixel_deg, pixel_deg]
    wcs.wcs.set()
    return SkyFrame(wcs, shape, projection == "MOL")


def draw_completeness(
    figure: Figure, place: Any, run: RunTables, survey: str, frame: SkyFrame | None = None
) -> tuple[WCSAxes, Any]:
    """Map of a survey's tiles by completeness: of what was observed, or of what was allocated if nothing was scheduled.

    Returns
    -------
        The map's axes, and the image for its colour bar.
    """
    tiles = run.tiles.filter(survey=survey)
    frame = frame or tile_frame(run)
    axes = add_sky(figure, place, frame)
    near = run.nearest_complete.filter(survey=survey)
    share, low = (near["n_done"] / near["n_target"]).to_numpy(), lowest_completeness(run)
    image = paint_tiles(axes, frame, tiles, share, run.field_radius_deg, cmap=COMPLETENESS_MAP, vmin=low, vmax=1.0)
    draw_galactic(axes, frame)
    return axes, image


def tile_frame(run: RunTables) -> SkyFrame:
    """The frame that shows the tiles of all surveys."""
    return sky_frame(run.tiles["ra_deg"].to_numpy(), run.tiles["dec_deg"].to_numpy(), run.field_radius_deg)


def lowest_completeness(run: RunTables) -> float:
    """Where the colours of a run's completeness maps start: a whole 10 %, at most 50 %; one target in 50 may lie below."""
    known = run.nearest_complete.filter(pl.col("n_target") > 0)
    cells = known.with_columns(share=pl.col("n_done") / pl.col("n_target")).sort("share")
    above = cells.filter(pl.col("n_target").cum_sum() > _BELOW_FRAC * pl.col("n_target").sum())
    least = 0.0 if above.is_empty() else float(above["share"][0])
    return float(np.floor(10 * min(least, 0.5) + 1e-9) / 10)


def completeness_bar(figure: Figure, run: RunTables, image: Any, axes: Sequence[WCSAxes], **options: Any) -> None:
    """The colour bar of completeness maps, pointed where cells may be less complete than its colours go."""
    label = "Targets complete (%)" if run.is_scheduled else "Targets allocated (%)"
    extend = "min" if lowest_completeness(run) > 0.0 else "neither"
    bar = figure.colorbar(image, ax=list(axes), label=label, extend=extend, **options)
    as_percent(bar.ax.xaxis if options.get("location") == "bottom" else bar.ax.yaxis)
