"""A run that is killed, starved or damaged ends in a clear error or in the same tables; nothing between."""

import json
import os
import random
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from survey_sim import tables
from survey_sim.survey import stages
from survey_sim.survey.batches import Workers
from survey_sim.survey.engine import plan_stages, run_stages
from survey_sim.survey.run import open_run
from tests.faults import (
    BRIEF_COMMAND,
    COMMAND,
    assert_same_run,
    children,
    cluster,
    command_line,
    finish,
    kill_at_random,
    kill_at_write,
    remount,
    run_arguments,
    run_to_the_end,
    small_disk,
    wait_for,
)
from tests.small_survey import write_small_survey

N_WRITE_BEFORE_DEATH = (3, 10, 35)


@pytest.fixture(scope="module")
def pipeline(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small_survey(tmp_path_factory.mktemp("sky"))


@pytest.fixture(scope="module")
def finished(pipeline: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An undisturbed run; not to be changed."""
    out = tmp_path_factory.mktemp("runs") / "run"
    run_here(pipeline, out)
    return out


@pytest.fixture
def copy(pipeline: Path, finished: Path, tmp_path: Path) -> Path:
    """A finished run to damage, at home in its new place."""
    shutil.copytree(finished, tmp_path / "run")
    run_here(pipeline, tmp_path / "run")
    return tmp_path / "run"


@pytest.fixture(scope="module", autouse=True)
def brief_report() -> Iterator[None]:
    """Draw no figures, here neither: see `tests.faults`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stages, "draw_report", lambda run: tables.write_bytes(b"brief", run.folder / "report" / "index.html"))
        yield


def run_here(pipeline: Path, out: Path) -> None:
    run = open_run(pipeline, Workers(), out)
    with run.locked():
        run_stages(run)


def plan(pipeline: Path, out: Path) -> dict[str, list[str]]:
    return dict(plan_stages(open_run(pipeline, Workers(), out)))


class TestKilled:
    def test_at_writes(self, pipeline: Path, finished: Path, tmp_path: Path) -> None:
        """One death after the other, each at another write, before or after the file has its name."""
        for n_write, when in zip(N_WRITE_BEFORE_DEATH, ("before", "after") * 3, strict=False):
            assert kill_at_write(pipeline, tmp_path / "run", n_write, when)
        run_here(pipeline, tmp_path / "run")
        assert_same_run(tmp_path / "run", finished)

    def test_at_random_moments(self, pipeline: Path, finished: Path, tmp_path: Path) -> None:
        rng = random.Random(3)
        for _ in range(3):
            kill_at_random(BRIEF_COMMAND, pipeline, tmp_path / "run", rng, 4.0, "--workers", "2")
        run_here(pipeline, tmp_path / "run")
        assert_same_run(tmp_path / "run", finished)

    def test_what_a_killed_process_left_half_written_goes_away(self, pipeline: Path, finished: Path, copy: Path) -> None:
        for place in ("", ".state", ".state/parts", "report/figures"):
            (copy / place).mkdir(exist_ok=True)
            (copy / place / f".half.png.1{tables.TEMPORARY}").write_bytes(b"PNG")
        run_here(pipeline, copy)
        assert_same_run(copy, finished)

    @pytest.mark.parametrize("then", ["pass", "raise SystemError('a result with an exception set') from None"])
    def test_an_interrupt_that_a_library_swallows_or_changes_still_ends_the_run(
        self, then: str, pipeline: Path, tmp_path: Path
    ) -> None:
        lossy = f"""
import os, signal, time
from survey_sim.survey import batches
make = batches.run_batch
def run_batch(batch):
    try:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1)
    except KeyboardInterrupt:
        {then}
    return make(batch)
batches.run_batch = run_batch
"""
        command = [*BRIEF_COMMAND[:2], lossy + BRIEF_COMMAND[2], *run_arguments(pipeline, tmp_path / "run", "--serial")]
        done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120)
        assert done.returncode == 130
        assert done.stderr.splitlines()[-1].startswith("error: interrupted: ")

    def test_interrupted_with_all_its_workers(self, pipeline: Path, finished: Path, tmp_path: Path) -> None:
        """Ctrl-C in a terminal reaches the whole process group."""
        out = tmp_path / "run"
        command = [*BRIEF_COMMAND, *run_arguments(pipeline, out, "--workers", "2")]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
        wait_for(lambda: list((out / ".state" / "parts").glob("*.json")), process)
        os.killpg(process.pid, signal.SIGINT)
        _, message = process.communicate(timeout=60)
        assert process.returncode == 130
        assert message.strip() == "error: interrupted: finished tiles are kept, run the same command again to go on"
        run_here(pipeline, out)
        assert_same_run(out, finished)

    def test_a_worker_that_is_killed_is_replaced(self, pipeline: Path, finished: Path, tmp_path: Path) -> None:
        out = tmp_path / "run"
        command = [*BRIEF_COMMAND, *run_arguments(pipeline, out, "--workers", "2")]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        wait_for(lambda: list((out / ".state" / "parts").glob("*.json")), process)
        workers = [pid for pid in children(process.pid) if "spawn_main" in command_line(pid)]
        assert len(workers) == 2
        os.kill(workers[0], signal.SIGKILL)
        _, message = process.communicate(timeout=240)
        assert process.returncode == 0, message
        assert_same_run(out, finished)

    def test_a_scheduler_that_goes_away_is_told_and_parts_are_kept(
        self, pipeline: Path, finished: Path, tmp_path: Path
    ) -> None:
        out = tmp_path / "run"
        with cluster(tmp_path) as (address, processes):
            command = [*BRIEF_COMMAND, *run_arguments(pipeline, out, "--scheduler", address)]
            process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
            manifests = out / ".state" / "parts"
            wait_for(lambda: list(manifests.glob("*.json")), process)
            processes[0].kill()
            _, message = process.communicate(timeout=120)
        assert process.returncode == 2, message
        assert message.startswith("error: --scheduler: the scheduler has gone away"), message
        assert len(message.strip().splitlines()) == 2, message
        kept = {path: path.stat().st_mtime_ns for path in manifests.glob("*.json")}
        assert kept
        run_here(pipeline, out)
        assert {path: path.stat().st_mtime_ns for path in kept} == kept
        assert_same_run(out, finished)


