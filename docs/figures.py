"""Draws the figures of the docs, from the package itself: `python docs/figures.py FOLDER`."""

import sys
from pathlib import Path

import numpy as np
import polars as pl
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from survey_sim.allocation import AllocationSettings, FieldTargets, start_allocation
from survey_sim.instrument import Plate, load_instrument, make_plate
from survey_sim.motion import Legs, make_legs, make_trajectories
from survey_sim.plotting import figure_style, new_figure
from survey_sim.plotting.style import INK, KIND_COLOURS, MOTION_COLOURS, MUTED, SURVEY_HUES
from survey_sim.region import healpix_29
from survey_sim.routing import ROUTER_NAMES, RoutingSettings, route
from survey_sim.simulation import simulate
from survey_sim.survey.pooling import PoolRules, pool_survey
from survey_sim.survey.workers import Workers
from survey_sim.tiling import TilingSettings, make_tiles

N_TARGET = 600
ALGORITHMS = ("cda-basic", "cda-advanced", "matching", "plan")
# Visit whose moves are shown: the third, when the nearest targets are taken.
SHOWN_VISIT = 2
# Side of the square whose tiles are shown, deg, and targets per square degree in its poor and its rich half.
SKY_DEG, DENSITIES = 18.0, (15, 60)
NUMBER_BOX = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}


def main(folder: Path) -> None:
    """Draw all figures."""
    folder.mkdir(parents=True, exist_ok=True)
    with figure_style():
        figures = {"leg": leg, "separation": separation, "allocation": allocation, "routers": routers, "tiles": tiles}
        for name, draw in figures.items():
            draw().savefig(folder / f"{name}.png", dpi=130)


def leg() -> Figure:
    """The two ways of one leg: turn one axis onto the line and go, or go along x, then y."""
    figure = new_figure(8.0, 2.9)
    start, theta, goal = np.array([0.0, 0.0]), 20.0, np.array([24.0, 15.0])
    plate = _two_robots(start, np.array([60.0, 60.0]))
    for axes, is_turned in zip(figure.subplots(1, 2), (True, False), strict=True):
        way = make_legs(
            plate.instrument, plate.park_mm, np.array([theta, 0.0]), np.array([0], dtype=np.int32), np.zeros(1), goal[None],
            np.array([is_turned]),
        )  # fmt: skip
        path = make_trajectories(plate.instrument, plate.park_mm, way)
        x, y = (values[path.first[0] : path.first[1]] for values in (path.x_mm, path.y_mm))
        axes.plot(x, y, color=MOTION_COLOURS["moving_s"], linewidth=2, zorder=1)
        for place, angle, name in ((start, theta, "start"), (goal, float(way.theta_deg[0]), "end")):
            axes.add_patch(Circle(place, 4.0, facecolor="white", edgecolor=INK))
            for turn, label in ((0.0, "x"), (90.0, "y")):
                axis = 6.5 * np.array([np.cos(np.radians(angle + turn)), np.sin(np.radians(angle + turn))])
                axes.annotate("", place + axis, place, arrowprops={"arrowstyle": "->", "color": INK})
                axes.annotate(label, place + 1.25 * axis, ha="center", va="center", fontsize=8)
            axes.annotate(name, place + np.array([3.0, -7.0]), ha="center", fontsize=9)
        rotate, dx, dy = way.rotate_deg[0], way.dx_mm[0], way.dy_mm[0]
        axes.set_title(f"turn {rotate:.1f} deg, x {dx:.1f} mm, y {dy:.1f} mm: {path.t_s.max():.1f} s", fontsize=9)
        axes.set(xlim=(-10, 36), ylim=(-12, 26), aspect="equal", xlabel="x (mm)", ylabel="y (mm)")
    return figure


