"""Commands of single fields and of finished runs, each given what breaks one rule: refused in words, nothing written."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from typer.testing import CliRunner

from survey_sim import tables
from survey_sim.cli import app
from survey_sim.exchange import ALLOCATION, POSITIONS, ROUTER, Document, FileModel, read, to_bytes
from survey_sim.schema import PATHS
from survey_sim.survey.field import route_field
from tests.report_run import write_run
from tests.test_field import field, instrument, make_targets, xml  # noqa: F401 - fixtures

Change = Callable[[pl.DataFrame], pl.DataFrame]
MOVES = PATHS[0]
DEAD = 4


def refused(words: list[str], *said: str) -> str:
    """What a command says when it refuses: one short block."""
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == 2, (words, result.output, result.exception)
    assert result.stderr.startswith("error: ")
    assert len(result.stderr.strip().splitlines()) <= 3, result.stderr
    for text in said:
        assert text in result.stderr, result.stderr
    return result.stderr


def put(robot: int, **values: object) -> Change:
    """Other values in the rows of a robot."""

    def change(frame: pl.DataFrame) -> pl.DataFrame:
        is_its = pl.col("robot_id") == robot
        return frame.with_columns(
            pl.when(is_its).then(pl.lit(value)).otherwise(name).alias(name) for name, value in values.items()
        )

    return change


def beside_another(frame: pl.DataFrame) -> pl.DataFrame:
    """Robot 1 stands 5 mm from the robot that is nearest to its park, on the side of its park."""
    place, park = frame.select("x_mm", "y_mm").to_numpy(), frame.select("park_x_mm", "park_y_mm").row(0)
    away = park - place[1:]
    nearest = np.hypot(*away.T).argmin()
    x, y = place[1 + nearest] + 5.0 * away[nearest] / np.hypot(*away[nearest])
    return put(1, x_mm=x, y_mm=y)(frame)


def across_the_plate(frame: pl.DataFrame) -> pl.DataFrame:
    """Robot 2 stands 45 mm from the centre, on the other side than its park."""
    park = np.array(frame.select("park_x_mm", "park_y_mm").row(1))
    x, y = -45.0 * park / np.hypot(*park)
    return put(2, x_mm=x, y_mm=y)(frame)


def spoiled(path: Path, model: FileModel, table: str, change: Change, to: Path) -> Path:
    """The file with one of its tables changed, in a folder of its own."""
    document = read(path, model)
    changed = {**document.tables, table: change(document.tables[table])}
    to.write_bytes(to_bytes(Document(model, document.params, changed)))
    return to


def rewritten(path: Path, old: str, new: str, to: Path) -> Path:
    """The file with a text of it replaced."""
    text = path.read_text()
    assert old in text
    to.write_text(text.replace(old, new))
    return to


# Of where robots stand or go to: the change, and what is said of it.
PLACES: dict[str, tuple[Change, tuple[str, ...]]] = {
    "nearer than the separation": (beside_another, ("nearer to each other than min_separation_mm", "robot 1")),
    "outside the plate": (put(1, x_mm=0.0, y_mm=61.0), ("outside the plate", "robot 1")),
    "out of reach": (across_the_plate, ("further from park than the patrol radius", "robot 2")),
    "NaN": (put(1, x_mm=float("nan")), ("x_mm", "NaN or empty", "rows [0]")),
    "infinite": (put(1, y_mm=float("inf")), ("y_mm", "not a finite number", "rows [0]")),
}
# Of whose rows there are.
ROBOTS: dict[str, tuple[Change, tuple[str, ...]]] = {
    "an unknown robot": (put(5, robot_id=99), ("robot_id", "not a robot of", "rows [99]")),
    "two rows for a robot": (
        lambda frame: pl.concat([frame, frame[2]]),
        ("robot_id", "two rows for one robot", "rows [2, 13]"),
    ),
    "no row for a robot": (lambda frame: frame[1:], ("robot_id", "robots have no row", "rows [1]")),
}
HELD: dict[str, tuple[Change, tuple[str, ...]]] = {
    "an unknown kind": (put(1, target_id=1000, kind="galaxy"), ("kind", "none of science", "rows [0]")),
    "one target for two robots": (
        lambda frame: put(2, target_id=1000, kind="science")(put(1, target_id=1000, kind="science")(frame)),
        ("target_id", "one target for two robots"),
    ),
}  # fmt: skip
# Of any exchange file: a text, and another in its place.
FORM: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "not XML": ("</TABLE>", "<TABLE>", ("not well-formed XML",)),
    "entities": ("<VOTABLE ", '<!DOCTYPE VOTABLE [<!ENTITY a "b">]><VOTABLE ', ("document type declaration",)),
    "no such column": ('name="y_mm"', 'name="z_mm"', ("no column 'y_mm'",)),
    "another unit": ('unit="mm"', 'unit="s"', ("does not convert",)),
}


class TestAllocationFiles:
    """`route` and `compare-routers`."""

    @pytest.mark.parametrize("command", ["route", "compare-routers"])
    @pytest.mark.parametrize("fault", [*PLACES, *ROBOTS, *HELD])
    def test_rows(self, command: str, fault: str, field: Path, instrument: Path, tmp_path: Path) -> None:  # noqa: F811
        change, said = (PLACES | ROBOTS | HELD)[fault]
        bad = spoiled(xml(field, "allocation")[0], ALLOCATION, "allocation", change, tmp_path / "bad.xml")
        refused([command, bad, "--instrument", instrument, "--out", tmp_path / "out"], str(bad), *said)
        assert not (tmp_path / "out").exists()

    @pytest.mark.parametrize("command", ["route", "compare-routers"])
    @pytest.mark.parametrize("fault", FORM)
    def test_form(self, command: str, fault: str, field: Path, tmp_path: Path) -> None:  # noqa: F811
        old, new, said = FORM[fault]
        bad = rewritten(xml(field, "allocation")[0], old, new, tmp_path / "bad.xml")
        refused([command, bad, "--out", tmp_path / "out"], str(bad), *said)
        assert not (tmp_path / "out").exists()

    @pytest.mark.parametrize("fault", [*PLACES, *ROBOTS])
    def test_backup_of_where_robots_stand(self, fault: str, field: Path, tmp_path: Path) -> None:  # noqa: F811
        change, said = (PLACES | ROBOTS)[fault]
        bad = spoiled(field / "xml" / "positions_0000.xml", POSITIONS, "positions", change, tmp_path / "bad.xml")
        file = str(bad) if fault not in list(PLACES)[:3] else "where it begins"
        refused(["route", xml(field, "allocation")[1], "--start", bad, "--out", tmp_path / "out"], file, *said)
        assert not (tmp_path / "out").exists()

    def test_two_rows_where_the_file_describes_its_own_robots(self, field: Path, tmp_path: Path) -> None:  # noqa: F811
        change, said = ROBOTS["two rows for a robot"]
        bad = spoiled(xml(field, "allocation")[0], ALLOCATION, "allocation", change, tmp_path / "bad.xml")
        refused(["route", bad, "--out", tmp_path / "out"], str(bad), *said)

    def test_settings_of_other_sections(self, field: Path, tmp_path: Path) -> None:  # noqa: F811
        for change, said in (
            ("routing.margin=1", "margin"),
            ("allocation.visits=1", "no section here"),
            ("x", "cannot read"),
        ):
            refused(["route", field, "--set", change, "--out", tmp_path / "out"], said)
        refused(
            ["route", field, "--set", "routing.options.pause_s=1.0", "--out", tmp_path / "out"], "options are for routers"
        )
        assert not (tmp_path / "out").exists()


# Of the moves of a router file.
def second_tick_first(frame: pl.DataFrame) -> pl.DataFrame:
    return frame.with_columns(tick=pl.col("tick").reverse()) if frame["tick"].n_unique() > 1 else frame.with_columns(tick=-1)


MOVED: dict[str, tuple[Change, tuple[str, ...]]] = {
    "NaN": (lambda f: f.with_columns(dx_mm=pl.lit(float("nan"))), ("dx_mm", "NaN or empty")),
    "ticks out of order": (second_tick_first, ("tick", "ticks out of order")),
    "two moves in a tick": (lambda f: pl.concat([f[0], f]), ("robot_id", "two moves of one robot in a tick", "rows [0, 1")),
    "an unknown robot": (lambda f: f.with_columns(robot_id=99), ("robot_id", "not among the initial positions")),
    "a dead robot": (lambda f: f.with_columns(robot_id=DEAD)[:1], ("robot_id", "a dead robot moves", "rows [0]")),
    "ends elsewhere": (lambda f: f.with_columns(pl.col("x_mm") + 1.0), ("x_mm", "does not follow from the move")),
    "turns too far": (lambda f: f.with_columns(dtheta_deg=pl.lit(200.0)), ("dtheta_deg", "more than half a turn")),
}  # fmt: skip


class TestRouterFiles:
    """`simulate` and `view`; what collides or leaves the plate is a finding of `simulate` (test_field.py)."""

    def refuse(self, command: str, bad: Path, said: tuple[str, ...], *more: object) -> None:
        out = bad.parent / ("page.html" if command == "view" else "out")
        refused([command, bad, *more, "--out", out], str(bad), *said)
        assert not out.exists()

    @pytest.mark.parametrize("command", ["simulate", "view"])
    @pytest.mark.parametrize("fault", ["NaN", "infinite", *ROBOTS, *HELD])
    def test_rows(self, command: str, fault: str, field: Path, instrument: Path, tmp_path: Path) -> None:  # noqa: F811
        change, said = (PLACES | ROBOTS | HELD)[fault]
        bad = spoiled(xml(field, "router")[0], ROUTER, "initial_positions", change, tmp_path / "bad.xml")
        self.refuse(command, bad, said, "--instrument", instrument)

    @pytest.mark.parametrize("command", ["simulate", "view"])
    @pytest.mark.parametrize("fault", MOVED)
    def test_moves(self, command: str, fault: str, field: Path, tmp_path: Path) -> None:  # noqa: F811
        change, said = MOVED[fault]
        bad = spoiled(xml(field, "router")[1], ROUTER, MOVES, change, tmp_path / "bad.xml")
        self.refuse(command, bad, (f"table {MOVES}", *said))

    @pytest.mark.parametrize("command", ["simulate", "view"])
    @pytest.mark.parametrize("fault", [*FORM, "no TABLE"])
    def test_form(self, command: str, fault: str, field: Path, tmp_path: Path) -> None:  # noqa: F811
        form = {**FORM, "no TABLE": (f'"{PATHS[2]}"', '"x"', (f"no TABLE named '{PATHS[2]}'",))}
        old, new, said = form[fault]
        bad = rewritten(xml(field, "router")[0], old, new, tmp_path / "bad.xml")
        self.refuse(command, bad, said)


class TestTargets:
    """`allocate`: what `test_field.py` (targets) and `test_fuzz.py` (options) do not try."""

    @pytest.mark.parametrize(
        ("change", "said"),
        [
            (lambda f: f.with_columns(y_mm=pl.lit(float("inf"))), ("y_mm", "not a finite number", "rows [0, 1")),
            (lambda f: f.with_columns(wanted_visits=pl.lit(0)), ("wanted_visits", "less than 1")),
            (lambda f: f.with_columns(priority=pl.lit(0)), ("priority", "outside")),
            (lambda f: f.drop("y_mm"), ("no plate positions", "remedy")),
            (lambda f: f.clear(), ("no target can be reached",)),
        ],
    )
    def test_rows(self, change: Change, said: tuple[str, ...], instrument: Path, tmp_path: Path) -> None:  # noqa: F811
        path = tmp_path / "bad.csv"
        change(make_targets()).write_csv(path)
        refused(["allocate", path, "--instrument", instrument, "--out", tmp_path / "out"], str(path), *said)
        assert not (tmp_path / "out").exists()

    @pytest.mark.parametrize(("ra", "dec", "said"), [(361.0, 0.0, "ra_deg: outside"), (10.0, -91.0, "dec_deg: outside")])
    def test_places_on_the_sky(self, ra: float, dec: float, said: str, tmp_path: Path) -> None:
        path = tmp_path / "bad.csv"
        path.write_text(f"target_id,ra_deg,dec_deg\n1,10.0,0.0\n2,{ra},{dec}\n")
        refused(["allocate", path, "--centre", "10,0", "--out", tmp_path / "out"], str(path), said, "rows [1]")
        assert not (tmp_path / "out").exists()

    @pytest.mark.parametrize(
        ("option", "value", "said"),
        [
            ("--dead", "400", "400"),
            ("--instrument", "taipan-15", "did you mean 'taipan-150'"),
            ("--algorithm", "matchin", "did you mean 'matching'"),
            ("--travel-power", "nan", "travel_power"),
            ("--travel-power", "0", "travel_power"),
            ("--visits", "0", "--visits"),
            ("--set", "allocation.min_skies=1", "did you mean 'min_sky'"),
            ("--set", "routing.router=coordinated", "no section here"),
        ],
    )
    def test_options(self, option: str, value: str, said: str, tmp_path: Path) -> None:
        path = tmp_path / "targets.csv"
        make_targets().write_csv(path)
        result = CliRunner().invoke(app, ["allocate", str(path), option, value, "--out", str(tmp_path / "out")])
        assert result.exit_code == 2, result.output
        assert said in result.stderr
        assert not (tmp_path / "out").exists()

    def test_targets_off_the_plate_are_counted_and_set_aside(self, instrument: Path, tmp_path: Path) -> None:  # noqa: F811
        path, out = tmp_path / "targets.csv", tmp_path / "out"
        make_targets().with_columns(x_mm=pl.when(pl.col("target_id") < 1003).then(100.0).otherwise("x_mm")).write_csv(path)
        words = ["allocate", path, "--instrument", instrument, "--algorithm", "cda-basic", "--visits", "1", "--out", out]
        result = CliRunner().invoke(app, [str(word) for word in words])
        assert result.exit_code == 0, result.output
        assert "3 targets lie outside the plate" in result.output
        assert tables.read(out, "unallocated").filter(reason="out-of-reach").height == 3


RUN_COMMANDS = {
    "report": ["report", "RUN"],
    "compare": ["compare", "RUN", "--out", "OUT"],
    "imprint": ["imprint", "RUN", "--out", "OUT"],
    "weights": ["weights", "RUN", "--realisations", "2"],
    "view": ["view", "RUN", "--out", "OUT"],
    "export": ["export", "RUN", "--out", "OUT"],
    "export of exchange files": ["export", "RUN", "--format", "exchange", "--out", "OUT"],
    "simulate": ["simulate", "RUN", "--out", "OUT"],
    "route": ["route", "RUN", "--out", "OUT"],
    "compare-routers": ["compare-routers", "RUN", "--out", "OUT"],
}
OF_TABLES = list(RUN_COMMANDS)[:7]


class TestRuns:
    """Commands on the folder of a run."""

    def refuse(self, command: str, run: Path, out: Path, *said: str) -> None:
        words = [{"RUN": str(run), "OUT": str(out)}.get(word, word) for word in RUN_COMMANDS[command]]
        before = sorted(run.rglob("*"))
        refused(words, *said)
        assert not out.exists()
        assert command == "report" or sorted(run.rglob("*")) == before  # figures before the one that cannot be drawn stay

    @pytest.mark.parametrize("command", RUN_COMMANDS)
    def test_no_run_there(self, command: str, tmp_path: Path) -> None:
        self.refuse(command, tmp_path / "absent", tmp_path / "out", str(tmp_path / "absent"))
        (tmp_path / "empty").mkdir()
        self.refuse(command, tmp_path / "empty", tmp_path / "out", str(tmp_path / "empty"))

    @pytest.mark.parametrize("command", [name for name in OF_TABLES if name != "export"])  # which reads no run.json
    @pytest.mark.parametrize("content", ["", "{", "[1]", '{"instrument": 3}'])
    def test_a_record_that_is_none(self, command: str, content: str, tmp_path: Path) -> None:
        run = write_run(tmp_path / "run")
        (run / "run.json").write_text(content)
        self.refuse(command, run, tmp_path / "out", "run.json")

    @pytest.mark.parametrize("command", [name for name in OF_TABLES if name != "weights"])
    def test_a_table_that_is_none(self, command: str, tmp_path: Path) -> None:
        run = write_run(tmp_path / "run")
        path = run / ("targets.parquet" if command in {"compare", "imprint"} else "visits.parquet")
        path.write_text("PAR1 and no more")
        self.refuse(command, run, tmp_path / "out", path.name)

    @pytest.mark.parametrize("command", ["compare", "imprint", "view", "export of exchange files"])
    def test_no_such_table(self, command: str, tmp_path: Path) -> None:
        run = write_run(tmp_path / "run")
        path = run / ("targets.parquet" if command in {"compare", "imprint"} else "visits.parquet")
        path.unlink()
        self.refuse(command, run, tmp_path / "out", path.name)


@pytest.mark.parametrize("n_write", [1, 2, 12])
def test_a_command_that_dies_while_it_writes_is_typed_again(
    n_write: int, field: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch  # noqa: F811
) -> None:  # fmt: skip
    whole, torn = (Path(shutil.copytree(field, tmp_path / name)) for name in ("whole", "torn"))
    route_field([whole], router="coordinated")
    write, left = tables.write_bytes, n_write

    def write_some(content: bytes, path: Path, aside: Path | None = None) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise KeyboardInterrupt
        write(content, path, aside)

    with monkeypatch.context() as patch:
        patch.setattr(tables, "write_bytes", write_some)
        with pytest.raises(KeyboardInterrupt):
            route_field([torn], router="coordinated")
    (torn / f".legs.parquet.1{tables.TEMPORARY}").write_text("half")
    refused(["view", torn, "--out", tmp_path / "page.html"], "gives no instrument")
    route_field([torn], router="coordinated")
    assert {path.relative_to(torn) for path in torn.rglob("*")} == {path.relative_to(whole) for path in whole.rglob("*")}
    for path in (path for path in whole.rglob("*") if path.is_file() and path.name != "run.json"):
        assert (torn / path.relative_to(whole)).read_bytes() == path.read_bytes(), path
    records = [json.loads((run / "run.json").read_text()) | {"name": ""} for run in (whole, torn)]
    assert records[0] == records[1]
