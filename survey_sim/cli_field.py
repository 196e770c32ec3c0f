"""Commands of single fields and exchange files, for `cli`. Heavy libraries are imported where they are used."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from survey_sim.errors import InputError

if TYPE_CHECKING:
    import polars as pl

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
Instrument = Annotated[
    str | None,
    typer.Option(
        metavar="NAME/FILE", help="Preset or TOML file; by default the one that the files describe.", show_default=False
    ),
]
RunOrFiles = Annotated[
    list[Path],
    typer.Argument(metavar="RUN_DIR / FILE.xml ...", help="A run folder, or exchange files in order.", show_default=False),
]
Out = Annotated[
    Path | None, typer.Option(help="Folder to write; the run folder named, or runs/field, by default.", show_default=False)
]

Survey = Annotated[str | None, typer.Option(help="Survey of the run.", show_default=False)]
Tile = Annotated[int | None, typer.Option(min=0, help="Tile of the survey.", show_default=False)]
Visits = Annotated[list[int] | None, typer.Option(min=0, help="Visit of the tile. May be repeated.", show_default=False)]
Change = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change a setting: section.key=value. May be repeated."),
]
# Short heads, so that a row fits a terminal.
_SUMMARY_HEADS = {
    "visit_id": "visit",
    **{f"n_{kind}": kind for kind in ("science", "standard", "sky", "guide")},
    "travel_mean_mm": "mean_mm",
    "travel_max_mm": "max_mm",
    "crossings": "crossings",
    "completeness_frac": "complete",
}

_STUDY_HEADS = {
    "completeness_frac": "complete_%",
    "bound_frac": "bound_%",
    "travel_mean_mm": "mean_mm",
    "travel_p95_mm": "p95_mm",
    "travel_max_mm": "max_mm",
}


def allocate(
    targets: Annotated[
        Path,
        typer.Argument(
            help="VOTable, FITS, CSV or Parquet with target_id and x_mm, y_mm (or ra_deg, dec_deg).", show_default=False
        ),
    ],
    instrument: Annotated[str, typer.Option(metavar="NAME/FILE", help="Preset or TOML file.")] = "taipan-150",
    algorithm: Annotated[
        str, typer.Option(help="ideal, cda-basic, cda-advanced, matching, plan, or an installed package's.")
    ] = "plan",
    visits: Annotated[
        int | None, typer.Option(min=1, help="Visits; by default as many as completeness needs.", show_default=False)
    ] = None,
    travel_power: Annotated[float, typer.Option(help="Cost of a move of d mm is d^POWER.")] = 4.0,
    centre: Annotated[
        str | None, typer.Option(metavar="RA,DEC", help="Field centre, deg; sky positions then count.", show_default=False)
    ] = None,
    dead: Annotated[
        list[int] | None, typer.Option(metavar="ROBOT", help="Robot that never moves. May be repeated.", show_default=False)
    ] = None,
    change: Change = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random streams.")] = 1,
    out: Annotated[Path, typer.Option(help="Folder to write.")] = Path("runs/field"),
    quiet: Quiet = False,
) -> None:
    """Allocate the targets of one field: tables, and one allocation file a visit."""
    from survey_sim.survey.field import allocate_field

    made = allocate_field(
        targets,
        out,
        instrument=instrument,
        algorithm=algorithm,
        visits=visits,
        travel_power=travel_power,
        centre_deg=None if centre is None else _centre(centre),
        dead=tuple(dead or ()),
        seed=seed,
        changes=tuple(change or ()),
    )
    console = _console(quiet)
    console.print(_table(made.visits.select(*_SUMMARY_HEADS).rename(_SUMMARY_HEADS)))
    if made.n_off_plate:
        console.print(f"[yellow]warning:[/yellow] {made.n_off_plate} targets lie outside the plate")
    console.print(f"{len(made.files)} allocation files: [bold]{made.files[0].parent}[/bold]")
    console.print(f"  next  survey-sim route {made.out}")


def route(
    sources: RunOrFiles,
    router: Annotated[
        str, typer.Option(help="simple-vector, traffic-light, cooperative-astar, coordinated, or an installed package's.")
    ] = "coordinated",
    start: Annotated[
        Path | None, typer.Option(metavar="POSITIONS.xml", help="Backup file of the robots' positions.", show_default=False)
    ] = None,
    instrument: Instrument = None,
    change: Change = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random streams.")] = 1,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """Route the three paths of each visit: tables, and one router file a visit."""
    from survey_sim.survey.field import route_field

    made = route_field(
        sources, out, router=router, instrument=instrument, start=start, seed=seed, changes=tuple(change or ())
    )
    console = _console(quiet)
    console.print(_table(_path_figures(made.paths)))
    console.print(f"{len(made.files)} router files: [bold]{made.files[0].parent}[/bold]")
    console.print(f"  watch  survey-sim view {made.out}")


def simulate(
    sources: RunOrFiles,
    instrument: Instrument = None,
    stop_at: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS", min=0.0, help="Also write a backup file, so far into the last visit.", show_default=False
        ),
    ] = None,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """Play router files: times of every robot and path, and whatever collides; tables and CSV."""
    from survey_sim.survey.field import simulate_field

    made = simulate_field(sources, out, instrument=instrument, stop_at_s=stop_at)
    console = _console(quiet)
    console.print(_table(_path_figures(made.paths)))
    for finding in made.findings:
        typer.echo(f"found: {finding}")
    console.print(f"{made.out / 'paths.csv'}, {made.out / 'robot_times.csv'}")


def view(
    sources: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="RUN_DIR / ROUTER.xml ...",
            help="Run folders or router files; several: side by side.",
            show_default=False,
        ),
    ] = None,
    survey: Survey = None,
    tile: Tile = None,
    visit: Visits = None,
    instrument: Instrument = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="Page to write; view.html in the run by default.", show_default=False),
    ] = None,
    is_served: Annotated[
        bool, typer.Option("--serve", help="The simulator as an application in the browser, for this machine only.")
    ] = False,
    port: Annotated[int, typer.Option(min=1024, max=65535, help="Port of --serve.")] = 8050,
    quiet: Quiet = False,
) -> None:
    """Write the field player: one HTML file that opens from disk."""
    if is_served:
        _serve(sources or [], port, quiet)
        return
    if not sources:
        raise InputError("nothing to show", place="view", remedy="name a run folder or router files, or give --serve")
    from survey_sim.survey.field import view_field

    page = view_field(sources, out, survey=survey, tile_id=tile, visit_ids=visit, instrument=instrument)
    _console(quiet).print(f"open in a browser: [bold]{page}[/bold]")


def export(
    run_dir: Annotated[Path, typer.Argument(metavar="RUN_DIR", help="Folder of a run.", show_default=False)],
    form: Annotated[
        str, typer.Option("--format", help="votable, fits or csv; exchange: the paper's files of one tile.")
    ] = "votable",
    survey: Survey = None,
    tile: Tile = None,
    visit: Visits = None,
    table: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Only this table. May be repeated.", show_default=False)
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write; export/ in the run by default.", show_default=False)
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Write a run's tables, or those of a tile or visit, for TOPCAT and friends."""
    out = out or run_dir / "export"
    if form == "exchange":
        from survey_sim.survey.field import export_exchange

        files = export_exchange(run_dir, out, survey=survey, tile_id=tile, visit_ids=visit)
    else:
        from survey_sim.survey.export import export_run

        files = export_run(run_dir, out, form, survey=survey, tile_id=tile, visit_ids=visit, only=table)
    _console(quiet).print(f"{len(files)} files: [bold]{out}[/bold]")


