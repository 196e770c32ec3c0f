"""The docs: the page of the data model is that of the schema, and the README's links and commands exist."""

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from survey_sim.cli import app
from survey_sim.schema import TABLES
from survey_sim.survey.docs import data_model_page

ROOT = Path(__file__).resolve().parent.parent


def test_the_data_model_page_is_up_to_date() -> None:
    assert (ROOT / "docs" / "data-model.md").read_text(encoding="utf-8") == data_model_page(), "run `make docs`"


def test_every_column_stands_on_the_page() -> None:
    page = data_model_page()
    for table in TABLES.values():
        section = page.split(f"\n## {table.name}\n")[1].split("\n## ")[0]
        assert all(f"| `{column.name}" in section for column in (*table.columns, *table.prefixes))


def test_links_of_the_readme_lead_somewhere() -> None:
    links = re.findall(r"\]\(([^)#]+)\)", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert len(links) >= 4
    assert [link for link in links if not (ROOT / link).exists()] == []


def test_commands_of_the_readme_exist() -> None:
    named = set(re.findall(r"`survey-sim ([a-z-]+)", (ROOT / "README.md").read_text(encoding="utf-8")))
    assert named >= {"run", "check", "report"}
    for command in named:
        assert CliRunner().invoke(app, [command, "--help"]).exit_code == 0, command


@pytest.mark.parametrize("target", ["demo", "test", "lint", "bench", "docs", "catalogues", "survey", "help"])
def test_the_makefile_lists_its_targets(target: str) -> None:
    assert re.search(rf"^{target}:.*## ", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE)