def separation() -> Figure:
    """Distance of two robots whose ways cross: together they collide, a start delay keeps them apart."""
    figure = new_figure(8.0, 3.0)
    plate = _two_robots(np.array([0.0, 0.0]), np.array([24.1, 0.0]))
    goal = np.array([[22.0, 20.0], [2.0, 20.0]])
    axes = figure.subplots()
    for delay_s, hue in ((0.0, SURVEY_HUES[1]), (7.0, SURVEY_HUES[0])):
        way = make_legs(
            plate.instrument, plate.park_mm, np.zeros(2), np.arange(2, dtype=np.int32), np.array([0.0, delay_s]), goal,
            np.ones(2, dtype=bool),
        )  # fmt: skip
        time_s, apart_mm = _distance(plate, way)
        least = simulate(plate, plate.park_mm, np.zeros(2), way).min_separation_mm
        axes.plot(time_s, apart_mm, color=hue, label=f"second starts at {delay_s:g} s: least {least:.3f} mm")
        axes.plot(time_s[np.argmin(apart_mm)], least, "o", color=hue)
    axes.axhline(plate.instrument.min_separation_mm, color=INK, linestyle="--", linewidth=1)
    axes.annotate("min_separation_mm", (0.2, plate.instrument.min_separation_mm + 0.4), fontsize=9)
    axes.set(xlabel="time (s)", ylabel="distance of centres (mm)", ylim=(0, None))
    axes.legend()
    return figure


def tiles() -> Figure:
    """Tiles of a square on the equator, rich in targets on one side, and the visits that pooling gives each."""
    plate, rng = make_plate(load_instrument("taipan-150")), np.random.default_rng(1)
    radius_deg = plate.instrument.field_radius_deg
    n_target = [round(density * SKY_DEG**2 / 2) for density in DENSITIES]
    west = np.repeat([0.0, -SKY_DEG / 2], n_target)
    ra_deg = 180.0 + west + rng.uniform(0.0, SKY_DEG / 2, len(west))
    targets = pl.DataFrame(
        {
            "target_id": np.arange(len(west)),
            "survey": "taipan",
            "programme": "galaxies",
            "kind": "science",
            "ra_deg": ra_deg,
            "dec_deg": rng.uniform(-SKY_DEG / 2, SKY_DEG / 2, len(west)),
            "mag": 15.0,
            "priority": 5,
            "wanted_visits": 1,
        }
    )
    targets = targets.with_columns(_healpix_29=pl.Series(healpix_29(ra_deg, targets["dec_deg"].to_numpy())))
    centres, targets = make_tiles(targets, TilingSettings(), radius_deg)
    rules = PoolRules("taipan", {"galaxies": 0.95}, plate, AllocationSettings.load({}), seed=1)
    _, plan = pool_survey(rules, targets, centres, Workers())
    n_visit = plan.select("tile_id", "visit").unique().group_by("tile_id").len()
    figure = new_figure(5.6, 5.0)
    axes = figure.subplots()
    axes.plot(targets["ra_deg"], targets["dec_deg"], ".", color=MUTED, markersize=0.6)
    shown = centres.join(n_visit, on="tile_id", how="left").with_columns(pl.col("len").fill_null(0))
    for ra, dec, n in shown.select("ra_deg", "dec_deg", "len").iter_rows():
        axes.add_patch(Circle((ra, dec), radius_deg, facecolor="none", edgecolor=SURVEY_HUES[0], linewidth=0.8))
        axes.annotate(f"{n}", (ra, dec), ha="center", va="center", fontsize=9, color=INK, bbox=NUMBER_BOX)
    axes.set(aspect="equal", xlabel="right ascension (deg)", ylabel="declination (deg)")
    axes.autoscale_view()
    axes.invert_xaxis()
    return figure


def allocation() -> Figure:
    """The same field's third visit by each algorithm."""
    figure = new_figure(10.0, 3.2)
    plate = make_plate(load_instrument("paper"))
    targets = _targets(plate)
    for axes, algorithm in zip(figure.subplots(1, len(ALGORITHMS)), ALGORITHMS, strict=True):
        visits = _visits(plate, targets, algorithm)
        start, goal = visits[SHOWN_VISIT]
        axes.add_patch(Circle((0, 0), plate.instrument.plate_radius_mm, facecolor="none", edgecolor=MUTED))
        axes.plot(targets.x_mm, targets.y_mm, ".", color=KIND_COLOURS["idle"], markersize=1.5)
        axes.add_collection(LineCollection(list(np.stack([start, goal], axis=1)), colors=SURVEY_HUES[0], linewidths=0.9))
        axes.plot(*goal.T, ".", color=SURVEY_HUES[0], markersize=3)
        axes.set(aspect="equal")
        axes.set_axis_off()
        axes.set_title(f"{algorithm}\nfurthest move {np.hypot(*(goal - start).T).max():.1f} mm", fontsize=10)
        axes.autoscale_view()
    return figure


