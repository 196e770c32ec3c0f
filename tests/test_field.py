"""Single fields on files alone: allocate, route, simulate, resume, in any order; and what is refused."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest
import typer
from astropy.table import Table
from polars.testing import assert_frame_equal
from typer.testing import CliRunner

from survey_sim import tables
from survey_sim.check import check_run
from survey_sim.cli_field import add_field_commands
from survey_sim.errors import InputError
from survey_sim.exchange import (
    POSITIONS,
    positions_document,
    read,
    read_allocation,
    read_positions,
    read_router,
    router_document,
    to_bytes,
)
from survey_sim.geometry import plate_to_sky
from survey_sim.instrument import load_instrument, make_plate
from survey_sim.schema import PATHS
from survey_sim.survey.field import allocate_field, route_field, simulate_field, standing_at, visits_of_run
from survey_sim.survey.field.rows import move_rows

N_VISIT = 3
# Rows of these are equal after tables -> XML -> tables.
ROUND_TRIP = ("robots", "targets", "tiles", "visits", "allocations", "paths", "legs", "robot_times")


def make_targets(n_science: int = 90, seed: int = 1) -> pl.DataFrame:
    """A field of 13 robots: uniform targets of all kinds on a small plate."""
    rng = np.random.default_rng(seed)
    n = n_science + 20
    radius, angle = 58 * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
    kind = ["science"] * n_science + ["standard"] * 8 + ["sky"] * 12
    return pl.DataFrame(
        {
            "target_id": np.arange(n) + 1000,
            "x_mm": radius * np.cos(angle),
            "y_mm": radius * np.sin(angle),
            "kind": kind,
            "mag": rng.uniform(9, 12, n),
            "priority": rng.integers(1, 10, n),
        }
    )


@pytest.fixture(scope="module")
def instrument(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("instrument") / "small.toml"
    path.write_text('n_science = 13\nplate_radius_mm = 60.0\nguides = "none"\npatrol_radius_mm = 30.0\n')
    return path


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory, instrument: Path) -> Path:
    """A routed field of three visits, one robot dead."""
    folder = tmp_path_factory.mktemp("field")
    make_targets().write_csv(folder / "targets.csv")
    out = folder / "run"
    made = allocate_field(
        folder / "targets.csv", out, instrument=instrument, algorithm="cda-advanced", visits=N_VISIT, dead=(4,)
    )
    assert len(made.files) == N_VISIT
    route_field([out], router="simple-vector")
    return out


def xml(run: Path, model: str) -> list[Path]:
    return sorted((run / "xml").glob(f"{model}_*.xml"))


class TestChain:
    def test_every_table_is_there(self, field: Path) -> None:
        for name in ROUND_TRIP:
            assert tables.read(field, name).height, name
        assert tables.read(field, "visits")["visit_id"].to_list() == [0, 1, 2]

    def test_what_allocation_alone_knows(self, field: Path, instrument: Path, tmp_path: Path) -> None:
        allocate_field(
            field.parent / "targets.csv", tmp_path / "run", instrument=instrument, algorithm="cda-advanced", visits=N_VISIT,
            dead=(4,),
        )  # fmt: skip
        before = tables.read(tmp_path / "run", "visits")
        route_field([tmp_path / "run"])
        after = tables.read(tmp_path / "run", "visits")
        unknown = ["collisions", "unrouted", "ticks", "configuration_time_s", "configuration_time_p95_s", "lower_bound_s"]
        assert before.select(unknown).null_count().row(0) == (N_VISIT,) * len(unknown)
        assert after.null_count().sum_horizontal().sum() == 0
        assert after["unrouted"].sum() == 0
        assert_frame_equal(before.drop(unknown), after.drop(unknown))

    def test_what_the_router_lost_is_named(self, field: Path) -> None:
        held = tables.read(field, "allocations").filter(kind="science").group_by("target_id").len("n")
        science = tables.read(field, "targets").filter(kind="science").join(held, on="target_id", how="left")
        lost = science.filter(pl.col("n").fill_null(0) < pl.col("wanted_visits"))
        given = tables.read(field, "unallocated")
        assert sorted(given["target_id"]) == sorted(lost["target_id"])
        n_unrouted = tables.read(field, "visits")["unrouted"].sum()
        assert given.filter(reason="unrouted").height <= n_unrouted

    def test_robots_end_where_allocated(self, field: Path) -> None:
        held = tables.read(field, "allocations").drop_nulls("target_id")
        targets = pl.read_csv(field.parent / "targets.csv")
        both = held.join(targets, on="target_id")
        assert both.height == held.height > N_VISIT * 8
        np.testing.assert_allclose(both["x_mm"], both["x_mm_right"], atol=1e-9)
        assert (both["kind"] == both["kind_right"]).all()

    def test_tables_to_xml_to_tables(self, field: Path, tmp_path: Path) -> None:
        """Equal to 1 um and 1e-4 deg is promised; doubles come back, sums of a leg's parts to rounding."""
        simulate_field(xml(field, "router"), tmp_path / "again")
        for name in ROUND_TRIP:
            before, after = tables.read(field, name), tables.read(tmp_path / "again", name)
            assert_frame_equal(before, after, check_exact=False, rel_tol=0.0, abs_tol=1e-9)

    def test_visits_of_tables_are_visits_of_files(self, field: Path) -> None:
        for visit, path in zip(visits_of_run(field, "field", 0), xml(field, "router"), strict=True):
            other = read_router(path)
            assert dict(visit.params).items() >= {"visit_id": other.params["visit_id"], "start": other.start}.items()
            np.testing.assert_allclose(visit.standing.position_mm, other.standing.position_mm, atol=1e-9)
            np.testing.assert_allclose(visit.standing.theta_deg, other.standing.theta_deg, atol=1e-9)
            for name in PATHS:
                np.testing.assert_array_equal(visit.legs[name].robot, other.legs[name].robot)
                np.testing.assert_allclose(visit.legs[name].dx_mm, other.legs[name].dx_mm, atol=1e-9)
            assert visit.reasons == other.reasons

    def test_proved_by_the_checker(self, field: Path) -> None:
        assert check_run(field).faults.is_empty()

    def test_dead_robot_stays(self, field: Path) -> None:
        assert 4 not in tables.read(field, "legs")["robot_id"]
        assert tables.read(field, "robots").filter(state="dead")["robot_id"].to_list() == [4]

    def test_csv(self, field: Path, tmp_path: Path) -> None:
        made = simulate_field(xml(field, "router"), tmp_path / "csv")
        assert pl.read_csv(made.out / "paths.csv").height == N_VISIT * 3
        assert pl.read_csv(made.out / "robot_times.csv").height == N_VISIT * 3 * 13
        assert made.findings == []


