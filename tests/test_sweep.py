"""Sweeps: what scenarios share is computed once, each run is what it would be alone, bad files are refused."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from survey_sim import tables
from survey_sim.check import check_run
from survey_sim.cli import app
from survey_sim.errors import InputError
from survey_sim.folders import data_folder, find_pipeline
from survey_sim.schema import TABLES
from survey_sim.survey.engine import run_stages
from survey_sim.survey.run import open_run
from survey_sim.survey.settings import load_pipeline
from survey_sim.survey.sweep import is_sweep, load_sweep, plan_sweep, run_sweep
from survey_sim.survey.workers import Workers
from tests.small_survey import write_small_survey

SWEEP = """
base = "small.toml"
title = "Configuration time"
seeds = [3, 4]
set = { "schedule.end_date" = 2016-10-06, "allocation.visits" = 3 }
reference = "routed"

[[scenario]]
name = "constant"
set = { "schedule.configuration_s" = 300.0 }

[[scenario]]
name = "routed"

[[scenario]]
name = "wide"
set = { "instrument.patrol_radius_mm" = 75.0 }
"""
QUIET = Console(quiet=True)


def _write(folder: Path, text: str = SWEEP) -> Path:
    write_small_survey(folder)
    path = folder / "question.toml"
    path.write_text(text)
    return path


def _inode(folder: Path, name: str) -> int:
    return (folder / name).stat().st_ino


@pytest.fixture(scope="module")
def sky(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _write(tmp_path_factory.mktemp("sky"))


@pytest.fixture(scope="module")
def finished(sky: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished sweep; not to be changed."""
    sweep = load_sweep(sky, tmp_path_factory.mktemp("runs") / "question")
    run_sweep(sweep, Workers(), QUIET)
    return sweep.folder


def test_stages_that_a_change_does_not_touch_are_shared(finished: Path) -> None:
    routed, constant, wide = (finished / name / "seed-3" for name in ("routed", "constant", "wide"))
    part = next((routed / "legs").iterdir()).name
    for name in ("targets.parquet", "tiles.parquet", "visits.parquet", f"legs/{part}"):
        assert _inode(constant, name) == _inode(routed, name), name
    assert _inode(constant, "exposures.parquet") != _inode(routed, "exposures.parquet")
    assert _inode(wide, "rejected.parquet") == _inode(routed, "rejected.parquet")
    assert _inode(wide, "visits.parquet") != _inode(routed, "visits.parquet")
    other_seed = finished / "routed" / "seed-4"
    assert (other_seed / "exposures.parquet").read_bytes() != (routed / "exposures.parquet").read_bytes()


def test_a_run_of_a_sweep_is_what_it_would_be_alone(finished: Path, sky: Path, tmp_path: Path) -> None:
    values = {"schedule.end_date": "2016-10-06", "allocation.visits": 3, "schedule.configuration_s": 300.0}
    changes = ("run.seed=3", "run.mock_seed=3")
    alone = open_run(sky.parent / "small.toml", Workers(), tmp_path / "alone", changes, values_set=values)
    with alone.locked():
        run_stages(alone, skipped=("report",))
    shared = finished / "constant" / "seed-3"
    for table in TABLES:
        names = [path.relative_to(alone.folder) for path in tables.files(alone.folder, table)]
        assert [path.relative_to(shared) for path in tables.files(shared, table)] == names
        assert all((alone.folder / name).read_bytes() == (shared / name).read_bytes() for name in names), table
    assert check_run(shared).is_passed
    ours, theirs = (json.loads((folder / "run.json").read_text()) for folder in (shared, alone.folder))
    assert ours["targets"] == theirs["targets"]
    assert set(ours["stages"]) == set(theirs["stages"])
    assert ours["scenario"]["changes"] == json.loads(json.dumps(values, default=str))


