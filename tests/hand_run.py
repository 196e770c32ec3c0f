"""A small correct run, written by plain arithmetic: two tiles, two visits each, six robots; none of the project's solvers.

Robots 1 to 4 are science robots, 5 is a guide, 6 is dead. Robot 3 waits before it goes, robot 2 goes x then y, robot 1 goes
by a way point at visit 1, and robot 4 is not routed to its target at visit 1 of tile 1. At the telescope robot 2 holds at
tile 1 what robot 1 holds in the visit, and misses its target on the second night.
"""

import json
from math import asin, atan2, ceil, cos, degrees, floor, hypot, log2, pi, radians, sin
from pathlib import Path
from statistics import mean, median
from typing import Any

import polars as pl

from survey_sim import tables
from survey_sim.schema import TABLES
from tests import naive_check as naive

SURVEY = "hand"
SCALE = 67.2
APPROACH = 0.02
INSTRUMENT = {
    "name": "hand",
    "plate_radius_mm": 163.5,
    "plate_scale_arcsec_mm": SCALE,
    "patrol_radius_mm": 50.0,
    "guide_patrol_radius_mm": 10.0,
    "min_separation_mm": 9.0,
    "coarse_speed_mm_s": naive.COARSE,
    "precise_speed_mm_s": naive.PRECISE,
    "rotation_speed_deg_s": naive.TURNING,
    "precise_approach_mm": APPROACH,
}
PARK = {1: (0.0, 0.0), 2: (24.1, 0.0), 3: (0.0, 24.1), 4: (24.1, 24.1), 5: (12.05, 12.05), 6: (48.2, 0.0)}
CENTRES = {0: (359.5, -40.0), 1: (120.0, -89.0)}
DEAD, GUIDE = 6, 5
# Goals on the plate, mm, by (tile, visit) and robot; a robot that is not named stays.
GOALS = {
    (0, 0): {1: (-8.0, 5.0), 2: (30.0, -9.0), 3: (3.0, 33.0), 4: (33.0, 28.0), 5: (13.0, 14.0)},
    (0, 1): {1: (-15.0, -6.0), 2: (36.0, -4.0), 3: (-6.0, 40.0), 5: (10.0, 11.0)},
    (1, 0): {1: (6.0, -11.0), 3: (-9.0, 30.0), 4: (40.0, 30.0)},
    (1, 1): {1: (-4.0, -9.0), 2: (26.0, 4.0), 5: (12.0, 9.0)},
}
# What stands at those goals; a robot that is not named goes there idle.
HELD = {
    (0, 0): {1: 0, 2: 1, 3: 2, 4: 3, 5: 4},
    (0, 1): {1: 5, 2: 6, 5: 7},
    (1, 0): {1: 8, 3: 9, 4: 10},
    (1, 1): {1: 11, 2: 12, 5: 13},
}
KINDS = {2: "sky", 4: "guide", 6: "standard", 7: "guide", 10: "standard", 13: "guide"}
MINIMA = {"min_standard": 1, "min_sky": 2, "min_guide": 1, "min_sky_region": 1, "sky_regions": 4}
UNROUTED = {(1, 1): {4: "no-path"}}
# Pointings: night, MJD - 57400, tile, visit, status, open shutter in s, targets by robot, and targets missed.
POINTINGS = [
    (0, 0.40, 0, 0, "observed", 600.0, HELD[0, 0], {}),
    (0, 0.41, 0, 1, "not-started", 0.0, HELD[0, 1], {}),
    (0, 0.42, 1, 0, "interrupted", 100.0, {2: 8, 3: 9, 4: 10}, {}),
    (0, 0.43, 1, 0, "observed", 600.0, {2: 8, 3: 9, 4: 10}, {}),
    (1, 1.40, 1, 1, "observed", 600.0, {1: 11, 5: 13}, {2: 12}),
]
# Targets that nobody reaches: one of tile 0; the others want more visits than they get.
UNREACHED = 14
WANTED = {0: 2, UNREACHED: 1}
PATHS = ("start_to_target", "start_to_park", "park_to_target")