def compare_routers(
    sources: RunOrFiles,
    router: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="May be repeated; our four by default.", show_default=False),
    ] = None,
    instrument: Instrument = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random streams.")] = 1,
    out: Annotated[Path, typer.Option(help="Folder to write.")] = Path("routers"),
    quiet: Quiet = False,
) -> None:
    """Route the same allocations by several routers: times and failures as CSV and figures."""
    import polars as pl

    from survey_sim.survey.field import compare_routers as compare

    made = compare(sources, out, routers=tuple(router or ()), instrument=instrument, seed=seed)
    figures = made.rows.group_by("router", "path", maintain_order=True).agg(
        pl.col("configuration_time_s").mean().alias("mean_s"),
        pl.col("configuration_time_p95_s").mean().alias("p95_s"),
        pl.col("configuration_time_median_s").mean().alias("median_s"),
        pl.col("lower_bound_s").mean().alias("bound_s"),
        pl.col("collisions", "unrouted").sum(),
    )
    console = _console(quiet)
    console.print(_table(figures))
    console.print(f"{made.file}, and figures beside it")


_EXECUTION_HEADS = {
    "margin_mm": "margin mm",
    "scatter_frac": "scatter %",
    "near_frac": "near %",
    "contact_frac": "contact %",
    "cost_frac": "longer %",
    "margin_cost_frac": "planned over bound %",
    "metrology_s": "metrology s",
}


