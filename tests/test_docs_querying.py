"""Every snippet of docs/querying.md, run as it stands there."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import duckdb
import polars as pl
import pytest

from survey_sim import tables
from tests.test_field import field, instrument  # noqa: F401 - fixtures

PAGE = Path(__file__).parents[1] / "docs" / "querying.md"


def snippets(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture
def run(field: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:  # noqa: F811 - the fixture
    """A folder with `runs/demo`, a routed field with two nights and the status of every target."""
    demo = tmp_path / "runs" / "demo"
    shutil.copytree(field, demo)
    science = tables.read(demo, "targets").filter(kind="science")
    status = science.select(
        "target_id", "survey", "programme",
        n_observed=pl.lit(0), first_night=pl.lit(None), last_night=pl.lit(None), reason=pl.lit("never-scheduled"),
    )  # fmt: skip
    tables.write(status, "target_status", demo / "target_status.parquet")
    night = {"night": [0, 1], "evening_mjd": [57388.0, 57389.0], "dark_s": [3e4, 3e4], "lost_s": [0.0, 1e4]}
    night |= {"exposing_s": [2e4, 1e4], "overhead_s": [1e4, 1e4], "n_exposure": [20, 10]}
    tables.write(pl.DataFrame(night), "nights", demo / "nights.parquet")
    monkeypatch.chdir(tmp_path)
    return demo


def test_there_are_snippets_of_each_kind() -> None:
    assert min(len(snippets(language)) for language in ("python", "sql", "sh")) >= 2


def test_python(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    namespace: dict = {}
    for snippet in snippets("python"):
        exec(snippet, namespace)
    shown = capsys.readouterr().out
    assert "science targets were never held" in shown
    assert "s mm" in shown
    assert len(namespace["near"].collect()) > 0


def test_sql(run: Path) -> None:
    for snippet in snippets("sql"):
        assert duckdb.sql(snippet).fetchall(), snippet


def test_shell(run: Path, tmp_path: Path) -> None:
    if shutil.which("stilts") is None:
        if os.environ.get("SURVEY_SIM_REQUIRE_STILTS") == "1":
            pytest.fail("stilts is not installed (apt-get install stilts)")
        pytest.skip("stilts is not installed")
    programs = tmp_path / "bin"
    programs.mkdir()
    own = programs / "survey-sim"
    own.write_text(f'#!/bin/sh\nexec {sys.executable} -m survey_sim "$@"\n')
    own.chmod(0o755)
    environment = {**os.environ, "PATH": f"{programs}:{os.environ['PATH']}"}
    for snippet in snippets("sh"):
        done = subprocess.run(["bash", "-ec", snippet], capture_output=True, text=True, env=environment, check=False)
        assert done.returncode == 0, done.stderr
        assert done.stdout.strip()
