"""Writes the docs pages that follow from the code: `python -m survey_sim.survey.docs docs`.

`data-model.md` is kept, for it is read without building the docs; what goes into `made/` is not.
"""

from __future__ import annotations

import sys
from pathlib import Path

import polars as pl

from survey_sim.schema import SCHEMA_VERSION, TABLES, Column, Table
from survey_sim.study_schema import STUDY_TABLES
from survey_sim.survey.settings_page import settings_page

_HEAD = f"""# Data model

<!-- Written by `make docs` from survey_sim/schema.py: do not edit. -->

Every table of a run, schema version {SCHEMA_VERSION}. Most tables are one file, `runs/<name>/<table>.parquet`; the large
ones are folders of parts, `runs/<name>/<table>/*.parquet`: allocations, legs and robot_times a part for each batch of tiles,
exposure_allocations and exposure_legs for each group of nights. Files are Parquet with zstd, rows sorted, and carry
VOParquet metadata (units, UCDs and descriptions for astropy and TOPCAT). The same quantity has the same name in every table;
names end in their unit. Null means that there is no value.

The plate frame is in mm, origin at the plate centre, x to the east, y to the north, as seen on the sky. Sky positions are
ICRS, in degrees. Times of a path are seconds from its start; `configuration_time_p95_s` is when 95 % of the robots that move
(rounded up to a robot) have come to rest, and `lower_bound_s` the slowest robot that arrives, were it alone.

Where a visit starts: `start_to_target` begins where the tile's previous visit ended (its first: from park), or at park if
the algorithm always starts there (`visits.start`). `start_to_park` begins where the previous visit ended, `park_to_target`
at park. A robot that was not routed stays where the path began; `robot_times.reason` says why, and `allocations` holds where
it stands.
"""

_STUDIES = """
## Tables of studies

`survey-sim compare`, `imprint` and `weights` make these of finished runs; a row names its scenario, programme or target.
"""


def data_model_page() -> str:
    """The page, as Markdown."""
    studies = "".join(_table(table, "###") for table in STUDY_TABLES.values())
    return _HEAD + "".join(_table(table) for table in TABLES.values()) + _STUDIES + studies


def _table(table: Table, heading: str = "##") -> str:
    where = f"{table.name}/*.parquet" if table.is_in_parts else f"{table.name}.parquet"
    lines = [
        f"\n{heading} {table.name}\n",
        f"One row is {table.row}. File: `{where}`. Key: {', '.join(f'`{name}`' for name in table.key)}.\n",
        "| column | type | unit | meaning | UCD |",
        "|---|---|---|---|---|",
        *(_row(column, column.name) for column in table.columns),
        *(_row(column, f"{column.name}<programme>") for column in table.prefixes),
    ]
    return "\n".join(lines) + "\n"


def _row(column: Column, name: str) -> str:
    kind = "string" if isinstance(column.dtype, pl.String) else str(column.dtype).lower()
    kind += ", or null" if column.is_nullable else ""
    return f"| `{name}` | {kind} | {column.unit} | {column.description} | {column.ucd} |"


def main(folder: Path) -> None:
    """Write the pages into the folder of the docs."""
    (folder / "made").mkdir(exist_ok=True)
    (folder / "data-model.md").write_text(data_model_page(), encoding="utf-8")
    (folder / "made" / "settings.md").write_text(settings_page(), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
