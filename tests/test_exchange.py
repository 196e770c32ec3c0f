"""Exchange files: round trips, files from elsewhere, and everything that is refused at the door."""

import gzip
import os
import re
import shutil
import subprocess
from contextlib import suppress
from pathlib import Path

import astropy.units as u
import numpy as np
import polars as pl
import pytest
from astropy.io.votable import parse, tree, validate
from astropy.table import Table
from hypothesis import given, settings
from hypothesis import strategies as st

from survey_sim.errors import InputError
from survey_sim.exchange import (
    ALLOCATION,
    CATALOGUE,
    FILES,
    POSITIONS,
    ROUTER,
    STARBUGS,
    SYSTEM_PARAMETERS,
    Document,
    door,
    legs_from_moves,
    plate_documents,
    plate_of,
    read,
    read_plate,
    read_router,
    robot_columns,
    robot_params,
    rows_of_robots,
    to_bytes,
)
from survey_sim.instrument import PRESETS, Plate, load_instrument, make_plate
from survey_sim.schema import PATHS
from survey_sim.tables import write_bytes

SERIALISATIONS = ("tabledata", "binary", "binary2")


@pytest.fixture(scope="module")
def plate() -> Plate:
    return make_plate(load_instrument("paper"), dead=[7])


def positions(plate: Plate, x_mm: np.ndarray | None = None) -> Document:
    x = plate.park_mm[:, 0] if x_mm is None else x_mm
    frame = robot_columns(plate).with_columns(x_mm=pl.Series(x), y_mm=pl.Series(plate.park_mm[:, 1]), theta_deg=pl.lit(0.0))
    return Document(POSITIONS, {"survey": "field", "tile_id": 0, **robot_params(plate)}, {"positions": frame})


def four_robots(tmp_path: Path) -> Plate:
    """Robots 1 to 4 in a square of 30 mm."""
    places = "[[-15.0, -15.0], [15.0, -15.0], [-15.0, 15.0], [15.0, 15.0]]"
    path = tmp_path / "square.toml"
    path.write_text(f'guides = "none"\nn_science = 4\npark_positions_mm = {places}\n')
    return make_plate(load_instrument(path))


def router(plate: Plate, moves: pl.DataFrame | None = None) -> Document:
    """Robot 1 turns by 10 deg and goes 2 mm along its own x in two ticks; robot 2 goes 1 mm up in the second."""
    turned = np.radians(10.0)
    x1, y1 = -15 + np.cos(turned), -15 + np.sin(turned)
    rows = {
        "tick": [0, 1, 1],
        "robot_id": [1, 1, 2],
        "x_mm": [x1, x1 + np.cos(turned), 15.0],
        "y_mm": [y1, y1 + np.sin(turned), -14.0],
        "theta_deg": [10.0, 10.0, 0.0],
        "dx_mm": [1.0, 1.0, 0.0],
        "dy_mm": [0.0, 0.0, 1.0],
        "dtheta_deg": [10.0, 0.0, 0.0],
        "precise_mm": [0.0, 0.02, 0.02],
        "start_s": [0.0, 10 / 35 + 0.5, 10 / 35 + 0.5],
        "leg": [0, 0, 0],
    }
    first = moves if moves is not None else pl.DataFrame(rows)
    none = pl.DataFrame(rows).clear()
    initial = robot_columns(plate).with_columns(
        pl.lit(None, pl.Int64).alias("target_id"),
        pl.lit(None, pl.String).alias("kind"),
        x_mm=pl.col("park_x_mm"),
        y_mm=pl.col("park_y_mm"),
        theta_deg=pl.lit(0.0),
    )
    params = {"survey": "field", "tile_id": 0, "visit_id": 0, "router": "coordinated", **robot_params(plate)}
    return Document(ROUTER, params, dict(zip(["initial_positions", *PATHS], [initial, first, none, none], strict=True)))


def save(document: Document, tmp_path: Path, serialisation: str = "tabledata", name: str = "file.xml") -> Path:
    path = tmp_path / name
    write_bytes(to_bytes(document, serialisation), path)
    return path


def edited(document: Document, tmp_path: Path, old: str, new: str, count: int = 1) -> Path:
    """The document's file with some text replaced."""
    text = to_bytes(document).decode()
    assert old in text
    path = tmp_path / "edited.xml"
    path.write_text(text.replace(old, new, count))
    return path


