"""Break our own code in small ways, one at a time, and see whether the tests notice: `make mutation`.

The faults stand in `mutations.toml`. Each is put into a copy of the checkout, in which the quickest tests that should notice
it are run, kernels as plain Python (compiling them would take longer than the tests). A fault that no test notices is a
survivor; the exit code is 1 if there are any.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LIST = Path(__file__).with_suffix("").parent / "mutations.toml"
_COPIED = ("survey_sim", "tests", "pipelines", "reports", "catalogues", "pyproject.toml")
TIMEOUT_S = 900
# Exit code of pytest when tests ran, and some failed.
NOTICED = 1


@dataclass(frozen=True)
class Mutation:
    """One fault: what stands in the file, what is put there instead, and the tests that should notice."""

    file: str
    old: str
    new: str
    tests: str


def load_mutations() -> list[Mutation]:
    """All faults of the list."""
    return [Mutation(**entry) for entry in tomllib.loads(LIST.read_text(encoding="utf-8"))["mutation"]]


def run_tests(folder: Path, tests: str) -> int:
    """Exit code of the tests in a copy of the checkout; those that do not end have noticed."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *shlex.split(tests)]
    environment = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_DISABLE_JIT": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        return subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, timeout=TIMEOUT_S, check=False
        ).returncode
    except subprocess.TimeoutExpired:
        return NOTICED


def is_noticed(folder: Path, mutation: Mutation) -> bool:
    """Whether the tests fail with the fault put in; the copy is as before afterwards."""
    path = folder / mutation.file
    sound = path.read_text(encoding="utf-8")
    assert sound.count(mutation.old) == 1, (
        f"{mutation.file}: {mutation.old!r} stands there {sound.count(mutation.old)} times"
    )
    path.write_text(sound.replace(mutation.old, mutation.new), encoding="utf-8")
    try:
        return run_tests(folder, mutation.tests) == NOTICED
    finally:
        path.write_text(sound, encoding="utf-8")


def main() -> int:
    """Put in every fault; arguments are words of which a fault's file must have one."""
    wanted = [m for m in load_mutations() if not sys.argv[1:] or any(word in m.file for word in sys.argv[1:])]
    survivors = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for item in _COPIED:
            copy = shutil.copytree if (ROOT / item).is_dir() else shutil.copy
            copy(ROOT / item, folder / item)
        for mutation in wanted:
            begun = time.monotonic()
            noticed = is_noticed(folder, mutation)
            verdict = "noticed " if noticed else "SURVIVED"
            print(
                f"{verdict} {time.monotonic() - begun:6.1f} s  {mutation.file}: {mutation.new or 'without ' + mutation.old}",
                flush=True,
            )
            if not noticed:
                survivors.append(mutation)
    print(f"{len(wanted) - len(survivors)} of {len(wanted)} noticed")
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
