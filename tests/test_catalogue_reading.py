"""Cards and readers: four formats alike, units, bad rows, and files that mean harm."""

import gzip
import os
from io import BytesIO
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from astropy.table import Table
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from survey_sim.catalogue import check_catalogue, list_cards, load_card, make_catalogue, read_catalogue
from survey_sim.catalogue.parsers import parse, read_bytes
from survey_sim.errors import InputError
from survey_sim.folders import data_folder

ROWS = {"star": ["a", "b", "c"], "ra": [10.0, 359.5, 360.0], "dec": [-90.0, 0.25, 90.0], "v": [9.5, 10.25, 11.0]}
COLUMNS = """
[columns]
source_id = "star"
ra = { name = "ra", unit = "deg" }
dec = { name = "dec", unit = "deg" }
mag = { name = "v", unit = "mag" }
"""


def write_table(path: Path, rows: dict) -> Path:
    name = path.name.removesuffix(".gz")
    if name.endswith(".parquet"):
        pl.DataFrame(rows).write_parquet(path)
    elif name.endswith(".csv"):
        pl.DataFrame(rows).write_csv(path)
    else:
        kind = "fits" if name.endswith(".fits") else "votable"
        Table(rows).write(path.with_name(name), format=kind)
    if path.suffix == ".gz":
        path.write_bytes(gzip.compress(path.with_name(name).read_bytes()))
    return path


def write_card(folder: Path, file: str, extra: str = "", columns: str = COLUMNS) -> Path:
    card = folder / "card.toml"
    card.write_text(f'name = "mine"\nfile = "{file}"\n{extra}\n{columns}')
    return card


def read(card: Path, tmp_path: Path):
    return read_catalogue(load_card(card, tmp_path), tmp_path / "cache")


@pytest.mark.parametrize("name", ["t.csv", "t.parquet", "t.fits", "t.vot", "t.fits.gz", "t.vot.gz", "t.xml"])
def test_all_formats_give_the_same_rows(tmp_path, name):
    write_table(tmp_path / name, ROWS)
    catalogue = read(write_card(tmp_path, name), tmp_path)
    assert catalogue.rows["source_id"].to_list() == ["a", "b", "c"]
    assert catalogue.rows["ra_deg"].to_list() == [10.0, 359.5, 0.0]  # 360 is 0
    assert catalogue.rows["dec_deg"].to_list() == ROWS["dec"]
    assert catalogue.rows["mag"].to_list() == ROWS["v"]
    assert catalogue.rejected.height == 0


def test_gzipped_csv(tmp_path):
    (tmp_path / "t.csv.gz").write_bytes(gzip.compress(b"star,ra,dec,v\na,1,2,3\n"))
    assert read(write_card(tmp_path, "t.csv.gz"), tmp_path).rows.row(0) == ("a", 1.0, 2.0, 3.0)


def test_units_and_joined_identifiers(tmp_path):
    rows = {"i": [7, 8], "j": [1, 2], "ra_h": [0.5, 23.0], "dec_udeg": [-1_500_000, 2], "m": [9_500, -1_088]}
    write_table(tmp_path / "t.parquet", rows)
    columns = """
    [columns]
    source_id = ["i", "j"]
    ra = { name = "ra_h", unit = "hourangle" }
    dec = { name = "dec_udeg", unit = "udeg" }
    mag = { name = "m", unit = "mmag" }
    """
    found = read(write_card(tmp_path, "t.parquet", columns=columns), tmp_path).rows
    assert found["source_id"].to_list() == ["7-1", "8-2"]
    assert found["ra_deg"].to_list() == pytest.approx([7.5, 345.0], abs=1e-12)
    assert found["dec_deg"].to_list() == pytest.approx([-1.5, 2e-6], abs=1e-15)
    assert found["mag"].to_list() == pytest.approx([9.5, -1.088], abs=1e-12)


def test_a_table_needs_no_card_if_it_uses_our_names(tmp_path):
    (tmp_path / "my stars.csv").write_text("# made by hand\nsource_id,ra_deg,dec_deg,mag\n1,10,20,9\n")
    catalogue = read(tmp_path / "my stars.csv", tmp_path)
    assert catalogue.card.name == "my-stars"
    assert catalogue.rows.row(0) == ("1", 10.0, 20.0, 9.0)