def start_of(plate: Plate) -> tuple[np.ndarray, np.ndarray]:
    return plate.park_mm, np.zeros(plate.n_robot)


class TestRoundTrips:
    @pytest.mark.parametrize("serialisation", SERIALISATIONS)
    def test_frames_come_back_exactly(self, plate: Plate, tmp_path: Path, serialisation: str) -> None:
        written = positions(plate, plate.park_mm[:, 0] + 1 / 3)
        back = read(save(written, tmp_path, serialisation), POSITIONS)
        assert back.table().equals(written.table())
        assert dict(back.params) == dict(written.params)

    @pytest.mark.parametrize("serialisation", SERIALISATIONS)
    def test_nulls_come_back(self, tmp_path: Path, serialisation: str) -> None:
        small = four_robots(tmp_path)
        back = read(save(router(small), tmp_path, serialisation), ROUTER)
        assert back.table()["target_id"].null_count() == back.table()["kind"].null_count() == 4
        integers = {"tick": pl.Int32, "leg": pl.Int16, "robot_id": pl.Int32}
        assert back.table("start_to_target").equals(router(small).table("start_to_target").cast(integers))

    @given(numbers=st.lists(st.floats(-1e3, 1e3, allow_subnormal=False), min_size=151, max_size=151))
    @settings(max_examples=10, deadline=None)
    def test_any_double_survives(self, plate: Plate, tmp_path_factory: pytest.TempPathFactory, numbers: list[float]) -> None:
        folder = tmp_path_factory.mktemp("doubles")
        back = read(save(positions(plate, np.array(numbers)), folder), POSITIONS)
        assert back.table()["x_mm"].to_list() == numbers

    @pytest.mark.parametrize("name", sorted(PRESETS))
    def test_an_instrument_comes_back(self, tmp_path: Path, name: str) -> None:
        plate = make_plate(load_instrument(name), dead=[3, 5])
        system, starbugs = plate_documents(plate)
        back = read_plate(save(system, tmp_path, name="system.xml"), save(starbugs, tmp_path, name="starbugs.xml"))
        for array in ("robot_id", "is_guide", "is_live", "park_mm", "patrol_radius_mm"):
            np.testing.assert_array_equal(getattr(back, array), getattr(plate, array))
        assert robot_params(back) == robot_params(plate)

    def test_a_file_says_which_plate_it_is_for(self, plate: Plate, tmp_path: Path) -> None:
        back = plate_of(read(save(positions(plate), tmp_path), POSITIONS))
        np.testing.assert_array_equal(back.park_mm, plate.park_mm)
        assert not back.is_live[6]

    def test_strings_are_escaped(self, plate: Plate, tmp_path: Path) -> None:
        written = positions(plate)
        odd = "a<b>&\"'\u00e9\u2606"
        back = read(save(Document(POSITIONS, {**written.params, "survey": odd}, written.tables), tmp_path), POSITIONS)
        assert back.params["survey"] == odd

    def test_a_control_character_is_refused_when_written(self, plate: Plate) -> None:
        written = positions(plate)
        with pytest.raises(InputError, match="control character"):
            to_bytes(Document(POSITIONS, {**written.params, "survey": "a\x00"}, written.tables))

    def test_gzip_is_read(self, plate: Plate, tmp_path: Path) -> None:
        path = tmp_path / "positions.xml.gz"
        path.write_bytes(gzip.compress(to_bytes(positions(plate))))
        assert read(path, POSITIONS).table().equals(positions(plate).table())


