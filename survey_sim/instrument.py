"""Instruments: the robots' constants, where they park, and the presets of the papers.

Sources: P = Goodwin et al. 2014, SPIE 9152 (tables named below); T = the TAIPAN plate as built,
from the survey's public tiling code (2017-2020); D = derived here; assumed = no source gives it.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import polars as pl
from pydantic import Field, model_validator

from survey_sim.errors import InputError, did_you_mean
from survey_sim.settings import Settings, read_toml

FloatArray = npt.NDArray[np.float64]

# T: places of the nine guide bundles on the as-built plate, mm.
GUIDE_PLACES_MM = (
    (0.0, 0.0),
    (-63.3, 105.0),
    (-85.3, 22.9),
    (-107.3, -59.2),
    (26.4, 98.5),
    (-26.4, -98.5),
    (107.3, 59.2),
    (85.3, -22.9),
    (63.3, -105.0),
)


class Instrument(Settings):
    """A plate of Starbugs: every physical constant, and the rule that places the park positions."""

    name: str = "taipan-150"
    # D: radius of the 327 mm field (P Table 2).
    plate_radius_mm: float = Field(163.5, gt=0)
    # T: 67.2 arcsec/mm, an equidistant projection.
    plate_scale_arcsec_mm: float = Field(67.2, gt=0)
    # P Table 2: 50 to 75 mm (science), 10 mm (guides).
    patrol_radius_mm: float = Field(50.0, ge=0)
    guide_patrol_radius_mm: float = Field(10.0, ge=0)
    # P Table 2: exclusion radius 9 mm; T: later practice 11.65 mm.
    min_separation_mm: float = Field(9.0, gt=0)
    # P 1.3: approximately 8 mm.
    robot_diameter_mm: float = Field(8.0, gt=0)
    # P Table 1.
    coarse_speed_mm_s: float = Field(2.0, gt=0)
    coarse_step_mm: float = Field(0.020, gt=0)
    precise_speed_mm_s: float = Field(0.3, gt=0)
    precise_step_mm: float = Field(0.003, gt=0)
    rotation_speed_deg_s: float = Field(35.0, gt=0)
    rotation_step_deg: float = Field(1.0, gt=0)
    # Assumed: one coarse step, walked in precise steps, ends every path that moves.
    precise_approach_mm: float = Field(0.020, ge=0)
    # P 1.4 and Figure 8; D: a hexagonal lattice of this pitch has exactly 151 points inside the plate.
    lattice_pitch_mm: float = Field(24.1, gt=0)
    lattice_angle_deg: float = 0.0
    n_science: int = Field(150, ge=0)
    # How guides stand on the lattice: none; between its points, at the triangle centroids; or on its points.
    guides: Literal["none", "centroids", "lattice"] = "centroids"
    guide_places_mm: tuple[tuple[float, float], ...] = GUIDE_PLACES_MM
    # Explicit park positions replace the lattice: (x, y) of science robots, mm. Guides then stand at guide_places_mm.
    park_positions_mm: tuple[tuple[float, float], ...] | None = None

    @model_validator(mode="after")
    def _approach_is_precise(self) -> "Instrument":
        if self.precise_speed_mm_s > self.coarse_speed_mm_s:
            raise ValueError("precise_speed_mm_s must not exceed coarse_speed_mm_s")
        return self

    @property
    def field_radius_deg(self) -> float:
        """Radius of the plate on the sky, deg."""
        return self.plate_radius_mm * self.plate_scale_arcsec_mm / 3600.0


PRESETS: Mapping[str, Mapping[str, Any]] = {
    # P Figures 7 to 10: 151 science robots, no guides.
    "paper": {"n_science": 151, "guides": "none"},
    # The 150 of P Table 2: the paper's lattice without its centre, where a guide stands.
    "taipan-150": {},
    # T: the as-built plate, 300 science and 9 guides on one lattice turned by 15 deg.
    "taipan-300": {"n_science": 300, "guides": "lattice", "lattice_pitch_mm": 16.98, "lattice_angle_deg": 15.0},
    # P Table 2: about 600 science robots on a 1250 mm plate that sees 20 arcmin; D: pitch that fills it, and scale.
    "manifest": {
        "n_science": 600,
        "guides": "none",
        "plate_radius_mm": 625.0,
        "plate_scale_arcsec_mm": 0.96,
        "patrol_radius_mm": 100.0,
        "lattice_pitch_mm": 47.8,
    },
}


@dataclass(frozen=True)
class Plate:
    """The robots of one instrument as arrays; a robot's index is its place in them.

    Attributes
    ----------
    robot_id
        (n_robot,) int32, ascending from 1, science robots first.
    is_guide, is_live
        (n_robot,) bool.
    park_mm
        (n_robot, 2) park positions, mm, plate frame.
    patrol_radius_mm
        (n_robot,) reach from park, mm.
    """

    instrument: Instrument
    robot_id: npt.NDArray[np.int32]
    is_guide: npt.NDArray[np.bool_]
    is_live: npt.NDArray[np.bool_]
    park_mm: FloatArray
    patrol_radius_mm: FloatArray

    @property
    def n_robot(self) -> int:
        """Number of robots, live or dead."""
        return len(self.robot_id)

    @cached_property
    def n_science_live(self) -> int:
        """Number of live science robots."""
        return int((self.is_live & ~self.is_guide).sum())


def load_instrument(name_or_path: str | Path, overrides: Mapping[str, Any] | None = None) -> Instrument:
    """Instrument of a preset's name, or of a TOML file (a `preset` key and what differs from it).

    Raises
    ------
    InputError
        Unknown preset, missing file, unknown or impossible setting.
    """
    name = str(name_or_path)
    if name in PRESETS:
        return Instrument.load({"name": name, **PRESETS[name], **(overrides or {})}, section="instrument")
    if not name.endswith(".toml"):
        hint = f"{did_you_mean(name, PRESETS)}; or the path of a TOML file"
        raise InputError(f"unknown instrument {name!r}", place="instrument", remedy=hint)
    values = read_toml(Path(name))
    preset = values.pop("preset", "taipan-150")
    if preset not in PRESETS:
        raise InputError(f"unknown preset {preset!r}", file=name, place="preset", remedy=did_you_mean(preset, PRESETS))
    merged = {"name": Path(name).stem, **PRESETS[preset], **values, **(overrides or {})}
    return Instrument.load(merged, file=name)


def make_plate(instrument: Instrument, dead: Iterable[int] = ()) -> Plate:
    """Robots of an instrument, those with an id in `dead` not live.

    Raises
    ------
    InputError
        Park positions outside the plate or nearer to each other than the separation; unknown dead robot.
    """
    science, guides = _park_positions(instrument)
    park = np.ascontiguousarray(np.vstack([science, guides]))
    n_science, n_guide = len(science), len(guides)
    robot_id = np.arange(1, len(park) + 1, dtype=np.int32)
    _check_park(instrument, park, robot_id)
    dead_ids = sorted(set(dead))
    unknown = [robot for robot in dead_ids if not 1 <= robot <= len(park)]
    if unknown:
        hint = f"robots of {instrument.name} are 1 to {len(park)}"
        raise InputError("unknown robot", place="instrument.dead_robots", rows=unknown, remedy=hint)
    patrol = [instrument.patrol_radius_mm, instrument.guide_patrol_radius_mm]
    return Plate(
        instrument=instrument,
        robot_id=robot_id,
        is_guide=np.repeat([False, True], [n_science, n_guide]),
        is_live=~np.isin(robot_id, dead_ids),
        park_mm=park,
        patrol_radius_mm=np.repeat(patrol, [n_science, n_guide]),
    )


def robots_table(plate: Plate, survey: str) -> pl.DataFrame:
    """The `robots` table of one survey."""
    return pl.DataFrame(
        {
            "survey": [survey] * plate.n_robot,
            "robot_id": plate.robot_id,
            "kind": np.where(plate.is_guide, "guide", "science").tolist(),
            "state": np.where(plate.is_live, "live", "dead").tolist(),
            "park_x_mm": plate.park_mm[:, 0],
            "park_y_mm": plate.park_mm[:, 1],
            "patrol_radius_mm": plate.patrol_radius_mm,
        }
    )


def _park_positions(instrument: Instrument) -> tuple[FloatArray, FloatArray]:
    """(n_science, 2) and (n_guide, 2) park positions, mm."""
    places = np.array(instrument.guide_places_mm, dtype=np.float64).reshape(-1, 2)
    if instrument.park_positions_mm is not None:
        science = np.array(instrument.park_positions_mm, dtype=np.float64).reshape(-1, 2)
        return science, places if instrument.guides != "none" else places[:0]
    n_science = instrument.n_science
    if instrument.guides == "none":
        return _by_row(_lattice(instrument)[:n_science]), places[:0]
    if instrument.guides == "lattice":
        points = _lattice(instrument)[: n_science + len(places)]
        chosen = _nearest(points, places)
        return _by_row(np.delete(points, chosen, axis=0)), points[chosen]
    # One guide takes the lattice point at the plate centre, the others stand between three lattice points.
    points = _lattice(instrument)
    centre = np.flatnonzero(np.hypot(*places.T) < instrument.lattice_pitch_mm / 2)
    taken = _nearest(points, places[centre])
    others = np.delete(places, centre, axis=0)
    centroids = _centroids(instrument)
    guides = np.vstack([points[taken], centroids[_nearest(centroids, others)]])
    return _by_row(np.delete(points, taken, axis=0)[:n_science]), guides


def _lattice(instrument: Instrument) -> FloatArray:
    """Points of the hexagonal lattice inside the plate, mm, from the centre outwards.

    Points at one radius are ordered by their larger coordinate, then by angle: the as-built plate lacks the four of its
    outermost twelve that reach furthest along an axis (T).
    """
    pitch = instrument.lattice_pitch_mm
    reach = int(2 * instrument.plate_radius_mm / pitch) + 2
    i, j = (index.ravel() for index in np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1)))
    points = _turned(np.column_stack([i + j / 2, j * np.sqrt(3) / 2]) * pitch, instrument.lattice_angle_deg)
    points = points[np.hypot(*points.T) <= instrument.plate_radius_mm]
    radius = np.hypot(*points.T).round(6)
    return points[np.lexsort((np.arctan2(*points.T[::-1]).round(9), np.abs(points).max(axis=1).round(6), radius))]


def _centroids(instrument: Instrument) -> FloatArray:
    """Centroids of the lattice's triangles, mm: pitch / sqrt(3) from three lattice points."""
    points = _lattice(instrument)
    arms = np.array([[0.5, 0.5 / np.sqrt(3)], [0.5, -0.5 / np.sqrt(3)]]) * instrument.lattice_pitch_mm
    return np.vstack([points + arm for arm in _turned(arms, instrument.lattice_angle_deg)])


