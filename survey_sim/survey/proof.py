"""What `survey-sim check` prints: what was proved, or the faults."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from survey_sim.check import CheckResult, Fault, check_run

# Faults printed of each check; all are counted.
N_SHOWN = 5


def prove(run_dir: Path, console: Console) -> CheckResult:
    """Check a run and print the result; progress meanwhile."""
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("checking parts", total=None)
        result = check_run(run_dir, lambda done, total: progress.update(task, completed=done, total=total))
    console.print(
        f"{run_dir}: {result.n_visit} visits, {result.n_exposure} pointings, {result.n_path} paths, {result.n_leg} legs, "
        f"{result.n_pair} pairs of robots; least separation {result.least_separation_mm:.9f} mm"
    )
    if result.is_passed:
        console.print("[bold]no fault[/bold]")
    return result


def fault_lines(result: CheckResult) -> list[str]:
    """The faults as lines: the number of each check, and the first few rows."""
    lines = []
    for check, number in result.n_faults.items():
        lines.append(f"{check}: {number} fault{'s' if number > 1 else ''}")
        rows = result.faults.filter(check=check).head(N_SHOWN)
        lines += [f"  {Fault(**row)}" for row in rows.iter_rows(named=True)]
        lines += [f"  ... and {number - N_SHOWN} more"] if number > N_SHOWN else []
    return lines
