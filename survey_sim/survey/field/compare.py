"""`survey-sim compare-routers`: the same visits by several routers (Goodwin et al. 2014, Figure 15)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from survey_sim import tables
from survey_sim.exchange import AllocatedVisit, Standing, parked, read_allocation
from survey_sim.instrument import load_instrument, make_plate
from survey_sim.routing import ROUTER_NAMES, RoutingSettings, UnroutedReason
from survey_sim.schema import PATHS
from survey_sim.simulation import simulate
from survey_sim.survey.field.folder import find_files
from survey_sim.survey.field.route import check_plates, route_paths

_FIGURES = (
    "configuration_time_s",
    "configuration_time_p95_s",
    "configuration_time_median_s",
    "ticks",
    "collisions",
    "min_separation_mm",
)


@dataclass(frozen=True)
class RouterComparison:
    """What `compare-routers` made.

    Attributes
    ----------
    rows
        A row a router, visit and path, as written to `routers.csv`.
    file
        The CSV file; figures of each path stand beside it.
    """

    rows: pl.DataFrame
    file: Path


def compare_routers(
    sources: Sequence[Path],
    out: Path,
    *,
    routers: Sequence[str] = (),
    instrument: str | Path | None = None,
    seed: int = 1,
) -> RouterComparison:
    """Route the same visits by each router, and write figures and CSV.

    Every router is given the same starts, whatever it left unrouted before: robots stand where the allocation before sent
    them, turned to 0; the first visit begins at park.

    Parameters
    ----------
    sources
        One run folder (of `allocate`), or allocation files in order.
    routers
        All of ours by default.

    Raises
    ------
    InputError
        Unknown router; files that do not fit; starts or ends that are not legal.
    """
    names = tuple(routers) or ROUTER_NAMES
    chosen = [RoutingSettings.load({"router": name}, section="routing") for name in names]
    given = None if instrument is None else make_plate(load_instrument(instrument))
    visits = [read_allocation(path, given) for path in find_files(sources, "allocation")]
    check_plates(visits)
    rows = pl.DataFrame([row for settings in chosen for row in _rows(settings, visits, seed)])
    tables.write_bytes(tables.csv_bytes(rows), out / "routers.csv")
    _draw(rows, out)
    return RouterComparison(rows, out / "routers.csv")


def _rows(settings: RoutingSettings, visits: Sequence[AllocatedVisit], seed: int) -> list[dict]:
    plate = visits[0].plate
    standing = parked(plate)
    rows = []
    for number, visit in enumerate(visits):
        begin = parked(plate, standing)
        starts = {PATHS[0]: begin if visit.start == "park" else standing, PATHS[1]: standing, PATHS[2]: begin}
        for path, routed in route_paths(visit, standing, settings, seed, number).items():
            start = starts[path]
            played = simulate(plate, start.position_mm, start.theta_deg, routed.legs)
            n_unrouted = int((routed.reason != UnroutedReason.ARRIVED).sum())
            figures = {name: getattr(played, name) for name in _FIGURES}
            bound = {"lower_bound_s": routed.lower_bound_s, "unrouted": n_unrouted}
            file = visit.file.name if visit.file else ""
            rows.append({"router": settings.router, "visit_id": number, "file": file, "path": path, **figures, **bound})
        goal = np.where(plate.is_live[:, None], visit.goal_mm, standing.position_mm)
        standing = Standing(goal, np.zeros(plate.n_robot))
    return rows


def _draw(rows: pl.DataFrame, out: Path) -> None:
    """Write the figure of each path, as PNG and PDF."""
    from survey_sim.plotting.figures import DEFAULT_DPI, save_figure  # noqa: PLC0415 - matplotlib is slow to import
    from survey_sim.plotting.routers import draw_routers  # noqa: PLC0415
    from survey_sim.plotting.style import figure_style  # noqa: PLC0415

    for path in PATHS:
        with figure_style():
            save_figure(draw_routers(rows.filter(path=path)), out / f"routers_{path}", DEFAULT_DPI)
