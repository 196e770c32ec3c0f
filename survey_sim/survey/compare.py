"""Scenarios side by side: measures of each run, and paired differences with their uncertainties.

Runs of one seed are a pair: they have the same sky and, where the scenario does not change them, the same tiles and weather.
The statistic is the mean over seeds of the paired differences, its standard error (sample standard deviation / sqrt(n)), and
the 95 % interval of Student's t with n - 1 degrees of freedom. One seed has no uncertainty, and none is shown.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from survey_sim import tables
from survey_sim.errors import InputError, did_you_mean
from survey_sim.plotting import RunTables
from survey_sim.plotting.comparison import draw_comparison
from survey_sim.survey.imprint import imprint_runs
from survey_sim.survey.measures import measure_run

CONFIDENCE = 0.95
_CURVE = "completeness_frac_"
_QUANTILES = np.linspace(0.0, 1.0, 201)
# What runs of one scenario may differ in.
_OF_A_SEED = ("name", "seed", "mock_seed")


@dataclass(frozen=True)
class ComparedRun:
    """A run, its scenario and its seed."""

    tables: RunTables
    scenario: str
    seed: int


def compare_runs(run_dirs: Sequence[Path], out: Path | None = None, reference: str | None = None) -> Path:
    """Compare runs, and write the tables of the comparison and `comparison.json`; gives their folder.

    Parameters
    ----------
    run_dirs
        Folders of runs, or of sweeps: all runs in it.
    out
        Folder of the comparison; `comparison/` in the sweep's folder, or else runs/comparison, by default.
    reference
        Scenario that the others are compared to; the sweep's, or else the first, by default.

    Raises
    ------
    InputError
        A folder holds no run; two runs of one scenario and seed; an unknown reference.
    """
    runs = read_runs(run_dirs)
    scenarios = _scenarios(runs, reference)
    measures = pl.concat([_tagged(measure_run(run.tables), run) for run in runs])
    rows = compare_measures(measures, scenarios)
    folder = out or (run_dirs[0] / "comparison" if _is_sweep(run_dirs[0]) else Path("runs") / "comparison")
    made = {
        "measures": measures,
        "comparison": rows,
        "completeness_curves": _curves(runs),
        "configuration_quantiles": _configuration_quantiles(runs, scenarios),
        **imprint_runs([(run.scenario, run.tables) for run in runs]),
    }
    for name, frame in made.items():
        tables.write(frame, name, folder / f"{name}.parquet")
    titles = {given.get("title") or given.get("sweep") for run in runs for given in [run.tables.record.get("scenario", {})]}
    title = titles.pop() if len(titles) == 1 and None not in titles else ", ".join(scenarios)
    shared = {name: _shared(runs, name, scenarios[0]) for name in scenarios[1:]}
    _write_about(folder, title, scenarios, runs, shared)
    return folder


def write_imprint(run_dir: Path, out: Path | None = None) -> Path:
    """Write the imprint's tables and figures of one run; gives their folder, `imprint/` in the run's by default."""
    run, folder = RunTables(run_dir), out or run_dir / "imprint"
    for name, frame in imprint_runs([(run.name, run)]).items():
        tables.write(frame, name, folder / f"{name}.parquet")
    _write_about(folder, run.name, [run.name], [ComparedRun(run, run.name, int(run.setting("run", "seed") or 0))], {})
    for _ in draw_comparison(folder, ("imprint_pairs", "imprint_place", "imprint_plate")):
        pass
    return folder


def _write_about(
    folder: Path, title: str, scenarios: Sequence[str], runs: Sequence[ComparedRun], shared: dict[str, str]
) -> None:
    """Write comparison.json: all that the figures and the page say besides the tables."""
    about = {
        "title": title,
        "scenarios": list(scenarios),
        "n_seed": len({run.seed for run in runs}),
        "shared": shared,
        "changes": {run.scenario: run.tables.record.get("scenario", {}).get("changes", {}) for run in runs},
        "min_separation_deg": {run.scenario: _separation_deg(run.tables) for run in runs},
        "runs": [{"scenario": run.scenario, "seed": run.seed, "folder": str(run.tables.folder)} for run in runs],
    }
    tables.write_bytes((json.dumps(about, indent=2) + "\n").encode(), folder / "comparison.json")


def _separation_deg(run: RunTables) -> float:
    """Least separation of two robots on the sky."""
    return float(run.instrument["min_separation_mm"] * run.instrument["plate_scale_arcsec_mm"] / 3600.0)


def read_runs(run_dirs: Sequence[Path]) -> list[ComparedRun]:
    """The runs of some folders, each with its scenario and seed.

    Runs that are no sweep's are of one scenario if their settings are the same but for their names and seeds.
    """
    found = [RunTables(folder) for run_dir in run_dirs for folder in _folders(run_dir)]
    names: dict[str, str] = {}
    runs = []
    for run in found:
        given = run.record.get("scenario")
        settings = {**run.record.get("settings", {})}
        own = settings.get("run", {})
        settings["run"] = {key: value for key, value in own.items() if key not in _OF_A_SEED}
        name = given["scenario"] if given else names.setdefault(json.dumps(settings, sort_keys=True), run.name)
        runs.append(ComparedRun(run, name, int(given["seed"] if given else own.get("seed", 0))))
    keys = [(run.scenario, run.seed) for run in runs]
    twice = sorted({key for key in keys if keys.count(key) > 1})
    if twice:
        words = [f"{scenario}, seed {seed}" for scenario, seed in twice]
        raise InputError("runs of the same scenario and seed", rows=words, remedy="name each run once")
    return runs


def compare_measures(measures: pl.DataFrame, scenarios: Sequence[str]) -> pl.DataFrame:
    """Table `comparison` of table `measures`; the first scenario is the reference."""
    keys = ["of", "measure", "unit"]
    known = measures.filter(pl.col("value").is_not_null())
    pairs = known.join(
        known.filter(scenario=scenarios[0]).select(*keys, "seed", base="value"), on=[*keys, "seed"], how="left"
    ).with_columns(difference=pl.col("value") - pl.col("base"))
    rows = pairs.group_by("scenario", *keys).agg(
        n_seed=pl.len(),
        mean=pl.col("value").mean(),
        mean_error=pl.col("value").std() / pl.len().sqrt(),
        n_pair=pl.col("difference").count(),
        difference=pl.col("difference").mean(),
        difference_error=pl.col("difference").std() / pl.col("difference").count().sqrt(),
    )
    rows = measures.select("scenario", *keys).unique().join(rows, on=["scenario", *keys], how="left")
    half = pl.col("difference_error") * pl.Series("t", _student(rows["n_pair"].fill_null(0).to_numpy()))
    return rows.with_columns(
        pl.col("n_seed", "n_pair").fill_null(0),
        reference=pl.lit(scenarios[0]),
        difference_low=pl.col("difference") - half,
        difference_high=pl.col("difference") + half,
    )


def _student(n_pair: np.ndarray) -> np.ndarray:
    """(n,) half width of the 95 % interval in standard errors."""
    from scipy.stats import t  # noqa: PLC0415 - 0.3 s that the command line's help need not pay

    return np.asarray(t.ppf(0.5 + CONFIDENCE / 2.0, np.maximum(n_pair - 1, 1)))


def _folders(run_dir: Path) -> Iterator[Path]:
    """The run in a folder, or those of the sweep that is in it and are finished."""
    if (run_dir / "run.json").is_file() or not run_dir.is_dir():
        yield run_dir
        return
    inside = sorted(path.parent for path in run_dir.glob("*/seed-*/run.json"))
    inside = [folder for folder in inside if "schedule" in tables.read_record(folder).get("stages", {})]
    if not inside:
        raise InputError("no run and no sweep here", file=run_dir, remedy="name the folder of a finished run or sweep")
    yield from inside


def _is_sweep(run_dir: Path) -> bool:
    return not (run_dir / "run.json").is_file()


def _scenarios(runs: Sequence[ComparedRun], reference: str | None) -> list[str]:
    """Names in the order of the runs, the reference first."""
    names = list(dict.fromkeys(run.scenario for run in runs))
    given = {str(run.tables.record["scenario"]["reference"]) for run in runs if "scenario" in run.tables.record}
    first = reference or (given.pop() if len(given) == 1 else names[0])
    if first not in names:
        raise InputError(f"no run is of the scenario {first!r}", place="--reference", remedy=did_you_mean(first, names))
    order = next((run.tables.record["scenario"].get("order") for run in runs if "scenario" in run.tables.record), None)
    names.sort(key=lambda name: order.index(name) if order and name in order else len(order or ()))
    return [first, *(name for name in names if name != first)]


def _tagged(frame: pl.DataFrame, run: ComparedRun) -> pl.DataFrame:
    return frame.select(pl.lit(run.scenario).alias("scenario"), pl.lit(run.seed).alias("seed"), pl.all())


def _curves(runs: Sequence[ComparedRun]) -> pl.DataFrame:
    """Table `completeness_curves`."""
    frames = [tables.empty("completeness_curves")]
    for run in runs:
        curves = run.tables.nights.select("night", pl.col(f"^{_CURVE}.*$").name.map(lambda name: name.removeprefix(_CURVE)))
        long = curves.unpivot(index="night", variable_name="programme", value_name="completeness_frac")
        frames.append(_tagged(long, run).select(frames[0].columns))
    return pl.concat([frames[0], *(frame.cast(frames[0].schema) for frame in frames[1:])])


def _configuration_quantiles(runs: Sequence[ComparedRun], scenarios: Sequence[str]) -> pl.DataFrame:
    """Table `configuration_quantiles`."""
    frames = [tables.empty("configuration_quantiles")]
    columns = ("configuration_time_s", "configuration_time_p95_s")
    for scenario in scenarios:
        own = [run.tables for run in runs if run.scenario == scenario]
        paths = pl.concat([run.paths.filter(path="start_to_target").select("survey", *columns) for run in own])
        for (survey,), rows in paths.partition_by("survey", as_dict=True).items():
            values = {column: np.quantile(rows[column].to_numpy(), _QUANTILES) for column in columns}
            fixed = {"scenario": scenario, "survey": survey, "readout_s": own[0].readout_s}
            frame = pl.DataFrame({"quantile_frac": _QUANTILES, **values}).with_columns(
                **{name: pl.lit(value) for name, value in fixed.items()}
            )
            frames.append(frame.select(frames[0].columns).cast(frames[0].schema))
    return pl.concat(frames)


def _shared(runs: Sequence[ComparedRun], scenario: str, reference: str) -> str:
    """What all pairs of two scenarios have in common."""
    by_seed: dict[str, dict[int, RunTables]] = {
        name: {run.seed: run.tables for run in runs if run.scenario == name} for name in (scenario, reference)
    }
    seeds = sorted(set(by_seed[scenario]) & set(by_seed[reference]))
    if not seeds:
        return "no seed in common: nothing is paired"
    pairs = [(by_seed[scenario][seed], by_seed[reference][seed]) for seed in seeds]
    what = {
        "sky and tiles": [_checksum(one, "targets") == _checksum(two, "targets") for one, two in pairs],
        "weather": [_weather(one) == _weather(two) for one, two in pairs],
    }
    same = [words for words, is_same in what.items() if all(is_same)]
    other = [words for words, is_same in what.items() if not all(is_same)]
    words = f"same {', '.join(same)}" if same else ""
    return "; ".join(filter(None, [words, f"other {', '.join(other)}" if other else ""])) + f"; {len(seeds)} pairs"


def _checksum(run: RunTables, table: str) -> list[str]:
    return [tables.checksum(path) for path in tables.files(run.folder, table)]


def _weather(run: RunTables) -> tuple[Any, ...]:
    """All that the clouds of a run's nights depend on."""
    keys = (("schedule", "weather"), ("run", "seed"), ("schedule", "start_date"), ("schedule", "end_date"))
    return tuple(run.setting(*key) for key in keys)
