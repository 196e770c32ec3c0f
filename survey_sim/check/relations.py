"""Tables one by one and against each other: types, nulls, codes, ranges, keys, and rows that refer to rows."""

import polars as pl

from survey_sim.check.faults import Fault, FaultLog
from survey_sim.schema import PATHS, TABLES, TARGET_KINDS

VISIT = ["survey", "tile_id", "visit_id"]
TILE = ["survey", "tile_id"]
ROBOT = ["survey", "robot_id"]

_CODES: dict[tuple[str, str], tuple[str, ...]] = {
    ("robots", "kind"): ("science", "guide"),
    ("robots", "state"): ("live", "dead"),
    ("targets", "kind"): TARGET_KINDS,
    ("allocations", "kind"): TARGET_KINDS,
    ("exposure_allocations", "kind"): TARGET_KINDS,
    ("visits", "start"): ("previous", "park"),
    ("paths", "path"): PATHS,
    ("legs", "path"): PATHS,
    ("robot_times", "path"): PATHS,
    ("executions", "path"): PATHS,
    ("executions", "mode"): ("open-loop", "resync", "keep-order"),
}
# Reasons and states that stages name themselves: lower-case words joined by hyphens.
_WORDS = {
    ("robot_times", "reason"),
    ("exposure_allocations", "reason"),
    ("target_status", "reason"),
    ("rejected", "reason"),
    ("unallocated", "reason"),
    ("exposures", "status"),
}
_WORD = "^[a-z0-9]+(-[a-z0-9]+)*$"
_RANGES = {
    "ra_deg": (0.0, 360.0),
    "dec_deg": (-90.0, 90.0),
    "moon_alt_deg": (-90.0, 90.0),
    "moon_sep_deg": (0.0, 180.0),
    "priority": (1.0, 9.0),
}
_NOT_NEGATIVE = {"leg", "ticks", "crossings", "collisions", "unrouted", "wanted_visits", "patrol_radius_mm", "precise_mm"}
# A plate of one robot has no pair, so no least separation.
_MAY_BE_INFINITE = {(table, "min_separation_mm") for table in ("paths", "exposure_paths", "executions")}


def check_table(log: FaultLog, frame: pl.DataFrame, table: str) -> bool:
    """Whether a table (or part) is sound enough to look further: columns, types, nulls, finite numbers, keys, codes.

    Values out of range are faults too, but leave it sound.
    """
    found = log.count["schema"]
    declared = TABLES[table]
    for column in declared.columns:
        if frame.schema.get(column.name) != column.dtype:
            detail = f"{column.name} is {frame.schema.get(column.name, 'absent')}, declared {column.dtype}"
            log.add_one(Fault("schema", table, detail=detail))
    for name in frame.columns:
        if declared.column(name) is None:
            log.add_one(Fault("schema", table, detail=f"{name} is not declared"))
    if log.count["schema"] > found:
        return False
    for name in frame.columns:
        _check_values(log, frame, table, name)
    repeated = frame.filter(frame.select(declared.key).is_duplicated())
    log.add("schema", table, repeated, f"rows share the key {', '.join(declared.key)}")
    is_sound = log.count["schema"] == found
    for name in frame.columns:
        _check_range(log, frame, table, name)
    return is_sound


def check_refers(
    log: FaultLog, frame: pl.DataFrame, table: str, other: pl.DataFrame, other_table: str, on: list[str]
) -> None:
    """Faults for rows that name a row of another table that is not there."""
    lost = frame.join(other, on=on, how="anti", maintain_order="left")
    log.add("schema", table, lost, f"no row of {other_table} has this {', '.join(on)}")


def check_small(log: FaultLog, robots: pl.DataFrame, tiles: pl.DataFrame, visits: pl.DataFrame, paths: pl.DataFrame) -> None:
    """Visits of known tiles, counted from 0, on plates with robots; and their three paths."""
    check_refers(log, visits, "visits", tiles, "tiles", TILE)
    check_refers(log, visits, "visits", robots, "robots", ["survey"])
    check_refers(log, paths, "paths", visits, "visits", VISIT)
    counted = visits.sort(VISIT).with_columns(place=pl.int_range(pl.len()).over(TILE))
    gaps = counted.filter(pl.col("visit_id") != pl.col("place"))
    log.add("schema", "visits", gaps, "visits of a tile are not counted from 0 without gaps", limit=pl.col("place"))
    wanted = visits.select(VISIT).join(pl.DataFrame({"path": PATHS}), how="cross")
    check_present(log, wanted, paths, "paths", [*VISIT, "path"])


