"""The command line: parses, calls one function of `survey`, prints. Heavy libraries are imported where they are used."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
import typer.core

from survey_sim import interrupts
from survey_sim.cli_field import Change, Quiet, add_field_commands
from survey_sim.errors import InputError

INTERRUPTED = 130
BAD_INPUT = 2


class Commands(typer.core.TyperGroup):
    """Commands whose errors become one readable block on stderr and an exit code."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command that was named."""
        try:
            return super().invoke(ctx)
        except BaseException as failure:
            _end_with_words(failure)
            raise


app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Batch simulator for whole surveys with Starbug fibre robots: from catalogue to routed visits and report.",
)
catalogue_app = typer.Typer(no_args_is_help=True, help="Catalogues: what there is, whether it is sound, and mocks.")
app.add_typer(catalogue_app, name="catalogue")

RunDir = Annotated[Path, typer.Argument(metavar="RUN_DIR", help="Folder of a run, such as runs/demo.", show_default=False)]


@app.command()
def run(
    pipeline: Annotated[
        Path,
        typer.Argument(metavar="PIPELINE.toml", help="Pipeline or scenarios, or the name of one that is shipped (demo)."),
    ],
    out: Annotated[Path | None, typer.Option(help="Folder of the run; runs/<name> by default.")] = None,
    change: Change = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes on this machine; one a core by default.")] = None,
    scheduler: Annotated[str | None, typer.Option(metavar="ADDRESS", help="Use the dask cluster of this scheduler.")] = None,
    serial: Annotated[bool, typer.Option("--serial", help="Do everything in this process.")] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="List the stages and why each would run; write nothing.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Run a whole pipeline or a file of scenarios, or what is out of date of it."""
    from survey_sim.folders import find_pipeline
    from survey_sim.survey.engine import plan_stages, run_stages
    from survey_sim.survey.run import open_run
    from survey_sim.survey.sweep import is_sweep
    from survey_sim.survey.workers import Workers

    if sum([workers is not None, scheduler is not None, serial]) > 1:
        raise InputError("exclude each other", place="--workers, --scheduler, --serial", remedy="give one of them")
    n_worker = 0 if serial else workers or len(os.sched_getaffinity(0))
    console = _console(quiet)
    file, changes = find_pipeline(pipeline), tuple(change or ())
    if is_sweep(file):
        _run_scenarios(file, out, changes, Workers(n_worker, scheduler), dry_run, console)
        return
    opened = open_run(file, Workers(n_worker, scheduler), out, changes, console)
    if dry_run:
        for name, reasons in plan_stages(opened):
            typer.echo(f"{name}: {'; '.join(reasons) or 'up to date'}")
        return
    with opened.locked():
        run_stages(opened)
    console.print(f"done: [bold]{opened.folder}[/bold]")
    console.print(f"  look at  {opened.folder / 'report' / 'index.html'}")
    console.print(f"  prove it survey-sim check {opened.folder}")


@app.command()
def report(run_dir: RunDir, quiet: Quiet = False) -> None:
    """Draw the figures and the page of a finished run again."""
    from survey_sim.survey.report import make_report

    page = make_report(run_dir)
    _console(quiet).print(f"report: {page}")


@app.command()
def check(run_dir: RunDir, quiet: Quiet = False) -> None:
    """Prove every allocation and every leg again from the tables alone; exit 1 with the rows if anything is wrong."""
    from survey_sim.survey.proof import fault_lines, prove

    lines = fault_lines(prove(run_dir, _console(quiet)))
    if lines:
        print("\n".join(lines), file=sys.stderr)
        raise typer.Exit(1)


@app.command()
def compare(
    run_dirs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN_DIR ...", help="Folders of runs, or of a sweep: all its runs.", show_default=False),
    ],
    out: Annotated[Path | None, typer.Option(help="Folder of the comparison; the sweep's comparison/ by default.")] = None,
    reference: Annotated[str | None, typer.Option(help="Scenario that the others are compared to.")] = None,
    quiet: Quiet = False,
) -> None:
    """Scenarios side by side: differences with uncertainties from paired seeds, as text, Parquet and HTML."""
    from survey_sim.plotting.comparison import ComparisonTables
    from survey_sim.survey.compare import compare_runs
    from survey_sim.survey.comparison_page import text_of, write_comparison

    folder = compare_runs(run_dirs, out, reference)
    page = write_comparison(folder)
    if not quiet:
        typer.echo(text_of(ComparisonTables(folder)), nl=False)
    _console(quiet).print(f"comparison: {page}")


@app.command()
def imprint(
    run_dir: RunDir,
    out: Annotated[Path | None, typer.Option(help="Folder of tables and figures; imprint/ in the run's by default.")] = None,
    quiet: Quiet = False,
) -> None:
    """What the allocation prints on the sky: completeness by pair separation, density, place on the plate, and park."""
    from survey_sim.survey.compare import write_imprint

    _console(quiet).print(f"imprint: {write_imprint(run_dir, out)}")