class TestDisk:
    @pytest.mark.parametrize("size", ["16k", "1m"])
    def test_a_full_disk_is_told_and_the_run_goes_on_when_there_is_room(
        self, pipeline: Path, finished: Path, tmp_path: Path, size: str
    ) -> None:
        with small_disk(tmp_path / "disk", size) as disk:
            out = disk / "run"
            done = finish(BRIEF_COMMAND, *run_arguments(pipeline, out, "--serial"))
            assert done.returncode == 2, done.stderr
            assert "cannot be written: No space left on device\n  remedy: free space" in done.stderr
            assert len(done.stderr.strip().splitlines()) == 2
            assert not list(disk.rglob("*.tmp"))
            remount(disk, "size=40m")
            run_to_the_end(BRIEF_COMMAND, pipeline, out)
            assert_same_run(out, finished)

    def test_a_place_that_cannot_be_written(self, pipeline: Path, tmp_path: Path) -> None:
        with small_disk(tmp_path / "disk", "1m") as disk:
            remount(disk, "ro")
            for out in (disk, disk / "run"):
                done = finish(BRIEF_COMMAND, *run_arguments(pipeline, out, "--serial"))
                assert done.returncode == 2
                assert done.stderr.startswith(f"error: {out}"), done.stderr
                assert "Read-only file system" in done.stderr


