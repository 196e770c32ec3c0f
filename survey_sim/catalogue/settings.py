"""What a programme takes from a catalogue: one `[[programme]]` of the pipeline file.

Sources: P = Goodwin et al. 2014 (Table 2); T = the TAIPAN survey's public tiling code; assumed = no source gives it.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from survey_sim.region import Declination
from survey_sim.settings import Settings

# A word that is safe as a file name, a column name, and in a page.
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", max_length=64)]
Priority = Annotated[int, Field(ge=1, le=9)]

# What the supplies of calibration fibres take where the file says nothing. Magnitudes are assumed; 40 guides per sq deg are
# about four in reach of every guide robot, 12 standards and sky positions are 350 on a plate that needs 10 and 20 (T).
_DEFAULTS_OF_KIND: Mapping[str, Mapping[str, Any]] = {
    "science": {},
    "guide": {"mag_bright": 8.0, "mag_faint": 11.0, "density_per_sq_deg": 40.0},
    "standard": {"mag_bright": 9.0, "mag_faint": 12.0, "density_per_sq_deg": 12.0},
    "sky": {"density_per_sq_deg": 12.0},
}
# Keys that mean nothing to the other kinds.
KEYS_OF_SCIENCE = ("exposure_s", "visits", "completeness_frac")


class PriorityBin(Settings):
    """A range of magnitudes, bright end included and faint end not, and the priority of the targets in it."""

    mag_bright: float = Field(-30.0, ge=-30, le=40)
    mag_faint: float = Field(40.0, ge=-30, le=40)
    priority: Priority


PriorityRule = Priority | tuple[PriorityBin, ...]


class ProgrammeSettings(Settings):
    """A science case, or a supply of calibration fibres: what it takes from which catalogue, and what it wants."""

    name: Name
    survey: Name
    # science: wanted in its own right. standard, guide, sky: a supply that any visit of the survey may draw on.
    kind: Literal["science", "standard", "guide", "sky"] = "science"
    # Name of a card in catalogues/, or path of a card or of a table; none for sky.
    catalogue: str | None = None
    # Bright end included, faint end not, mag in the catalogue's band. Absent: no limit; guides 8 to 11, standards 9 to 12.
    mag_bright: float | None = Field(None, ge=-30, le=40)
    mag_faint: float | None = Field(None, ge=-30, le=40)
    # Footprint: declinations, and least distance from the Galactic equator, deg.
    dec_min_deg: Declination = -90.0
    dec_max_deg: Declination = 90.0
    abs_b_min_deg: float = Field(0.0, ge=0, lt=90)
    # P Table 2: about 30 min (TAIPAN), less than 3 min (FunnelWeb).
    exposure_s: float = Field(1800.0, gt=0)
    # Times that each target is wanted; P Table 2: 5 for the galaxy programme.
    visits: int = Field(1, ge=1, le=1000)
    # P Table 2: 0.7 (TAIPAN), 1 (FunnelWeb).
    completeness_frac: float = Field(1.0, gt=0, le=1)
    # 1 (low) to 9 (high): one number, or one a magnitude bin (1 outside all bins). Absent: the card's rule, or 5.
    priority: PriorityRule | None = None
    # Supplies only: at most so many positions per square degree, the brightest of each HEALPix cell; absent: all.
    density_per_sq_deg: float | None = Field(None, gt=0, le=10_000)
    # Sky only: least distance from every object of every catalogue of the run; assumed.
    clearance_arcsec: float = Field(30.0, ge=0, le=3600)
    # Two objects of a survey nearer than this are one target: 3.3 arcsec is a fibre at 67.2 arcsec/mm; assumed.
    fibre_arcsec: float = Field(3.3, ge=0, le=600)

    @model_validator(mode="before")
    @classmethod
    def _take_defaults_of_kind(cls, values: Any) -> Any:
        if not isinstance(values, Mapping):
            return values
        defaults = _DEFAULTS_OF_KIND.get(str(values.get("kind", "science")), {})
        return {**defaults, **values}

    @field_validator("priority", mode="before")
    @classmethod
    def _bins_are_a_tuple(cls, value: Any) -> Any:
        return tuple(value) if isinstance(value, list) else value

    @model_validator(mode="after")
    def _is_consistent(self) -> "ProgrammeSettings":
        if (self.kind == "sky") != (self.catalogue is None):
            raise ValueError("kind 'sky' takes no catalogue, every other kind needs one")
        if self.kind != "science" and (stray := self.model_fields_set.intersection(KEYS_OF_SCIENCE)):
            raise ValueError(f"{', '.join(sorted(stray))}: only for kind 'science'")
        if self.kind == "science" and self.density_per_sq_deg is not None:
            raise ValueError("density_per_sq_deg: not for kind 'science'")
        if self.kind == "sky" and self.density_per_sq_deg is None:
            raise ValueError("kind 'sky' needs density_per_sq_deg")
        if self.mag_bright is not None and self.mag_faint is not None and self.mag_bright >= self.mag_faint:
            raise ValueError("mag_bright must be less than mag_faint")
        if self.dec_min_deg >= self.dec_max_deg:
            raise ValueError("dec_min_deg must be less than dec_max_deg")
        return self
