"""Plate and sky: the projection of a field, and unit vectors for distances on the sphere.

The plate frame is mm, origin at the plate centre, x to the east, y to the north, as seen on the sky. The projection is the
zenithal equidistant one (ARC of Calabretta & Greisen 2002, A&A 395, 1077, section 5.1.3), by wcslib: radius on the plate =
scale x angle from the centre, as on a Schmidt.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from astropy.wcs import WCS

FloatArray = npt.NDArray[np.float64]


def sky_to_plate(
    ra_deg: FloatArray, dec_deg: FloatArray, centre_deg: tuple[float, float], scale_arcsec_mm: float
) -> FloatArray:
    """Plate positions of sky positions.

    Parameters
    ----------
    ra_deg, dec_deg
        (n,) ICRS, deg.
    centre_deg
        Right ascension and declination of the field centre, deg.
    scale_arcsec_mm
        Plate scale, arcsec/mm.

    Returns
    -------
        (n, 2) mm, plate frame. A point opposite the centre has no direction: it maps to the plate's far edge of the sky.
    """
    sky = np.column_stack([np.atleast_1d(ra_deg), np.atleast_1d(dec_deg)]).astype(np.float64)
    if not len(sky):
        return np.empty((0, 2))
    return np.ascontiguousarray(_projection(centre_deg, scale_arcsec_mm).wcs.s2p(sky, 0)["pixcrd"])


def plate_to_sky(position_mm: FloatArray, centre_deg: tuple[float, float], scale_arcsec_mm: float) -> FloatArray:
    """Sky positions of plate positions: the inverse of `sky_to_plate`, better than 1 um on the plate.

    Parameters
    ----------
    position_mm
        (n, 2) mm, plate frame.

    Returns
    -------
        (n, 2) right ascension in [0, 360) and declination, ICRS, deg.
    """
    plate = np.atleast_2d(np.asarray(position_mm, dtype=np.float64))
    if not plate.size:
        return np.empty((0, 2))
    sky = _projection(centre_deg, scale_arcsec_mm).wcs.p2s(plate, 0)["world"]
    return np.column_stack([sky[:, 0] % 360.0, sky[:, 1]])


def unit_vectors(ra_deg: FloatArray, dec_deg: FloatArray) -> FloatArray:
    """(n, 3) unit vectors of sky positions, ICRS."""
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    return np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])


def chord(angle_deg: float) -> float:
    """Straight distance between two unit vectors at an angle: turns a search on the sky into one in space."""
    return float(2.0 * np.sin(np.radians(angle_deg) / 2.0))


def _projection(centre_deg: tuple[float, float], scale_arcsec_mm: float) -> WCS:
    from astropy.wcs import WCS  # noqa: PLC0415 - 0.2 s that the command line's help need not pay

    projection = WCS(naxis=2)
    projection.wcs.ctype = ["RA---ARC", "DEC--ARC"]
    projection.wcs.crval = centre_deg
    projection.wcs.crpix = [1.0, 1.0]
    projection.wcs.cdelt = [scale_arcsec_mm / 3600.0] * 2
    projection.wcs.lonpole = 180.0  # else wcslib turns a field that is centred on the north pole by half a turn
    projection.wcs.set()
    return projection