def figures(
    out: Annotated[Path, typer.Option(help="Folder to write.")] = Path("runs/figures"),
    study: Annotated[
        Literal["allocation", "execution"],
        typer.Option(help="The paper's Figures 7 to 10, or safety and cost of errors of execution."),
    ] = "allocation",
    quick: Annotated[bool, typer.Option("--quick", help="Fewer fields: without thousands of stars.")] = False,
    quiet: Quiet = False,
) -> None:
    """Compare the allocation algorithms on the paper's fields, or ways to play legs with errors: tables and figures."""
    import polars as pl

    console = _console(quiet)
    if study == "execution":
        from survey_sim.survey.execution_study import draw_execution_study

        shares = draw_execution_study(out, console, quick=quick)
        console.print(_table(shares.with_columns(pl.col("^.*_frac$") * 100.0).rename(_EXECUTION_HEADS)))
        console.print(f"tables and figures: [bold]{out}[/bold]")
        return
    from survey_sim.survey.allocation_study import draw_paper_figures

    summary = draw_paper_figures(out, console, quick=quick)
    in_percent = pl.col("completeness_frac", "bound_frac") * 100.0
    console.print(_table(summary.with_columns(in_percent).rename(_STUDY_HEADS)))
    console.print(f"tables and figures: [bold]{out}[/bold]")


def add_field_commands(app: typer.Typer) -> None:
    """Register the commands."""
    for command in (allocate, route, simulate, view, export, compare_routers, figures):
        app.command()(command)


def _serve(sources: list[Path], port: int, quiet: bool) -> None:
    try:
        from survey_sim.survey.window.app import HOST, serve
    except ModuleNotFoundError as absent:
        remedy = "pip install 'survey-sim[serve]'"
        raise InputError(f"needs {absent.name}, which is not installed", place="--serve", remedy=remedy) from None
    _console(quiet).print(f"open [bold]http://{HOST}:{port}[/bold] in a browser; Ctrl+C ends it")
    serve(sources, port)


def _centre(text: str) -> tuple[float, float]:
    try:
        ra, dec = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"cannot read {text!r}", place="--centre", remedy="write --centre RA,DEC in degrees") from None
    if not (0 <= ra <= 360 and -90 <= dec <= 90):
        raise InputError(f"{text!r} is no place on the sky", place="--centre", remedy="RA in 0 to 360, DEC in -90 to 90")
    return ra, dec


def _path_figures(paths: pl.DataFrame) -> pl.DataFrame:
    import polars as pl

    return paths.select(
        pl.col("visit_id").alias("visit"),
        "path",
        pl.col("configuration_time_s").alias("time_s"),
        pl.col("configuration_time_p95_s").alias("p95_s"),
        pl.col("lower_bound_s").alias("bound_s"),
        "ticks",
        "collisions",
        "unrouted",
    )


def _table(frame: pl.DataFrame) -> Any:
    """A frame as rich prints it."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for name in frame.columns:
        table.add_column(name, no_wrap=True, justify="right" if frame[name].dtype.is_numeric() else "left")
    for row in frame.iter_rows():
        table.add_row(*(f"{value:.2f}" if isinstance(value, float) else str(value) for value in row))
    return table


def _console(quiet: bool) -> Any:
    from rich.console import Console

    console = Console(stderr=True, quiet=quiet, highlight=False)
    if not console.is_terminal:
        console.width = 120  # a table in a log file is not cut
    return console
