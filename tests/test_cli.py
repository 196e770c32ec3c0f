"""The command line: help, exit codes, and bad input as one readable block before anything is written."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from survey_sim.cli import app
from tests.small_survey import PIPELINE, write_small_survey

runner = CliRunner()


@pytest.mark.parametrize("command", [[], ["run"], ["check"], ["report"], ["catalogue"], ["catalogue", "make"]])
def test_every_command_has_help(command: list[str]) -> None:
    result = runner.invoke(app, [*command, "--help"])
    assert result.exit_code == 0
    assert "Usage" in result.output


def test_help_does_not_import_the_heavy_libraries() -> None:
    heavy = ["numba", "polars", "astropy", "matplotlib", "scipy", "distributed"]
    code = "import sys, atexit; sys.argv = ['survey-sim', '--help']; from survey_sim.cli import main; "
    code += f"atexit.register(lambda: print([name for name in {heavy} if name in sys.modules])); main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip().endswith("[]")


def _edit(old: str, new: str) -> Callable[[Path], None]:
    def edit(pipeline: Path) -> None:
        assert old in PIPELINE
        pipeline.write_text(PIPELINE.replace(old, new, 1))

    return edit


def _edit_stars(change: Callable[[list[str]], list[str]]) -> Callable[[Path], None]:
    def edit(pipeline: Path) -> None:
        file = pipeline.parent / "stars.csv"
        file.write_text("\n".join(change(file.read_text().splitlines())) + "\n")

    return edit


BAD_INPUT = {
    "missing file": (_edit('catalogue = "stars.csv"', 'catalogue = "star.csv"'), ["star.csv", "no such file"]),
    "unknown key": (_edit("mag_faint = 10.0", "mag_fain = 10.0"), ["programme.0.mag_fain", "unknown key", "'mag_faint'"]),
    "unknown section": (_edit("[routing]", "[rooting]"), ["rooting", "unknown key", "did you mean 'routing'"]),
    "unknown algorithm": (
        _edit('algorithm = "cda-basic"', 'algorithm = "cda-basis"'),
        ["allocation.algorithm", "did you mean 'cda-basic'"],
    ),
    "unknown router": (_edit("simple-vector", "simple-vectors"), ["routing.router", "did you mean 'simple-vector'"]),
    "unknown preset": (_edit("taipan-150", "taipan-151"), ["instrument", "did you mean 'taipan-150'"]),
    "unknown constant": (_edit('preset = "taipan-150"', "patrol_mm = 5"), ["instrument.patrol_mm", "unknown key"]),
    "wrong type": (_edit("exposure_s = 300.0", 'exposure_s = "5 min"'), ["programme.0.exposure_s", "number", "'5 min'"]),
    "out of range": (_edit("visits = 2", "visits = 0"), ["programme.0.visits", "greater than or equal to 1", "not 0"]),
    "not a number": (_edit("exposure_s = 300.0", "exposure_s = nan"), ["programme.0.exposure_s", "finite"]),
    "not TOML": (_edit("[run]", "[run"), ["small.toml", "is not TOML", "line 2"]),
    "name used twice": (_edit('name = "faint"', 'name = "bright"'), ["programme", "used twice", "bright"]),
    "ideal cannot be routed": (_edit("cda-basic", "ideal"), ["ideal", "cannot be routed"]),
    "wrong column": (
        _edit_stars(lambda rows: [rows[0].replace("dec_deg", "decl_deg"), *rows[1:]]),
        ["stars.csv", "dec_deg", "did you mean 'decl_deg'"],
    ),
    "coordinate out of range": (
        _edit_stars(lambda rows: [*rows[:5], "far,10.0,-95.0,9.0", *rows[5:]]),
        ["stars.csv", "dec_deg", "[-90, 90]", "rows [4"],
    ),
    "coordinate not a number": (
        _edit_stars(lambda rows: [*rows, "lost,nan,-30.0,9.0"]),
        ["stars.csv", "ra_deg", "rows [900]"],
    ),
    "duplicate id": (_edit_stars(lambda rows: [*rows, rows[3]]), ["stars.csv", "source_id", "rows [2, 900]"]),
    "text where a number stands": (
        _edit_stars(lambda rows: [*rows, "odd,ten,-30.0,9.0"]),
        ["stars.csv", "ra_deg", "900"],
    ),
    "empty file": (_edit_stars(lambda rows: []), ["stars.csv"]),
}


@pytest.mark.parametrize("case", BAD_INPUT)
def test_bad_input_is_one_readable_block_and_nothing_is_written(case: str, tmp_path: Path) -> None:
    spoil, words = BAD_INPUT[case]
    pipeline = write_small_survey(tmp_path / "sky")
    spoil(pipeline)
    out = tmp_path / "out"
    result = runner.invoke(app, ["run", str(pipeline), "--out", str(out), "--serial", "--quiet"])
    assert result.exit_code == 2, result.output
    message = result.stderr
    assert message.startswith("error: ")
    assert len(message.strip().splitlines()) <= 3
    for word in words:
        assert word in message, message
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "nothing.toml"], ["nothing.toml", "no such file", "demo"]),
        (["run", "demo", "--set", "seed"], ["--set", "section.key=value"]),
        (["run", "demo", "--set", "programme.gaia.visits=2"], ["gaia", "known:"]),
        (["run", "demo", "--serial", "--workers", "2"], ["exclude each other"]),
        (["check", "nowhere"], ["nowhere"]),
        (["report", "nowhere"], ["nowhere"]),
        (["catalogue", "check", "tyco2"], ["did you mean 'tycho2'"]),
        (["catalogue", "make", "tycho2"], ["has no recipe"]),
    ],
)
def test_bad_arguments_name_the_remedy(arguments: list[str], words: list[str], tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = runner.invoke(app, arguments)
    assert result.exit_code == 2, result.output
    for word in words:
        assert word in result.stderr, result.stderr
    assert not list(tmp_path.iterdir())


def test_an_unreachable_scheduler_is_named(tmp_path: Path) -> None:
    pipeline = write_small_survey(tmp_path / "sky")
    arguments = ["run", str(pipeline), "--out", str(tmp_path / "out"), "--scheduler", "tcp://127.0.0.1:1", "--quiet"]
    result = runner.invoke(app, arguments)
    assert result.exit_code == 2
    assert "no dask scheduler at tcp://127.0.0.1:1" in result.stderr


def test_shipped_pipelines_are_found_by_name(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = runner.invoke(app, ["run", "demo", "--dry-run"])
    assert result.exit_code == 0, result.output
    assert result.output.splitlines()[0] == "targets: never run"
    assert not list(tmp_path.iterdir())