def to_sky(x: float, y: float, centre: tuple[float, float]) -> tuple[float, float]:
    """Right ascension and declination of a place on the plate, deg: a great circle from the field centre."""
    angle = radians(hypot(x, y) * SCALE / 3600)
    bearing = atan2(x, y)
    ra0, dec0 = map(radians, centre)
    dec = asin(sin(dec0) * cos(angle) + cos(dec0) * sin(angle) * cos(bearing))
    ra = ra0 + atan2(sin(bearing) * sin(angle) * cos(dec0), cos(angle) - sin(dec0) * sin(dec))
    return degrees(ra) % 360, degrees(dec)


def wrap(theta: float) -> float:
    """Angle in [-180, 180), deg."""
    return (theta + 180) % 360 - 180


def turned_leg(state: tuple[float, float, float], goal: tuple[float, float], start_s: float) -> dict:
    """Turn the nearest axis onto the line, then go."""
    x, y, theta = state
    length = hypot(goal[0] - x, goal[1] - y)
    line = degrees(atan2(goal[1] - y, goal[0] - x))
    axis = min(range(4), key=lambda k: abs(wrap(line - theta - 90 * k)))
    rotate = wrap(line - theta - 90 * axis)
    dx, dy = [(length, 0.0), (0.0, length), (-length, 0.0), (0.0, -length)][axis]
    return {"start_s": start_s, "rotate_deg": rotate, "dx_mm": dx, "dy_mm": dy, "theta_deg": wrap(theta + rotate)} | {
        "x_mm": goal[0],
        "y_mm": goal[1],
        "precise_mm": 0.0,
    }


def square_leg(state: tuple[float, float, float], goal: tuple[float, float], start_s: float) -> dict:
    """Do not turn; go along x, then along y."""
    x, y, theta = state
    c, s = cos(radians(theta)), sin(radians(theta))
    ex, ey = goal[0] - x, goal[1] - y
    steps = {"rotate_deg": 0.0, "dx_mm": c * ex + s * ey, "dy_mm": c * ey - s * ex, "precise_mm": 0.0}
    return {"start_s": start_s, "x_mm": goal[0], "y_mm": goal[1], "theta_deg": theta} | steps


def make_legs(robot: int, state: tuple, goal: tuple[float, float], visit: int) -> list[dict]:
    """Legs of a robot on a path, the last with the precise approach."""
    if state[:2] == goal:
        return []
    if robot == 2:
        legs = [square_leg(state, goal, 0.0)]
    elif robot == 1 and visit == 1:
        half = ((state[0] + goal[0]) / 2 - 1.0, (state[1] + goal[1]) / 2)
        first = turned_leg(state, half, 0.0)
        legs = [first, turned_leg((*half, first["theta_deg"]), goal, naive.leg_end_s(first) + 0.5)]
    else:
        legs = [turned_leg(state, goal, 1.5 if robot == 3 else 0.0)]
    last = legs[-1]
    last["precise_mm"] = min(APPROACH, abs(last["dx_mm"]) + abs(last["dy_mm"]))
    return legs


def alone_s(state: tuple, goal: tuple[float, float]) -> float:
    """Time of one robot alone: the quicker of its two ways."""
    if state[:2] == goal:
        return 0.0
    ways = [turned_leg(state, goal, 0.0), square_leg(state, goal, 0.0)]
    for leg in ways:
        leg["precise_mm"] = min(APPROACH, abs(leg["dx_mm"]) + abs(leg["dy_mm"]))
    return min(map(naive.leg_end_s, ways))


def rank(values: list[float]) -> float:
    """The smallest value that at least 95 % do not exceed."""
    return sorted(values)[ceil(0.95 * len(values)) - 1] if values else 0.0


def crosses(a: tuple, b: tuple, c: tuple, d: tuple) -> bool:
    """Whether segments a-b and c-d properly intersect."""

    def side(p: tuple, q: tuple, r: tuple) -> float:
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    return side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0


def make_targets() -> list[dict]:
    """Targets where robots will stand, and one out of reach of all."""
    rows = []
    for (tile, visit), held in HELD.items():
        for robot, target in held.items():
            rows.append(_target(target, tile, GOALS[tile, visit][robot]))
    rows.append(_target(UNREACHED, 0, (100.0, 100.0)))
    return sorted(rows, key=lambda row: row["target_id"])


