"""Puts the page together: visits as JSON, the template, style and scripts beside this file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from survey_sim.exchange import RoutedVisit, Standing
from survey_sim.instrument import Plate
from survey_sim.motion import Legs
from survey_sim.schema import PATHS

_FOLDER = Path(__file__).resolve().parent
_SCRIPTS = ("motion.js", "draw.js", "player.js")
_CONSTANTS = (
    "name",
    "plate_radius_mm",
    "min_separation_mm",
    "robot_diameter_mm",
    "coarse_speed_mm_s",
    "precise_speed_mm_s",
    "rotation_speed_deg_s",
)
_LEG_COLUMNS = {
    "start": "start_s",
    "rotate": "rotate_deg",
    "dx": "dx_mm",
    "dy": "dy_mm",
    "precise": "precise_mm",
    "x": "x_mm",
    "y": "y_mm",
}
# Decimals of times, lengths and angles in the page: 1e-6 mm, far below what a screen shows.
_DECIMALS = 6


@dataclass(frozen=True)
class PlayerRun:
    """Visits of one router, to be played one after the other, or beside another run's.

    Attributes
    ----------
    targets
        target_id, kind, priority, mag, x_mm, y_mm of the field's targets.
    """

    name: str
    visits: Sequence[RoutedVisit]
    targets: pl.DataFrame


def make_page(runs: Sequence[PlayerRun], title: str) -> str:
    """The player's page.

    Parameters
    ----------
    runs
        One, or several to be played side by side.
    """
    plates: list[Plate] = []
    data = {"paths": PATHS, "runs": [_run(run, plates) for run in runs]}
    data["plates"] = [_plate(plate) for plate in plates]
    environment = Environment(autoescape=True, undefined=StrictUndefined, keep_trailing_newline=True)
    template = environment.from_string((_FOLDER / "page.html").read_text(encoding="utf-8"))
    return template.render(
        title=title,
        subtitle=plates[0].instrument.name,
        style=Markup((_FOLDER / "player.css").read_text(encoding="utf-8")),
        script=Markup("\n".join((_FOLDER / name).read_text(encoding="utf-8") for name in _SCRIPTS)),
        data=Markup(_script_json(data)),
    )


def _script_json(data: Any) -> str:
    """JSON that no text of a file can break out of a script element with."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _run(run: PlayerRun, plates: list[Plate]) -> dict[str, Any]:
    visits = [_visit(visit, plates) for visit in run.visits]
    return {"name": run.name, "visits": visits, "targets": _targets(run.targets)}


def _visit(visit: RoutedVisit, plates: list[Plate]) -> dict[str, Any]:
    place = next((i for i, plate in enumerate(plates) if plate is visit.plate), len(plates))
    if place == len(plates):
        plates.append(visit.plate)
    reasons = {path: visit.reasons.get(path) or [] for path in PATHS}
    return {
        "id": visit.params.get("visit_id"),
        "label": visit.label or "visit",
        "plate": place,
        "target": visit.held["target_id"].to_list(),
        "begin": {path: _standing(visit.begin(path)) for path in PATHS},
        "legs": {path: _legs(visit.legs[path]) for path in PATHS},
        "reasons": {path: {i: code for i, code in enumerate(codes) if code} for path, codes in reasons.items()},
    }


def _plate(plate: Plate) -> dict[str, Any]:
    return {
        "instrument": {name: getattr(plate.instrument, name) for name in _CONSTANTS},
        "robot_id": plate.robot_id.tolist(),
        "guide": plate.is_guide.tolist(),
        "live": plate.is_live.tolist(),
        "park": {"x": _rounded(plate.park_mm[:, 0]), "y": _rounded(plate.park_mm[:, 1])},
        "patrol": _rounded(plate.patrol_radius_mm),
    }


def _targets(targets: pl.DataFrame) -> dict[str, Any]:
    return {
        "id": targets["target_id"].to_list(),
        "kind": targets["kind"].to_list(),
        "priority": targets["priority"].to_list(),
        "mag": targets["mag"].round(2).to_list(),
        "x": _rounded(targets["x_mm"].to_numpy()),
        "y": _rounded(targets["y_mm"].to_numpy()),
    }


def _standing(standing: Standing) -> dict[str, list[float]]:
    x, y = standing.position_mm.T
    return {"x": _rounded(x), "y": _rounded(y), "theta": _rounded(standing.theta_deg)}


def _legs(legs: Legs) -> dict[str, list[float]]:
    columns = {name: _rounded(getattr(legs, column)) for name, column in _LEG_COLUMNS.items()}
    return {"robot": legs.robot.tolist(), **columns}


def _rounded(values: np.ndarray) -> list[float]:
    return [float(value) for value in np.round(values, _DECIMALS)]
