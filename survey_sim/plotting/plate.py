"""One plate: park positions, patrol discs, targets, and the moves of a visit as its legs go; also part of the overview."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import polars as pl
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle, Patch

from survey_sim.geometry import sky_to_plate
from survey_sim.plotting.run import RunTables, Visit
from survey_sim.plotting.style import INK, KIND_COLOURS, MUTED, survey_colours

FloatArray = npt.NDArray[np.float64]

KIND_MARKERS = {"science": "o", "standard": "*", "sky": "s", "guide": "D"}
_KIND_WORDS = {"science": "science target", "standard": "standard", "sky": "sky", "guide": "guide star"}
KIND_SIZES = {"science": 17.0, "standard": 52.0, "sky": 15.0, "guide": 18.0}
# Discs of the robots that travel furthest.
N_DISC = 3


@dataclass(frozen=True)
class PlateVisit:
    """What one visit puts on the plate.

    Attributes
    ----------
    robots
        Allocations of the visit, with `park_x_mm`, `park_y_mm`, `patrol_radius_mm`, `state` and where the move starts,
        `start_x_mm`, `start_y_mm`.
    ways_mm
        Way points of each robot that moves, (n, 2) mm each.
    targets_mm
        (n, 2) science targets of the field, mm.
    """

    visit: Visit
    robots: pl.DataFrame
    ways_mm: list[FloatArray]
    targets_mm: FloatArray


def read_plate(run: RunTables, visit: Visit) -> PlateVisit:
    """A visit's robots, moves, and the science targets of its field."""
    parks = run.robots.filter(survey=visit.survey).drop("survey", "kind")
    robots = run.rows_of("allocations", visit).join(parks, on="robot_id", how="left")
    start = _starts(run, visit)
    robots = robots.join(start, on="robot_id", how="left").with_columns(
        start_x_mm=pl.coalesce("start_x_mm", "park_x_mm"), start_y_mm=pl.coalesce("start_y_mm", "park_y_mm")
    )
    legs = run.rows_of("legs", visit).filter(path="start_to_target").sort("robot_id", "leg")
    return PlateVisit(visit, robots.sort("robot_id"), _ways(robots, legs), _targets(run, visit))


def draw_plate(axes: Axes, run: RunTables, plate: PlateVisit) -> None:
    """Draw a visit; north up, east to the right as the plate frame has it."""
    radius, hue = float(run.instrument["plate_radius_mm"]), survey_colours(run)[plate.visit.survey]
    edge = axes.add_patch(Circle((0, 0), radius, facecolor="#FAFAF7", edgecolor=MUTED, linewidth=1.0, zorder=0))
    x, y = plate.targets_mm.T
    axes.scatter(x, y, s=3.0, color="#9C9C9C", linewidth=0, label="science target", rasterized=True, zorder=1)
    _draw_reaches(axes, plate, edge)
    park = plate.robots.select("park_x_mm", "park_y_mm").to_numpy()
    axes.scatter(
        park[:, 0], park[:, 1], s=13, marker="+", color=INK, linewidth=0.6, alpha=0.55, label="park position", zorder=2
    )
    axes.add_collection(LineCollection(plate.ways_mm, colors=INK, linewidths=0.9, zorder=3, label="move"))
    _draw_robots(axes, plate, hue)
    axes.set(xlim=(-1.04 * radius, 1.04 * radius), ylim=(-1.04 * radius, 1.04 * radius), aspect="equal")
    step = 10.0 ** np.floor(np.log10(radius)) / 2.0
    ticks = np.arange(-np.floor(radius / step), np.floor(radius / step) + 1) * step
    axes.set(xticks=ticks, yticks=ticks)
    axes.set(xlabel="Plate x, east (mm)", ylabel="Plate y, north (mm)")
    axes.grid(False)