def _target(target: int, tile: int, place: tuple[float, float]) -> dict:
    ra, dec = to_sky(*place, CENTRES[tile])
    kind = KINDS.get(target, "science")
    is_science = kind == "science"
    return {
        "target_id": target,
        "survey": SURVEY,
        "programme": "case" if is_science else None,
        "kind": kind,
        "source_id": f"s{target}",
        "ra_deg": ra,
        "dec_deg": dec,
        "mag": None if kind == "sky" else 10.0 + target / 10,
        "priority": 5,
        "wanted_visits": WANTED.get(target, 1) if is_science else 0,
        "tile_id": tile if is_science else None,
        "_healpix_29": target,
    }


def make_tables(
    start: str = "previous", first: dict[int, tuple[float, float, float]] | None = None
) -> dict[str, pl.DataFrame]:
    """All tables of the run; every visit starts where the last one ended, or from park; the tiles' first from `first`."""
    targets = make_targets()
    rows: dict[str, list[dict]] = {table: [] for table in TABLES if table != "rejected"}
    rows["targets"] = targets
    rows["robots"] = [_robot(robot) for robot in PARK]
    for tile, (ra, dec) in CENTRES.items():
        n = sum(row["kind"] == "science" and row["tile_id"] == tile for row in targets)
        rows["tiles"].append({"survey": SURVEY, "tile_id": tile, "ra_deg": ra, "dec_deg": dec, "n_target": n})
        _add_tile(rows, tile, targets, n, start, first)
    _add_schedule(rows, targets)
    _add_outcome(rows, targets)
    return {table: _frame(table, own) for table, own in rows.items()}


def _robot(robot: int) -> dict:
    return {
        "survey": SURVEY,
        "robot_id": robot,
        "kind": "guide" if robot == GUIDE else "science",
        "state": "dead" if robot == DEAD else "live",
        "park_x_mm": PARK[robot][0],
        "park_y_mm": PARK[robot][1],
        "patrol_radius_mm": 10.0 if robot == GUIDE else 50.0,
    }


def _frame(table: str, rows: list[dict]) -> pl.DataFrame:
    schema = {column.name: column.dtype for column in TABLES[table].columns}
    if rows:
        schema |= {name: pl.Float64 for name in rows[0] if name not in schema}
    return pl.DataFrame(rows, schema=schema)


def _add_tile(
    rows: dict[str, list[dict]], tile: int, targets: list[dict], n_target: int, start: str, first: dict | None
) -> None:
    park = {robot: (*place, 0.0) for robot, place in PARK.items()}
    state, n_done = first or park, 0
    park[DEAD] = state[DEAD]
    parked = {robot: place[:2] for robot, place in park.items()}
    for visit in (0, 1):
        key = {"survey": SURVEY, "tile_id": tile, "visit_id": visit}
        unrouted = UNROUTED.get((tile, visit), {})
        goals = {robot: GOALS[tile, visit].get(robot, state[robot][:2]) for robot in PARK}
        begin = park if start == "park" else state
        ends = _add_path(rows, key | {"path": PATHS[0]}, visit, begin, goals, unrouted)
        _add_path(rows, key | {"path": PATHS[1]}, visit, state, parked, {})
        _add_path(rows, key | {"path": PATHS[2]}, visit, park, {robot: end[:2] for robot, end in ends.items()}, {})
        held = HELD[tile, visit]
        for robot in PARK:
            target = held.get(robot)
            rows["allocations"].append(
                key
                | {"robot_id": robot, "target_id": target, "kind": None if target is None else targets[target]["kind"]}
                | {"x_mm": ends[robot][0], "y_mm": ends[robot][1]}
                | {"travel_mm": hypot(ends[robot][0] - begin[robot][0], ends[robot][1] - begin[robot][1])}
            )
        n_done += sum(targets[t]["kind"] == "science" and targets[t]["wanted_visits"] == 1 for t in held.values())
        _add_visit(rows, key | {"start": start}, [targets[t] for t in held.values()], begin, ends, n_done / n_target)
        state = ends


