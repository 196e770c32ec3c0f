"""What goes wrong around a run, done on purpose: kills, full disks, absent workers. Shared by the suite and the soaks."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from survey_sim import tables
from survey_sim.schema import TABLES

COMMAND = [sys.executable, "-m", "survey_sim"]
# The same without drawing figures, which is most of a small run's time: its report is a page of one word.
_BRIEFLY = """
from survey_sim import cli, tables
from survey_sim.survey import stages
stages.draw_report = lambda run: tables.write_bytes(b"brief", run.folder / "report" / "index.html")
"""
BRIEF_COMMAND = [sys.executable, "-c", f"{_BRIEFLY}if __name__ == '__main__': cli.main()"]
# Sees every write of a run: the process kills itself, as a power failure would, at the n-th of them.
_KILL_AT_WRITE = f"""{_BRIEFLY}
import os, signal, sys
from pathlib import Path
left, when = int(sys.argv.pop(1)), sys.argv.pop(1)
rename = Path.replace
def replace(self, target):
    global left
    left -= 1
    if left == 0 and when == "before":
        os.kill(os.getpid(), signal.SIGKILL)
    rename(self, target)
    if left == 0:
        os.kill(os.getpid(), signal.SIGKILL)
Path.replace = replace
cli.main()
"""


def table_bytes(folder: Path) -> dict[str, bytes]:
    """Bytes of all tables of a run."""
    return {str(path.relative_to(folder)): path.read_bytes() for name in TABLES for path in tables.files(folder, name)}


def file_names(folder: Path) -> set[str]:
    """All files of a run."""
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def assert_same_run(folder: Path, undisturbed: Path) -> None:
    """The same tables, byte for byte, and no file more."""
    assert table_bytes(folder) == table_bytes(undisturbed)
    assert file_names(folder) == file_names(undisturbed)


def run_arguments(pipeline: Path, out: Path, *more: str) -> list[str]:
    """A run, as typed."""
    return ["run", str(pipeline), "--out", str(out), "--quiet", *more]


def finish(command: list[str], *arguments: str) -> subprocess.CompletedProcess[str]:
    """A command that ended, and what it said."""
    return subprocess.run([*command, *arguments], capture_output=True, text=True, timeout=600, check=False)


def run_to_the_end(command: list[str], pipeline: Path, out: Path, *more: str, **options: Any) -> None:
    """Run it in a process of its own; it must succeed."""
    arguments = run_arguments(pipeline, out, *(more or ("--serial",)))
    subprocess.run([*command, *arguments], check=True, timeout=600, **options)


def kill_at_write(pipeline: Path, out: Path, n_write: int, when: str) -> bool:
    """Run in one process that dies at its n-th write, before or after the rename; whether it died."""
    arguments = run_arguments(pipeline, out, "--serial")
    done = finish([sys.executable, "-c", _KILL_AT_WRITE], str(n_write), when, *arguments)
    assert done.returncode in {0, -signal.SIGKILL}
    return done.returncode != 0


def kill_at_random(command: list[str], pipeline: Path, out: Path, rng: random.Random, longest_s: float, *more: str) -> bool:
    """Start it, and kill its whole process group when it has spent up to so much CPU time; whether it was still at work."""
    command = [*command, *run_arguments(pipeline, out, *(more or ("--serial",)))]
    process = subprocess.Popen(command, start_new_session=True, stderr=subprocess.PIPE)
    moment_s = rng.uniform(0.0, longest_s)
    while process.poll() is None and sum(map(cpu_s, [process.pid, *children(process.pid)])) < moment_s:
        time.sleep(0.05)
    is_at_work = process.poll() is None
    if is_at_work:
        os.killpg(process.pid, signal.SIGKILL)
    _, message = process.communicate()
    assert is_at_work or process.returncode == 0, message.decode()
    return is_at_work


def wait_for(condition, process: subprocess.Popen | None = None, timeout_s: float = 240.0) -> None:
    """Wait until it holds, as long as the process is at work."""
    deadline = time.monotonic() + timeout_s
    while not condition() and time.monotonic() < deadline and (process is None or process.poll() is None):
        time.sleep(0.01)
    assert condition()


def children(pid: int) -> list[int]:
    """Processes that a process started, and those that these started."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        child = int(path.parent.name)
        if (fields := _stat(child)) and int(fields[1]) == pid:
            found += [child, *children(child)]
    return found


def cpu_s(pid: int) -> float:
    """CPU time that a process has spent; none if it ended."""
    fields = _stat(pid)
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK") if fields else 0.0


def _stat(pid: int) -> list[str]:
    """What the system says of a process after its name; nothing if it ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def command_line(pid: int) -> str:
    """What a process was started as."""
    return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()


@contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Path]:
    """A disk of its own of this size; the test is skipped where the system does not let us."""
    folder.mkdir()
    if finish(["mount"], "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)).returncode:
        pytest.skip("only root may mount a disk")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def remount(folder: Path, options: str) -> None:
    """Change a disk made by `small_disk`: its size, or whether it can be written."""
    subprocess.run(["mount", "-o", f"remount,{options}", str(folder)], check=True)


@contextmanager
def cluster(folder: Path, n_worker: int = 2) -> Iterator[tuple[str, list[subprocess.Popen]]]:
    """A dask scheduler and workers as separate processes on this machine; gives the address, and the processes."""
    note = folder / "scheduler.json"
    python = [sys.executable, "-m"]
    scheduler = [*python, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    worker = [*python, "distributed.cli.dask_worker", "--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1"]
    where = ["--scheduler-file", str(note)]
    with open(folder / "cluster.log", "w") as log:
        processes = [subprocess.Popen([*scheduler, *where], stdout=log, stderr=log)]
        try:
            wait_for(note.exists, processes[0])
            processes += [subprocess.Popen([*worker, *where], stdout=log, stderr=log) for _ in range(n_worker)]
            yield json.loads(note.read_text())["address"], processes
        finally:
            for process in reversed(processes):
                process.terminate()
            for process in processes:
                process.wait(timeout=30)