def routers() -> Figure:
    """The same visit by each router: robots at rest against time."""
    figure = new_figure(8.0, 3.2)
    axes = figure.subplots()
    plate = make_plate(load_instrument("paper"))
    start, goal = _visits(plate, _targets(plate), "cda-basic")[SHOWN_VISIT]
    theta = np.zeros(plate.n_robot)
    for name, hue, dashes in zip(ROUTER_NAMES, SURVEY_HUES, ("-", "--", "-.", ":"), strict=False):
        routed = route(plate, start, theta, goal, RoutingSettings.load({"router": name}), np.random.default_rng(1))
        played = simulate(plate, start, theta, routed.legs)
        rest_s = np.sort((played.rotating_s + played.moving_s + played.waiting_s)[routed.reason == 0])
        share = np.arange(1, len(rest_s) + 1) / plate.n_robot
        n_lost = int((routed.reason != 0).sum())
        label = f"{name}: {played.configuration_time_s:.1f} s" + (f", {n_lost} not routed" if n_lost else "")
        axes.step(rest_s, 100 * share, where="post", color=hue, linestyle=dashes, label=label)
    axes.axvline(routed.lower_bound_s, color=INK, linewidth=1, linestyle=":")
    axes.annotate("lower bound", (routed.lower_bound_s, 5), fontsize=9, rotation=90, ha="right")
    axes.set(xlabel="time (s)", ylabel="robots at rest (%)", ylim=(0, 101))
    axes.legend(loc="lower right")
    return figure


def _two_robots(*park_mm: np.ndarray) -> Plate:
    places = tuple((float(x), float(y)) for x, y in park_mm)
    return make_plate(load_instrument("paper", {"park_positions_mm": places, "n_science": len(places)}))


def _distance(plate: Plate, legs: Legs) -> tuple[np.ndarray, np.ndarray]:
    """The distance of two robots at many instants, for the eye; what counts is found in closed form."""
    path = make_trajectories(plate.instrument, plate.park_mm, legs)
    time_s = np.linspace(0.0, path.t_s.max() + 1.0, 2000)
    robots = [slice(path.first[i], path.first[i + 1]) for i in range(2)]
    x, y = ([np.interp(time_s, path.t_s[robot], values[robot]) for robot in robots] for values in (path.x_mm, path.y_mm))
    return time_s, np.hypot(x[1] - x[0], y[1] - y[0])


def _targets(plate: Plate) -> FieldTargets:
    rng = np.random.default_rng(5)
    radius, angle = plate.instrument.plate_radius_mm * np.sqrt(rng.random(N_TARGET)), 2 * np.pi * rng.random(N_TARGET)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return FieldTargets.from_table(pl.DataFrame({"target_id": np.arange(N_TARGET), "x_mm": x, "y_mm": y}))


def _visits(plate: Plate, targets: FieldTargets, algorithm: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Where each visit of the field starts and ends, were all robots to arrive."""
    settings = AllocationSettings.load({"algorithm": algorithm, "visits": SHOWN_VISIT + 2})
    session = start_allocation(targets, plate, settings, np.random.default_rng(1))
    standing, visits = plate.park_mm, []
    while (visit := session.next_visit(standing)) is not None:
        session.record(visit, np.ones(plate.n_robot, dtype=bool))
        visits.append((plate.park_mm if visit.start == "park" else standing, visit.goal_mm))
        standing = visit.goal_mm
    return visits


if __name__ == "__main__":
    main(Path(sys.argv[1]))