class TestOrder:
    def test_changed_order_goes_by_park(self, field: Path, tmp_path: Path) -> None:
        first, second, third = xml(field, "router")
        made = simulate_field([first, third, second], tmp_path / "night")
        assert tables.read(made.out, "visits")["start"].to_list() == ["previous", "park", "park"]
        visits = visits_of_run(made.out, "field", 0)
        for visit, path in zip(visits, (first, third, second), strict=True):
            end, planned = visit.end("start_to_target"), read_router(path).end("start_to_target")
            np.testing.assert_allclose(end.position_mm, planned.position_mm, atol=1e-9)
        assert made.findings == []
        assert check_run(made.out).faults.is_empty()

    def test_straight_on_after_a_way_by_park(self, field: Path, tmp_path: Path) -> None:
        """Visit 2 follows visit 1, which was reached by park, so otherwise turned: robots turn in place first."""
        _, second, third = xml(field, "router")
        stow = field / "xml" / "stow.xml"
        made = simulate_field([xml(field, "router")[0], stow, second, third], tmp_path / "night")
        assert tables.read(made.out, "visits")["start"].to_list() == ["previous", "park", "park", "previous"]
        assert made.findings == []
        assert check_run(made.out).faults.is_empty()

    def test_a_lost_way_is_refused(self, field: Path, tmp_path: Path) -> None:
        alone = []
        for path in (xml(field, "router")[0], xml(field, "router")[2]):
            alone.append(tmp_path / path.name)
            alone[-1].write_bytes(path.read_bytes())
        with pytest.raises(InputError, match="no file leads from there to park"):
            simulate_field(alone, tmp_path / "night")
        assert not (tmp_path / "night").exists()

    def test_routed_in_the_nights_order(self, field: Path, tmp_path: Path) -> None:
        first, second, third = xml(field, "allocation")
        made = route_field([third, first, second], tmp_path / "other", router="simple-vector")
        assert [path.name for path in made.files] == [f"router_000{i}.xml" for i in range(3)]
        ends = tables.read(made.out, "allocations").filter(visit_id=0).drop_nulls("target_id")
        planned = tables.read(field, "allocations").filter(visit_id=2)
        assert set(ends["target_id"]) <= set(read_held(third)) | set(planned["target_id"])