@pytest.mark.parametrize("unit", ["degs", "mag", "m", "deg/s", "((("])
def test_unknown_or_unfit_unit(tmp_path, unit):
    write_table(tmp_path / "t.csv", ROWS)
    columns = COLUMNS.replace('"ra", unit = "deg"', f'"ra", unit = "{unit}"')
    with pytest.raises(InputError, match="unit"):
        read(write_card(tmp_path, "t.csv", columns=columns), tmp_path)


def test_unit_that_the_file_contradicts(tmp_path):
    table = Table(ROWS)
    table["ra"].unit = "rad"
    table.write(tmp_path / "t.vot", format="votable")
    with pytest.raises(InputError, match=r"ra: the card says deg, the file rad"):
        read(write_card(tmp_path, "t.vot"), tmp_path)


@pytest.mark.parametrize(
    ("column", "value", "rule"),
    [
        ("ra", float("nan"), r"ra: not a number in \[0, 360\] deg at rows \[1\]"),
        ("ra", 360.5, r"ra: not a number in \[0, 360\]"),
        ("ra", -0.1, r"ra: not a number in \[0, 360\]"),
        ("ra", float("inf"), r"ra: not a number in \[0, 360\]"),
        ("dec", 90.0001, r"dec: not a number in \[-90, 90\]"),
        ("dec", None, r"dec: not a number in \[-90, 90\]"),
        ("star", None, "star: has no identifier"),
        ("star", "  ", "star: has no identifier"),
        ("star", "a", r"star: identifier used more than once at rows \[0, 1\]"),
    ],
)
@pytest.mark.parametrize("name", ["t.csv", "t.parquet"])
def test_a_bad_row_is_an_error_or_a_rejected_row(tmp_path, name, column, value, rule):
    values = list(ROWS[column])
    values[1] = value
    write_table(tmp_path / name, {**ROWS, column: values})
    with pytest.raises(InputError, match=rule):
        read(write_card(tmp_path, name), tmp_path)
    catalogue = read(write_card(tmp_path, name, 'on_bad_row = "reject"'), tmp_path)
    assert catalogue.rows["source_id"].sort().to_list() == ["a", "c"]
    reason = {"ra": "bad-coordinate", "dec": "bad-coordinate"}.get(column)
    reason = reason or ("duplicate-identifier" if value == "a" else "no-identifier")
    assert catalogue.rejected["reason"].to_list() == [reason]
    assert catalogue.rejected["source_id"].is_unique().all()


def test_a_row_without_magnitude_is_rejected(tmp_path):
    write_table(tmp_path / "t.parquet", {**ROWS, "v": [None, float("nan"), 11.0]})
    catalogue = read(write_card(tmp_path, "t.parquet"), tmp_path)
    assert catalogue.rows["source_id"].to_list() == ["c"]
    assert catalogue.rejected["reason"].to_list() == ["no-magnitude"] * 2
    assert catalogue.rejected["mag"].to_list() == [None, None]


def test_of_one_identifier_the_brightest_stays_whatever_the_order(tmp_path):
    rows = {"star": ["a", "a", "a", "b"], "ra": [1.0, 2.0, 3.0, 4.0], "dec": [0.0] * 4, "v": [9.0, 8.0, 10.0, 9.0]}
    for order in ([0, 1, 2, 3], [3, 2, 1, 0], [1, 3, 0, 2]):
        write_table(tmp_path / "t.parquet", {key: [column[i] for i in order] for key, column in rows.items()})
        catalogue = read(write_card(tmp_path, "t.parquet", 'on_bad_row = "reject"'), tmp_path)
        assert dict(zip(catalogue.rows["source_id"], catalogue.rows["ra_deg"], strict=True)) == {"a": 2.0, "b": 4.0}
        assert sorted(catalogue.rejected.select("source_id", "ra_deg").rows()) == [("a#2", 1.0), ("a#3", 3.0)]


def test_text_that_is_no_number_names_its_rows(tmp_path):
    (tmp_path / "t.csv").write_text("star,ra,dec,v\na,1,2,3\nb,12:30,2,3\nc,x,2,3\n")
    with pytest.raises(InputError, match=r"ra: not a number \('12:30'\) at rows \[1, 2\]"):
        read(write_card(tmp_path, "t.csv"), tmp_path)


@pytest.mark.parametrize("name", ["t.csv", "t.parquet", "t.fits", "t.vot"])
def test_wrong_column_has_a_hint(tmp_path, name):
    write_table(tmp_path / name, ROWS)
    with pytest.raises(InputError, match=r"(?s)dek: no such column.*did you mean 'dec'"):
        read(write_card(tmp_path, name, columns=COLUMNS.replace('name = "dec"', 'name = "dek"')), tmp_path)