def _turned(points: FloatArray, angle_deg: float) -> FloatArray:
    sine, cosine = np.sin(np.radians(angle_deg)), np.cos(np.radians(angle_deg))
    return points @ np.array([[cosine, sine], [-sine, cosine]])


def _nearest(points: FloatArray, places: FloatArray) -> npt.NDArray[np.intp]:
    """Index of the point nearest to each place."""
    return np.hypot(*(points[None] - places[:, None]).transpose(2, 0, 1)).argmin(axis=1)


def _by_row(points: FloatArray) -> FloatArray:
    """Points row by row, from the south, each from the west: the order of robot ids."""
    return points[np.lexsort((points[:, 0], points[:, 1].round(6)))]


def _check_park(instrument: Instrument, park: FloatArray, robot_id: npt.NDArray[np.int32]) -> None:
    if instrument.park_positions_mm is None and len(park) < instrument.n_science:
        rule = f"the lattice has {len(park)} park positions inside the plate, {instrument.n_science} robots wanted"
        raise InputError(rule, place="instrument.n_science", remedy="a smaller lattice_pitch_mm or fewer robots")
    outside = np.hypot(*park.T) > instrument.plate_radius_mm
    if outside.any() or not np.isfinite(park).all():
        bad = robot_id[outside | ~np.isfinite(park).all(axis=1)].tolist()
        raise InputError("park position outside the plate", place="instrument.park_positions_mm", rows=bad)
    distance = np.hypot(*(park[:, None] - park[None]).transpose(2, 0, 1))
    np.fill_diagonal(distance, np.inf)
    near = np.flatnonzero((distance < instrument.min_separation_mm).any(axis=1))
    if len(near):
        rule = f"park positions nearer to each other than min_separation_mm = {instrument.min_separation_mm}"
        raise InputError(rule, place="instrument", rows=robot_id[near].tolist(), remedy="move them apart")