def read_held(path: Path) -> list[int]:
    return Table.read(path, format="votable")["target_id"].compressed().tolist()


class TestRecovery:
    def test_from_the_middle_of_a_configuration(self, field: Path, tmp_path: Path) -> None:
        """The power fails in visit 1; the robots go on from where the backup file says that they stand."""
        path = xml(field, "router")[1]
        simulate_field(xml(field, "router")[:2], tmp_path / "night", stop_at_s=3.0)
        backup = tmp_path / "night" / "xml" / "positions_stopped.xml"
        visit = read_router(path)
        stopped = standing_at(visit, "start_to_target", 3.0)
        standing, plate = read_positions(backup, visit.plate)
        np.testing.assert_allclose(standing.position_mm, stopped.position_mm, atol=1e-9)
        made = route_field([xml(field, "allocation")[1]], tmp_path / "go_on", router="simple-vector", start=backup)
        resumed = read_router(made.files[0])
        np.testing.assert_allclose(resumed.standing.position_mm, standing.position_mm, atol=1e-9)
        np.testing.assert_allclose(resumed.standing.theta_deg, standing.theta_deg, atol=1e-9)
        assert check_run(made.out).faults.is_empty()
        again = visits_of_run(made.out, "field", 0)[0]
        np.testing.assert_allclose(again.standing.position_mm, standing.position_mm, atol=1e-9)
        assert not plate.is_live[3]

    def test_stopped_at_the_ends_of_a_path(self, field: Path) -> None:
        visit = read_router(xml(field, "router")[1])
        begun, ended = standing_at(visit, "start_to_target", 0.0), standing_at(visit, "start_to_target", 1e4)
        np.testing.assert_allclose(begun.position_mm, visit.standing.position_mm)
        np.testing.assert_allclose(ended.position_mm, visit.end("start_to_target").position_mm)
        np.testing.assert_allclose(ended.theta_deg, visit.end("start_to_target").theta_deg)

    def test_illegal_start_is_refused(self, field: Path, tmp_path: Path) -> None:
        visit = read_router(xml(field, "router")[0])
        visit.standing.position_mm[:2] = visit.standing.position_mm[:2].mean(axis=0) + np.array([[-1.0, 0.0], [1.0, 0.0]])
        backup = tmp_path / "positions.xml"
        backup.write_bytes(to_bytes(positions_document(visit.plate, visit.standing)))
        with pytest.raises(InputError, match="nearer to each other") as caught:
            route_field([xml(field, "allocation")[0]], tmp_path / "out", router="simple-vector", start=backup)
        assert "where it begins" in str(caught.value)
        assert "robot 1" in str(caught.value)
        assert not (tmp_path / "out").exists()


class TestFindings:
    def test_a_planted_collision_is_found(self, field: Path, tmp_path: Path) -> None:
        """Robot 1 drives to a point 5 mm from robot 2: no fault of the file, a finding of the simulation."""
        visit = read_router(xml(field, "router")[0])
        moves = move_rows(visit)
        begin, other = visit.begin("start_to_park").position_mm[0], visit.begin("start_to_park").position_mm[1]
        goal = other - [5.0, 0.0]
        row = {"tick": 0, "robot_id": 1, "x_mm": goal[0], "y_mm": goal[1], "theta_deg": 0.0, "dx_mm": goal[0] - begin[0]}
        row |= {"dy_mm": goal[1] - begin[1], "dtheta_deg": 0.0, "precise_mm": 0.0, "start_s": 0.0, "leg": 0}
        moves["start_to_park"] = pl.DataFrame([row])
        path = tmp_path / "crash.xml"
        path.write_bytes(to_bytes(router_document(visit, moves)))
        found = simulate_field([path], tmp_path / "out").findings
        assert found[1:] == ["field, tile 0, visit 0, start_to_park: robots 1 and 2 collide, 5.000 mm between their centres"]
        assert tables.read(tmp_path / "out", "paths").filter(path="start_to_park")["collisions"].to_list() == [1]

    def test_leaving_plate_and_reach_is_found(self, field: Path, tmp_path: Path) -> None:
        visit = read_router(xml(field, "router")[0])
        moves = move_rows(visit)
        begin = visit.begin("start_to_park").position_mm[0]
        row = {"tick": 0, "robot_id": 1, "x_mm": begin[0], "y_mm": begin[1] - 40.0, "theta_deg": 0.0, "dx_mm": 0.0}
        row |= {"dy_mm": -40.0, "dtheta_deg": 0.0, "precise_mm": 0.0, "start_s": 0.0, "leg": 0}
        moves["start_to_park"] = pl.DataFrame([row])
        path = tmp_path / "out.xml"
        path.write_bytes(to_bytes(router_document(visit, moves)))
        found = " ".join(simulate_field([path], tmp_path / "out").findings)
        assert "robots [1] leave the plate" in found
        assert "robots [1] go further from park" in found


