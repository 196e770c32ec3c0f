"""A small run for figures: every table through the schema, numbers made up but of the right kind; no stage is run."""

import json
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from survey_sim import tables
from survey_sim.instrument import load_instrument, make_plate, robots_table
from survey_sim.schema import PATHS, TABLES

KINDS = ("science", "standard", "sky", "guide")
FIRST_EVENING_MJD = 57388.085913
N_NIGHT = 5


def write_run(
    folder: Path,
    programmes: tuple[tuple[str, str], ...] = (("galaxy", "taipan"), ("cosmology", "taipan"), ("stars", "funnelweb")),
    n_tile: int = 3,
    n_visit: int = 4,
    n_target: int = 60,
    spread_deg: float = 10.0,
    unrouted: bool = False,
    settings: dict[str, Any] | None = None,
    without: tuple[str, ...] = (),
    record: tuple[str, ...] | None = None,
) -> Path:
    """Write a run into a folder.

    Parameters
    ----------
    programmes
        Name and survey of each.
    n_tile, n_visit, n_target
        Tiles of a survey, visits of a tile, targets of a programme in a tile.
    spread_deg
        Right ascension between tiles.
    settings
        Sections of the pipeline's settings besides the usual.
    without
        Tables that are not written.
    record
        Entries of run.json that are written; all by default.
    """
    rng = np.random.default_rng(5)
    plate = make_plate(load_instrument("taipan-150", {"n_science": 12}), dead=(3,))
    surveys = sorted({survey for _, survey in programmes})
    tiles = pl.DataFrame(
        [
            {"survey": survey, "tile_id": tile, "ra_deg": (355.0 + spread_deg * tile) % 360, "dec_deg": -30.0, "n_target": 0}
            for survey in surveys
            for tile in range(n_tile)
        ],
        schema=dict(tables.empty("tiles").schema),
    )
    targets = _targets(rng, tiles, programmes, n_target)
    made = targets.group_by("survey", "tile_id").len()
    tiles = (
        tiles.join(made, on=["survey", "tile_id"], how="left").with_columns(n_target=pl.col("len").fill_null(0)).drop("len")
    )
    status = _status(rng, targets)
    visits = _visit_tables(rng, tiles, targets, plate, n_visit, unrouted)
    frames = {
        "robots": pl.concat([robots_table(plate, survey) for survey in surveys]),
        "targets": targets,
        "rejected": tables.empty("rejected"),
        "tiles": tiles,
        **visits,
        "unallocated": targets.filter(~pl.col("target_id").is_in(visits["allocations"]["target_id"].implode())).select(
            "target_id", "survey", "tile_id", n_allocated=pl.lit(0), reason=pl.lit("crowded")
        ),
        **_night_tables(rng, tiles, n_visit, [name for name, _ in programmes]),
        "target_status": status.drop("tile_id"),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, frame in frames.items():
        if name not in without:
            path = folder / name / "part-00000.parquet" if TABLES[name].is_in_parts else folder / f"{name}.parquet"
            tables.write(frame, name, path)
    entries = {
        "package": "survey-sim",
        "version": "0",
        "schema_version": 1,
        "name": folder.name,
        "seed": 5,
        "instrument": plate.instrument.model_dump(mode="json"),
        "settings": {
            "programme": [
                {"name": name, "survey": survey, "kind": "science", "completeness_frac": 0.5} for name, survey in programmes
            ],
            "report": {"title": "", "plate": None, "dpi": 60},
            "schedule": {"start_date": str(date(2016, 1, 1)), "telescope": {"readout_s": 60.0}, "surveys": {}},
            **(settings or {}),
        },
        "stages": {"targets": {"wall_s": 1.0, "cpu_s": 1.0}},
        "catalogues": {"counts": {"mock": {"rows": 10}}, "sha256": {"mock": "00ff"}},
        "warnings": {"schedule": ["survey <b>taipan</b>: a warning"]},
    }
    kept = {key: value for key, value in entries.items() if record is None or key in record}
    (folder / "run.json").write_text(json.dumps(kept))
    return folder


def _targets(rng: np.random.Generator, tiles: pl.DataFrame, programmes: tuple[tuple[str, str], ...], n: int) -> pl.DataFrame:
    frames = [tables.empty("targets")]
    for name, survey in programmes:
        for tile in tiles.filter(survey=survey).iter_rows(named=True):
            frames.append(
                pl.DataFrame(
                    {
                        "target_id": np.arange(n) + 1000 * len(frames),
                        "survey": [survey] * n,
                        "programme": [name] * n,
                        "kind": ["science"] * n,
                        "source_id": [f"{name}-{i}" for i in range(n)],
                        "ra_deg": (tile["ra_deg"] + rng.uniform(-2, 2, n)) % 360,
                        "dec_deg": tile["dec_deg"] + rng.uniform(-2, 2, n),
                        "mag": rng.uniform(9, 11, n),
                        "priority": [5] * n,
                        "wanted_visits": [1] * n,
                        "tile_id": [tile["tile_id"]] * n,
                        "_healpix_29": np.arange(n),
                    }
                ).cast(dict(tables.empty("targets").schema))
            )
    return pl.concat(frames)


def _status(rng: np.random.Generator, targets: pl.DataFrame) -> pl.DataFrame:
    n = len(targets)
    reason = rng.choice(np.array([None, None, None, "crowded", "not-scheduled"], dtype=object), n)
    is_done = np.array([one is None for one in reason], dtype=bool)
    return targets.select("target_id", "survey", "programme", "tile_id").with_columns(
        n_observed=pl.Series(is_done, dtype=pl.Int16),
        first_night=pl.lit(None, pl.Int32),
        last_night=pl.lit(None, pl.Int32),
        reason=pl.Series(list(reason), dtype=pl.String),
    )


def _visit_tables(
    rng: np.random.Generator, tiles: pl.DataFrame, targets: pl.DataFrame, plate: Any, n_visit: int, unrouted: bool
) -> dict[str, pl.DataFrame]:
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in ("visits", "allocations", "paths", "legs", "robot_times")}
    for tile in tiles.iter_rows(named=True):
        before = plate.park_mm
        of_tile = targets.filter(survey=tile["survey"], tile_id=tile["tile_id"]).sort(pl.col("target_id") % 1000)
        own = iter(of_tile["target_id"].to_list())
        for visit in range(n_visit):
            keys = {"survey": tile["survey"], "tile_id": tile["tile_id"], "visit_id": visit}
            after = plate.park_mm + rng.uniform(-5, 5, plate.park_mm.shape) * plate.is_live[:, None]
            travel = np.hypot(*(after - before).T)
            bound = float(rng.uniform(5, 25))
            times = {"configuration_time_s": bound * rng.choice([1.0, 1.2]), "lower_bound_s": bound}
            times["configuration_time_p95_s"] = 0.8 * bound
            counts = {"ticks": 3, "collisions": 0, "unrouted": int(unrouted)}
            done = 0.2 + 0.6 * visit / max(1, n_visit - 1)
            rows["visits"].append(
                {
                    **keys,
                    **times,
                    **counts,
                    "start": "previous" if visit else "park",
                    "mag_bright": 9.0,
                    "mag_faint": 11.0,
                    **{f"n_{kind}": 3 for kind in KINDS},
                    "n_idle": 2,
                    **{f"{name}_shortfall": 0 for name in (*KINDS[1:], "sky_region")},
                    "sky_shortfall": 2 * (visit % 2),
                    "completeness_frac": done,
                    "ideal_completeness_frac": min(1.0, done + 0.2),
                    "completeness_bound_frac": min(1.0, done + 0.1),
                    "travel_mean_mm": travel.mean(),
                    "travel_p95_mm": travel.max(),
                    "travel_max_mm": travel.max(),
                    "crossings": int(rng.integers(0, 3)),
                }
            )
            for path in PATHS:
                extra = {"configuration_time_median_s": 0.5 * bound, "min_separation_mm": 9.0 + rng.random()}
                rows["paths"].append({**keys, "path": path, **times, **counts, **extra})
            for robot, (x, y) in enumerate(after):
                kind = None if not plate.is_live[robot] else KINDS[robot % 4]
                name = {"robot_id": int(plate.robot_id[robot])}
                target = next(own, None) if kind == "science" else robot if kind else None
                held = {"target_id": target, "kind": kind if target is not None else None}
                rows["allocations"].append({**keys, **name, **held, "x_mm": x, "y_mm": y, "travel_mm": travel[robot]})
                for path in PATHS:
                    spent = {"rotating_s": 0.5, "moving_s": travel[robot] / 2, "waiting_s": float(robot % 3)}
                    reason = "no-path" if unrouted and robot == 1 else None
                    rows["robot_times"].append({**keys, "path": path, **name, **spent, "reason": reason})
                    if travel[robot] > 0:
                        step = after[robot] - before[robot]
                        rows["legs"].append(
                            {
                                **keys,
                                "path": path,
                                **name,
                                "leg": 0,
                                "start_s": 0.0,
                                "rotate_deg": 0.0,
                                "dx_mm": step[0],
                                "dy_mm": step[1],
                                "precise_mm": 0.02,
                                "x_mm": x,
                                "y_mm": y,
                                "theta_deg": 0.0,
                            }
                        )
            before = after
    return {name: pl.DataFrame(own, infer_schema_length=None) if own else tables.empty(name) for name, own in rows.items()}