class TestLegs:
    def test_parts_of_a_leg_are_joined(self, tmp_path: Path) -> None:
        plate = four_robots(tmp_path)
        legs = legs_from_moves(router(plate), "start_to_target", plate, *start_of(plate))
        assert legs.robot.tolist() == [0, 1]
        assert legs.rotate_deg.tolist() == [10.0, 0.0]
        assert legs.dx_mm.tolist() == [2.0, 0.0]
        assert legs.precise_mm.tolist() == [0.02, 0.02]
        assert legs.start_s.tolist() == [0.0, 10 / 35 + 0.5]

    def test_times_and_approach_are_completed(self, tmp_path: Path) -> None:
        plate = four_robots(tmp_path)
        moves = router(plate).table("start_to_target").drop("precise_mm", "start_s", "leg")
        legs = legs_from_moves(router(plate, moves), "start_to_target", plate, *start_of(plate))
        assert legs.robot.tolist() == [0, 0, 1]
        assert legs.leg.tolist() == [0, 1, 0]
        assert legs.precise_mm.tolist() == [0.0, 0.02, 0.02]
        np.testing.assert_allclose(legs.start_s, [0.0, 10 / 35 + 0.5, 10 / 35 + 0.5])

    @pytest.mark.parametrize(
        ("column", "values", "rule", "row"),
        [
            ("tick", [1, 0, 1], "ticks out of order", "1"),
            ("tick", [-1, 1, 1], "ticks out of order", "0"),
            ("tick", [0, 0, 0], "two moves of one robot in a tick", "0, 1"),
            ("robot_id", [1, 1, 9], "not among the initial positions", "2"),
            ("x_mm", [0.0, 0.0, 15.0], "final position does not follow", "0, 1"),
            ("theta_deg", [10.0, 10.0, 1.0], "final angle does not follow", "2"),
            ("start_s", [0.0, 0.1, 0.1], "begins before the moves of the last", "1, 2"),
            ("precise_mm", [0.0, 0.02, 2.0], "outside the move", "2"),
            ("dtheta_deg", [370.0, 0.0, 0.0], "more than half a turn", "0"),
        ],
    )
    def test_refused(self, tmp_path: Path, column: str, values: list, rule: str, row: str) -> None:
        plate = four_robots(tmp_path)
        moves = router(plate).table("start_to_target").with_columns(pl.Series(column, values))
        document = read(save(router(plate, moves), tmp_path), ROUTER)
        with pytest.raises(InputError, match=rule) as caught:
            legs_from_moves(document, "start_to_target", plate, *start_of(plate))
        assert "file.xml" in str(caught.value)
        assert "table start_to_target" in str(caught.value)
        assert f"rows [{row}" in str(caught.value)

    def test_a_dead_robot_stays(self, tmp_path: Path) -> None:
        plate = four_robots(tmp_path)
        dead = make_plate(plate.instrument, dead=[2])
        with pytest.raises(InputError, match="dead robot moves"):
            legs_from_moves(router(plate), "start_to_target", dead, *start_of(plate))


class TestFilesFromElsewhere:
    @pytest.mark.parametrize("serialisation", SERIALISATIONS)
    def test_units_order_and_names(self, plate: Plate, tmp_path: Path, serialisation: str) -> None:
        """Another program's table: no TABLE name, other order, um and m, rad, the paper's names, a column more."""
        table = Table()
        table["theta"] = np.full(plate.n_robot, np.pi / 6) * u.rad
        table["Y"] = plate.park_mm[:, 1] * 1e-3 * u.m
        table["comment"] = ["x"] * plate.n_robot
        table["x"] = plate.park_mm[:, 0] * 1e3 * u.um
        table["Bug"] = plate.robot_id.astype(float)
        path = tmp_path / "other.vot"
        table.write(path, format="votable", tabledata_format=serialisation)
        frame = rows_of_robots(read(path, POSITIONS), plate)
        np.testing.assert_allclose(frame["x_mm"], plate.park_mm[:, 0], atol=1e-9)
        np.testing.assert_allclose(frame["y_mm"], plate.park_mm[:, 1], atol=1e-9)
        np.testing.assert_allclose(frame["theta_deg"], 30.0)

    @pytest.mark.parametrize(("unit", "factor"), [("arcmin", 60.0), ("arcsec", 3600.0), ("rad", np.pi / 180)])
    def test_angles(self, tmp_path: Path, unit: str, factor: float) -> None:
        table = Table({"target_id": [1, 2], "ra": np.array([10.0, 20.0]) * factor, "dec": np.array([-5.0, 5.0]) * factor})
        table["ra"].unit = table["dec"].unit = unit
        path = tmp_path / "catalogue.vot"
        table.write(path, format="votable")
        np.testing.assert_allclose(read(path, CATALOGUE).table()["ra_deg"], [10.0, 20.0])

    def test_params_are_converted(self, tmp_path: Path) -> None:
        document = plate_documents(make_plate(load_instrument("paper")))[0]
        path = edited(document, tmp_path, 'unit="mm" value="163.5"', 'unit="cm" value="16.35"')
        assert read(path, SYSTEM_PARAMETERS).params["plate_radius_mm"] == pytest.approx(163.5)


