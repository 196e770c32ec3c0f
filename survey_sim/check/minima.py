"""By how much each visit falls short of the least acceptable fibres, derived again from run.json's settings."""

from math import tau
from typing import Any

import polars as pl

KINDS = ("standard", "sky", "guide")
_SCHEMA = {"survey": pl.String} | dict.fromkeys(
    (*(f"min_{kind}" for kind in KINDS), "min_sky_region", "sky_regions"), pl.Int64
)


def read_minima(record: dict[str, Any], robots: pl.DataFrame) -> pl.DataFrame:
    """Least acceptable fibres of a visit of each survey; null where run.json does not say.

    No more are acceptable than are wanted, nor more guides than the survey has guide robots.
    """
    given = record.get("settings", {}).get("allocation") or {}
    rows = []
    for survey in robots["survey"].unique().sort():
        own = given.get("surveys", {}).get(survey) or given.get("every", given)
        least = {name: own.get(name) for name in _SCHEMA if name != "survey"}
        if all(value is not None for value in least.values()):
            n_guide_robot = robots.filter(survey=survey, kind="guide").height
            for kind in KINDS:
                least[f"min_{kind}"] = min(least[f"min_{kind}"], own.get(f"wanted_{kind}", least[f"min_{kind}"]))
            least["min_guide"] = min(least["min_guide"], n_guide_robot)
            if "wanted_sky" in own:
                least["min_sky_region"] = min(least["min_sky_region"], own["wanted_sky"] // least["sky_regions"])
        rows.append({"survey": survey, **least})
    return pl.DataFrame(rows, schema=_SCHEMA)


def shortfalls(rows: pl.DataFrame, minima: pl.DataFrame) -> pl.DataFrame:
    """visit_row and `own_*_shortfall` of each visit, from its `allocations` (`Part.rows`)."""
    rows = rows.join(minima, on="survey", how="left", maintain_order="left")
    by_kind = rows.group_by("visit_row", maintain_order=True).agg(
        *((pl.col(f"min_{kind}").first() - (pl.col("kind") == kind).sum()).alias(f"own_{kind}_shortfall") for kind in KINDS),
        region_wants=pl.col("min_sky_region").first() * pl.col("sky_regions").first(),
    )
    turn = (pl.arctan2("y_mm", "x_mm") / tau) % 1.0
    sector = pl.min_horizontal((turn * pl.col("sky_regions")).floor(), pl.col("sky_regions") - 1)
    skies = rows.filter(pl.col("kind") == "sky").group_by("visit_row", sector=sector)
    counted = skies.agg(n=pl.min_horizontal(pl.len(), pl.col("min_sky_region").first()))
    counted = counted.group_by("visit_row").agg(pl.col("n").sum())
    by_kind = by_kind.join(counted, on="visit_row", how="left", maintain_order="left")
    lack = by_kind.with_columns(own_sky_region_shortfall=pl.col("region_wants") - pl.col("n").fill_null(0))
    return lack.select("visit_row", pl.col("^own_.*_shortfall$").clip(0).cast(pl.Int32))
