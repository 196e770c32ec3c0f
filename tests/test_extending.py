"""Allocators and routers of another package: found, named, run, proved; and what is wrong with bad ones is told."""

import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from survey_sim import extensions, tables
from survey_sim.allocation import AllocationSettings
from survey_sim.conformance import check_allocator, check_router
from survey_sim.conformance import main as conformance
from survey_sim.errors import InputError
from survey_sim.routing import RoutingSettings
from survey_sim.survey.engine import run_stages
from survey_sim.survey.run import open_run
from survey_sim.survey.specimen import write_specimen
from survey_sim.survey.stages import parameters
from survey_sim.survey.workers import Workers

PACKAGE = Path(__file__).parent / "extension_package"
# Routers that are wrong in one way each.
BAD = """
from dataclasses import replace

import numpy as np

from turn_taking import route_one_at_a_time

def text(problem, settings, rng):
    return "legs"

def nan(problem, settings, rng):
    legs, reasons = route_one_at_a_time(problem, settings, rng)
    return replace(legs, dx_mm=legs.dx_mm * np.nan), reasons

def unsorted(problem, settings, rng):
    legs, reasons = route_one_at_a_time(problem, settings, rng)
    return legs.take(np.arange(len(legs))[::-1]), reasons

def half(problem, settings, rng):
    legs, reasons = route_one_at_a_time(problem, settings, rng)
    return legs, reasons[:5]

def codes(problem, settings, rng):
    legs, reasons = route_one_at_a_time(problem, settings, rng)
    return legs, reasons + 50

def unrouted(problem, settings, rng):
    legs, reasons = route_one_at_a_time(problem, settings, rng)
    return legs, np.ones_like(reasons)

def hurried(problem, settings, rng):
    legs, reasons = route_one_at_a_time(problem, settings, rng)
    return legs.starting_at(np.zeros(len(legs))), reasons

def lost(problem, settings, rng):
    legs, reasons = route_one_at_a_time(problem, settings, rng)
    return legs.take(np.arange(len(legs)) != 3), reasons

def moody(problem, settings, rng):
    legs, reasons = route_one_at_a_time(problem, settings, rng)
    return legs.starting_at(legs.start_s + np.random.default_rng().random()), reasons

def allocator(choose):
    return lambda field, rng: choose

@allocator
def greedy(field, request):
    return np.zeros(field.plate.n_robot, dtype=int)

@allocator
def closed(field, request):
    held = np.full(field.plate.n_robot, -1)
    pair = np.flatnonzero(field.targets.is_science[field.pair_target()])[0]
    held[field.reach_robot[pair]] = field.pair_target()[pair]
    return held

@allocator
def far(field, request):
    held = np.full(field.plate.n_robot, -1)
    star = np.flatnonzero(request.is_open)[0]
    held[np.argmax(np.hypot(*(field.xy_mm[star] - field.plate.park_mm).T))] = star
    return held

@allocator
def floats(field, request):
    return np.full(field.plate.n_robot, np.nan)
"""

BAD_ROUTERS = ("text", "nan", "unsorted", "half", "codes", "unrouted", "hurried", "lost", "moody")
BAD_ALLOCATORS = ("greedy", "closed", "far", "floats")


