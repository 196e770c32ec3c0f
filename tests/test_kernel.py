"""Compiled functions are kept on disk, and an edit in another file of their folder is noticed."""

import subprocess
import sys
from pathlib import Path

INNER = """
from survey_sim.kernel import kernel


@kernel
def inner(x):
    return x + {step}
"""
OUTER = """
from rooms.inner import inner
from survey_sim.kernel import kernel


@kernel
def outer(x):
    return 10 * inner(x)
"""
CALL = "from rooms.outer import outer; print(outer(1), sum(outer.stats.cache_hits.values()))"


def call(folder: Path) -> tuple[int, int]:
    """What `outer(1)` gives in a new process, and how many compiled functions it found on disk."""
    ran = subprocess.run([sys.executable, "-c", CALL], cwd=folder, capture_output=True, text=True, check=True)
    value, hits = ran.stdout.split()
    return int(value), int(hits)


def write(folder: Path, step: int) -> None:
    (folder / "rooms").mkdir(exist_ok=True)
    (folder / "rooms" / "inner.py").write_text(INNER.format(step=step))
    (folder / "rooms" / "outer.py").write_text(OUTER)


def test_kept_until_a_file_beside_it_changes(tmp_path):
    write(tmp_path, 1)
    assert call(tmp_path) == (20, 0)
    assert call(tmp_path) == (20, 1)
    write(tmp_path, 2)
    assert call(tmp_path) == (30, 0)
    assert call(tmp_path) == (30, 1)