class TestRefused:
    """Every message names the file, and what of table, row and rule there is."""

    def refuse(self, path: Path, match: str, model: str = "positions") -> str:
        with pytest.raises(InputError, match=match) as caught:
            read(path, FILES[model])
        assert path.name in str(caught.value)
        return str(caught.value)

    def test_malformed(self, plate: Plate, tmp_path: Path) -> None:
        text = to_bytes(positions(plate)).decode()
        path = tmp_path / "broken.xml"
        path.write_text(text[: len(text) // 2])
        assert "table positions, row" in self.refuse(path, "not well-formed XML")

    def test_empty_and_other_files(self, tmp_path: Path) -> None:
        path = tmp_path / "empty.xml"
        path.write_bytes(b"")
        self.refuse(path, "not well-formed")
        path.write_bytes(b"\x89PNG\r\n\x1a\n")
        self.refuse(path, "not well-formed")
        path.write_bytes(b"<html/>")
        self.refuse(path, "no VOTable")
        path.write_bytes(b'<?xml version="1.0" encoding="nonsense"?><VOTABLE/>')
        self.refuse(path, "not .*XML")
        self.refuse(tmp_path / "absent.xml", "no such file")
        self.refuse(tmp_path, "cannot be read")

    def test_external_entity(self, plate: Plate, tmp_path: Path) -> None:
        secret = tmp_path / "secret.txt"
        secret.write_text("secret")
        doctype = f'<!DOCTYPE VOTABLE [<!ENTITY e SYSTEM "file://{secret}">]><VOTABLE '
        message = self.refuse(edited(positions(plate), tmp_path, "<VOTABLE ", doctype), "document type declaration")
        assert "secret" not in message.replace(str(tmp_path), "")

    def test_billion_laughs(self, tmp_path: Path) -> None:
        entities = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 10))
        path = tmp_path / "laughs.xml"
        path.write_text(f'<!DOCTYPE VOTABLE [<!ENTITY l0 "ha">{entities}]><VOTABLE>&l9;</VOTABLE>')
        self.refuse(path, "document type declaration")

    def test_gzip_bomb(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(door, "N_BYTES_MAX", 1 << 20)
        path = tmp_path / "bomb.xml.gz"
        path.write_bytes(gzip.compress(b" " * (20 << 20)))
        self.refuse(path, "unpacks to more than 1 MiB")
        path.write_bytes(b" " * ((1 << 20) + 1))
        self.refuse(path, "more than 1 MiB")

    def test_gzip_that_breaks_off(self, plate: Plate, tmp_path: Path) -> None:
        path = tmp_path / "short.xml.gz"
        content = gzip.compress(to_bytes(positions(plate)))
        path.write_bytes(content[:200])
        self.refuse(path, "breaks off")
        path.write_bytes(content[:40] + b"\xff" * 20 + content[60:])
        self.refuse(path, "gzip|XML")

    def test_data_elsewhere(self, plate: Plate, tmp_path: Path) -> None:
        secret = tmp_path / "secret.bin"
        secret.write_bytes(b"\0" * 100)
        text = to_bytes(positions(plate), "binary").decode()
        path = tmp_path / "remote.xml"
        path.write_text(text.replace("<STREAM ", f'<STREAM href="file://{secret}" ', 1))
        self.refuse(path, "href is not followed")

    @pytest.mark.parametrize(
        ("old", "new"),
        [
            ("<TABLE ", '<TABLE nrows="900000000000" '),
            ('arraysize="*"', 'arraysize="2000000000"'),
            ("<TABLE ", '<TABLE nrows="x" '),
        ],
    )
    def test_impossible_sizes(self, plate: Plate, tmp_path: Path, old: str, new: str) -> None:
        text = re.sub(r' nrows="\d+"', "", to_bytes(positions(plate)).decode())
        path = tmp_path / "sizes.xml"
        path.write_text(text.replace(old, new, 1))
        self.refuse(path, "no possible size")

    def test_nested_without_end(self, tmp_path: Path) -> None:
        path = tmp_path / "deep.xml"
        path.write_text("<VOTABLE>" + "<RESOURCE>" * 5000 + "</RESOURCE>" * 5000 + "</VOTABLE>")
        self.refuse(path, "nests elements deeper")

    def test_missing_table(self, plate: Plate, tmp_path: Path) -> None:
        message = self.refuse(save(positions(plate), tmp_path), "no TABLE named 'initial_positions'", "router")
        assert "this one has: positions" in message

    def test_missing_path_table(self, tmp_path: Path) -> None:
        path = edited(router(four_robots(tmp_path)), tmp_path, 'name="park_to_target"', 'name="other"')
        path.write_text(path.read_text().replace('ID="park_to_target"', 'ID="other"'))
        self.refuse(path, "no TABLE named 'park_to_target'", "router")

    def test_missing_column(self, plate: Plate, tmp_path: Path) -> None:
        message = self.refuse(edited(positions(plate), tmp_path, 'name="y_mm"', 'name="z_mm"'), "no column 'y_mm'")
        assert "table positions" in message

    def test_wrong_unit(self, plate: Plate, tmp_path: Path) -> None:
        path = tmp_path / "unit.xml"
        text = to_bytes(positions(plate)).decode()
        path.write_text(re.sub(r'(name="x_mm"[^>]*unit=")mm', r"\1s", text))
        assert "table positions, x_mm" in self.refuse(path, "unit 's' does not convert to 'mm'")
        path.write_text(re.sub(r'(name="x_mm"[^>]*unit=")mm', r"\1furlong", text))
        self.refuse(path, "unit 'furlong' does not convert")

    def test_no_unit(self, plate: Plate, tmp_path: Path) -> None:
        table = Table({"bug": plate.robot_id, "x": plate.park_mm[:, 0], "y": plate.park_mm[:, 1], "theta": np.zeros(151)})
        table.write(tmp_path / "plain.vot", format="votable")
        self.refuse(tmp_path / "plain.vot", "x: has no unit")

    @pytest.mark.parametrize(
        ("value", "rule"), [("NaN", "NaN or empty"), ("", "NaN or empty"), ("+Inf", "not a finite number")]
    )
    def test_not_a_number(self, plate: Plate, tmp_path: Path, value: str, rule: str) -> None:
        first = f"<TD>{plate.park_mm[0, 0]!r}</TD>".replace("np.float64(", "").replace(")", "")
        text = to_bytes(positions(plate)).decode()
        at = text.index(first, text.index(first) + 1)  # park_x_mm stands before x_mm
        path = tmp_path / "nan.xml"
        path.write_text(text[:at] + f"<TD>{value}</TD>" + text[at + len(first) :])
        message = self.refuse(path, rule)
        assert "table positions, x_mm" in message
        assert "rows [0]" in message

    def test_text_for_a_number(self, plate: Plate, tmp_path: Path) -> None:
        message = self.refuse(edited(positions(plate), tmp_path, "<TD>1</TD>", "<TD>one</TD>"), "not a readable VOTable")
        assert "table positions, row 0" in message

    def test_ids_that_do_not_match(self, plate: Plate, tmp_path: Path) -> None:
        def ids(path: Path) -> None:
            rows_of_robots(read(path, POSITIONS), plate)

        frame = positions(plate).table()
        params = positions(plate).params
        for changed, rule in (
            (frame.head(150), r"robots have no row at rows \[151\]"),
            (pl.concat([frame, frame.tail(1)]), r"two rows for one robot at rows \[150, 151\]"),
            (frame.with_columns(pl.col("robot_id").replace(151, 400)), r"not a robot of paper \(1 to 151\) at rows \[400\]"),
        ):
            with pytest.raises(InputError, match=rule):
                ids(save(Document(POSITIONS, params, {"positions": changed}), tmp_path))

    def test_unknown_instrument(self, plate: Plate, tmp_path: Path) -> None:
        table = Table(
            {"bug": plate.robot_id, "x_mm": plate.park_mm[:, 0], "y_mm": plate.park_mm[:, 1], "theta_deg": np.zeros(151)}
        )
        table.write(tmp_path / "plain.vot", format="votable")
        with pytest.raises(InputError, match="names no preset instrument"):
            plate_of(read(tmp_path / "plain.vot", POSITIONS))

    def test_odd_robots(self, plate: Plate, tmp_path: Path) -> None:
        path = edited(positions(plate), tmp_path, "<TD>dead</TD>", "<TD>ill</TD>")
        with pytest.raises(InputError, match=r"state: neither 'live' nor 'dead' at rows \[6\]"):
            plate_of(read(path, POSITIONS))


class TestDamage:
    """Whatever a file holds, it is read or refused."""

    @given(data=st.data())
    @settings(max_examples=150, deadline=None)
    def test_damaged_bytes(self, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
        folder = tmp_path_factory.mktemp("damage")
        serialisation = data.draw(st.sampled_from(SERIALISATIONS))
        content = bytearray(to_bytes(router(four_robots(folder)), serialisation))
        for _ in range(data.draw(st.integers(1, 4))):
            place = data.draw(st.integers(0, len(content) - 1))
            length = data.draw(st.integers(0, 12))
            content[place : place + length] = data.draw(st.binary(max_size=12) | st.sampled_from(DAMAGE))
        path = folder / "damaged.xml"
        path.write_bytes(content)
        with suppress(InputError):
            read_router(path)


DAMAGE = (b"<TR>", b"</TD>", b"NaN", b"1e999", b"-1", b"99999999999999999999", b'unit="s"', b"\xff\xfe", b"&amp;", b"\x00")


class TestOtherPrograms:
    def files(self, plate: Plate, tmp_path: Path) -> list[Path]:
        """One file of each kind."""
        small = four_robots(tmp_path)
        system, starbugs = plate_documents(plate)
        allocation = router(small).table().drop("theta_deg").with_columns(travel_mm=pl.lit(0.0))
        catalogue = pl.DataFrame(
            {"target_id": [1], "kind": ["science"], "source_id": ["<&\u2606>"], "ra_deg": [1.0], "dec_deg": [2.0],
             "x_mm": [0.0], "y_mm": [0.0], "mag": [None], "priority": [9], "wanted_visits": [1]},
            schema_overrides={"mag": pl.Float64},
        )  # fmt: skip
        documents = [
            system, starbugs, positions(plate), router(small),
            Document(ALLOCATION, {"visit_id": 0, **robot_params(small)}, {"allocation": allocation}),
            Document(CATALOGUE, {"survey": "field", "centre_ra_deg": 1.0}, {"targets": catalogue}),
        ]  # fmt: skip
        assert {document.model.name for document in documents} == set(FILES)
        return [
            save(document, tmp_path, serialisation, f"{document.model.name}_{serialisation}.xml")
            for document in documents
            for serialisation in SERIALISATIONS
        ]

    def test_astropy_finds_no_fault(self, plate: Plate, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        for path in self.files(plate, tmp_path):
            assert validate(str(path)), capsys.readouterr().out
            document = parse(path, verify="exception")
            assert document.version == "1.4"

    def test_every_column_has_a_description(self) -> None:
        for model in FILES.values():
            for column in (*model.params, *(column for table in model.tables for column in table.columns)):
                assert column.description
                assert column.ucd

    def test_stilts(self, plate: Plate, tmp_path: Path) -> None:
        """`votlint` finds nothing, and `tpipe` selects."""
        stilts = shutil.which("stilts")
        if stilts is None:
            if os.environ.get("SURVEY_SIM_REQUIRE_STILTS") == "1":
                pytest.fail("stilts is not installed (apt-get install stilts)")
            pytest.skip("stilts is not installed")
        paths = self.files(plate, tmp_path)
        for path in paths:
            lint = subprocess.run([stilts, "votlint", f"votable={path}"], capture_output=True, text=True, check=True)
            assert lint.stdout + lint.stderr == "", path.name
        router_file = next(path for path in paths if path.name == "router_tabledata.xml")
        done = subprocess.run(
            [stilts, "tpipe", f"in={router_file}#1", "cmd=select robot_id==1", "cmd=keepcols 'tick dx_mm'", "ofmt=csv"],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert done.stdout.split() == ["tick,dx_mm", "0,1.0", "1,1.0"]


def test_the_tree_is_votable_1_4(plate: Plate) -> None:
    assert b'<VOTABLE version="1.4"' in to_bytes(positions(plate))
    assert tree.VOTableFile(version="1.4").version == "1.4"


def test_starbug_file_needs_both_halves(plate: Plate, tmp_path: Path) -> None:
    system, starbugs = plate_documents(plate)
    path = edited(starbugs, tmp_path, 'name="coarse_speed_mm_s"', 'name="speed"')
    with pytest.raises(InputError, match="PARAMs absent: coarse_speed_mm_s"):
        read_plate(save(system, tmp_path, name="system.xml"), path)
    assert read(path, STARBUGS).table().height == plate.n_robot