def install(folder: Path, name: str, version: str, groups: dict[str, dict[str, str]]) -> None:
    """What an installer leaves of a package besides its modules."""
    metadata = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    lines = [line for group, names in groups.items() for line in (f"[{group}]", *(f"{k} = {v}" for k, v in names.items()))]
    (metadata / "entry_points.txt").write_text("\n".join(lines) + "\n")


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder of installed packages on the module path: the example of the docs, and bad ones."""
    folder = tmp_path_factory.mktemp("packages")
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text())["project"]
    (folder / "turn_taking.py").write_text((PACKAGE / "turn_taking.py").read_text())
    install(folder, project["name"], project["version"], project["entry-points"])
    (folder / "bad_ways.py").write_text(BAD)
    routers = {name: f"bad_ways:{name}" for name in BAD_ROUTERS} | {"gone": "no_such_module:route"}
    allocators = {name: f"bad_ways:{name}" for name in BAD_ALLOCATORS}
    install(folder, "bad-ways", "0.1", {"survey_sim.routers": routers, "survey_sim.allocators": allocators})
    sys.path.insert(0, str(folder))
    yield folder
    sys.path.remove(str(folder))


def test_the_examples_keep_the_rules(packages: Path) -> None:
    routed = check_router("one-at-a-time")
    assert routed["survey"].to_list() == ["plain", "dead robots", "wide separation", "short reach"]
    assert (routed["time_to_bound"] > 5).all()
    allocated = check_allocator("brightest-first")
    assert (allocated["completeness_frac"] > 0.7).all()


def test_ours_keep_them_from_park_too() -> None:
    assert (check_router("coordinated", algorithm="cda-basic", surveys=["plain"])["time_to_bound"] < 1.2).all()


def test_workers_import_them(packages: Path, tmp_path: Path) -> None:
    sections = '[routing]\nrouter = "one-at-a-time"\n[allocation]\nalgorithm = "brightest-first"\nvisits = 1\n'
    pipeline = write_specimen(tmp_path, f"{sections}[output]\ntiles_per_part = 1\n", n_star=60, width_deg=9.0)
    made = [open_run(pipeline, Workers(n), tmp_path / f"run-{n}") for n in (0, 2)]
    for run in made:
        with run.locked():
            run_stages(run, skipped=("schedule", "report"))
    legs = [tables.read(run.folder, "legs") for run in made]
    assert legs[0]["tile_id"].n_unique() >= 2, "one tile would be done in this process"
    assert legs[0].equals(legs[1])


@pytest.mark.parametrize("name", ["text", "nan", "unsorted", "half", "codes", "unrouted", "lost"])
def test_a_router_that_gives_nonsense_is_refused(packages: Path, name: str) -> None:
    with pytest.raises(InputError, match=rf"routing\.router: router '{name}' gave (.|\n)*mend that package"):
        check_router(name, surveys=["plain"])


@pytest.mark.parametrize(("name", "fault"), [("hurried", "separation"), ("moody", "second run differ")])
def test_a_router_that_breaks_the_rules_fails_the_proof(packages: Path, name: str, fault: str) -> None:
    with pytest.raises(AssertionError, match=fault):
        check_router(name, surveys=["plain"])


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("greedy", "one target to two robots"),
        ("closed", "not open"),
        ("far", "may not serve"),
        ("floats", "whole numbers"),
    ],
)
def test_an_allocator_that_breaks_a_rule_is_refused(packages: Path, name: str, rule: str) -> None:
    with pytest.raises(InputError, match=rf"allocator '{name}' gave (.|\n)*{rule}"):
        check_allocator(name, surveys=["plain"])


def test_an_unknown_name_lists_all_that_there_are(packages: Path) -> None:
    with pytest.raises(InputError) as failure:
        RoutingSettings.load({"router": "one-at-a-tim"}, section="routing")
    for word in ("routing.router", "did you mean 'one-at-a-time'?", "coordinated", "one-at-a-time (turn-taking 1.0)"):
        assert word in str(failure.value)
    with pytest.raises(InputError, match=r"allocation\.algorithm(.|\n)*matching(.|\n)*brightest-first \(turn-taking 1\.0\)"):
        AllocationSettings.load({"algorithm": "x"}, section="allocation")


def test_a_name_that_cannot_be_imported_says_so(packages: Path) -> None:
    with pytest.raises(InputError, match="cannot be imported: No module named 'no_such_module'"):
        extensions.load("router", "gone")


def test_a_name_that_two_packages_claim_is_refused(packages: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "rival", "2", {"survey_sim.routers": {"one-at-a-time": "rival:route", "coordinated": "rival:route"}})
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match=r"claimed by rival 2 and turn-taking 1\.0"):
        RoutingSettings.load({"router": "one-at-a-time"})
    assert RoutingSettings.load({"router": "coordinated"}).router == "coordinated"
    assert extensions.origin("router", "coordinated", ("coordinated",)) is None


def test_options_reach_the_router_and_are_refused_by_ours(packages: Path) -> None:
    slow, quick = (check_router("one-at-a-time", {"pause_s": pause_s}, surveys=["plain"]) for pause_s in (10.0, 0.0))
    assert slow["time_to_bound"].item() > quick["time_to_bound"].item()
    for model, key in ((RoutingSettings, "router"), (AllocationSettings, "algorithm")):
        assert key in model.model_fields
        with pytest.raises(InputError, match="options are for"):
            model.load({"options": {"pause_s": 1.0}})


def test_a_run_depends_on_the_code_of_the_package(packages: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "turn_taking", raising=False)  # another test may have it from another folder
    run = open_run(write_specimen(tmp_path, '[routing]\nrouter = "one-at-a-time"\n'), Workers(), tmp_path / "run")
    before = parameters(run, "visits")["extensions"]
    assert before["one-at-a-time"]["package"] == "turn-taking 1.0"
    module = packages / "turn_taking.py"
    text = module.read_text()
    module.write_text(text + "\n# edited\n")
    after = parameters(run, "visits")["extensions"]
    module.write_text(text)
    assert before["one-at-a-time"]["sha256"] != after["one-at-a-time"]["sha256"]


def test_the_command_prints_figures_or_what_is_wrong(packages: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert conformance(["router", "hurried"]) == 1
    assert "separation: " in capsys.readouterr().err
    assert conformance(["routers"]) == 2
    assert "usage" in capsys.readouterr().err
