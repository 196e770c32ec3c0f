"""Whole runs for other programs: astropy, STILTS, DuckDB, polars; units and nulls kept."""

import os
import shutil
import subprocess
from pathlib import Path

import astropy.units as u
import duckdb
import numpy as np
import polars as pl
import pytest
from astropy.io.votable import validate
from astropy.table import Table
from polars.testing import assert_frame_equal

from survey_sim import tables
from survey_sim.errors import InputError
from survey_sim.exchange import ROUTER, read, read_allocation, read_router
from survey_sim.schema import TABLES
from survey_sim.survey import export
from survey_sim.survey.export import export_run
from survey_sim.survey.field import export_exchange
from tests.test_field import field, instrument, xml  # noqa: F401 - fixtures

FIELD_TABLES = ["robots", "targets", "tiles", "visits", "allocations", "paths", "legs", "robot_times", "unallocated"]


def stilts(*words: str) -> str:
    """Output of STILTS; the test fails where it must be there, or is skipped."""
    program = shutil.which("stilts")
    if program is None:
        if os.environ.get("SURVEY_SIM_REQUIRE_STILTS") == "1":
            pytest.fail("stilts is not installed (apt-get install stilts)")
        pytest.skip("stilts is not installed")
    done = subprocess.run([program, *words], capture_output=True, text=True, check=True)
    return done.stdout + done.stderr


@pytest.fixture
def run(field: Path) -> Path:  # noqa: F811 - the fixture
    return field


class TestFormats:
    @pytest.mark.parametrize("form", ["votable", "fits"])
    def test_astropy_reads_values_units_and_nulls(self, run: Path, tmp_path: Path, form: str) -> None:
        files = export_run(run, tmp_path, form)
        assert [path.stem for path in files] == FIELD_TABLES
        for path in files:
            back, frame = Table.read(path), tables.read(run, path.stem)
            assert back.colnames == frame.columns
            for column in TABLES[path.stem].columns:
                if column.unit:
                    assert back[column.name].unit == u.Unit(column.unit), column.name
                is_null = np.ma.getmaskarray(back[column.name])
                values = frame[column.name]
                if column.dtype == pl.String:
                    texts = np.ma.filled(back[column.name], "")
                    assert [str(text) for text in texts] == values.fill_null("").to_list()
                    continue
                own = values.is_null() if column.dtype.is_integer() else values.is_null() | values.is_nan()
                if column.dtype.is_integer():
                    assert is_null.tolist() == own.to_list(), column.name
                kept = ~own.to_numpy()
                np.testing.assert_array_equal(np.asarray(back[column.name])[kept], values.to_numpy()[kept])

    def test_csv(self, run: Path, tmp_path: Path) -> None:
        for path in export_run(run, tmp_path, "csv"):
            frame = tables.read(run, path.stem)
            assert_frame_equal(pl.read_csv(path, schema=frame.schema), frame)

    def test_one_visit(self, run: Path, tmp_path: Path) -> None:
        files = export_run(run, tmp_path, "csv", survey="field", tile_id=0, visit_ids=[1])
        for path in files:
            if "visit_id" in TABLES[path.stem].names:
                assert pl.read_csv(path)["visit_id"].unique().to_list() == [1]
        assert [path.stem for path in export_run(run, tmp_path, "csv", only=["legs"])] == ["legs"]

    def test_large_tables_are_cut(self, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        whole = tables.read(run, "legs")
        monkeypatch.setattr(export, "N_ROWS_MAX", 50)
        files = export_run(run, tmp_path, "csv", only=["legs"])
        assert [path.name for path in files] == [f"legs_{i:03d}.csv" for i in range(-(-len(whole) // 50))]
        assert_frame_equal(pl.concat(pl.read_csv(path, schema=whole.schema) for path in files), whole)

    def test_refused(self, run: Path, tmp_path: Path) -> None:
        for words, match in (
            ({"form": "hdf5"}, "unknown format"),
            ({"form": "csv", "only": ["leg"]}, r"unknown table 'leg'.*\n.*legs"),
            ({"form": "csv", "only": ["nights"]}, "no such table"),
            ({"form": "csv", "tile_id": 5}, "no visit there"),
            ({"form": "csv", "visit_ids": [50]}, "no visit there"),
        ):
            with pytest.raises(InputError, match=match):
                export_run(run, tmp_path / "x", **words)
        with pytest.raises(InputError, match="holds no table"):
            export_run(tmp_path, tmp_path / "x", "csv")
        assert not (tmp_path / "x").exists()

    def test_exchange_files_of_a_tile(self, run: Path, tmp_path: Path) -> None:
        files = export_exchange(run, tmp_path)
        assert len(files) == 3 + 3 * 3
        for planned in xml(run, "router"):
            one, other = read_router(planned), read_router(tmp_path / planned.name)
            np.testing.assert_allclose(one.standing.position_mm, other.standing.position_mm, atol=1e-9)
            for path in one.legs:
                np.testing.assert_allclose(one.legs[path].x_mm, other.legs[path].x_mm, atol=1e-9)
        assert read_allocation(tmp_path / "allocation_0000.xml").plate.n_robot == 13
        assert "centre_ra_deg" in read(tmp_path / "router_0000.xml", ROUTER).params


class TestPrograms:
    def test_votlint_is_clean_and_tpipe_selects(self, run: Path, tmp_path: Path) -> None:
        for path in export_run(run, tmp_path, "votable"):
            assert validate(str(path))
            assert stilts("votlint", f"votable={path}") == "", path.name
        n_waiting = tables.read(run, "robot_times").filter(pl.col("waiting_s") > 0).height
        select = ("cmd=select waiting_s>0", "omode=count")
        for form, suffix in (("votable", "vot"), ("fits", "fits"), ("csv", "csv")):
            (path,) = export_run(run, tmp_path, form, only=["robot_times"])
            assert path.suffix == f".{suffix}"
            counted = stilts("tpipe", f"in={path}", f"ifmt={form}", *select)
            assert f"rows: {n_waiting}" in counted

    def test_votlint_is_clean_of_binary(self, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(export, "N_TEXT_ROWS_MAX", 0)
        for path in export_run(run, tmp_path, "votable"):
            assert b"<BINARY>" in path.read_bytes()
            assert stilts("votlint", f"votable={path}") == "", path.name
            assert len(Table.read(path)) == tables.read(run, path.stem).height

    def test_exchange_files_in_stilts(self, run: Path, tmp_path: Path) -> None:
        for path in export_exchange(run, tmp_path):
            assert stilts("votlint", f"votable={path}") == "", path.name

    def test_duckdb_reads_the_parquet(self, run: Path) -> None:
        legs, times = run / "legs" / "*.parquet", run / "robot_times" / "*.parquet"
        counted = duckdb.sql(
            f"""select t.path, sum(t.moving_s) moving_s, count(l.leg) n
            from '{times}' t left join '{legs}' l using (survey, tile_id, visit_id, path, robot_id)
            where l.leg = 0 group by t.path order by t.path"""
        ).fetchall()
        first = tables.read(run, "legs").filter(leg=0)
        both = tables.read(run, "robot_times").join(first, on=["visit_id", "path", "robot_id"], how="semi")
        for path, moving_s, n in counted:
            own = both.filter(path=path)
            assert n == own.height
            assert moving_s == pytest.approx(own["moving_s"].sum())

    def test_astropy_reads_the_parquet_with_units(self, run: Path) -> None:
        table = Table.read(run / "paths.parquet", format="parquet.votable")
        assert table["configuration_time_s"].unit == u.s
        assert table["min_separation_mm"].unit == u.mm
        assert len(table) == 9