class TestTargets:
    @pytest.mark.parametrize("suffix", ["csv", "parquet", "fits", "vot"])
    def test_any_format_gives_the_same(self, field: Path, instrument: Path, tmp_path: Path, suffix: str) -> None:
        frame, path = make_targets(), tmp_path / f"targets.{suffix}"
        if suffix == "csv":
            frame.write_csv(path)
        elif suffix == "parquet":
            frame.write_parquet(path)
        else:
            table = Table({name: frame[name].to_list() for name in frame.columns})
            table["x_mm"] = np.array(table["x_mm"]) / 10
            table["x_mm"].unit = "cm"
            table["y_mm"].unit = "mm"
            table.write(path, format="fits" if suffix == "fits" else "votable")
        made = allocate_field(path, tmp_path / "run", instrument=instrument, algorithm="cda-advanced", visits=1, dead=(4,))
        planned = tables.read(field, "targets").drop("ra_deg", "dec_deg", "_healpix_29").sort("target_id")
        assert_frame_equal(tables.read(made.out, "targets").select(planned.columns).sort("target_id"), planned)

    def test_sky_positions_with_a_centre(self, instrument: Path, tmp_path: Path) -> None:
        frame = make_targets()
        centre = (150.0, -31.0)
        sky = plate_to_sky(frame.select("x_mm", "y_mm").to_numpy(), centre, 67.2)
        by_sky = frame.drop("x_mm", "y_mm").with_columns(ra_deg=sky[:, 0], dec_deg=sky[:, 1])
        by_sky.write_csv(tmp_path / "sky.csv")
        with pytest.raises(InputError, match=r"no plate positions.*\n.*--centre"):
            allocate_field(tmp_path / "sky.csv", tmp_path / "run", instrument=instrument)
        made = allocate_field(
            tmp_path / "sky.csv", tmp_path / "run", instrument=instrument, centre_deg=centre, visits=1, algorithm="cda-basic"
        )
        tile = tables.read(made.out, "tiles").row(0, named=True)
        assert (tile["ra_deg"], tile["dec_deg"]) == centre
        assert read_allocation(made.files[0]).params["centre_ra_deg"] == 150.0

    @pytest.mark.parametrize(
        ("change", "match"),
        [
            (lambda f: f.drop("target_id"), "no column 'target_id'"),
            (lambda f: f.with_columns(x_mm=pl.lit(float("nan"))), "targets.x_mm: null, NaN or infinite"),
            (lambda f: pl.concat([f, f.head(1)]), "targets.target_id: duplicate id"),
            (lambda f: f.with_columns(kind=pl.lit("galaxy")), "unknown kind 'galaxy'"),
            (lambda f: f.with_columns(priority=pl.lit(12)), "priority: outside"),
            (lambda f: f.with_columns(x_mm=pl.lit("left")), "x_mm: not a number"),
            (lambda f: f.with_columns(target_id=pl.col("target_id") + 0.5), "target_id: not a whole number"),
            (lambda f: f.with_columns(pl.col("x_mm", "y_mm") + 1e3), "no target can be reached"),
            (lambda f: f.with_columns(pl.col("x_mm", "y_mm") * 1e4), "than the sky reaches"),
        ],
    )
    def test_refused(self, instrument: Path, tmp_path: Path, change, match: str) -> None:
        change(make_targets()).write_csv(tmp_path / "bad.csv")
        with pytest.raises(InputError, match=match) as caught:
            allocate_field(tmp_path / "bad.csv", tmp_path / "run", instrument=instrument, algorithm="cda-basic", visits=1)
        assert "bad.csv" in str(caught.value)
        assert not (tmp_path / "run").exists()

    def test_not_a_table(self, instrument: Path, tmp_path: Path) -> None:
        (tmp_path / "a.txt").write_text("x")
        (tmp_path / "b.fits").write_text("x")
        (tmp_path / "c.parquet").write_text("x")
        for name, match in (
            ("a.txt", "no known kind"),
            ("b.fits", "not readable FITS"),
            ("c.parquet", "not readable PARQUET"),
            ("d.csv", "no such file"),
        ):
            with pytest.raises(InputError, match=match):
                allocate_field(tmp_path / name, tmp_path / "run", instrument=instrument)


