"""Tables on disk: through the schema, with units, whole or absent."""

import warnings
from pathlib import Path

import polars as pl
import pyarrow.parquet as pq
import pytest
from astropy.io.votable.ucd import check_ucd
from astropy.table import Table
from astropy.units import Unit

from survey_sim import tables
from survey_sim.errors import InputError
from survey_sim.instrument import load_instrument, make_plate, robots_table
from survey_sim.schema import SCHEMA_VERSION, TABLES


@pytest.fixture
def robots() -> pl.DataFrame:
    return robots_table(make_plate(load_instrument("taipan-150")), "taipan")


def test_astropy_reads_units_and_descriptions(robots: pl.DataFrame, tmp_path: Path) -> None:
    file = tmp_path / "robots.parquet"
    tables.write(robots, "robots", file)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read = Table.read(str(file), format="parquet.votable")
    assert read["park_x_mm"].unit == Unit("mm")
    assert "park position" in read["park_x_mm"].description
    assert read["robot_id"].tolist() == robots["robot_id"].to_list()


def test_same_rows_give_the_same_bytes_in_any_order(robots: pl.DataFrame) -> None:
    shuffled = robots.sample(fraction=1.0, shuffle=True, seed=3).select(reversed(robots.columns))
    assert tables.encode(shuffled, "robots") == tables.encode(robots, "robots")


@pytest.mark.parametrize("name", TABLES)
def test_every_table_is_declared_soundly(name: str, tmp_path: Path) -> None:
    table = TABLES[name]
    assert set(table.key) <= set(table.names)
    assert set(table.order) <= set(table.names)
    for column in (*table.columns, *table.prefixes):
        assert column.description
        assert check_ucd(column.ucd, check_controlled_vocabulary=True), column.ucd
        Unit(column.unit)
    file = tmp_path / "empty.parquet"
    tables.write(tables.empty(name), name, file)
    assert pq.read_schema(file).names == table.names


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: f.drop("park_x_mm"), "robots.park_x_mm: column is absent"),
        (lambda f: f.with_columns(colour=pl.lit("red")), "robots.colour: column is not declared"),
        (lambda f: f.with_columns(state=pl.lit(None)), r"robots.state: null where none may be at rows \[0, 1"),
        (lambda f: pl.concat([f, f.head(1)]), r"share the key .* at rows \[0, 159\]"),
        (lambda f: f.with_columns(robot_id=pl.lit("x")), "does not fit its column"),
    ],
)
def test_a_frame_that_breaks_the_schema_is_refused(spoil, message: str, robots: pl.DataFrame) -> None:
    with pytest.raises(InputError, match=message):
        tables.conform(spoil(robots), "robots")


def test_columns_made_per_programme_are_declared_by_their_prefix() -> None:
    night = tables.empty("nights").with_columns(completeness_frac_funnelweb=pl.Series([], dtype=pl.Float64))
    assert tables.conform(night, "nights").columns[-1] == "completeness_frac_funnelweb"


def test_a_file_that_cannot_be_written_leaves_nothing_behind(robots: pl.DataFrame, tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        tables.write(robots, "robots", blocked / "robots.parquet")
    assert list(tmp_path.iterdir()) == [blocked]


def test_scan_refuses_what_is_no_table_of_this_version(robots: pl.DataFrame, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such table"):
        tables.scan(tmp_path, "robots")
    file = tmp_path / "robots.parquet"
    robots.write_parquet(file)
    with pytest.raises(InputError, match="schema version none, this package reads"):
        tables.scan(tmp_path, "robots")
    for version in (SCHEMA_VERSION - 1, SCHEMA_VERSION + 1):
        other = robots.to_arrow().replace_schema_metadata({"survey_sim.schema_version": str(version)})
        pq.write_table(other, file)
        with pytest.raises(InputError, match=f"schema version {version}, this package reads {SCHEMA_VERSION}"):
            tables.scan(tmp_path, "robots")
    file.write_bytes(b"PAR1 and then nothing")
    with pytest.raises(InputError, match="not a readable Parquet file"):
        tables.scan(tmp_path, "robots")


def test_parts_are_read_as_one_table(tmp_path: Path) -> None:
    legs = tables.empty("legs")
    for name in ("b", "a"):
        tables.write(legs, "legs", tmp_path / "legs" / f"{name}.parquet")
    assert [path.stem for path in tables.files(tmp_path, "legs")] == ["a", "b"]
    assert tables.read(tmp_path, "legs").columns == TABLES["legs"].names