def test_a_csv_with_two_columns_of_one_name_is_refused(tmp_path):
    (tmp_path / "t.csv").write_text("star,ra,dec,v,ra\na,1,2,3,4\n")
    with pytest.raises(InputError, match="two columns have this name"):
        read(write_card(tmp_path, "t.csv"), tmp_path)


def test_priorities_and_programmes_of_a_catalogue(tmp_path):
    columns = COLUMNS + 'priority = "p"\nprogramme = "case"\n'
    write_table(tmp_path / "t.csv", {**ROWS, "p": [1, 9, 5], "case": ["x", "y", "x"]})
    found = read(write_card(tmp_path, "t.csv", columns=columns), tmp_path).rows
    assert found["priority"].to_list() == [1, 9, 5]
    assert found["programme"].to_list() == ["x", "y", "x"]
    write_table(tmp_path / "t.csv", {**ROWS, "p": [0.0, 9.0, 2.5], "case": ["x", "y", "x"]})
    with pytest.raises(InputError, match=r"p: not a whole number from 1 to 9 at rows \[0, 2\]"):
        read(write_card(tmp_path, "t.csv", columns=columns), tmp_path)


def test_checksum(tmp_path):
    write_table(tmp_path / "t.csv", ROWS)
    with pytest.raises(InputError, match=r"(?s)SHA-256 is .* says 0000.*remedy"):
        read(write_card(tmp_path, "t.csv", f'sha256 = "{"0" * 64}"'), tmp_path)
    _, digest = read_bytes(tmp_path / "t.csv")
    assert read(write_card(tmp_path, "t.csv", f'sha256 = "{digest}"'), tmp_path).sha256 == digest


# Cards ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("file", ["../t.csv", "sub/../../t.csv", "..\\\\t.csv", "/etc/passwd", "C:\\\\t.csv", "link/t.csv"])
def test_a_card_cannot_reach_out_of_its_folder(tmp_path, file):
    folder = tmp_path / "cards"
    folder.mkdir()
    write_table(tmp_path / "t.csv", ROWS)
    os.symlink(tmp_path, folder / "link")
    with pytest.raises(InputError, match="must lie inside the card's folder"):
        load_card(write_card(folder, file), folder)


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ('name = "x"\nfiel = "t.csv"', r"(?s)fiel: unknown key.*did you mean 'file'"),
        ('name = "x"', "needs either file or recipe"),
        ('name = "x"\nfile = "t.csv"\n[recipe]\n', "needs either file or recipe"),
        ('name = "../x"\nfile = "t.csv"', "name"),
        ('name = "x"\nfile = "absent.csv"', "no such file"),
        ('name = "x"\nfile = "t.txt"', "unknown kind of file"),
        ('name = "x"\nfile = "t.csv"\nformat = "pickle"', "format"),
        ('name = "x"\n[recipe]\nn_galaxy = 1e12', "n_galaxy"),
        ("name = ", "is not TOML"),
    ],
)
def test_bad_cards(tmp_path, text, rule):
    (tmp_path / "t.txt").write_text("")
    write_table(tmp_path / "t.csv", ROWS)
    (tmp_path / "card.toml").write_text(text)
    with pytest.raises(InputError, match=rule):
        load_card(tmp_path / "card.toml", tmp_path)


def test_unknown_catalogue_names_the_nearest():
    with pytest.raises(InputError, match="did you mean 'tycho2'"):
        load_card("tycho", data_folder("catalogues"))
    with pytest.raises(InputError, match="no such file"):
        load_card("nowhere/stars.csv", data_folder("catalogues"))


def test_shipped_cards_are_sound(tmp_path, monkeypatch):
    monkeypatch.setenv("SURVEY_SIM_CACHE", str(tmp_path))
    folder = data_folder("catalogues")
    assert [card.name for card in list_cards(folder)] == ["taipan-mock", "tycho2"]
    assert all(card.settings.source and card.licence and card.title for card in list_cards(folder))
    found = check_catalogue("tycho2", folder)
    assert found["usable rows"] == 1_864_555
    assert found["rejected, duplicate-identifier"] == 176
    with pytest.raises(InputError, match="has no recipe"):
        make_catalogue("tycho2", folder, None, None)


# Files that mean harm -----------------------------------------------------------------------------------------------------