def test_a_dry_run_says_what_would_run_and_what_would_be_taken(sky: Path, finished: Path, tmp_path: Path) -> None:
    assert {line.rsplit(": ", 1)[1] for line in plan_sweep(load_sweep(sky, finished))} == {"up to date"}
    fresh = list(plan_sweep(load_sweep(sky, tmp_path / "fresh")))
    assert len(fresh) == 6 * 5
    assert fresh[0] == "routed, seed 3: targets: never run"
    assert not (tmp_path / "fresh").exists()
    changed = CliRunner().invoke(
        app, ["run", str(sky), "--out", str(finished), "--set", "schedule.end_date=2016-10-05", "--dry-run"]
    )
    lines = changed.output.splitlines()
    assert "wide, seed 4: visits: up to date" in lines
    assert "wide, seed 4: schedule: settings changed: schedule.end_date" in lines


def test_runs_that_were_lost_are_taken_from_the_others_and_damage_is_noticed(sky: Path, tmp_path: Path) -> None:
    sweep = load_sweep(sky, tmp_path / "question", ["allocation.visits=1", "schedule.end_date=2016-10-02"])
    run_sweep(sweep, Workers(), QUIET)
    member = sweep.members[0]
    before = (member.folder / "visits.parquet").read_bytes()
    for path in sorted(member.folder.rglob("*"), reverse=True):
        path.unlink() if path.is_file() else path.rmdir()
    lines = list(plan_sweep(sweep))
    assert lines[0] == "routed, seed 3: targets: as in routed-seed-3"
    shared = next((sweep.folder / ".shared").glob("visits-*/visits.parquet"))
    shared.chmod(0o644)
    shared.unlink()
    shared.write_bytes(b"damaged")
    run_sweep(sweep, Workers(), QUIET)
    assert (member.folder / "visits.parquet").read_bytes() == before
    assert {line.rsplit(": ", 1)[1] for line in plan_sweep(sweep)} == {"up to date"}


def test_processes_side_by_side_make_the_same(sky: Path, finished: Path, tmp_path: Path) -> None:
    one_scenario = sky.parent / "one.toml"
    one_scenario.write_text(SWEEP.split("[[scenario]]", 1)[0] + '[[scenario]]\nname = "routed"\n')
    sweep = load_sweep(one_scenario, tmp_path / "two")
    run_sweep(sweep, Workers(2), QUIET)
    for member in sweep.members:
        alone = finished / member.folder.relative_to(sweep.folder)
        files = [path.relative_to(alone) for table in TABLES for path in tables.files(alone, table)]
        assert len(files) > 10
        assert all((member.folder / name).read_bytes() == (alone / name).read_bytes() for name in files)


def _wait_for_the_end_of(group: int) -> None:
    """Until no process of a group is left; workers that go on for longer are ended, and are a failure."""
    for _ in range(200):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    os.killpg(group, signal.SIGKILL)
    pytest.fail("workers go on after the sweep was interrupted")


