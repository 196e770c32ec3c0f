"""The fenced blocks of a page of the docs, and how each kind is run."""

import glob
import os
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import duckdb
from typer.testing import CliRunner

from survey_sim.cli import app
from survey_sim.survey.settings import PipelineSettings

# Before a block that the tests do not run, with the reason.
NOT_RUN = re.compile(r"<!-- not run: (?P<reason>[^>]+) -->\s*\Z")
BLOCK = re.compile(r"^```(?P<language>[^\n]*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
# Languages of blocks that are nothing to run; and Sphinx's directives.
SHOWN_ONLY = ("text", "json", "xml")
# A program that a machine may lack, which a block then cannot use.
OPTIONAL_PROGRAM = "stilts"
_FILLER = {"run": {"name": "fragment"}, "programme": [{"name": "p", "survey": "s", "catalogue": "tycho2"}]}


@dataclass(frozen=True)
class Snippet:
    """One fenced block; `reason` says why it is not run."""

    language: str
    text: str
    reason: str | None

    @property
    def first_line(self) -> str:
        """What it begins with."""
        return self.text.splitlines()[0] if self.text else ""


def snippets(page: Path) -> list[Snippet]:
    """The blocks of a page, in order."""
    text = page.read_text(encoding="utf-8")
    found = []
    for match in BLOCK.finditer(text):
        if match["language"].startswith("{") or match["language"] in SHOWN_ONLY:
            continue
        excused = NOT_RUN.search(text[: match.start()])
        found.append(Snippet(match["language"], match["text"], excused["reason"] if excused else None))
    return found


def run_snippet(snippet: Snippet, namespace: dict[str, Any]) -> None:
    """Run a block in the present folder; Python blocks of a page share their names."""
    match snippet.language:
        case "python":
            before = set(namespace)
            exec(compile(snippet.text, snippet.first_line, "exec"), namespace)
            for name in set(namespace) - before:
                if name.startswith("test_"):
                    namespace[name]()
        case "sql":
            for statement in filter(str.strip, snippet.text.split(";")):
                assert duckdb.sql(statement).fetchall(), statement
        case "sh":
            run_shell(snippet.text)
        case "toml":
            read_toml(snippet)
        case other:
            raise AssertionError(f"no way to run a block in {other!r}: {snippet.first_line}")


def run_shell(text: str) -> None:
    """Commands of ours are called in this process, which saves their start; the others by bash."""
    for line in re.sub(r"\\\n", " ", text).splitlines():
        words = shlex.split(line, comments=True)
        if not words:
            continue
        if words[0] == "survey-sim":
            arguments = [name for word in words[1:] for name in (sorted(glob.glob(word)) if "*" in word else [word])]
            done = CliRunner().invoke(app, arguments)
            assert done.exit_code == 0, f"{line}\n{done.output}\n{done.exception!r}"
        else:
            programs = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
            environment = {**os.environ, "PATH": programs, "PYTHONPATH": ":".join(filter(None, sys.path))}
            done_by_bash = subprocess.run(
                ["bash", "-ec", line], capture_output=True, text=True, env=environment, check=False, timeout=120
            )
            assert done_by_bash.returncode == 0, f"{line}\n{done_by_bash.stderr}"


def read_toml(snippet: Snippet) -> None:
    """A block that begins with a file's name is written there; a piece of a pipeline must be one that can be loaded."""
    values = tomllib.loads(snippet.text)
    if named := re.fullmatch(r"# (\S+\.toml)", snippet.first_line):
        Path(named[1]).write_text(snippet.text, encoding="utf-8")
    elif values.keys() <= PipelineSettings.model_fields.keys():
        PipelineSettings.load({**_FILLER, **values})
