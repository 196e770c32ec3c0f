"""Parts of the sky: the region a run is limited to, Galactic latitude, and HEALPix cells.

All positions are ICRS, epoch as the catalogue gives them (J2000 for Tycho-2): proper motions over the survey are far smaller
than a fibre for all but a handful of stars, and are not applied.
"""

from typing import Annotated

import numpy as np
import numpy.typing as npt
from pydantic import Field, field_validator

from survey_sim.geometry import unit_vectors
from survey_sim.settings import Settings

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# ESA 1997, The Hipparcos and Tycho Catalogues, vol. 1, section 1.5.3: north Galactic pole, ICRS, deg.
GALACTIC_POLE_DEG = (192.85948, 27.12825)
# The whole sphere, 129600 / pi.
SPHERE_SQ_DEG = 41_252.961
# Order of the HATS column: a cell is 0.4 milli-arcsec wide.
HEALPIX_ORDER = 29

RightAscension = Annotated[float, Field(ge=0, le=360)]
Declination = Annotated[float, Field(ge=-90, le=90)]


class Region(Settings):
    """A contiguous part of the sky: a range of right ascension (may wrap through 0) and one of declination, ICRS."""

    # [from, to) eastwards, deg: [350, 10] is the 20 degrees around 0. Absent: all.
    ra_deg: tuple[RightAscension, RightAscension] | None = None
    # [from, to], deg.
    dec_deg: tuple[Declination, Declination] = (-90.0, 90.0)

    @field_validator("ra_deg")
    @classmethod
    def _ra_is_a_range(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value is not None and value[0] == value[1]:
            raise ValueError("the two right ascensions must differ; leave ra_deg out for the whole circle")
        return value

    @field_validator("dec_deg")
    @classmethod
    def _dec_is_a_range(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] >= value[1]:
            raise ValueError("the first declination must be the southern one")
        return value

    def contains(self, ra_deg: FloatArray, dec_deg: FloatArray) -> BoolArray:
        """(n,) whether each position is in the region."""
        inside = (dec_deg >= self.dec_deg[0]) & (dec_deg <= self.dec_deg[1])
        if self.ra_deg is None:
            return inside
        west, east = self.ra_deg
        if west < east:
            return inside & (ra_deg >= west) & (ra_deg < east)
        return inside & ((ra_deg >= west) | (ra_deg < east))


def abs_galactic_latitude_deg(ra_deg: FloatArray, dec_deg: FloatArray) -> FloatArray:
    """(n,) distance from the Galactic equator, deg."""
    pole = unit_vectors(np.array([GALACTIC_POLE_DEG[0]]), np.array([GALACTIC_POLE_DEG[1]]))[0]
    vectors = unit_vectors(ra_deg, dec_deg)
    # Term by term: the last digit of a matrix product depends on a row's place in the matrix.
    sine = vectors[:, 0] * pole[0] + vectors[:, 1] * pole[1] + vectors[:, 2] * pole[2]
    return np.degrees(np.arcsin(np.abs(sine).clip(max=1.0)))


def healpix_29(ra_deg: FloatArray, dec_deg: FloatArray) -> IntArray:
    """(n,) HEALPix cells, nested, order 29."""
    import healpy  # noqa: PLC0415 - 0.5 s that the command line's help need not pay

    if not len(ra_deg):
        return np.empty(0, dtype=np.int64)
    return healpy.ang2pix(2**HEALPIX_ORDER, ra_deg, dec_deg, nest=True, lonlat=True).astype(np.int64)


def healpix_positions(cell: IntArray, order: int) -> tuple[FloatArray, FloatArray]:
    """Right ascension in [0, 360) and declination of the centres of nested cells, deg."""
    import healpy  # noqa: PLC0415 - as above

    ra_deg, dec_deg = healpy.pix2ang(2**order, cell, nest=True, lonlat=True)
    return ra_deg % 360.0, dec_deg
