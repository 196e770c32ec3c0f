"""What a scientist may change about the schedule.

Sources: T = the TAIPAN survey's own public tiling code (2017-2020); P = Goodwin et al. 2014, SPIE 9152; assumed = no
source gives it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from survey_sim.settings import Settings

# States of the sky, in the order of the kernels' codes.
SkyState = Literal["dark", "grey", "bright", "twilight"]
SKY_STATES: tuple[SkyState, ...] = ("dark", "grey", "bright", "twilight")
# Sun's altitude at which the night is dark (the end of astronomical twilight, by definition), deg.
ASTRONOMICAL_TWILIGHT_DEG = -18.0

Frac = Annotated[float, Field(ge=0, le=1)]


@dataclass(frozen=True)
class Programme:
    """What the schedule needs to know of a science case.

    Attributes
    ----------
    name, survey
        As in the tables.
    exposure_s
        Shutter time of one visit, s; a visit is exposed for the longest of the programmes it holds.
    completeness_wanted_frac
        Share of the programme's targets that is wanted with all their visits; once it is reached, the rest counts for
        little (`ScheduleSettings.beyond_wanted_weight`).
    """

    name: str
    survey: str
    exposure_s: float
    completeness_wanted_frac: float = 1.0


class Site(Settings):
    """Where the telescope stands (WGS84). Default: the UK Schmidt at Siding Spring (T)."""

    longitude_deg: float = Field(default=149.0712, ge=-180, le=360)  # east
    latitude_deg: float = Field(default=-31.2722, ge=-90, le=90)
    height_m: float = Field(default=1165.0, ge=-500, le=9000)


class Telescope(Settings):
    """An equatorial mount and its CCD: times spent between two exposures."""

    slew_rate_deg_s: float = Field(default=1.0, gt=0)  # each axis, both move together (assumed)
    settle_s: float = Field(default=10.0, ge=0)  # after every slew to another field (assumed)
    readout_s: float = Field(default=60.0, ge=0)  # T: 1 min


class Weather(Settings):
    """Cloud as a seeded random process with two memories: of nights and of hours."""

    mean_loss_frac: Frac = 0.40  # T: default of TAIPAN's simulator; share of the time that is cloudy
    night_memory_days: float = Field(default=2.0, ge=0)  # e-folding time of the slow part (assumed: passing fronts)
    hour_memory_h: float = Field(default=3.0, ge=0)  # e-folding time of the fast part (assumed)
    # Share of the variance that is the night's, the rest being the hour's (assumed).
    night_share_frac: Frac = 0.75


class Moonlight(Settings):
    """What makes a sky dark, grey or bright. The Moon down is dark, whatever its phase."""

    up_alt_deg: float = Field(default=0.0, ge=-90, le=90)  # the Moon counts as up above this true altitude (by definition)
    grey_max_frac: Frac = 0.5  # Moon up and at most so much of its disc lit: grey; more: bright (assumed: half Moon)


class SurveyRule(Settings):
    """When a survey may observe, and within which limits."""

    # States of the sky that the survey takes first, and those it takes when no survey that takes them has anything to do.
    takes: tuple[SkyState, ...] = ("dark", "grey", "bright")
    fills: tuple[SkyState, ...] = ()
    # Sun's altitude above which it does not observe, deg: -18 astronomical, -12 nautical twilight (by definition).
    twilight_deg: float = Field(default=ASTRONOMICAL_TWILIGHT_DEG, ge=-30, le=0)
    airmass_max: float = Field(default=2.0, ge=1, le=10)  # sec z at start and end of an exposure (assumed)
    hour_angle_max_deg: float = Field(default=75.0, gt=0, le=180)  # either side of the meridian: 5 h (assumed)
    moon_separation_min_deg: float = Field(default=30.0, ge=0, le=180)  # while the Moon is up (assumed)
    # Lamps before each exposure: T: 0.8 min a pointing.
    calibration_s: float = Field(default=48.0, ge=0)
    weight: float = Field(default=1.0, ge=0)  # worth of one target-visit of this survey, relative to the others (assumed)


# The two surveys of P on one telescope: TAIPAN takes dark and grey time, FunnelWeb bright time and twilight (rule assumed).
SURVEY_RULES: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "taipan": {"takes": ("dark", "grey")},
        "funnelweb": {
            "takes": ("bright", "twilight"),
            "fills": ("grey", "dark"),
            "twilight_deg": -12.0,
            "moon_separation_min_deg": 20.0,
        },
    }
)


class ScheduleSettings(Settings):
    """Dates, site, limits, weather and overheads of the nights."""

    # Evenings of the first and the last night: the paper's five years.
    start_date: date = date(2016, 1, 1)
    end_date: date = date(2020, 12, 31)
    site: Site = Site()
    telescope: Telescope = Telescope()
    weather: Weather = Weather()
    moonlight: Moonlight = Moonlight()
    # Rules by survey; a key left out is that of `SURVEY_RULES` for the surveys named there, else that of `SurveyRule`.
    surveys: dict[str, SurveyRule] = Field(default_factory=dict)
    # One night in so many is engineering: nothing is observed (assumed: once a month); 0: none.
    engineering_every_nights: int = Field(default=30, ge=0)
    # "routed": the times of the table of paths; a number: so many seconds for every pointing (T: 300).
    configuration_s: Literal["routed"] | Annotated[float, Field(ge=0)] = "routed"
    # Probability that a target observed under a clear sky succeeds, by programme; 1 for those not named (assumed).
    success_frac: dict[str, Frac] = Field(default_factory=dict)
    # A visit all done is taken again if at least so much of its science still lacks a success (assumed).
    repeat_min_frac: Frac = 0.2
    # Worth of a target-visit once its programme has the completeness wanted (assumed); 0: the programme stops there.
    beyond_wanted_weight: Frac = 0.1
    # Worth falls as (least airmass of the field / airmass)^airmass_power (measured: docs/schedule.md).
    airmass_power: float = Field(default=1.0, ge=0)
    # Look ahead at each field's time left and its competition; without, the richest visit goes first.
    is_looking_ahead: bool = True
    # With no field to observe, look again after so long, s (assumed).
    idle_step_s: float = Field(default=120.0, gt=0)

    @model_validator(mode="before")
    @classmethod
    def _known_surveys(cls, values: Any) -> Any:
        """Start the rules of known surveys from their own defaults."""
        if not isinstance(values, Mapping) or not isinstance(values.get("surveys", {}), Mapping):
            return values
        given = dict(values.get("surveys", {}))
        rules = {
            name: {**SURVEY_RULES.get(name, {}), **rule} if isinstance(rule, Mapping) else rule
            for name, rule in given.items()
        }
        return {**values, "surveys": {**SURVEY_RULES, **rules}}

    @model_validator(mode="after")
    def _states_named_once(self) -> Self:
        for name, rule in self.surveys.items():
            states = rule.takes + rule.fills
            if len(set(states)) < len(states):
                raise ValueError(f"surveys.{name}: a state of the sky stands twice in takes and fills")
        return self

    def rule(self, survey: str) -> SurveyRule:
        """The rule of a survey; the default one if none is given."""
        return self.surveys.get(survey) or SurveyRule.load({})

    @property
    def n_night(self) -> int:
        """Nights from the first evening to the last; 0 if they are the wrong way round."""
        return max(0, (self.end_date - self.start_date).days + 1)