def _add_path(rows: dict[str, list[dict]], key: dict, visit: int, state: dict, goals: dict, unrouted: dict) -> dict:
    """Legs, robot times and the path; gives the states in which the robots end."""
    legs, ends, figures = _go(state, goals, visit, unrouted)
    for robot, own in legs.items():
        rotating = sum(abs(leg["rotate_deg"]) / naive.TURNING for leg in own)
        moving = sum(naive.leg_end_s(leg) - leg["start_s"] for leg in own) - rotating
        rest = naive.leg_end_s(own[-1]) if own else 0.0
        times = {"rotating_s": rotating, "moving_s": moving, "waiting_s": rest - rotating - moving}
        rows["robot_times"].append(key | {"robot_id": robot} | times | {"reason": unrouted.get(robot)})
        rows["legs"] += [key | {"robot_id": robot, "leg": i} | leg for i, leg in enumerate(own)]
    rows["paths"].append(key | figures)
    moving, metrology = figures["configuration_time_s"] + 1.0, 2.0
    rows["executions"].append(
        key
        | {
            "mode": "keep-order",
            "moving_time_s": moving,
            "metrology_rounds": 0,
            "metrology_time_s": metrology,
            "configuration_time_s": moving + metrology,
            "min_separation_mm": 8.5,
            "collisions": 1,
            "contacts": 0,
            "error_max_um": 3.0,
            "is_within_tolerance": True,
        }
    )
    return ends


def _go(state: dict, goals: dict, visit: int, unrouted: dict) -> tuple[dict, dict, dict]:
    """Legs of each robot, the states in which they end, and the figures of the path."""
    legs = {robot: [] if robot in unrouted else make_legs(robot, state[robot], goals[robot], visit) for robot in PARK}
    rests = [naive.leg_end_s(own[-1]) for own in legs.values() if own]
    ends = {
        robot: (own[-1]["x_mm"], own[-1]["y_mm"], own[-1]["theta_deg"]) if own else state[robot]
        for robot, own in legs.items()
    }
    figures = {
        "configuration_time_s": max(rests, default=0.0),
        "configuration_time_p95_s": rank(rests),
        "configuration_time_median_s": median(rests) if rests else 0.0,
        "lower_bound_s": max(alone_s(state[robot], ends[robot][:2]) for robot in PARK),
        "ticks": len({leg["start_s"] for own in legs.values() for leg in own}),
        "collisions": 0,
        "unrouted": len(unrouted),
        "min_separation_mm": naive.least_of_all(list(state.values()), list(legs.values())),
    }
    return legs, ends, figures


def _add_visit(
    rows: dict[str, list[dict]], key: dict, held: list[dict], state: dict, ends: dict, completeness: float
) -> None:
    of_visit = {name: key[name] for name in ("survey", "tile_id", "visit_id")}.items()
    path = next(row for row in rows["paths"] if row["path"] == PATHS[0] and row.items() >= of_visit)
    going = [row["travel_mm"] for row in rows["allocations"] if row.items() >= of_visit and row["travel_mm"] > 0]
    mags = [target["mag"] for target in held if target["kind"] == "science"]
    lines = [(state[robot][:2], ends[robot][:2]) for robot in PARK]
    n_crossing = sum(crosses(*lines[i], *lines[j]) for i in range(len(lines)) for j in range(i))
    shared = ("configuration_time_s", "configuration_time_p95_s", "lower_bound_s", "ticks", "collisions", "unrouted")
    rows["visits"].append(
        key
        | {f"n_{kind}": sum(t["kind"] == kind for t in held) for kind in ("science", "standard", "sky", "guide")}
        | {"mag_bright": min(mags), "mag_faint": max(mags), "n_idle": len(PARK) - 1 - len(held)}
        | {"completeness_frac": completeness, "ideal_completeness_frac": 1.0, "completeness_bound_frac": 1.0}
        | {"travel_mean_mm": mean(going), "travel_p95_mm": rank(going), "travel_max_mm": max(going)}
        | {"crossings": n_crossing}
        | _shortfalls(held)
        | {name: path[name] for name in shared}
    )


