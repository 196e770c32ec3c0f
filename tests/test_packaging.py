"""The wheel and the sdist work outside the checkout, and take with them what is needed, no more."""

import ast
import os
import re
import subprocess
import sys
import tarfile
import tomllib
from collections.abc import Iterator
from pathlib import Path
from zipfile import ZipFile

import pytest

from tests.faults import BRIEF_COMMAND, run_to_the_end, table_bytes

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# Modules whose package has another name; tools that are called, not imported; and what comes with a package that is named.
PACKAGE_OF = {
    "erfa": "pyerfa",
    "multipart": "python-multipart",
    "dask": "distributed",
    "markupsafe": "jinja2",
    "mpl_toolkits": "matplotlib",
}
# Other people's programs that benchmarks measure themselves against, if they are there.
COMPARED = {"pyrvo"}
CALLED = {
    "ruff",
    "pytest-xdist",
    "mypy",
    "import-linter",
    "scipy-stubs",
    "hatchling",
    "furo",
    "pytest-benchmark",
    "python-multipart",
    "pandas",
}
TINY = """
[instrument]
preset = "paper"
n_science = 7
plate_radius_mm = 40.0

[tiling]
region = { ra_deg = [10.0, 10.8], dec_deg = [-30.4, -29.6] }

[[programme]]
name = "stars"
survey = "stars"
catalogue = "stars.csv"

[allocation]
max_visits = 1

[schedule]
start_date = 2016-10-01
end_date = 2016-10-01
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel and the sdist."""
    folder = tmp_path_factory.mktemp("built")
    build(ROOT, folder, "wheel", "sdist")
    return folder


def build(source: Path, folder: Path, *kinds: str) -> None:
    """Build from a source tree, with nothing from the network."""
    targets = [word for kind in kinds for word in ("-t", kind)]
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-d", folder, *targets], cwd=source, check=True, capture_output=True
    )


def test_the_wheel_runs_a_survey_outside_the_checkout(built: Path, tmp_path: Path) -> None:
    target, place = tmp_path / "installed", tmp_path / "work"
    place.mkdir()
    with ZipFile(next(built.glob("*.whl"))) as wheel:
        wheel.extractall(target)
    rows = [f"{i},{10.0 + 0.04 * i},{-30.3 + 0.03 * i},9.0" for i in range(20)]
    (place / "stars.csv").write_text("\n".join(["source_id,ra_deg,dec_deg,mag", *rows]) + "\n")
    (place / "tiny.toml").write_text(TINY)
    environment = {
        **os.environ,
        "PYTHONPATH": str(target),
        "SURVEY_SIM_CACHE": str(place / "cache"),
    }

    def call(*arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, *arguments], cwd=place, env=environment, check=False, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert Path(call("-c", "import survey_sim; print(survey_sim.__file__)").strip()).is_relative_to(target)
    assert "tycho2" in call("-m", "survey_sim", "catalogue", "list")
    assert "targets: never run" in call("-m", "survey_sim", "run", "five-year", "--dry-run")
    call("-m", "survey_sim", "run", "tiny.toml", "--serial")
    call("-m", "survey_sim", "check", "runs/tiny")
    assert (place / "runs" / "tiny" / "report" / "index.html").stat().st_size > 10_000
    run_to_the_end(BRIEF_COMMAND, place / "tiny.toml", place / "runs" / "checkout", cwd=ROOT)
    assert table_bytes(place / "runs" / "checkout") == table_bytes(place / "runs" / "tiny")


def test_the_sdist_builds_the_same_wheel(built: Path, tmp_path: Path) -> None:
    with tarfile.open(next(built.glob("*.tar.gz"))) as sdist:
        sdist.extractall(tmp_path, filter="data")
        names = {Path(*Path(name).parts[1:]).as_posix() for name in sdist.getnames()}
    assert {"Makefile", "docs/data-model.md", "tests/test_packaging.py", "ARCHITECTURE.md", "CONTRIBUTING.md"} <= names
    source = next(path for path in tmp_path.iterdir() if path.is_dir())
    build(source, tmp_path / "again", "wheel")
    assert contents(next((tmp_path / "again").glob("*.whl"))) == contents(next(built.glob("*.whl")))


def contents(wheel: Path) -> dict[str, int]:
    """Name and checksum of each file of a wheel but its own list of them."""
    with ZipFile(wheel) as archive:
        return {info.filename: info.CRC for info in archive.infolist() if not info.filename.endswith("RECORD")}


def test_the_wheel_has_no_tests_and_no_second_package(built: Path) -> None:
    tops = {name.split("/")[0] for name in contents(next(built.glob("*.whl")))}
    assert tops == {"survey_sim", f"survey_sim-{PROJECT['version']}.dist-info"}


def declared(*extras: str) -> set[str]:
    """Names of the packages that the project needs, or an extra of it."""
    lists = [PROJECT["optional-dependencies"][extra] for extra in extras] or [PROJECT["dependencies"]]
    return {re.split(r"[<>=\[]", line)[0] for lines in lists for line in lines} - {"survey-sim"}


def imported(*places: str) -> set[str]:
    """Packages that the sources of some folders import, wherever in them."""
    found = set()
    for source in (path for place in places for path in (ROOT / place).rglob("*.py")):
        for name in _modules(ast.parse(source.read_text(encoding="utf-8"))):
            top = name.split(".")[0]
            if top not in sys.stdlib_module_names:
                found.add(PACKAGE_OF.get(top, top.replace("_", "-")))
    return found - {"survey-sim", "tests", "turn-taking"}


def _modules(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module


def test_every_dependency_is_used_and_every_import_declared() -> None:
    ours = imported("survey_sim", "reports", "pipelines")
    assert ours <= declared() | declared("serve")
    assert declared() <= ours
    assert declared("serve") - CALLED <= ours
    others = imported("tests", "docs") - COMPARED
    assert others <= declared() | declared("serve", "docs", "dev")
    assert declared("dev") - CALLED <= others


def test_every_dependency_has_its_reason() -> None:
    page = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8")
    named = {name.split(" ")[0] for row in re.findall(r"^\| ([a-z][^|]*) \|", page, flags=re.M) for name in row.split(", ")}
    assert named - {"package"} == declared() | declared("serve", "docs", "dev")