def _draw_reaches(axes: Axes, plate: PlateVisit, edge: Patch) -> None:
    """Patrol discs of the robots that go furthest, as far as they lie on the plate."""
    furthest = (
        plate.robots.sort("travel_mm", "robot_id", descending=[True, False]).filter(pl.col("travel_mm") > 0).head(N_DISC)
    )
    for number, row in enumerate(furthest.iter_rows(named=True)):
        disc = axes.add_patch(
            Circle(
                (row["park_x_mm"], row["park_y_mm"]),
                row["patrol_radius_mm"],
                facecolor="none",
                edgecolor=MUTED,
                linewidth=0.9,
                linestyle=(0, (4, 3)),
                label=None if number else f"reach of the {len(furthest)} that go furthest",
                zorder=1.5,
            )
        )
        disc.set_clip_path(edge)


def _draw_robots(axes: Axes, plate: PlateVisit, hue: str) -> None:
    """Robots where they end, by what they hold; `hue` is that of science."""
    for kind, marker in KIND_MARKERS.items():
        held = plate.robots.filter(kind=kind)
        if held.is_empty():
            continue
        colour = hue if kind == "science" else KIND_COLOURS[kind]
        axes.scatter(
            held["x_mm"],
            held["y_mm"],
            s=KIND_SIZES[kind],
            marker=marker,
            color=colour,
            edgecolor=INK,
            linewidth=0.45,
            label=f"robot on {'a ' if kind != 'sky' else ''}{_KIND_WORDS[kind]} ({len(held)})",
            zorder=5 if kind == "standard" else 4,
        )
    dead = plate.robots.filter(state="dead")
    if len(dead):
        axes.scatter(
            dead["x_mm"], dead["y_mm"], s=30, marker="x", color="#B00020", label=f"dead robot ({len(dead)})", zorder=6
        )


def _starts(run: RunTables, visit: Visit) -> pl.DataFrame:
    """Where robots stand when `start_to_target` begins, but for those at park."""
    row = run.visits.filter(survey=visit.survey, tile_id=visit.tile_id, visit_id=visit.visit_id)
    is_park = visit.visit_id == 0 or row.is_empty() or row["start"].item() == "park"
    before = run.rows_of("allocations", visit._replace(visit_id=-1 if is_park else visit.visit_id - 1))
    return before.select("robot_id", start_x_mm="x_mm", start_y_mm="y_mm")


def _ways(robots: pl.DataFrame, legs: pl.DataFrame) -> list[FloatArray]:
    """Way points: start, and for each leg its corner (own x first, then own y) and its end."""
    theta = np.radians(legs["theta_deg"].to_numpy())
    end = legs.select("x_mm", "y_mm").to_numpy()
    corner = end - legs["dy_mm"].to_numpy()[:, None] * np.column_stack([-np.sin(theta), np.cos(theta)])
    points = np.stack([corner, end], axis=1)
    start = {row[0]: row[1:] for row in robots.select("robot_id", "start_x_mm", "start_y_mm").iter_rows()}
    owner = legs["robot_id"].to_numpy()
    first = np.flatnonzero(np.diff(owner, prepend=-1))
    parts = np.split(points, first[1:]) if len(owner) else []
    return [np.vstack([start[robot], part.reshape(-1, 2)]) for robot, part in zip(owner[first], parts, strict=True)]


def _targets(run: RunTables, visit: Visit) -> FloatArray:
    """(n, 2) science targets of the visit's survey on its plate, mm, whichever tile they are of."""
    tile = run.tiles.filter(survey=visit.survey, tile_id=visit.tile_id)
    if tile.is_empty():
        return np.empty((0, 2))
    centre = float(tile["ra_deg"].item()), float(tile["dec_deg"].item())
    own = run.science.filter(
        (pl.col("survey") == visit.survey) & ((pl.col("dec_deg") - centre[1]).abs() < run.field_radius_deg)
    )
    if not np.isfinite(centre).all() or own.is_empty():
        return np.empty((0, 2))
    scale = float(run.instrument["plate_scale_arcsec_mm"])
    place = sky_to_plate(own["ra_deg"].to_numpy(), own["dec_deg"].to_numpy(), centre, scale)
    return place[np.hypot(*place.T) < float(run.instrument["plate_radius_mm"])]