def unsound_tiles(
    log: FaultLog, parts: dict[str, pl.DataFrame], visits: pl.DataFrame, robots: pl.DataFrame, seen: pl.DataFrame
) -> pl.DataFrame:
    """Tiles of a part whose rows do not fit together; their faults are logged, and they are not looked at further.

    Every visit of a tile has a row of `allocations` for each robot of its survey, and a row of `robot_times` for each robot
    and path; every row of the three tables names a known visit and robot; a tile is in one part only.

    Parameters
    ----------
    parts
        The part's `allocations`, `legs` and `robot_times`.
    seen
        (survey, tile_id) of the tiles of earlier parts.
    """
    bad = []
    here = pl.concat([frame.select(TILE).unique() for frame in parts.values()]).unique(maintain_order=True)
    for table, frame in parts.items():
        for other, name, on in ((visits, "visits", VISIT), (robots, "robots", ROBOT)):
            check_refers(log, frame, table, other, name, on)
            bad.append(frame.join(other, on=on, how="anti").select(TILE))
    twice = here.join(seen, on=TILE, how="semi", maintain_order="left")
    log.add("schema", "allocations", twice, "tile is in more than one part")
    bad.append(twice)
    wanted = visits.join(here, on=TILE, how="semi").select(VISIT).join(robots.select(ROBOT), on="survey")
    bad.append(check_present(log, wanted, parts["allocations"], "allocations", [*VISIT, "robot_id"]).select(TILE))
    routes = wanted.join(pl.DataFrame({"path": PATHS}), how="cross")
    lacking = check_present(log, routes, parts["robot_times"], "robot_times", [*VISIT, "path", "robot_id"])
    bad.append(lacking.select(TILE))
    return pl.concat(bad).unique()


def check_present(log: FaultLog, wanted: pl.DataFrame, frame: pl.DataFrame, table: str, key: list[str]) -> pl.DataFrame:
    """Faults for the rows of `wanted` that the table lacks; gives these."""
    lacking = wanted.join(frame, on=key, how="anti", maintain_order="left")
    log.add("schema", table, lacking, "row is missing")
    return lacking


def _check_values(log: FaultLog, frame: pl.DataFrame, table: str, name: str) -> None:
    """Faults for nulls, numbers that are not finite, and unknown codes."""
    column = TABLES[table].column(name)
    value = pl.col(name)
    if column is not None and not column.is_nullable and frame[name].null_count():
        log.add("schema", table, frame.filter(value.is_null()), f"{name} is null")
    if frame.schema[name].is_float():
        is_wrong = value.is_nan() if (table, name) in _MAY_BE_INFINITE else ~value.is_finite()
        log.add("schema", table, frame.filter(is_wrong), f"{name} is not a finite number")
    if (codes := _CODES.get((table, name))) is not None:
        unknown = frame.filter(~value.is_in(codes))
        log.add("schema", table, unknown, pl.format("{} '{}' is not a known code", pl.lit(name), value))
    if (table, name) in _WORDS:
        unknown = frame.filter(~value.str.contains(_WORD))
        log.add("schema", table, unknown, pl.format("{} '{}' is not a code", pl.lit(name), value))


def _check_range(log: FaultLog, frame: pl.DataFrame, table: str, name: str) -> None:
    low, high = _RANGES.get(name, (None, None))
    if "_frac" in name:
        low, high = 0.0, 1.0
    elif name in _NOT_NEGATIVE or name.startswith("n_") or name.endswith("_s"):
        low = 0.0
    if low is not None:
        bad = frame.filter(pl.col(name) < low)
        log.add("schema", table, bad, f"{name} is too small", value=pl.col(name), limit=low)
    if high is not None:
        bad = frame.filter(pl.col(name) > high + 1e-9)
        log.add("schema", table, bad, f"{name} is too large", value=pl.col(name), limit=high)