@pytest.mark.parametrize("n_worker", [0, 2])
def test_an_interrupted_sweep_ends_with_one_line_and_goes_on(
    n_worker: int, sky: Path, finished: Path, tmp_path: Path
) -> None:
    out = tmp_path / "question"
    how = ["--workers", str(n_worker)] if n_worker else ["--serial"]
    command = [sys.executable, "-m", "survey_sim", "run", str(sky), "--out", str(out), *how, "--quiet"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    while process.poll() is None and not list(out.glob("*/seed-*/.state/parts/*.json")):
        time.sleep(0.01)
    process.send_signal(signal.SIGTERM)
    _, message = process.communicate(timeout=60)
    line = "error: interrupted: finished tiles are kept, run the same command again to go on\n"
    assert (process.returncode, message) == (130, line)
    _wait_for_the_end_of(process.pid)
    sweep = load_sweep(sky, out)
    kept = {path: path.stat().st_mtime_ns for path in out.glob("*/seed-*/.state/parts/*.json")}
    run_sweep(sweep, Workers(), QUIET)
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    for member in sweep.members:
        alone = finished / member.folder.relative_to(sweep.folder)
        files = [path.relative_to(alone) for table in TABLES for path in tables.files(alone, table)]
        assert all((member.folder / name).read_bytes() == (alone / name).read_bytes() for name in files)


BAD = {
    "unknown key": ('title = "Configuration time"', 'titel = "x"', ["titel", "'title'"]),
    "no such base": ('base = "small.toml"', 'base = "smal.toml"', ["smal.toml", "no such file"]),
    "no seeds": ("seeds = [3, 4]", "seeds = []", ["seeds"]),
    "a seed twice": ("seeds = [3, 4]", "seeds = [3, 3]", ["seeds are different"]),
    "a name twice": ('name = "wide"', 'name = "routed"', ["used twice: routed"]),
    "unknown reference": ('reference = "routed"', 'reference = "rooted"', ["'rooted' is no scenario", "'routed'"]),
    "a name that leaves the folder": ('name = "wide"', 'name = "../wide"', ["scenario.2.name"]),
    "unknown setting": ("instrument.patrol_radius_mm", "instrument.patrol_mm", ["scenario wide", "patrol_mm"]),
    "setting out of range": ('patrol_radius_mm" = 75.0', 'patrol_radius_mm" = -1.0', ["scenario wide", "patrol_radius_mm"]),
    "unknown programme": ('"instrument.patrol_radius_mm"', '"programme.brigt.visits"', ["'bright'"]),
    "no section": ('"instrument.patrol_radius_mm"', '"patrol"', ["section.key"]),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_scenarios_are_refused_before_anything_is_written(case: str, tmp_path: Path) -> None:
    old, new, words = BAD[case]
    assert old in SWEEP
    path = _write(tmp_path, SWEEP.replace(old, new, 1))
    assert is_sweep(path)
    with pytest.raises(InputError) as failure:
        load_sweep(path, tmp_path / "runs")
    assert all(word in str(failure.value) for word in words), str(failure.value)
    assert not (tmp_path / "runs").exists()


def test_a_share_of_dead_robots_is_drawn_by_the_seed_and_nested(sky: Path) -> None:
    pipeline = sky.parent / "small.toml"

    def dead(frac: float, seed: int) -> set[int]:
        plate = load_pipeline(pipeline, [f"instrument.dead_frac={frac}", f"run.seed={seed}"]).plate(pipeline.parent)
        assert not plate.is_guide[~plate.is_live].any()
        return set(plate.robot_id[~plate.is_live].tolist())

    assert dead(0.0, 1) == set()
    assert len(dead(0.05, 1)) == round(0.05 * 150)
    assert dead(0.05, 1) < dead(0.1, 1)
    assert dead(0.1, 1) != dead(0.1, 2)
    named = load_pipeline(pipeline, ["instrument.dead_frac=0.02", "instrument.dead_robots=[155]"]).plate(pipeline.parent)
    assert np.count_nonzero(~named.is_live) == 4


def test_the_shipped_sweeps_are_sound() -> None:
    files = sorted((data_folder("pipelines") / "scenarios").glob("*.toml"))
    assert {file.stem for file in files} == {
        *("patrol-radius", "separation", "robots", "dead-robots", "allocator", "router", "travel-power"),
        *("exposure-time", "weather", "configuration"),
    }
    for file in files:
        sweep = load_sweep(find_pipeline(file.stem))
        assert len(sweep.members) == len(sweep.settings.scenario) * len(sweep.settings.seeds) >= 8
        assert sweep.members[0].scenario == sweep.settings.reference_name
        runs = {member.scenario: member.open(Workers()) for member in sweep.members if member.seed == 1}
        dumps = {name: json.dumps(run.settings.model_dump(mode="json", exclude={"run"})) for name, run in runs.items()}
        assert len(set(dumps.values())) == len(runs), f"{file.stem}: two scenarios are the same"
