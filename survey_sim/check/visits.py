"""Figures of each visit: counts, magnitudes, completeness, travel, crossings, and the figures that `paths` holds too."""

import numpy as np
import polars as pl

from survey_sim.check.faults import FaultLog
from survey_sim.check.inputs import Run
from survey_sim.check.kernels import count_crossings
from survey_sim.check.minima import KINDS, shortfalls
from survey_sim.check.part import START_TO_TARGET, Part
from survey_sim.check.relations import TILE
from survey_sim.check.routes import POSITION_MM, rank_95
from survey_sim.schema import TARGET_KINDS

_FRAC = 1e-9
_SHARED = ("collisions", "unrouted", "ticks", "configuration_time_s", "configuration_time_p95_s", "lower_bound_s")


def check_visits(log: FaultLog, part: Part, run: Run, held: pl.DataFrame) -> None:
    """Every figure of the part's visits, derived again.

    Parameters
    ----------
    held
        As `check_targets` gives it.
    """
    rows = part.rows
    travel = ((pl.col("x_mm") - pl.col("start_x_mm")) ** 2 + (pl.col("y_mm") - pl.col("start_y_mm")) ** 2).sqrt()
    log.compare("visits", "allocations", rows.with_columns(own_travel_mm=travel), {"travel_mm": POSITION_MM})
    here = run.visits.join(rows.select("visit_row").unique(), on="visit_row", how="semi", maintain_order="left")
    own = rows.group_by("visit_row", maintain_order=True).agg(**_row_figures())
    own = own.with_columns(own_crossings=pl.Series(_crossings(part)).cast(pl.Int32))
    visits = here.join(own, on="visit_row", how="left", maintain_order="left")
    visits = visits.join(shortfalls(rows, run.minima), on="visit_row", how="left", maintain_order="left")
    visits = visits.join(_magnitudes(held), on="visit_row", how="left", maintain_order="left")
    visits = visits.with_columns(_completeness(here, held, run))
    columns = {f"n_{name}": 0.0 for name in (*TARGET_KINDS, "idle")}
    columns |= {f"{name}_shortfall": 0.0 for name in (*KINDS, "sky_region")}
    columns |= dict.fromkeys(("travel_mean_mm", "travel_p95_mm", "travel_max_mm"), POSITION_MM)
    columns |= {"crossings": 0.0, "mag_bright": _FRAC, "mag_faint": _FRAC, "completeness_frac": _FRAC}
    log.compare("visits", "visits", visits, columns)
    path = run.paths.filter(pl.col("path") == START_TO_TARGET).select("visit_row", *_SHARED)
    path = path.rename({name: f"own_{name}" for name in _SHARED})
    both = here.join(path, on="visit_row", how="inner", maintain_order="left")
    log.compare("visits", "visits", both, dict.fromkeys(_SHARED, _FRAC), f"read from paths ({START_TO_TARGET})")
    beaten = visits.filter(pl.col("completeness_frac") > pl.col("completeness_bound_frac") + _FRAC)
    frac, bound = pl.col("completeness_frac"), pl.col("completeness_bound_frac")
    log.add("visits", "visits", beaten, "completeness above its proven bound", value=frac, limit=bound)


def _row_figures() -> dict[str, pl.Expr]:
    going = pl.col("travel_mm").filter(pl.col("travel_mm") > 0)
    is_idle = (pl.col("state") == "live") & pl.col("target_id").is_null()
    counts = {f"own_n_{kind}": (pl.col("kind") == kind).sum().cast(pl.Int32) for kind in TARGET_KINDS}
    return counts | {
        "own_n_idle": is_idle.sum().cast(pl.Int32),
        "own_travel_mean_mm": going.mean().fill_null(0.0),
        "own_travel_p95_mm": pl.when(going.len() > 0).then(rank_95(going)).otherwise(0.0),
        "own_travel_max_mm": going.max().fill_null(0.0),
    }


def _crossings(part: Part) -> np.ndarray:
    start = part.rows.select("start_x_mm", "start_y_mm").to_numpy(order="c")
    end = part.rows.select("x_mm", "y_mm").to_numpy(order="c")
    return count_crossings(part.first_row, start, end)


def _magnitudes(held: pl.DataFrame) -> pl.DataFrame:
    science = held.filter(pl.col("kind") == "science")
    return science.group_by("visit_row").agg(own_mag_bright=pl.col("mag").min(), own_mag_faint=pl.col("mag").max())


def _completeness(visits: pl.DataFrame, held: pl.DataFrame, run: Run) -> pl.Series:
    """Of each visit: science targets at home in the tile with all their wanted visits after it / all of them, or 1."""
    own = held.filter((pl.col("kind") == "science") & pl.col("is_home")).sort("visit_row")
    nth = own.with_columns(nth=pl.col("target_id").cum_count().over("target_id"))
    done = nth.filter(pl.col("nth") == pl.col("wanted_visits")).group_by("visit_row").len("n_done")
    home = run.targets.filter(pl.col("kind") == "science").group_by(TILE).len("n_home")
    figures = visits.join(done, on="visit_row", how="left", maintain_order="left")
    figures = figures.join(home, on=TILE, how="left", maintain_order="left")
    total = pl.col("n_done").fill_null(0).cum_sum().over(TILE)
    return figures.select(own_completeness_frac=(total / pl.col("n_home")).fill_null(1.0)).to_series()
