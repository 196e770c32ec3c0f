"""Whole small runs: the same bytes whoever does them, what is out of date runs again, what is done is kept."""

import json
import os
import platform
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from survey_sim import tables
from survey_sim.check import check_run
from survey_sim.schema import TABLES
from survey_sim.survey import warm
from survey_sim.survey.engine import plan_stages, run_stages
from survey_sim.survey.run import Run, open_run
from survey_sim.survey.stages import make_night_schedule
from survey_sim.survey.transitions import are_parts_whole
from survey_sim.survey.workers import Workers, memory_mib
from tests.faults import COMMAND, cluster, table_bytes
from tests.small_survey import write_small_survey


def _open(pipeline: Path, out: Path, *changes: str, workers: int = 0) -> Run:
    return open_run(pipeline, Workers(workers), out, changes)


def _run(pipeline: Path, out: Path, *changes: str, workers: int = 0) -> Run:
    run = _open(pipeline, out, *changes, workers=workers)
    with run.locked():
        run_stages(run)
    return run


def _plan(pipeline: Path, out: Path, *changes: str) -> dict[str, list[str]]:
    return dict(plan_stages(_open(pipeline, out, *changes)))


@pytest.fixture(scope="module")
def pipeline(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small_survey(tmp_path_factory.mktemp("sky"))


@pytest.fixture(scope="module")
def finished(pipeline: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run; not to be changed."""
    return _run(pipeline, tmp_path_factory.mktemp("runs") / "small").folder


@pytest.fixture
def copy(finished: Path, tmp_path: Path) -> Path:
    """A finished run to change."""
    return Path(shutil.copytree(finished, tmp_path / "small"))


def test_every_table_is_there_and_the_check_passes(finished: Path) -> None:
    for name in TABLES:
        assert tables.files(finished, name), name
        assert tables.read(finished, name).columns[: len(TABLES[name].names)] == TABLES[name].names
    result = check_run(finished)
    assert result.is_passed, result.faults
    assert result.n_visit == len(tables.read(finished, "visits")) > 20


def test_every_science_target_has_a_status_and_a_reason_if_it_is_not_complete(finished: Path) -> None:
    status = tables.read(finished, "target_status")
    science = tables.read(finished, "targets").filter(kind="science")
    joined = status.join(science.select("target_id", "wanted_visits"), on="target_id", how="full", coalesce=True)
    assert not joined["n_observed"].null_count()
    is_complete = pl.col("n_observed") >= pl.col("wanted_visits")
    assert joined.filter(is_complete != pl.col("reason").is_null()).is_empty()


def test_run_record_holds_what_a_reader_needs(finished: Path, pipeline: Path) -> None:
    record = json.loads((finished / "run.json").read_text())
    assert record["instrument"]["min_separation_mm"] == 9.0
    assert record["settings"]["schedule"]["end_date"] == "2016-10-12"
    assert record["seed"] == 7
    assert set(record["stages"]) == {"targets", "tiles", "pool", "visits", "schedule", "report"}
    assert all(stage["wall_s"] >= 0 and stage["cpu_s"] >= 0 for stage in record["stages"].values())
    digest = tables.checksum(pipeline.parent / "stars.csv")
    assert digest in record["catalogues"]["sha256"].values()


def test_two_workers_write_the_same_bytes(pipeline: Path, finished: Path, tmp_path: Path) -> None:
    assert table_bytes(_run(pipeline, tmp_path / "two", workers=2).folder) == table_bytes(finished)


def test_a_dask_cluster_writes_the_same_bytes(pipeline: Path, finished: Path, tmp_path: Path) -> None:
    with cluster(tmp_path) as (address, _):
        out = tmp_path / "cluster"
        command = [*COMMAND, "run", str(pipeline), "--out", str(out), "--scheduler", address, "--quiet"]
        subprocess.run(command, check=True, timeout=300)
    assert table_bytes(out) == table_bytes(finished)


def test_the_order_of_catalogue_rows_does_not_matter(finished: Path, tmp_path: Path) -> None:
    shuffled = write_small_survey(tmp_path / "sky", shuffle=5)
    assert table_bytes(_run(shuffled, tmp_path / "out").folder) == table_bytes(finished)


def test_part_size_does_not_change_a_row(pipeline: Path, finished: Path, tmp_path: Path) -> None:
    other = _run(pipeline, tmp_path / "out", "output.tiles_per_part=3").folder
    for name in TABLES:
        keys = list(TABLES[name].order)
        assert tables.read(other, name).sort(keys).equals(tables.read(finished, name).sort(keys)), name


def test_killed_run_goes_on_and_ends_with_the_same_bytes(pipeline: Path, finished: Path, tmp_path: Path) -> None:
    out = tmp_path / "killed"
    command = [*COMMAND, "run", str(pipeline), "--out", str(out), "--workers", "2", "--quiet"]
    process = subprocess.Popen(command, start_new_session=True)
    manifests = out / ".state" / "parts"
    deadline = time.monotonic() + 240
    while process.poll() is None and len(list(manifests.glob("*.json"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    kept = {path: path.stat().st_mtime_ns for path in manifests.glob("*.json")}
    assert 2 <= len(kept) < 7
    _run(pipeline, out)
    assert table_bytes(out) == table_bytes(finished)
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert not list(out.rglob("*.tmp"))


def test_interrupt_ends_with_a_clean_message(pipeline: Path, tmp_path: Path) -> None:
    out = tmp_path / "stopped"
    process = subprocess.Popen(
        [*COMMAND, "run", str(pipeline), "--out", str(out), "--serial", "--quiet"], stderr=subprocess.PIPE, text=True
    )
    while process.poll() is None and not (out / "tiles.parquet").exists():
        time.sleep(0.01)
    process.send_signal(signal.SIGTERM)
    _, message = process.communicate(timeout=60)
    assert process.returncode == 130
    assert message.strip().splitlines() == [
        "error: interrupted: finished tiles are kept, run the same command again to go on"
    ]


def test_nothing_runs_twice(pipeline: Path, copy: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in copy.rglob("*.parquet")}
    assert not any(_plan(pipeline, copy).values()), _plan(pipeline, copy)
    _run(pipeline, copy)
    assert {path: path.stat().st_mtime_ns for path in copy.rglob("*.parquet")} == before


@pytest.mark.parametrize("copier", [shutil.copy2, shutil.copyfile])
def test_a_run_that_was_copied_or_moved_is_up_to_date(
    pipeline: Path, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, copier
) -> None:
    copied = shutil.copytree(finished, tmp_path / "copied", copy_function=copier)
    assert not any(_plan(pipeline, copied).values()), _plan(pipeline, copied)
    moved = copied.rename(tmp_path / "moved")
    monkeypatch.chdir(tmp_path)
    assert not any(_plan(pipeline, Path("moved")).values())
    (moved / "tiles.parquet").unlink()
    assert [name for name, reasons in _plan(pipeline, moved).items() if reasons] == ["pool", "visits", "schedule", "report"]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ("schedule.site.height_m=1200", ["schedule", "report"]),
        ("routing.router='coordinated'", ["visits", "schedule", "report"]),
        ("programme.faint.mag_faint=11.5", ["targets", "tiles", "pool", "visits", "schedule", "report"]),
        ("report.title='Mine'", ["report"]),
    ],
)
def test_a_changed_setting_runs_only_what_uses_it(pipeline: Path, finished: Path, change: str, expected: list[str]) -> None:
    plan = _plan(pipeline, finished, change)
    assert [name for name, reasons in plan.items() if reasons] == expected
    key = change.partition("=")[0].split(".")[-1]
    assert key in plan[expected[0]][0] or "programme" in plan[expected[0]][0]


def test_a_changed_catalogue_runs_everything(copy: Path, tmp_path: Path, pipeline: Path) -> None:
    sky = tmp_path / "sky"
    shutil.copytree(pipeline.parent, sky)
    _run(sky / "small.toml", copy)
    with (sky / "stars.csv").open("a") as file:
        file.write("star-new,0.5,-30.0,9.0\n")
    plan = _plan(sky / "small.toml", copy)
    assert plan["targets"] == ["changed: stars.csv"]
    assert all(plan.values())


def test_dry_run_writes_nothing(pipeline: Path, tmp_path: Path) -> None:
    out = tmp_path / "none"
    plan = _plan(pipeline, out)
    assert list(plan) == ["targets", "tiles", "pool", "visits", "schedule", "report"]
    assert all(plan.values())
    assert not out.exists()


@pytest.mark.parametrize("spoil", [lambda path: path.write_bytes(path.read_bytes()[:-7]), Path.unlink])
def test_a_damaged_part_is_found_and_remade(pipeline: Path, finished: Path, copy: Path, spoil) -> None:
    part = sorted((copy / "legs").iterdir())[1]
    spoil(part)
    assert _plan(pipeline, copy)["visits"] == ["a part is absent or damaged"]
    _run(pipeline, copy)
    assert table_bytes(copy) == table_bytes(finished)


@pytest.fixture
def plate_only(finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A finished run to schedule anew, in which no way of the robots can be routed."""

    def refuse(batch: object) -> None:
        raise AssertionError("routed again")

    monkeypatch.setattr("survey_sim.survey.transitions.robots.route_chains", refuse)
    return Path(shutil.copytree(finished, tmp_path / "small"))


def _exposure_rows(folder: Path) -> list[pl.DataFrame]:
    return [tables.read(folder, name) for name in TABLES if name.startswith("exposure")]


def test_nights_as_they_were_are_not_routed_again(pipeline: Path, finished: Path, plate_only: Path) -> None:
    # 1 m of the site's height moves nothing by more than the digits that are kept.
    make_night_schedule(_open(pipeline, plate_only, "schedule.site.height_m=1166"))
    for own, before in zip(_exposure_rows(plate_only)[1:], _exposure_rows(finished)[1:], strict=True):
        assert own.equals(before)


def test_length_of_the_nights_parts_changes_no_row(pipeline: Path, finished: Path, plate_only: Path) -> None:
    make_night_schedule(_open(pipeline, plate_only, "output.nights_per_part=1"))
    assert len(tables.files(plate_only, "exposure_legs")) == 12
    for own, before in zip(_exposure_rows(plate_only), _exposure_rows(finished), strict=True):
        assert own.equals(before)
    make_night_schedule(_open(pipeline, plate_only))
    assert table_bytes(plate_only) == table_bytes(finished)


def test_a_damaged_part_of_nights_is_found_and_remade(pipeline: Path, finished: Path, plate_only: Path) -> None:
    (part,) = tables.files(plate_only, "exposure_legs")
    run = _open(pipeline, plate_only)
    assert are_parts_whole(run)
    part.write_bytes(part.read_bytes()[:-7])
    assert not are_parts_whole(run)
    make_night_schedule(run)
    assert table_bytes(plate_only) == table_bytes(finished)


@pytest.mark.parametrize(
    ("change", "warning"),
    [
        ("schedule.end_date=2015-01-01", "no night from"),
        ("schedule.weather.mean_loss_frac=1.0", "cloud takes all of the time"),
        ("schedule.site.latitude_deg=80.0", "tiles are never within its limits of airmass and hour angle"),
    ],
)
def test_schedules_of_nothing_are_sound_and_say_so(pipeline: Path, plate_only: Path, change: str, warning: str) -> None:
    run = _open(pipeline, plate_only, change)
    make_night_schedule(run)
    assert tables.read(plate_only, "exposures").is_empty()
    assert tables.read(plate_only, "exposure_allocations").is_empty()
    assert tables.read(plate_only, "target_status")["n_observed"].sum() == 0
    assert any(warning in told for told in tables.read_record(plate_only)["warnings"]["schedule"])
    assert check_run(plate_only).is_passed


def test_with_a_constant_time_robots_are_not_followed(pipeline: Path, finished: Path, plate_only: Path) -> None:
    make_night_schedule(_open(pipeline, plate_only, "schedule.configuration_s=300"))
    assert not any(tables.files(plate_only, name) for name in TABLES if name.startswith("exposure_"))
    assert set(tables.read(plate_only, "exposures")["configuration_time_s"]) == {300.0}
    spent = tables.read(plate_only, "time_budget").filter(activity="configuring")["time_s"].sum()
    assert spent > tables.read(finished, "time_budget").filter(activity="configuring")["time_s"].sum()


def test_robots_that_were_not_routed_lose_their_targets_and_no_other(finished: Path) -> None:
    exposures = tables.read(finished, "exposures").filter(status="observed").select("exposure_id")
    held = tables.read(finished, "exposure_allocations").join(exposures, on="exposure_id", how="semi")
    assert held["missed_target_id"].is_not_null().any()
    science = held.filter(kind="science").group_by("target_id").len("n")
    status = tables.read(finished, "target_status").filter(pl.col("n_observed") > 0)
    assert dict(science.iter_rows()) == dict(status.select("target_id", "n_observed").iter_rows())


def test_parts_of_tiles_that_are_gone_are_removed(pipeline: Path, copy: Path) -> None:
    stray = copy / "legs" / "stars-99999.parquet"
    shutil.copy(next((copy / "legs").iterdir()), stray)
    _run(pipeline, copy, "routing.router='coordinated'")
    assert not stray.exists()


def test_a_second_run_in_the_same_folder_is_refused(pipeline: Path, copy: Path) -> None:
    run = _open(pipeline, copy)
    with run.locked(), pytest.raises(ValueError, match="another run is at work"), _open(pipeline, copy).locked():
        pass


def test_what_workers_spend_is_counted_once() -> None:
    workers = Workers(1)
    try:
        assert sorted(workers.stream(abs, [-2, 3])) == [2, 3]
        assert 0 < workers.cpu_s < 60
        assert list(workers.memory_mib) != [(platform.node(), os.getpid())]
        assert len(workers.memory_mib) == 1
    finally:
        workers.close()
    here = Workers()
    assert list(here.stream(abs, [-2, 3])) == [2, 3]
    assert (here.cpu_s, here.memory_mib) == (0.0, {})


def test_tasks_are_made_when_they_are_wanted() -> None:
    made = []
    tasks = (made.append(n) or n for n in range(10))
    assert next(Workers().stream(abs, tasks)) == 0
    assert len(made) <= 2


def test_the_memory_of_a_process_is_not_that_of_the_one_that_started_it() -> None:
    ballast = np.ones(50_000_000)
    told = "from survey_sim.survey.workers import memory_mib; print(memory_mib())"
    own_mib = float(subprocess.run([sys.executable, "-c", told], check=True, capture_output=True).stdout)
    assert 1.0 < own_mib < memory_mib() - ballast.nbytes / 2**21


@pytest.mark.parametrize(
    ("change", "warnings"),
    [
        ("tiling.region.dec_deg=[60.0, 70.0]", ["programme stars/bright has no target", "survey stars has no tile"]),
        ("programme.faint.mag_bright=11.9999", ["programme stars/faint has no target"]),
    ],
)
def test_a_footprint_without_targets_gives_tables_and_a_warning(
    pipeline: Path, tmp_path: Path, change: str, warnings: list[str]
) -> None:
    run = _open(pipeline, tmp_path / "out", change)
    with run.locked():
        run_stages(run, skipped=("report",))
    said = [warning for stage in tables.read_record(run.folder)["warnings"].values() for warning in stage]
    assert set(warnings) <= set(said)
    n_target = tables.read(run.folder, "target_status").height
    assert n_target == tables.read(run.folder, "targets").filter(kind="science").height
    assert check_run(run.folder).is_passed


def test_the_survey_that_compiles_kernels_comes_to_all_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Visits, pointings and the ways between: a night that clouds take would leave the telescope's kernels uncompiled."""
    rows = {}
    names = ("visits", "exposures", "exposure_legs", "executions")
    monkeypatch.setattr(warm, "check_run", lambda folder: rows.update({n: tables.read(folder, n).height for n in names}))
    warm.compile_kernels()
    assert min(rows.values()) > 0, rows
