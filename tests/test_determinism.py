"""The same bytes whoever runs it, wherever, and under whatever settings of the system."""

import os
from pathlib import Path

import pytest

from tests.faults import BRIEF_COMMAND, COMMAND, assert_same_run, finish, run_to_the_end
from tests.small_survey import write_small_survey

ENVIRONMENTS = {
    "half hours, hash 4242, Turkish": {"PYTHONHASHSEED": "4242", "TZ": "America/St_Johns", "LC_ALL": "tr_TR.UTF-8"},
}


@pytest.fixture(scope="module")
def pipeline(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small_survey(tmp_path_factory.mktemp("sky"))


@pytest.fixture(scope="module")
def undisturbed(pipeline: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "run"
    run_to_the_end(BRIEF_COMMAND, pipeline, out, env={**os.environ, "PYTHONHASHSEED": "0"})
    return out


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_any_environment(name: str, pipeline: Path, undisturbed: Path, tmp_path: Path) -> None:
    run_to_the_end(BRIEF_COMMAND, pipeline, tmp_path / "run", env={**os.environ, **ENVIRONMENTS[name]}, cwd=tmp_path)
    assert_same_run(tmp_path / "run", undisturbed)


@pytest.mark.parametrize("n_worker", ["1", "3"])
def test_any_number_of_workers(n_worker: str, pipeline: Path, undisturbed: Path, tmp_path: Path) -> None:
    run_to_the_end(BRIEF_COMMAND, pipeline, tmp_path / "run", "--workers", n_worker)
    assert_same_run(tmp_path / "run", undisturbed)


@pytest.fixture(scope="module")
def older(pipeline: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run by a version whose tables were others."""
    out = tmp_path_factory.mktemp("older") / "run"
    command = [*BRIEF_COMMAND[:2], "from survey_sim import schema; schema.SCHEMA_VERSION = 0\n" + BRIEF_COMMAND[2]]
    run_to_the_end(command, pipeline, out)
    return out


@pytest.mark.parametrize("command", ["report", "check"])
def test_tables_of_another_schema_version_are_refused_in_words(command: str, older: Path) -> None:
    done = finish(COMMAND, command, str(older))
    assert done.returncode in {1, 2}, done.stderr
    assert "schema version 0, this package reads" in done.stderr.replace("\n", " ")
    assert "Traceback" not in done.stderr


def test_a_run_of_another_schema_version_is_made_again(pipeline: Path, undisturbed: Path, older: Path) -> None:
    run_to_the_end(BRIEF_COMMAND, pipeline, older)
    assert_same_run(older, undisturbed)
