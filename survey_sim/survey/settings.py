"""Settings of a pipeline: the sections of its TOML file, checked together."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self
from zlib import crc32

import numpy as np
from pydantic import Field, field_validator, model_validator

from survey_sim.allocation import ALGORITHMS, AllocationSettings
from survey_sim.catalogue import KEYS_OF_SCIENCE, ProgrammeSettings
from survey_sim.errors import InputError, did_you_mean
from survey_sim.extensions import origin
from survey_sim.instrument import Instrument, Plate, load_instrument, make_plate
from survey_sim.routing import ROUTER_NAMES, RoutingSettings
from survey_sim.schedule import ScheduleSettings
from survey_sim.settings import Settings, read_toml
from survey_sim.simulation import SimulationSettings
from survey_sim.tiling import TilingSettings


class RunSettings(Settings):
    """`[run]`: what the run is called, and the seeds of all its random streams."""

    # Also the name of its folder under runs/; the TOML file's own name by default.
    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")
    seed: int = Field(1, ge=0)
    # Of mock catalogues; absent: the seed in a mock's card.
    mock_seed: int | None = Field(None, ge=0, lt=2**63)


class InstrumentChoice(Settings):
    """`[instrument]`: a preset (or TOML file), the constants that differ from it, and the dead robots."""

    preset: str = "taipan-150"
    overrides: dict[str, Any] = Field(default_factory=dict)
    # Ids of robots that never move; they stand at their park positions.
    dead_robots: tuple[int, ...] = ()
    # Share of the science robots that are dead besides, drawn by the seed: those of a smaller share are of a larger too.
    dead_frac: float = Field(0.0, ge=0, le=1)

    @model_validator(mode="before")
    @classmethod
    def _gather_overrides(cls, values: Any) -> Any:
        """Any other key of the section is a constant of the instrument."""
        if not isinstance(values, dict) or "overrides" in values:
            return values
        own = {key: value for key, value in values.items() if key in cls.model_fields}
        return {**own, "overrides": {key: value for key, value in values.items() if key not in own}}

    def load(self, folder: Path) -> Instrument:  # type: ignore[override]
        """The instrument; a TOML file is looked for from `folder`."""
        name = str(folder / self.preset) if self.preset.endswith(".toml") else self.preset
        return load_instrument(name, self.overrides)


class AllocationChoice(Settings):
    """`[allocation]`: settings of every survey, and under `surveys` what differs for one of them."""

    every: AllocationSettings = AllocationSettings()
    surveys: dict[str, AllocationSettings] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _spread_common(cls, values: Any) -> Any:
        if not isinstance(values, dict) or "every" in values:
            return values
        common = {key: value for key, value in values.items() if key != "surveys"}
        own = values.get("surveys", {})
        if not isinstance(own, dict) or not all(isinstance(value, dict) for value in own.values()):
            raise ValueError("surveys holds one section a survey: [allocation.surveys.NAME]")
        return {"every": common, "surveys": {name: {**common, **value} for name, value in own.items()}}

    def of(self, survey: str) -> AllocationSettings:
        """The settings of one survey."""
        return self.surveys.get(survey, self.every)


class ReportSettings(Settings):
    """`[report]`: what the page shows."""

    title: str = ""
    # Survey, tile and visit of the plate that is drawn; the busiest visit by default.
    plate: tuple[str, int, int] | None = None
    dpi: int = Field(150, ge=50, le=600)


class OutputSettings(Settings):
    """`[output]`: how tables are cut into parts."""

    # Tiles of one part, which is also what a worker is given at a time; results do not depend on it.
    tiles_per_part: int = Field(8, ge=1)
    # Nights of one part of what the plate did.
    nights_per_part: int = Field(64, ge=1)


class PipelineSettings(Settings):
    """Everything that a run depends on, besides its catalogues."""

    unspoken_keys = frozenset({"every"})

    run: RunSettings
    instrument: InstrumentChoice = InstrumentChoice()
    programme: tuple[ProgrammeSettings, ...] = Field(min_length=1)
    tiling: TilingSettings = TilingSettings()
    allocation: AllocationChoice = AllocationChoice()
    routing: RoutingSettings = RoutingSettings()
    simulation: SimulationSettings = SimulationSettings()
    schedule: ScheduleSettings = ScheduleSettings()
    report: ReportSettings = ReportSettings()
    output: OutputSettings = OutputSettings()

    @field_validator("programme")
    @classmethod
    def _names_are_unique(cls, programmes: tuple[ProgrammeSettings, ...]) -> tuple[ProgrammeSettings, ...]:
        names = [programme.name for programme in programmes]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"programme names used twice: {', '.join(twice)}")
        return programmes

    @model_validator(mode="after")
    def _sections_name_surveys(self) -> Self:
        for survey in self.allocation.surveys:
            if survey not in self.surveys:
                hint = did_you_mean(survey, self.surveys)
                raise ValueError(f"[allocation.surveys.{survey}] names no survey of a programme; {hint}")
        if any(self._algorithm(survey) == "ideal" for survey in self.surveys):
            raise ValueError("allocation.algorithm 'ideal' keeps no separation, so its visits cannot be routed")
        return self

    @property
    def surveys(self) -> tuple[str, ...]:
        """Names of the surveys with a science programme, in alphabetical order."""
        return tuple(sorted({programme.survey for programme in self.programme if programme.kind == "science"}))

    @property
    def science(self) -> tuple[ProgrammeSettings, ...]:
        """The science programmes."""
        return tuple(programme for programme in self.programme if programme.kind == "science")

    @property
    def extensions(self) -> dict[str, dict[str, str]]:
        """Package and code of each allocator and router that is not ours, by its name."""
        named = {name: origin("allocator", name, ALGORITHMS) for name in map(self._algorithm, self.surveys)}
        named[self.routing.router] = origin("router", self.routing.router, ROUTER_NAMES)
        return {name: found for name, found in named.items() if found is not None}

    def _algorithm(self, survey: str) -> str:
        return self.allocation.of(survey).algorithm

    def plate(self, folder: Path) -> Plate:
        """The robots of the run."""
        instrument = self.instrument.load(folder)
        plate = make_plate(instrument, self.instrument.dead_robots)
        if not self.instrument.dead_frac:
            return plate
        science = np.random.default_rng([self.run.seed, crc32(b"dead")]).permutation(plate.robot_id[~plate.is_guide])
        drawn = science[: round(self.instrument.dead_frac * len(science))]
        return make_plate(instrument, {*self.instrument.dead_robots, *drawn.tolist()})


def load_pipeline(path: Path, changes: Sequence[str] = (), values_set: Mapping[str, Any] | None = None) -> PipelineSettings:
    """Settings of a pipeline's TOML file, with changes `section.key=value` (values as TOML writes them).

    Parameters
    ----------
    values_set
        Values by `section.key`, set before the changes.

    Raises
    ------
    InputError
        Missing or malformed file, unknown section or key, wrong type, unit or range.
    """
    values = read_toml(path)
    if isinstance(run := values.setdefault("run", {}), dict):
        run.setdefault("name", path.stem)
    for key, value in (values_set or {}).items():
        _set(values, key, value, place="set")
    for change in changes:
        _apply(values, change)
    _place_catalogues(values, path.parent)
    settings = PipelineSettings.load(values, file=path)
    try:
        settings.plate(path.parent)
    except InputError as fault:
        raise fault.of_file(path) from None
    return settings


def changed_section(section: str, values: Mapping[str, Any], changes: Sequence[str]) -> dict[str, Any]:
    """A section's values after changes `section.key=value`; for commands that have this section alone.

    Raises
    ------
    InputError
        A change cannot be read, or is of another section.
    """
    whole: dict[str, Any] = {section: dict(values)}
    for change in changes:
        _apply(whole, change)
    others = [name for name in whole if name != section]
    if others:
        raise InputError(f"{others[0]!r} is no section here", place="--set", remedy=f"write --set {section}.key=value")
    return whole[section]


def recorded_pipeline(record: Mapping[str, Any], file: Path) -> PipelineSettings:
    """Settings of a run from its run.json, which holds all constants of its instrument.

    Raises
    ------
    InputError
        The record has no settings, or was written by another version.
    """
    if not {"settings", "instrument"} <= set(record):
        raise InputError("is not the record of a run", file=file, remedy="name the folder of a finished run")
    values = dict(record["settings"])
    values["instrument"] = {**values["instrument"], "preset": "taipan-150", "overrides": record["instrument"]}
    values["programme"] = [
        {key: value for key, value in programme.items() if programme["kind"] == "science" or key not in KEYS_OF_SCIENCE}
        for programme in values["programme"]
    ]
    return PipelineSettings.load(values, file=file)


def _place_catalogues(values: dict[str, Any], folder: Path) -> None:
    """Catalogues given as paths are looked for beside the pipeline file, wherever the command is typed."""
    programmes = values.get("programme")
    for programme in programmes if isinstance(programmes, list) else []:
        catalogue = programme.get("catalogue") if isinstance(programme, dict) else None
        if isinstance(catalogue, str) and Path(catalogue).suffix:
            programme["catalogue"] = str(folder / catalogue)


def _apply(values: dict[str, Any], change: str) -> None:
    key, equals, text = change.partition("=")
    if not equals or "." not in key:
        raise InputError(f"cannot read {change!r}", place="--set", remedy="write --set section.key=value")
    _set(values, key.strip(), _value(text.strip()), place="--set")


def _set(values: dict[str, Any], key: str, value: Any, place: str) -> None:
    """Set the value that stands at `section.key`; `place` is where the user wrote it."""
    *sections, name = key.split(".")
    found: Any = values
    for section in sections:
        if isinstance(found, list):
            found = _named(found, section, key, place)
        elif isinstance(found, dict):
            found = found.setdefault(section, {})
    if not isinstance(found, dict) or not sections:
        raise InputError(f"{key!r} does not name a key of a section", place=place, remedy="write section.key=value")
    found[name] = value


def _named(entries: list[Mapping[str, Any]], name: str, key: str, place: str) -> Mapping[str, Any]:
    """The entry of `[[programme]]` with this name."""
    named = {str(entry.get("name")): entry for entry in entries if isinstance(entry, dict)}
    if name in named:
        return named[name]
    known = list(named)
    raise InputError(f"{key!r}: no entry is named {name!r}", place=place, remedy=did_you_mean(name, known))


def _value(text: str) -> Any:
    """A TOML value; a bare word is text."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (tomllib.TOMLDecodeError, KeyError):
        return text
    except (RecursionError, ValueError) as failure:
        raise InputError(f"cannot read {text!r}: {failure}", place="--set", remedy="write a TOML value") from None
