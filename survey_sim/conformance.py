"""Whether an allocator or a router of another package keeps the rules: small surveys with it, proved by the checker.

In that package's tests:

    from survey_sim.conformance import check_router

    def test_my_router_keeps_the_rules() -> None:
        check_router("my-router")

or on the command line: `python -m survey_sim.conformance router my-router`. Ours pass it too.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import polars as pl

from survey_sim import tables
from survey_sim.check import check_run
from survey_sim.errors import InputError
from survey_sim.survey.engine import run_stages
from survey_sim.survey.proof import fault_lines
from survey_sim.survey.run import Run, open_run
from survey_sim.survey.specimen import write_specimen
from survey_sim.survey.workers import Workers

# Lines of [instrument] of each survey: what makes life hard for an allocator or a router.
_INSTRUMENT = {
    "plain": "",
    "dead robots": "dead_robots = [17, 60, 93, 120]",
    "wide separation": "min_separation_mm = 11.65",
    "short reach": "patrol_radius_mm = 26.0",
}
SURVEYS = tuple(_INSTRUMENT)
_SKIPPED = ("schedule", "report")
_MADE = ("visits", "allocations", "paths", "legs", "robot_times")


def check_router(
    name: str, options: Mapping[str, Any] | None = None, *, algorithm: str = "plan", surveys: Sequence[str] = SURVEYS
) -> pl.DataFrame:
    """Route small surveys by a router, and prove all that it did from the tables alone.

    Parameters
    ----------
    name
        As a pipeline's `routing.router`.
    options
        As `[routing.options]`.
    algorithm
        That says where robots go; with `cda-basic` every visit starts from park.
    surveys
        Which of `SURVEYS`, all by default.

    Returns
    -------
        A row a survey: visits, completeness, robots not routed, mean of configuration time / lower bound, CPU seconds.

    Raises
    ------
    AssertionError
        The checker finds a fault, or a second run differs in a byte.
    InputError
        The name is unknown, or what it gives has not the right form.
    """
    sections = _section("allocation", "algorithm", algorithm, None) + _section("routing", "router", name, options)
    return _check(sections, surveys)


def check_allocator(
    name: str, options: Mapping[str, Any] | None = None, *, surveys: Sequence[str] = SURVEYS
) -> pl.DataFrame:
    """As `check_router`, of an allocator: `name` as a pipeline's `allocation.algorithm`, `options` as its `options`."""
    return _check(_section("allocation", "algorithm", name, options), surveys)


def _section(section: str, key: str, name: str, options: Mapping[str, Any] | None) -> str:
    given = "".join(f"{option} = {_toml(value)}\n" for option, value in (options or {}).items())
    return f'[{section}]\n{key} = "{name}"\n' + (f"[{section}.options]\n{given}" if given else "")


def _toml(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _check(sections: str, surveys: Sequence[str]) -> pl.DataFrame:
    rows = []
    with TemporaryDirectory(prefix="survey-sim-") as folder:
        for survey in surveys:
            text = f"[instrument]\n{_INSTRUMENT[survey]}\n{sections}[output]\ntiles_per_part = 1\n"
            place = Path(folder) / survey.replace(" ", "-")
            pipeline = write_specimen(place, text, n_star=160, width_deg=6.0)
            once, again = (_run(pipeline, place / name) for name in ("once", "again"))
            _prove(once, survey)
            _compare(once.folder, again.folder, survey)
            rows.append({"survey": survey, **_figures(once)})
    return pl.DataFrame(rows)


def _run(pipeline: Path, folder: Path) -> Run:
    run = open_run(pipeline, Workers(), folder)
    with run.locked():
        run_stages(run, skipped=_SKIPPED)
    return run


def _prove(run: Run, survey: str) -> None:
    lines = fault_lines(check_run(run.folder))
    if lines:
        raise AssertionError("\n".join([f"survey {survey!r}:", *lines]))


def _compare(once: Path, again: Path, survey: str) -> None:
    """The same input gives the same tables."""
    for table in _MADE:
        if not tables.read(once, table).equals(tables.read(again, table)):
            raise AssertionError(f"survey {survey!r}: {table} of a second run differ; use only the generator that is given")


def _figures(run: Run) -> dict[str, float]:
    visits, paths = tables.read(run.folder, "visits"), tables.read(run.folder, "paths")
    last = visits.group_by("tile_id").agg(pl.col("completeness_frac").last())["completeness_frac"]
    ratio = paths.filter(pl.col("lower_bound_s") > 0).select(pl.col("configuration_time_s") / pl.col("lower_bound_s"))
    return {
        "visits": len(visits),
        "completeness_frac": float(last.to_numpy().mean()),
        "unrouted": int(paths["unrouted"].sum()),
        "time_to_bound": float(ratio.to_series().to_numpy().mean()),
        "cpu_s": tables.read_record(run.folder)["stages"]["visits"]["cpu_s"],
    }


def main(arguments: list[str]) -> int:
    """`router NAME` or `allocator NAME`: print the figures, or what is wrong."""
    kinds: dict[str, Any] = {"router": check_router, "allocator": check_allocator}
    if len(arguments) != 2 or arguments[0] not in kinds:
        print("usage: python -m survey_sim.conformance router|allocator NAME", file=sys.stderr)
        return 2
    try:
        print(kinds[arguments[0]](arguments[1]))
    except (AssertionError, InputError) as failure:
        print(f"error: {failure}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