def _shortfalls(held: list[dict]) -> dict[str, int]:
    """What a visit lacks of `MINIMA`; a sky position is held in tile 0, visit 0 alone, in the first quarter."""
    kinds = [target["kind"] for target in held]
    lack = {f"{kind}_shortfall": max(0, MINIMA[f"min_{kind}"] - kinds.count(kind)) for kind in ("standard", "sky", "guide")}
    return lack | {"sky_region_shortfall": MINIMA["sky_regions"] - min(1, kinds.count("sky"))}


def _add_schedule(rows: dict[str, list[dict]], targets: list[dict]) -> None:
    """Night 0: tile 0 visit 0, tile 1 visit 0 (cloud stops it, then again); night 1: tile 1 visit 1, nothing of tile 0."""
    wanted = {row["target_id"]: row["wanted_visits"] for row in targets if row["kind"] == "science"}
    done: dict[int, list[int]] = {target: [] for target in wanted}
    state, last_night = {}, -1
    for i, (night, mjd, tile, visit, status, exposure, held, missed) in enumerate(POINTINGS):
        state = state if night == last_night else {robot: (*place, 0.0) for robot, place in PARK.items()}
        last_night = night
        state, configuration = _add_pointing(rows, i, (tile, visit), state, held, missed, targets)
        rows["exposures"].append(
            {"exposure_id": i, "night": night, "start_mjd": 57400.0 + mjd, "survey": SURVEY, "tile_id": tile}
            | {"visit_id": visit, "slew_s": 30.0, "configuration_time_s": configuration, "readout_s": 60.0}
            | {
                "overhead_s": 40.0 if status == "not-started" else 108.0,
                "exposure_s": exposure,
                "airmass": 1.2,
                "moon_alt_deg": -10.0,
                "moon_sep_deg": 90.0,
                "status": status,
            }
        )
        if status == "observed":
            for target in held.values():
                if target in done:
                    done[target].append(night)
    for night in (0, 1):
        own = [row["exposure_s"] for row in rows["exposures"] if row["night"] == night]
        overhead_s = sum(row["overhead_s"] for row in rows["exposures"] if row["night"] == night)
        n_complete = sum(sum(n <= night for n in done[t]) >= wanted[t] for t in wanted)
        rows["nights"].append(
            {
                "night": night,
                "evening_mjd": 57400.0 + night,
                "dark_s": 30000.0,
                "lost_s": 1000.0 * night,
                "exposing_s": sum(own),
            }
            | {
                "engineering_s": 50.0 * night,
                "overhead_s": overhead_s,
                "n_exposure": len(own),
                "completeness_frac_case": n_complete / len(wanted),
            }
        )
    allocated = {t: sum(t in held.values() for held in HELD.values()) for t in wanted}
    for t, nights in done.items():
        lost = None if len(nights) >= wanted[t] else "not-scheduled"
        first_last = {"first_night": min(nights, default=None), "last_night": max(nights, default=None)}
        status = {"target_id": t, "survey": SURVEY, "programme": "case", "n_observed": len(nights), "reason": lost}
        rows["target_status"].append(status | first_last)
        if allocated[t] < wanted[t]:
            own = {"target_id": t, "survey": SURVEY, "tile_id": targets[t]["tile_id"]}
            rows["unallocated"].append(own | {"n_allocated": allocated[t], "reason": "out-of-reach"})


def write_record(folder: Path, **more: Any) -> None:
    """Write run.json; settings and other entries besides the usual."""
    settings = {"allocation": MINIMA, **more.pop("settings", {})}
    (folder / "run.json").write_text(json.dumps({"instrument": INSTRUMENT, "settings": settings, **more}))