class TestDamaged:
    """Everything that a run wrote before is made again when a byte of it is not as it was."""

    @pytest.mark.parametrize(
        "file",
        [
            "legs/stars-00002.parquet",
            ".state/parts/paths/stars-00002.parquet",
            ".state/selected.parquet",
            "targets.parquet",
            "visits.parquet",
            "exposures.parquet",
        ],
    )
    @pytest.mark.parametrize("spoil", ["a byte", "the end", "all"])
    def test_table(self, pipeline: Path, finished: Path, copy: Path, file: str, spoil: str) -> None:
        path = copy / file
        content = bytearray(path.read_bytes())
        if spoil == "a byte":
            content[len(content) // 2] ^= 0x10
        path.write_bytes(content if spoil == "a byte" else content[:-9] if spoil == "the end" else b"")
        assert any("damaged" in reason for reasons in plan(pipeline, copy).values() for reason in reasons)
        run_here(pipeline, copy)
        assert_same_run(copy, finished)

    @pytest.mark.parametrize("content", ["", "{", "[]", "{}", '{"name": "stars-00002"}'])
    def test_manifest(self, pipeline: Path, finished: Path, copy: Path, content: str) -> None:
        (copy / ".state" / "parts" / "stars-00002.json").write_text(content)
        assert plan(pipeline, copy)["visits"] == ["a part is absent or damaged"]
        run_here(pipeline, copy)
        assert_same_run(copy, finished)

    def test_memory_of_the_engine(self, pipeline: Path, finished: Path, copy: Path) -> None:
        memory = copy / ".state" / "engine.db"
        for content in (b"", memory.read_bytes()[:3000], b"SQLite format 3\0" + b"x" * 5000):
            memory.write_bytes(content)
            run_here(pipeline, copy)
            assert_same_run(copy, finished)


class TestTwoRuns:
    def test_the_second_refuses(self, pipeline: Path, finished: Path, tmp_path: Path) -> None:
        out = tmp_path / "run"
        first = subprocess.Popen([*BRIEF_COMMAND, *run_arguments(pipeline, out, "--serial")])
        wait_for((out / ".state" / "lock").exists, first)
        time.sleep(0.1)
        second = finish(BRIEF_COMMAND, *run_arguments(pipeline, out, "--serial"))
        assert second.returncode == 2
        assert "another run is at work in this folder" in second.stderr
        assert first.wait(timeout=240) == 0
        assert_same_run(out, finished)


class TestNetwork:
    def test_only_this_machine_is_listened_to(self, pipeline: Path, tmp_path: Path) -> None:
        out = tmp_path / "run"
        process = subprocess.Popen([*BRIEF_COMMAND, *run_arguments(pipeline, out, "--workers", "2")], start_new_session=True)
        try:
            wait_for(lambda: len([p for p in children(process.pid) if "spawn_main" in command_line(p)]) == 2, process)
            wait_for(lambda: len(listening([process.pid, *children(process.pid)])) >= 3, process)
            addresses = listening([process.pid, *children(process.pid)])
        finally:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        assert {address.rpartition(":")[0] for address in addresses} == {"0100007F"}, addresses


def listening(pids: list[int]) -> set[str]:
    """Local addresses, in hexadecimal, on which processes listen (7F000001 is 127.0.0.1, bytes reversed)."""
    sockets = set()
    for pid in pids:
        for link in Path(f"/proc/{pid}/fd").glob("*"):
            try:
                sockets.add(os.readlink(link))
            except OSError:  # it ended, or was closed, meanwhile
                continue
    found = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and f"socket:[{fields[9]}]" in sockets:
                found.add(fields[1])
    return found


@pytest.mark.parametrize("content", ["", "{", "[1]", '{"stages": 3}'])
def test_a_record_that_is_damaged_is_named_and_made_again(content: str, pipeline: Path, finished: Path, copy: Path) -> None:
    (copy / "run.json").write_text(content)
    done = finish(COMMAND, "report", str(copy))
    assert done.returncode == 2
    assert "run.json" in done.stderr
    run_here(pipeline, copy)
    assert_same_run(copy, finished)
    again, before = (json.loads((run / "run.json").read_text()) for run in (copy, finished))
    assert again["stages"].keys() == before["stages"].keys()
    assert {**again, "stages": {}} == {**before, "stages": {}}
