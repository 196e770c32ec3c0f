"""The least acceptable fibres of a visit, by kind, and by how much a visit falls short of them."""

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from survey_sim.allocation.settings import AllocationSettings
from survey_sim.allocation.targets import GUIDE, SKY, STANDARD, FloatArray, IntArray
from survey_sim.instrument import Plate


@dataclass(frozen=True)
class Minima:
    """Least acceptable numbers of one visit; never more than are wanted, nor guides than the plate has guide robots.

    Attributes
    ----------
    min_standard, min_sky, min_guide
        Fibres of each kind.
    min_sky_region, sky_regions
        Sky fibres in each of so many equal sectors of the plate.
    """

    min_standard: int
    min_sky: int
    min_guide: int
    min_sky_region: int
    sky_regions: int

    @classmethod
    def of(cls, settings: AllocationSettings, plate: Plate) -> Self:
        """What these settings ask of a visit of this plate."""
        return cls(
            min_standard=min(settings.min_standard, settings.wanted_standard),
            min_sky=min(settings.min_sky, settings.wanted_sky),
            min_guide=min(settings.min_guide, settings.wanted_guide, int(plate.is_guide.sum())),
            min_sky_region=min(settings.min_sky_region, settings.wanted_sky // settings.sky_regions),
            sky_regions=settings.sky_regions,
        )

    def shortfall(self, kind: npt.NDArray[np.int8], x_mm: FloatArray, y_mm: FloatArray) -> dict[str, int]:
        """How many fibres a visit lacks: by kind, and `sky_region`, summed over the sectors.

        Parameters
        ----------
        kind, x_mm, y_mm
            (n_held,) codes and plate positions of the targets that its robots hold.
        """
        in_region = np.bincount(sectors(x_mm, y_mm, self.sky_regions)[kind == SKY], minlength=self.sky_regions)
        return {
            "standard": max(0, self.min_standard - int((kind == STANDARD).sum())),
            "sky": max(0, self.min_sky - int((kind == SKY).sum())),
            "guide": max(0, self.min_guide - int((kind == GUIDE).sum())),
            "sky_region": int((self.min_sky_region - in_region).clip(0).sum()),
        }


def sectors(x_mm: FloatArray, y_mm: FloatArray, n_sector: int) -> IntArray:
    """(n,) which of so many equal sectors of the plate each place lies in, counted from +x towards +y."""
    turn = (np.arctan2(y_mm, x_mm) / (2.0 * np.pi)) % 1.0
    return np.minimum((turn * n_sector).astype(np.int64), n_sector - 1)