def _add_pointing(
    rows: dict[str, list[dict]], i: int, visit: tuple[int, int], state: dict, held: dict, missed: dict, targets: list[dict]
) -> tuple[dict, float]:
    """What the plate did at a pointing; gives the states in which the robots end, and when."""
    key = {"exposure_id": i}
    places = {HELD[visit][robot]: GOALS[visit][robot] for robot in HELD[visit]}
    goals = {robot: places[held[robot]] if robot in held else state[robot][:2] for robot in PARK}
    legs, ends, figures = _go(state, goals, visit[1], dict.fromkeys(missed, "no-path"))
    for robot in PARK:
        target = held.get(robot)
        rows["exposure_allocations"].append(
            key
            | {"robot_id": robot, "target_id": target, "kind": None if target is None else targets[target]["kind"]}
            | dict(zip(("x_mm", "y_mm", "theta_deg"), ends[robot], strict=True))
            | {"travel_mm": hypot(ends[robot][0] - state[robot][0], ends[robot][1] - state[robot][1])}
            | {"missed_target_id": missed.get(robot), "reason": "no-path" if robot in missed else None}
        )
        rows["exposure_legs"] += [key | {"robot_id": robot, "leg": n} | leg for n, leg in enumerate(legs[robot])]
    rows["exposure_paths"].append(key | figures)
    return ends, figures["configuration_time_s"]


def _add_outcome(rows: dict[str, list[dict]], targets: list[dict]) -> None:
    """All nights are of 2016: evenings from MJD 57400, 2016-01-13; robots take less than the readout of 60 s."""
    n, overhead = len(POINTINGS), sum(row["overhead_s"] for row in rows["exposures"])
    exposing = sum(row["exposure_s"] for row in rows["exposures"])
    spent = {"exposing": exposing, "reading": 60.0 * (n - 1) + 40.0, "calibrating": 48.0 * (n - 1)}
    spent |= {"slewing": 0.0, "configuring": 0.0}
    lost = {"weather": 1000.0, "engineering": 50.0, "idle": 60000.0 - 1050.0 - exposing - overhead}
    for survey, own in ((SURVEY, spent), (None, lost)):
        rows["time_budget"] += [{"year": 2016, "survey": survey, "activity": k, "time_s": v} for k, v in own.items()]
    complete = {row["target_id"] for row in rows["target_status"] if row["reason"] is None}
    science = [row for row in targets if row["kind"] == "science"]
    per_sq_deg = len(science) / (360.0**2 / pi / (12 * 64**2))
    step = floor(2 * log2(per_sq_deg))
    bins = {
        "all": lambda row: (None, None),
        "year": lambda row: (2016.0, 2017.0),
        "mag": lambda row: (floor(2 * row["mag"]) / 2, floor(2 * row["mag"]) / 2 + 0.5),
        "priority": lambda row: (5.0, 6.0),
        "density": lambda row: (2 ** (step / 2), 2 ** ((step + 1) / 2)),
        "latitude": lambda row: (floor(_latitude(row) / 10) * 10.0, floor(_latitude(row) / 10) * 10.0 + 10.0),
    }
    for quantity, bin_of in bins.items():
        for low, high in sorted({bin_of(row) for row in science}):
            own = [row["target_id"] for row in science if bin_of(row) == (low, high)]
            n_complete = len(complete & set(own))
            rows["completeness"].append(
                {"programme": "case", "survey": SURVEY, "quantity": quantity, "low": low, "high": high, "n_target": len(own)}
                | {"n_complete": n_complete, "completeness_frac": n_complete / len(own)}
            )


def _latitude(row: dict) -> float:
    """Galactic latitude, absolute, deg."""
    ra, dec, pole_ra, pole_dec = map(radians, (row["ra_deg"], row["dec_deg"], 192.85948, 27.12825))
    return abs(degrees(asin(sin(dec) * sin(pole_dec) + cos(dec) * cos(pole_dec) * cos(ra - pole_ra))))


def write_run(folder: Path, made: dict[str, pl.DataFrame]) -> Path:
    """Write the tables, the large ones in a part a tile or a night."""
    folder.mkdir(parents=True, exist_ok=True)
    write_record(folder)
    for table, frame in made.items():
        if not TABLES[table].is_in_parts:
            tables.write(frame, table, folder / f"{table}.parquet")
            continue
        if "exposure_id" in frame.columns:
            for night in (0, 1):
                own = [i for i, pointing in enumerate(POINTINGS) if pointing[0] == night]
                part = frame.filter(pl.col("exposure_id").is_in(own))
                tables.write(part, table, folder / table / f"nights-{night:05d}.parquet")
            continue
        for tile in CENTRES:
            part = frame.filter(pl.col("tile_id") == tile)
            tables.write(part, table, folder / table / f"{SURVEY}-{tile:05d}.parquet")
    return folder