class TestDoor:
    def test_nothing_is_written_over_other_things(self, field: Path, instrument: Path, tmp_path: Path) -> None:
        (tmp_path / "precious.txt").write_text("x")
        for out in (tmp_path, tmp_path / "precious.txt"):
            with pytest.raises(InputError, match="choose another --out"):
                allocate_field(field.parent / "targets.csv", out, instrument=instrument)
        assert (tmp_path / "precious.txt").read_text() == "x"

    def test_unknown_names(self, field: Path, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"unknown allocator.*\n.*did you mean 'cda-basic'"):
            allocate_field(field.parent / "targets.csv", tmp_path / "x", algorithm="cda-basics")
        with pytest.raises(InputError, match="unknown router"):
            route_field([field], tmp_path / "x", router="straight")
        with pytest.raises(InputError, match="holds no xml/allocation"):
            route_field([tmp_path], tmp_path / "x")
        with pytest.raises(InputError, match="no such file"):
            route_field([tmp_path / "no.xml"], tmp_path / "x")

    def test_files_of_two_plates(self, field: Path, tmp_path: Path) -> None:
        other = allocate_field(
            field.parent / "targets.csv", tmp_path / "p", instrument="paper", algorithm="cda-basic", visits=1
        )
        with pytest.raises(InputError, match="another plate"):
            route_field([*xml(field, "allocation"), *other.files], tmp_path / "x")

    def test_targets_that_the_catalogue_lacks(self, field: Path, tmp_path: Path) -> None:
        for path in (field / "xml" / "catalogue.xml", xml(field, "allocation")[0], xml(field, "router")[0]):
            (tmp_path / path.name).write_bytes(path.read_bytes())
        held = read_router(xml(field, "router")[0]).held["target_id"].drop_nulls()[0]
        catalogue = tmp_path / "catalogue.xml"
        catalogue.write_text(catalogue.read_text().replace(f"<TD>{held}</TD>", "<TD>99999</TD>", 1))
        for command, name in ((route_field, "allocation_0000.xml"), (simulate_field, "router_0000.xml")):
            with pytest.raises(InputError, match="not in the catalogue") as caught:
                command([tmp_path / name], tmp_path / "out")
            assert f"{name}, target_id" in str(caught.value)
            assert f"rows [{held}]" in str(caught.value)

    def test_another_instrument_is_refused_by_its_robots(self, field: Path, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="robots have no row"):
            route_field([field], tmp_path / "x", instrument="paper")


class TestCommands:
    @pytest.fixture
    def run(self):
        app = typer.Typer()
        add_field_commands(app)
        return lambda *words: CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)

    def test_the_chain(self, run, instrument: Path, tmp_path: Path) -> None:
        make_targets().write_csv(tmp_path / "t.csv")
        out = tmp_path / "run"
        common = ("--instrument", instrument, "--algorithm", "cda-basic", "--visits", 2, "--out", out)
        assert run("allocate", tmp_path / "t.csv", *common).exit_code == 0
        done = run("route", out, "--router", "simple-vector")
        assert done.exit_code == 0
        assert "start_to_target" in done.output
        assert run("simulate", *xml(out, "router"), "--out", tmp_path / "sim", "--stop-at", 2).exit_code == 0
        assert read(tmp_path / "sim" / "xml" / "positions_stopped.xml", POSITIONS).table().height == 13
        assert run("simulate", out, "--quiet").output == ""

    def test_centre_is_checked(self, run, tmp_path: Path) -> None:
        for text in ("10", "10,100", "a,b"):
            with pytest.raises(InputError, match="--centre"):
                run("allocate", tmp_path / "t.csv", "--centre", text)


def test_the_small_instrument_is_what_the_tests_say(instrument: Path) -> None:
    assert make_plate(load_instrument(instrument)).n_robot == 13
