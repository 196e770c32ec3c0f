"""The docs: every command and snippet runs as it stands there, links lead somewhere, written pages are those of the code."""

import ast
import os
import re
import shutil
import sys
import tomllib
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from typer.testing import CliRunner

from survey_sim.cli import app
from survey_sim.exchange import Standing, positions_document, to_bytes
from survey_sim.instrument import load_instrument, make_plate
from survey_sim.schema import TABLES
from survey_sim.survey.batches import Workers
from survey_sim.survey.docs import data_model_page
from survey_sim.survey.engine import run_stages
from survey_sim.survey.run import open_run
from survey_sim.survey.settings import PipelineSettings
from survey_sim.survey.settings_page import settings_page
from survey_sim.survey.specimen import write_specimen
from tests.docs_snippets import OPTIONAL_PROGRAM, SHOWN_ONLY, run_snippet, snippets
from tests.test_extending import PACKAGE, install

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted(
    [*(ROOT / "docs").glob("*.md"), *(ROOT / name for name in ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md"))]
    + [ROOT / folder / "README.md" for folder in ("catalogues", "pipelines", "reports")]
)
IDS = [page.relative_to(ROOT).as_posix() for page in PAGES]
_NIGHTS = "[schedule]\nstart_date = 2016-10-01\nend_date = 2016-10-02\n"


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """What pages suppose: a pipeline `small.toml` and its run `runs/small`, which is `runs/demo` too; a field's targets."""
    place = tmp_path_factory.mktemp("docs")
    pipeline = write_specimen(place, f"[allocation]\nmax_visits = 2\n{_NIGHTS}[output]\ntiles_per_part = 1\n", width_deg=6.0)
    pipeline.rename(place / "small.toml")
    run = open_run(place / "small.toml", Workers(), place / "runs" / "small")
    with run.locked():
        run_stages(run, skipped=("report",))
    (place / "runs" / "demo").symlink_to("small")
    rng = np.random.default_rng(1)
    radius, angle = 160.0 * np.sqrt(rng.random(300)), rng.uniform(0, 2 * np.pi, 300)
    columns = {"target_id": np.arange(300), "x_mm": radius * np.cos(angle), "y_mm": radius * np.sin(angle)}
    pl.DataFrame(columns).write_csv(place / "targets.csv")
    plate = make_plate(load_instrument("taipan-150"))
    document = positions_document(plate, Standing(plate.park_mm, np.zeros(plate.n_robot)))
    (place / "positions.xml").write_bytes(to_bytes(document))
    packages = place / "packages"
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text())["project"]
    install(packages, project["name"], project["version"], project["entry-points"])
    shutil.copy(PACKAGE / "turn_taking.py", packages)
    sys.path.insert(0, str(packages))
    yield place
    sys.path.remove(str(packages))


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_snippet_runs(page: Path, prepared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = tmp_path / "place"
    shutil.copytree(prepared, place, symlinks=True)
    for folder in ("reports", "pipelines", "catalogues"):
        (place / folder).symlink_to(ROOT / folder)
    monkeypatch.chdir(place)
    namespace: dict = {"__name__": page.stem}
    for snippet in snippets(page):
        if snippet.reason is not None:
            continue
        if OPTIONAL_PROGRAM in snippet.text and shutil.which(OPTIONAL_PROGRAM) is None:
            assert os.environ.get("SURVEY_SIM_REQUIRE_STILTS") != "1", "stilts is not installed (apt-get install stilts)"
            continue
        run_snippet(snippet, namespace)


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_no_command_hides_from_the_tests(page: Path) -> None:
    """Commands stand in fenced blocks of a language that is run."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    assert re.findall(r"^    (?:survey-sim|python|pip|pytest|dask) .*$", text, flags=re.MULTILINE) == []
    assert {snippet.language for snippet in snippets(page)} <= {"python", "sql", "sh", "toml"}, f"or {SHOWN_ONLY}"


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_commands_named_in_the_text_exist(page: Path) -> None:
    """Command and options of every `survey-sim ...` in the text."""
    for command in re.findall(r"`survey-sim ([a-z][^`]*)`", page.read_text(encoding="utf-8")):
        names = re.match(r"[a-z-]+(?: (?:list|check|make)\b)?", command)
        assert names
        words = names[0].split()
        shown = CliRunner().invoke(app, [*(words if words[0] == "catalogue" else words[:1]), "--help"], terminal_width=200)
        assert shown.exit_code == 0, command
        options = set(re.findall(r"--[a-z-]+", command))
        assert options <= {*re.findall(r"--[a-z-]+", re.sub(r"\x1b\[[0-9;]*m", "", shown.output))}, command


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    links = [link for link in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", text) if "://" not in link]
    made = ("made/",)  # by `make docs`, which fails if they are not there
    assert [link for link in links if not link.startswith(made) and not (page.parent / link).exists()] == []


def test_every_promise_names_tests_that_exist() -> None:
    page = (ROOT / "docs" / "guarantees.md").read_text(encoding="utf-8")
    files = {path: (ROOT / path).read_text(encoding="utf-8") for path in re.findall(r"`(tests/[\w/.]+\.\w+)`", page)}
    files |= {name: (ROOT / "tests" / name).read_text(encoding="utf-8") for name in re.findall(r"`(test_\w+\.py)`", page)}
    assert len(files) > 15
    sources = "\n".join(files.values())
    named = re.findall(r"`(test_\w+)`|\b(Test[A-Z]\w+)", page)
    assert named
    for function, kind in named:
        assert re.search(rf"^ *def {function}\(" if function else rf"^class {kind}\b", sources, flags=re.MULTILINE), (
            function,
            kind,
        )


def test_the_data_model_page_is_up_to_date() -> None:
    assert (ROOT / "docs" / "data-model.md").read_text(encoding="utf-8") == data_model_page(), "run `make docs`"


def test_every_column_stands_on_the_page() -> None:
    page = data_model_page()
    for table in TABLES.values():
        section = page.split(f"\n## {table.name}\n")[1].split("\n## ")[0]
        assert all(f"| `{column.name}" in section for column in (*table.columns, *table.prefixes))


def test_the_settings_page_has_sections_limits_defaults_and_comments() -> None:
    page = settings_page()
    for section in PipelineSettings.model_fields:
        assert f"\n## `[{section}]`" in page or f"\n## `[[{section}]]`" in page
    assert "| `coarse_speed_mm_s` | number, > 0 | `2.0` | P Table 1. |" in page
    assert "| `settle_s` | number, ≥ 0 | `10.0` | after every slew to another field (assumed) |" in page
    assert '| `takes` | list of `"dark"`, `"grey"`, `"bright"`, `"twilight"` | `["dark", "grey", "bright"]`' in page


def test_every_public_name_is_described() -> None:
    """What `docs/api.md` shows has a docstring: modules, functions, classes and their public methods."""
    modules = re.findall(r"automodule:: (\S+)", (ROOT / "docs" / "api.md").read_text(encoding="utf-8"))
    assert len(modules) > 10
    for name in modules:
        spec = find_spec(name)
        assert spec is not None
        assert spec.origin is not None
        for source in Path(spec.origin).parent.glob("*.py") if spec.submodule_search_locations else [Path(spec.origin)]:
            tree = ast.parse(source.read_text(encoding="utf-8"))
            defined = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.ClassDef)]
            inner = {id(child) for node in defined if isinstance(node, ast.FunctionDef) for child in ast.walk(node)} - {
                id(node) for node in defined if node in tree.body
            }
            bare = [node.name for node in defined if id(node) not in inner and not ast.get_docstring(node)]
            assert [name for name in bare if not name.startswith("_")] == [], source


@pytest.mark.parametrize(
    "target", ["demo", "test", "lint", "bench", "soak", "mutation", "docs", "catalogues", "survey", "help"]
)
def test_the_makefile_lists_its_targets(target: str) -> None:
    assert re.search(rf"^{target}:.*## ", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE)