def _night_tables(
    rng: np.random.Generator, tiles: pl.DataFrame, n_visit: int, programmes: list[str]
) -> dict[str, pl.DataFrame]:
    pointings = [
        {
            "exposure_id": number,
            "night": number % N_NIGHT,
            "start_mjd": FIRST_EVENING_MJD + number % N_NIGHT + 0.5 + 0.01 * (number // N_NIGHT),
            "survey": tile["survey"],
            "tile_id": tile["tile_id"],
            "visit_id": visit,
            "slew_s": 20.0,
            "configuration_time_s": float(rng.uniform(10, 50)),
            "readout_s": 60.0,
            "overhead_s": 108.0,
            "exposure_s": 600.0,
            "airmass": float(rng.uniform(1, 2)),
            "moon_alt_deg": -10.0,
            "moon_sep_deg": 90.0,
            "status": "observed" if number % 5 else "interrupted",
        }
        for number, (visit, tile) in enumerate((v, t) for v in range(n_visit) for t in tiles.iter_rows(named=True))
    ]
    night = np.arange(N_NIGHT)
    nights = {
        "night": night,
        "evening_mjd": FIRST_EVENING_MJD + night,
        "dark_s": np.full(N_NIGHT, 28_000.0),
        "lost_s": np.full(N_NIGHT, 8_000.0),
        "engineering_s": np.zeros(N_NIGHT),
        "exposing_s": np.full(N_NIGHT, 2_400.0),
        "overhead_s": np.full(N_NIGHT, 300.0),
        "n_exposure": np.full(N_NIGHT, len(pointings) // N_NIGHT),
        **{f"completeness_frac_{name}": (night + 1) / N_NIGHT * 0.6 for name in programmes},
    }
    budget = {"year": [2015, 2016, 2016], "survey": [None, None, "taipan"], "activity": ["idle", "idle", "exposing"]}
    counted = [
        {"programme": name, "survey": "any", "quantity": quantity, "low": low, "high": low + 1.0}
        | {"n_target": 10, "n_complete": 6, "completeness_frac": 0.6}
        for name in programmes
        for quantity, low in (("year", 2016.0), ("mag", 10.0))
    ]
    return {
        "exposures": pl.DataFrame(pointings) if pointings else tables.empty("exposures"),
        "nights": pl.DataFrame(nights),
        "time_budget": pl.DataFrame({**budget, "time_s": [3600.0, 7200.0, 1800.0]}),
        "completeness": pl.DataFrame(counted) if counted else tables.empty("completeness"),
    }
