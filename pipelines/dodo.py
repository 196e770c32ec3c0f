"""The stages of a run as make-style tasks: what each reads, what it writes, and what it depends on besides.

A stage is out of date when a file it reads, a setting it uses, or the code it runs has changed, or when something it writes
is not there.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from survey_sim.survey import stages
from survey_sim.survey.engine import Stage, Unchanged
from survey_sim.survey.run import Run, code_digest
from survey_sim.survey.transitions import are_parts_whole


def make_stages(run: Run) -> Iterator[Stage]:
    """Stages of a run, in the order in which they run."""

    def files(*tables: str) -> list[Path]:
        return [run.table(table) for table in tables]

    def stage(
        name: str,
        action: Callable,
        reads: Sequence[Path],
        writes: Sequence[Path],
        is_whole: Callable[[], bool] = lambda: True,
    ) -> Stage:
        settings = Unchanged("settings", stages.parameters(run, name))
        code = Unchanged("code", {"digest": code_digest(*stages.STAGE_ROOMS[name])})
        return Stage(name, action, tuple(reads), tuple(writes), (settings, code), is_whole)

    selected = stages.selected_path(run)
    sky = ("targets", "tiles")
    nights = stages.scheduled_tables(run)
    page = run.folder / "report" / "index.html"

    yield stage("targets", stages.select_targets, stages.catalogue_files(run), [selected, *files("rejected")])
    yield stage("tiles", stages.place_tiles, [selected], stages.covered_paths(run))
    yield stage("pool", stages.pool_tiles, stages.covered_paths(run), [*files(*sky), stages.plans_path(run)])
    yield stage(
        "visits",
        stages.simulate_visits,
        [*files(*sky), stages.plans_path(run)],
        files("robots", *stages.GATHERED),
        is_whole=lambda: stages.are_parts_whole(run),
    )
    yield stage(
        "schedule",
        stages.make_night_schedule,
        files(*sky, *stages.GATHERED),
        files(*nights),
        is_whole=lambda: are_parts_whole(run),
    )
    drawn = [*files(*sky, *stages.GATHERED, *nights), *stages.report_files()]
    yield stage("report", stages.draw_report, drawn, [page])
