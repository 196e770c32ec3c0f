"""Every door, with damaged and hostile input: an error of ours, or a result that is right; never anything else."""

import math
import os
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from astropy.table import Table
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from survey_sim.catalogue import load_card
from survey_sim.cli import app
from survey_sim.errors import InputError
from survey_sim.folders import data_folder
from survey_sim.instrument import load_instrument, make_plate
from survey_sim.survey.field.targets import read_targets
from survey_sim.survey.settings import load_pipeline
from tests.small_survey import PIPELINE, write_small_survey

# `make soak` asks for many more.
N_EXAMPLE = int(os.environ.get("SOAK_EXAMPLES", "60"))
quick = settings(max_examples=N_EXAMPLE, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
runner = CliRunner()
PLATE = make_plate(load_instrument("paper"))
N_TARGET = 5
TARGETS = {
    "target_id": np.arange(N_TARGET),
    "x_mm": np.linspace(-100.0, 100.0, N_TARGET),
    "y_mm": np.linspace(-50.0, 90.0, N_TARGET),
    "mag": np.linspace(8.0, 12.0, N_TARGET),
    "priority": np.arange(1, N_TARGET + 1),
    "kind": ["science", "sky", "guide", "standard", "science"],
}
CARD = """name = "stars"
title = "Stars"
source = "nowhere"
licence = "none"
file = "stars.csv"

[columns]
id = "source_id"
ra = { name = "ra_deg", unit = "deg" }
dec = { name = "dec_deg", unit = "deg" }
mag = { name = "mag", unit = "mag" }
"""
_ODD = """3 -1 0 1e400 nan -inf true "" "x" [] [1,2] {} {a=1} 1979-05-27 07:32:00 [[[[[[]]]]]] '-1' 1.5"""
ODD_VALUES = st.sampled_from([*_ODD.split(), "'../../etc/passwd'", r"'\u0000'", r'"\u0000"', "9" * 400])


def content_of(kind: str) -> bytes:
    """The targets as a file of this kind."""
    buffer = BytesIO()
    if kind == "parquet":
        pl.DataFrame(TARGETS).write_parquet(buffer)
    elif kind == "csv":
        pl.DataFrame(TARGETS).write_csv(buffer)
    else:
        table = Table(TARGETS)
        for name in ("x_mm", "y_mm"):
            table[name].unit = "mm"
        table.write(buffer, format={"vot": "votable"}.get(kind, kind))
    return buffer.getvalue()


SOUND = {kind: content_of(kind) for kind in ("csv", "fits", "parquet", "vot")}


def damaged(data: st.DataObject, content: bytes) -> bytes:
    """Bytes changed, cut, doubled or put in."""
    changed = bytearray(content)
    for _ in range(data.draw(st.integers(1, 4))):
        if not changed:
            break
        place = data.draw(st.integers(0, len(changed) - 1))
        match data.draw(st.sampled_from(["set", "cut", "end", "twice", "put"])):
            case "set":
                changed[place] = data.draw(st.integers(0, 255))
            case "cut":
                del changed[place : place + data.draw(st.integers(1, 40))]
            case "end":
                del changed[place:]
            case "twice":
                changed[place:place] = changed[place : place + 60]
            case "put":
                changed[place:place] = data.draw(
                    st.sampled_from([b",", b"\n", b'"', b"nan", b"-", b"1e999", b"\0", b"<", b"&"])
                )
    return bytes(changed)


def outcome(read: Callable[..., Any], *arguments: Any) -> tuple[Any, str]:
    """What a reader gives, or what it says when it refuses; any other exception is a fault."""
    try:
        return read(*arguments), ""
    except InputError as refusal:
        return None, str(refusal)


def assert_is_a_table(frame: pl.DataFrame) -> None:
    """What a reader lets through can be worked with."""
    numbers = frame.select("x_mm", "y_mm").to_numpy()
    assert np.isfinite(numbers).all()
    assert frame["target_id"].is_unique().all()
    assert frame["priority"].is_between(1, 9).all()
    assert frame["kind"].is_in(["science", "standard", "guide", "sky"]).all()


class TestTargets:
    @pytest.mark.parametrize("kind", list(SOUND))
    def test_sound(self, kind: str, tmp_path: Path) -> None:
        path = tmp_path / f"targets.{kind}"
        path.write_bytes(SOUND[kind])
        frame = read_targets(path, PLATE, None).sort("target_id")
        assert frame["x_mm"].to_list() == pytest.approx(TARGETS["x_mm"])
        assert frame["kind"].to_list() == TARGETS["kind"]

    @pytest.mark.parametrize("kind", list(SOUND))
    @quick
    @given(data=st.data())
    def test_damaged_bytes(self, kind: str, tmp_path: Path, data: st.DataObject) -> None:
        path = tmp_path / f"targets.{kind}"
        path.write_bytes(damaged(data, SOUND[kind]))
        frame, refusal = outcome(read_targets, path, PLATE, None)
        if frame is None:
            assert str(path) in refusal
        else:
            assert_is_a_table(frame)

    @pytest.mark.parametrize("kind", list(SOUND))
    @quick
    @given(data=st.data())
    def test_odd_numbers(self, kind: str, tmp_path: Path, data: st.DataObject) -> None:
        """Whatever number stands in a column: refused with its row, or read as it is."""
        column = data.draw(st.sampled_from(["x_mm", "y_mm", "mag"]))
        row = data.draw(st.integers(0, N_TARGET - 1))
        value = data.draw(st.one_of(st.floats(), st.sampled_from([1e300, -1e300, 1e-320, 1e9])))
        frame = pl.DataFrame(TARGETS)
        frame = frame.with_columns(pl.when(pl.int_range(N_TARGET) == row).then(value).otherwise(column).alias(column))
        path = tmp_path / f"targets.{kind}"
        write_as(frame, path, kind)
        found, refusal = outcome(read_targets, path, PLATE, None)
        if found is None:
            assert not math.isfinite(value) or abs(value) > 1e3
            assert column in refusal
        elif math.isfinite(value):
            assert found.sort("target_id")[column][row] == pytest.approx(value)
        else:
            assert found.sort("target_id")[column][row] is None

    @pytest.mark.parametrize("kind", list(SOUND))
    def test_no_row_and_one_row(self, kind: str, tmp_path: Path) -> None:
        path = tmp_path / f"targets.{kind}"
        write_as(pl.DataFrame(TARGETS).head(1), path, kind)
        assert len(read_targets(path, PLATE, None)) == 1
        write_as(pl.DataFrame(TARGETS).clear(), path, kind)
        frame, refusal = outcome(read_targets, path, PLATE, None)
        assert str(path) in refusal if frame is None else frame.is_empty()

    def test_a_column_twice_is_refused(self, tmp_path: Path) -> None:
        path = tmp_path / "targets.csv"
        path.write_text("target_id,x_mm,y_mm,x_mm\n1,2.0,3.0,4.0\n")
        with pytest.raises(InputError, match="two columns have this name"):
            read_targets(path, PLATE, None)

    @pytest.mark.parametrize("suffix", ["pkl", "npy", "html", "csv.zip", ""])
    def test_other_kinds_are_refused(self, tmp_path: Path, suffix: str) -> None:
        path = tmp_path / f"targets.{suffix}"
        path.write_bytes(b"\x80\x04\x95c__builtin__\nprint\n")
        with pytest.raises(InputError, match="is of no known kind"):
            read_targets(path, PLATE, None)

    @pytest.mark.parametrize("kind", list(SOUND))
    def test_a_pickle_in_the_wrong_place_is_no_table(self, kind: str, tmp_path: Path) -> None:
        path = tmp_path / f"targets.{kind}"
        path.write_bytes(b"\x80\x04\x95\x1a\x00\x00\x00\x00\x00\x00\x00\x8c\x05posix\x8c\x06system\x93\x8c\x02id\x85R.")
        with pytest.raises(InputError):
            read_targets(path, PLATE, None)


def write_as(frame: pl.DataFrame, path: Path, kind: str) -> None:
    if kind in {"csv", "parquet"}:
        getattr(frame, f"write_{kind}")(path)
        return
    table = Table({name: frame[name].to_numpy() if name != "kind" else frame[name].to_list() for name in frame.columns})
    if not len(table):
        table["kind"] = np.array([], dtype="U8")
    for name in ("x_mm", "y_mm"):
        table[name].unit = "mm"
    table.write(path, format={"vot": "votable"}.get(kind, kind), overwrite=True)


class TestToml:
    @quick
    @given(data=st.data())
    def test_damaged_pipeline(self, tmp_path: Path, data: st.DataObject) -> None:
        pipeline = tmp_path / "small.toml"
        pipeline.write_bytes(damaged(data, PIPELINE.encode()))
        found, refusal = outcome(load_pipeline, pipeline)
        assert found is not None or str(pipeline) in refusal

    @quick
    @given(data=st.data())
    def test_odd_values(self, tmp_path: Path, data: st.DataObject) -> None:
        """One value of the file is something else."""
        lines = PIPELINE.splitlines()
        places = [number for number, line in enumerate(lines) if " = " in line]
        place = data.draw(st.sampled_from(places))
        lines[place] = lines[place].split(" = ")[0] + " = " + data.draw(ODD_VALUES)
        pipeline = tmp_path / "small.toml"
        pipeline.write_text("\n".join(lines))
        found, refusal = outcome(load_pipeline, pipeline)
        assert found is not None or refusal

    @pytest.mark.parametrize(
        "text", ["run = 3", "run = []", "[[run]]", "programme = 3", "programme = [3]", "[" * 5000, "a=" + "[" * 5000]
    )
    def test_odd_sections(self, tmp_path: Path, text: str) -> None:
        pipeline = tmp_path / "small.toml"
        pipeline.write_text(text)
        with pytest.raises(InputError, match=r"small\.toml"):
            load_pipeline(pipeline)

    @quick
    @given(
        key=st.lists(st.sampled_from(["run", "seed", "programme", "bright", "x", "", "schedule"]), max_size=4),
        value=ODD_VALUES,
    )
    def test_odd_changes(self, tmp_path: Path, key: list[str], value: str) -> None:
        pipeline = tmp_path / "small.toml"
        pipeline.write_text(PIPELINE)
        outcome(load_pipeline, pipeline, [f"{'.'.join(key)}={value}"])

    @quick
    @given(data=st.data())
    def test_damaged_card(self, tmp_path: Path, data: st.DataObject) -> None:
        (tmp_path / "stars.csv").write_text("source_id,ra_deg,dec_deg,mag\na,1,2,3\n")
        card = tmp_path / "stars.toml"
        card.write_bytes(damaged(data, CARD.encode()))
        found, refusal = outcome(load_card, str(card), data_folder("catalogues"))
        assert found is not None or str(tmp_path) in refusal

    @quick
    @given(data=st.data())
    def test_damaged_instrument(self, tmp_path: Path, data: st.DataObject) -> None:
        sound = "n_science = 13\nplate_radius_mm = 60.0\npatrol_radius_mm = 30.0\nguides = 'centroids'\n"
        path = tmp_path / "small.toml"
        path.write_bytes(damaged(data, sound.encode()))
        outcome(lambda: make_plate(load_instrument(path)))


ODD_WORDS = st.sampled_from(
    [
        "",
        " ",
        "-1",
        "0",
        "nan",
        "inf",
        "1e999",
        "9" * 30,
        "../..",
        "\0",
        "é",
        "--",
        "-",
        "a,b",
        "1,2,3",
        "nan,nan",
        "400,0",
        "x=y",
    ]
)
OPTIONS = {
    "allocate": ["--instrument", "--algorithm", "--visits", "--travel-power", "--centre", "--seed", "--dead"],
    "route": ["--router", "--start", "--instrument", "--seed"],
    "simulate": ["--stop-at", "--instrument"],
    "view": ["--survey", "--tile", "--visit", "--instrument"],
    "export": ["--format", "--survey", "--tile", "--visit", "--table"],
    "run": ["--set", "--workers"],
    "compare-routers": ["--router", "--instrument", "--seed"],
}


class TestCommandLine:
    @quick
    @given(data=st.data())
    def test_odd_options(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, data: st.DataObject) -> None:
        """Options that mean nothing, for files that are not there or are no tables."""
        monkeypatch.chdir(tmp_path)
        (tmp_path / "no.csv").write_text("target_id,x_mm,y_mm\n")
        command = data.draw(st.sampled_from(list(OPTIONS)))
        words = [command, data.draw(st.sampled_from(["no.csv", "absent", "", "."]))]
        for option in data.draw(st.lists(st.sampled_from(OPTIONS[command]), max_size=3, unique=True)):
            words += [option, data.draw(ODD_WORDS)]
        if command == "run":
            words.append("--dry-run")
        result = runner.invoke(app, words)
        assert result.exit_code != 0, (words, result.output)
        assert isinstance(result.exception, SystemExit), (words, result.exception)
        assert result.stderr.strip()

    def test_stop_at_is_a_time(self, tmp_path: Path) -> None:
        result = runner.invoke(app, ["simulate", str(tmp_path), "--stop-at", "nan"])
        assert result.exit_code == 2
        assert "--stop-at" in result.stderr


class TestSky:
    """Places where coordinates go wrong: each must be a row of the run, or refused."""

    def test_ra_of_360_is_ra_of_0(self, tmp_path: Path) -> None:
        rows = "target_id,ra_deg,dec_deg\n1,360.0,-30.0\n2,0.0,-30.5\n3,359.9999999999,-31.0\n"
        (tmp_path / "targets.csv").write_text(rows)
        for ra in (0.0, 360.0):
            found = read_targets(tmp_path / "targets.csv", PLATE, (ra, -30.0)).sort("target_id")
            assert np.abs(found["x_mm"].to_numpy()).max() < 1e-5

    @pytest.mark.parametrize("pole", [-90.0, 90.0])
    def test_a_field_at_the_pole(self, tmp_path: Path, pole: float) -> None:
        away = pole - math.copysign(1.0, pole)
        rows = "".join(f"{i},{ra},{away}\n" for i, ra in enumerate([0.0, 90.0, 180.0, 270.0]))
        (tmp_path / "targets.csv").write_text("target_id,ra_deg,dec_deg\n" + rows + f"9,123.0,{pole}\n")
        found = read_targets(tmp_path / "targets.csv", PLATE, (0.0, pole)).sort("target_id")
        radius = np.hypot(found["x_mm"], found["y_mm"]).to_numpy()
        expected = 3600.0 / PLATE.instrument.plate_scale_arcsec_mm
        np.testing.assert_allclose(radius, [expected] * 4 + [0.0], atol=1e-6)
        places = {(round(x, 3), round(y, 3)) for x, y in found.select("x_mm", "y_mm").iter_rows()}
        assert len(places) == 5


def test_parquet_that_unpacks_without_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    many = pl.DataFrame({"target_id": np.arange(200_000), "x_mm": np.zeros(200_000), "y_mm": np.zeros(200_000)})
    many.write_parquet(tmp_path / "targets.parquet")
    monkeypatch.setattr("survey_sim.survey.field.targets.N_BYTES_MAX", 1 << 20)
    with pytest.raises(InputError, match="unpacks to more than 1 MiB"):
        read_targets(tmp_path / "targets.parquet", PLATE, None)


def test_formulas_in_names_are_no_formulas_in_csv(tmp_path: Path) -> None:
    from survey_sim import tables

    names = ["=1+1", "+1+cmd|' /C calc'!A0", "-2+3|x", "@SUM(A1)", "\t=1", "+20 1234", "-12", "plain", None]
    text = tables.csv_bytes(pl.DataFrame({"source_id": names, "dx_mm": [-1.5] * len(names)}))
    cells = pl.read_csv(text)["source_id"].to_list()
    assert cells == ["'=1+1", "'+1+cmd|' /C calc'!A0", "'-2+3|x", "'@SUM(A1)", "'\t=1", "+20 1234", "-12", "plain", None]
    assert pl.read_csv(text)["dx_mm"].to_list() == [-1.5] * len(names)


def test_hostile_names_in_a_pipeline(tmp_path: Path) -> None:
    """HTML, mathematics and paths as the names of a programme, its survey and the report."""
    for old, new in (('name = "bright"', "name = '<script>alert(1)</script>'"), ('survey = "stars"', "survey = '../../up'")):
        pipeline = write_small_survey(tmp_path / "sky")
        pipeline.write_text(PIPELINE.replace(old, new))
        with pytest.raises(InputError, match="programme"):
            load_pipeline(pipeline)