VOTABLE = """<?xml version="1.0"?>{prologue}
<VOTABLE version="1.3" xmlns="http://www.ivoa.net/xml/VOTable/v1.3"><RESOURCE><TABLE>
<FIELD name="star" datatype="char" arraysize="*"/><FIELD name="ra" datatype="double"/>
<FIELD name="dec" datatype="double"/><FIELD name="v" datatype="double"/>
<DATA>{data}</DATA></TABLE></RESOURCE></VOTABLE>"""
BILLION = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {name} "{"&" + before + ";" * 1}{("&" + before + ";") * 9}">'
    for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    "text",
    [
        VOTABLE.format(prologue=BILLION + "]>", data="<TABLEDATA><TR><TD>&i;</TD></TR></TABLEDATA>"),
        VOTABLE.format(prologue='<!DOCTYPE x SYSTEM "file:///etc/passwd">', data="<TABLEDATA/>"),
        VOTABLE.format(prologue="", data='<BINARY><STREAM href="file:///etc/passwd"/></BINARY>'),
        VOTABLE.format(prologue="", data='<BINARY><STREAM encoding="base64" x=">" href="http://localhost/"/></BINARY>'),
        VOTABLE.format(prologue="", data='<BINARY><STREAM encoding="gzip">H4sI</STREAM></BINARY>'),
        VOTABLE.format(prologue="", data='<BINARY><STREAM encoding="&#103;zip">H4sI</STREAM></BINARY>'),
    ],
)
def test_votables_that_reach_out_or_grow_are_refused(tmp_path, text):
    (tmp_path / "t.vot").write_text(text)
    with pytest.raises(InputError, match=r"declares a document type|points to data elsewhere"):
        read(write_card(tmp_path, "t.vot"), tmp_path)
    (tmp_path / "t.vot").write_bytes(text.encode("utf-16"))
    with pytest.raises(InputError, match="not UTF-8"):
        read(write_card(tmp_path, "t.vot"), tmp_path)


def test_gzip_bomb_stops_at_the_limit(tmp_path):
    bomb = tmp_path / "t.csv.gz"
    bomb.write_bytes(gzip.compress(bytes(20 << 20)))
    assert bomb.stat().st_size < 1 << 16
    with pytest.raises(InputError, match="unpacks to more than 1 MiB"):
        read_bytes(bomb, max_bytes=1 << 20)
    # A second wrapping would be unpacked by the CSV parser, without a limit.
    bomb.write_bytes(gzip.compress(bomb.read_bytes()))
    with pytest.raises(InputError, match="is packed"):
        read_bytes(bomb)


def test_parquet_that_unpacks_past_the_limit_is_refused(tmp_path):
    pl.DataFrame({"star": np.arange(300_000), **{key: np.zeros(300_000) for key in ("ra", "dec", "v")}}).write_parquet(
        tmp_path / "t.parquet"
    )
    assert (tmp_path / "t.parquet").stat().st_size < 2 << 20
    card = load_card(write_card(tmp_path, "t.parquet"), tmp_path)
    with pytest.raises(InputError, match="unpacks to more than 4 MiB"):
        read_catalogue(card, tmp_path, max_bytes=4 << 20)


def table_bytes(kind: str) -> bytes:
    buffer = BytesIO()
    if kind == "parquet":
        pl.DataFrame(ROWS).write_parquet(buffer)
    elif kind == "csv":
        pl.DataFrame(ROWS).write_csv(buffer)
    else:
        Table(ROWS).write(buffer, format=kind)
    return buffer.getvalue()


SOUND = {kind: table_bytes(kind) for kind in ("parquet", "csv", "fits", "votable")}


@pytest.mark.parametrize("kind", list(SOUND))
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_files_give_our_error_or_a_table(kind, data):
    content = bytearray(SOUND[kind])
    for _ in range(data.draw(st.integers(1, 6))):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place] = data.draw(st.integers(0, 255))
    end = data.draw(st.one_of(st.just(len(content)), st.integers(0, len(content))))
    try:
        table = parse(bytes(content[:end]), kind, Path(f"t.{kind}"), list(ROWS), max_bytes=1 << 24)
    except InputError:
        return
    assert table.frame.columns == list(ROWS)


@pytest.mark.parametrize("kind", list(SOUND))
@pytest.mark.parametrize("content", [b"", b"\x80\x04\x95.", b"PAR1", b"\n\n", b"star,ra,dec,v"])
def test_files_that_are_no_table(kind, content):
    if kind == "csv" and content.startswith(b"star"):
        assert parse(content, kind, Path("t"), list(ROWS)).frame.height == 0
        return
    with pytest.raises(InputError):
        parse(content, kind, Path("t"), list(ROWS))