@app.command()
def weights(
    run_dir: RunDir,
    realisations: Annotated[int, typer.Option(min=1, help="Realisations of the allocation.")] = 128,
    survey: Annotated[
        list[str] | None, typer.Option(help="Survey that is weighed; all by default. May be repeated.")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes on this machine; one a core by default.")] = None,
    quiet: Quiet = False,
) -> None:
    """Selection probabilities and bitwise weights: the allocation of a run realised many times (table bitweights)."""
    from survey_sim.survey.weights import weigh_run
    from survey_sim.survey.workers import Workers

    n_worker = workers or len(os.sched_getaffinity(0))
    console, crew = _console(quiet), Workers(n_worker)
    try:
        path, remarks = weigh_run(run_dir, realisations, crew, console, survey or ())
    finally:
        crew.close()
    for remark in remarks:
        console.print(f"[yellow]warning:[/yellow] {remark}")
    console.print(f"weights: {path}")


add_field_commands(app)


@catalogue_app.command("list")
def catalogue_list() -> None:
    """List the catalogues that pipelines can name."""
    from survey_sim.catalogue import list_cards
    from survey_sim.folders import data_folder

    for card in list_cards(data_folder("catalogues")):
        typer.echo(f"{card.name:16} {card.title} ({card.licence})")


@catalogue_app.command("check")
def catalogue_check(
    card: Annotated[str, typer.Argument(metavar="CARD", help="Name of a catalogue, or the path of a card.")],
) -> None:
    """Read a catalogue through its card and say what it holds, or what is wrong with it."""
    from survey_sim.catalogue import check_catalogue
    from survey_sim.folders import cache_folder, data_folder

    _echo_items(check_catalogue(card, data_folder("catalogues"), cache_folder()))


@catalogue_app.command("make")
def catalogue_make(
    card: Annotated[str, typer.Argument(metavar="CARD", help="Name of a mock's card, such as taipan-mock.")],
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the mock; the card's own by default.")] = None,
    out: Annotated[Path | None, typer.Option(help="File to write; <card>.parquet in the cache by default.")] = None,
) -> None:
    """Make a mock catalogue from its recipe."""
    from survey_sim.catalogue import make_catalogue
    from survey_sim.folders import data_folder

    _echo_items(make_catalogue(card, data_folder("catalogues"), seed, out))


def _run_scenarios(
    file: Path, out: Path | None, changes: tuple[str, ...], workers: Any, dry_run: bool, console: Any
) -> None:
    from survey_sim.survey.compare import compare_runs
    from survey_sim.survey.comparison_page import write_comparison
    from survey_sim.survey.sweep import load_sweep, plan_sweep, run_sweep

    sweep = load_sweep(file, out, changes)
    if dry_run:
        for line in plan_sweep(sweep):
            typer.echo(line)
        return
    run_sweep(sweep, workers, console)
    page = write_comparison(compare_runs([sweep.folder]))
    console.print(f"done: [bold]{sweep.folder}[/bold]")
    console.print(f"  look at  {page}")


def main() -> None:
    """Entry point."""
    interrupts.listen()
    app()


def _end_with_words(failure: BaseException) -> None:
    """End the process if it is known what went wrong. A library may have made anything of an interrupt."""
    if isinstance(failure, KeyboardInterrupt) or interrupts.are_asked():
        _fail("interrupted: finished tiles are kept, run the same command again to go on", INTERRUPTED)
    if isinstance(failure, InputError):
        _fail(str(failure), BAD_INPUT)
    if isinstance(failure, OSError) and not isinstance(failure, BrokenPipeError):
        _fail(f"{failure.filename or 'system'}: {failure.strerror or failure}", BAD_INPUT)
    if _is_of_damaged_table(failure):
        text = " ".join(str(failure).split())[:200]
        _fail(f"a table cannot be read: {text}\n  remedy: run the pipeline again: it remakes what is damaged", BAD_INPUT)


def _fail(message: str, code: int) -> NoReturn:
    print(f"error: {message}", file=sys.stderr)
    sys.exit(code)


def _is_of_damaged_table(failure: BaseException) -> bool:
    """Whether polars gave up on a file; a panic of its own is not even an Exception."""
    polars = sys.modules.get("polars")
    return polars is not None and isinstance(failure, polars.exceptions.ComputeError | polars.exceptions.PanicException)


def _echo_items(items: dict[str, Any]) -> None:
    for key, value in items.items():
        typer.echo(f"{key:24} {value}")


def _console(quiet: bool) -> Any:
    from rich.console import Console

    return Console(stderr=True, quiet=quiet, highlight=False)


if __name__ == "__main__":
    main()
