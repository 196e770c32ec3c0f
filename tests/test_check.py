"""The proof of a run: a correct run passes, and every way to be wrong is found by the check that is named for it."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import polars as pl
import pyarrow.parquet as pq
import pytest

from survey_sim import tables
from survey_sim.check import check_run, faults
from survey_sim.errors import InputError
from survey_sim.schema import TABLES
from tests import hand_run
from tests.hand_run import SURVEY, make_tables, write_run

START_TO_TARGET, START_TO_PARK, PARK_TO_TARGET = hand_run.PATHS
Where = dict[str, object]


@pytest.fixture(scope="module")
def made() -> dict[str, pl.DataFrame]:
    """The tables of the hand-made run."""
    return make_tables()


@pytest.fixture(scope="module")
def correct(made: dict[str, pl.DataFrame], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The hand-made run on disk; tests copy it before they break it."""
    return write_run(tmp_path_factory.mktemp("correct") / "run", made)


@pytest.fixture
def run_dir(correct: Path, tmp_path: Path) -> Path:
    """A copy of the correct run."""
    return Path(shutil.copytree(correct, tmp_path / "run"))


def rewrite(run_dir: Path, table: str, change: Callable[[pl.DataFrame], pl.DataFrame]) -> None:
    """Change a table's files, past the writer's own checks."""
    for path in tables.files(run_dir, table):
        metadata = pq.read_schema(path).metadata
        frame = change(pl.read_parquet(path))
        pq.write_table(frame.to_arrow(compat_level=pl.CompatLevel.oldest()).replace_schema_metadata(metadata), path)


def is_row(where: Where) -> pl.Expr:
    """Whether a row is the one named."""
    return pl.all_horizontal(pl.lit(value=True), *(pl.col(name).eq_missing(pl.lit(value)) for name, value in where.items()))


def replaced(where: Where, **values: object) -> Callable[[pl.DataFrame], pl.DataFrame]:
    """Set values (or expressions) in the rows named."""

    def change(frame: pl.DataFrame) -> pl.DataFrame:
        new = {name: value if isinstance(value, pl.Expr) else pl.lit(value) for name, value in values.items()}
        dtypes = frame.schema
        return frame.with_columns(
            pl.when(is_row(where)).then(value.cast(dtypes[name])).otherwise(pl.col(name)).alias(name)
            for name, value in new.items()
        )

    return change


def without(where: Where) -> Callable[[pl.DataFrame], pl.DataFrame]:
    """Leave the rows named out."""
    return lambda frame: frame.filter(~is_row(where))


def found(run_dir: Path, check: str, detail: str, where: Where) -> bool:
    """Whether the check finds a fault whose detail begins so, in that place."""
    rows = check_run(run_dir).faults.filter(check=check).filter(pl.col("detail").str.starts_with(detail))
    return not rows.filter(is_row(where)).is_empty()


def row(tile: int, visit: int, robot: int | None = None, path: str | None = None) -> Where:
    """Keys of a visit, of a robot in it, or of its path."""
    key: Where = {"tile_id": tile, "visit_id": visit}
    return key | ({} if robot is None else {"robot_id": robot}) | ({} if path is None else {"path": path})


def test_correct_run_passes(correct: Path) -> None:
    steps = []
    result = check_run(correct, on_progress=lambda done, total: steps.append((done, total)))
    assert result.is_passed
    assert list(result) == []
    assert result.faults.is_empty()
    assert result.faults.columns == list(faults.FAULT_SCHEMA)
    numbers = (result.n_visit, result.n_exposure, result.n_path, result.n_pair)
    assert numbers == (4, len(hand_run.POINTINGS), 12 + 5, 17 * 15)
    assert steps[-1] == (4, 4)


def test_numbers_of_what_was_checked(correct: Path, made: dict[str, pl.DataFrame]) -> None:
    result = check_run(correct)
    assert result.n_leg == made["legs"].height + made["exposure_legs"].height
    least = min(made[table]["min_separation_mm"].min() for table in ("paths", "exposure_paths"))
    assert result.least_separation_mm == pytest.approx(least, abs=1e-9)


def test_run_that_starts_from_park_passes(tmp_path: Path) -> None:
    made = make_tables("park")
    assert made["visits"]["start"].unique().to_list() == ["park"]
    assert check_run(write_run(tmp_path / "run", made)).is_passed


def test_run_without_schedule_passes(run_dir: Path) -> None:
    for table in ("executions", "exposures", "nights", "target_status", "unallocated"):
        (run_dir / f"{table}.parquet").unlink()
    assert check_run(run_dir).is_passed


def test_status_without_exposures_counts_visits(run_dir: Path) -> None:
    (run_dir / "exposures.parquet").unlink()
    (run_dir / "nights.parquet").unlink()
    faults_found = check_run(run_dir).faults
    # Target 5 is held at visit 1 of tile 0, which the schedule never observed.
    assert set(faults_found["check"]) == {"target_status"}
    assert "n_observed" in faults_found["detail"][0]


@pytest.mark.parametrize("n_bytes", [0, 2**30])
def test_parts_one_by_one_and_together(correct: Path, monkeypatch: pytest.MonkeyPatch, n_bytes: int) -> None:
    monkeypatch.setattr("survey_sim.check.inputs.GROUP_BYTES", n_bytes)
    assert check_run(correct).is_passed


def at(exposure: int, robot: int) -> Where:
    """Keys of a robot at a pointing."""
    return {"exposure_id": exposure, "robot_id": robot}


LEG = {"leg": 0}
ONE = row(0, 0, 1, START_TO_TARGET)
WAY = row(0, 1, 1, START_TO_TARGET)

# What is broken: table, change; and the fault it must show: check, how its detail begins, where.
PLANTED = {
    # schema
    "null": ("legs", replaced(ONE, start_s=None), "schema", "start_s is null", {}),
    "not a number": ("legs", replaced(ONE, start_s=float("nan")), "schema", "start_s is not a finite number", {}),
    "infinite": (
        "visits",
        replaced(row(0, 0), travel_max_mm=float("inf")),
        "schema",
        "travel_max_mm is not a finite",
        row(0, 0),
    ),
    "least separation is no number": (
        "paths",
        replaced(row(0, 0), min_separation_mm=float("nan")),
        "schema",
        "min_separation_mm is not a finite number",
        row(0, 0),
    ),
    "wrong type": ("tiles", lambda t: t.cast({"tile_id": pl.Int64}), "schema", "tile_id is Int64, declared Int32", {}),
    "undeclared column": ("tiles", lambda t: t.with_columns(more=1), "schema", "more is not declared", {}),
    "repeated key": ("paths", lambda t: pl.concat([t, t.head(1)]), "schema", "rows share the key", row(0, 0)),
    "unknown robot kind": ("robots", replaced({"robot_id": 1}, kind="sci"), "schema", "kind 'sci'", {"robot_id": 1}),
    "unknown robot state": ("robots", replaced({"robot_id": 1}, state="ill"), "schema", "state 'ill'", {"robot_id": 1}),
    "unknown target kind": ("targets", replaced({"target_id": 0}, kind="star"), "schema", "kind 'star'", {}),
    "unknown kind held": ("allocations", replaced(row(0, 0, 1), kind="star"), "schema", "kind 'star'", row(0, 0, 1)),
    "unknown start": ("visits", replaced(row(0, 1), start="home"), "schema", "start 'home'", row(0, 1)),
    "unknown path": ("legs", replaced(ONE, path="home"), "schema", "path 'home'", {}),
    "reason is no code": (
        "robot_times",
        replaced(row(1, 1, 4, START_TO_TARGET), reason="No path!"),
        "schema",
        "reason 'No path!' is not a code",
        row(1, 1, 4),
    ),
    "status is no code": (
        "exposures",
        replaced({"exposure_id": 0}, status=""),
        "schema",
        "status '' is not a code",
        row(0, 0),
    ),
    "right ascension": (
        "targets",
        replaced({"target_id": 0}, ra_deg=361.0),
        "schema",
        "ra_deg is too large",
        {"value": 361.0},
    ),
    "declination": (
        "targets",
        replaced({"target_id": 0}, dec_deg=-91.0),
        "schema",
        "dec_deg is too small",
        {"value": -91.0},
    ),
    "priority": ("targets", replaced({"target_id": 0}, priority=0), "schema", "priority is too small", {"limit": 1.0}),
    "share above 1": (
        "visits",
        replaced(row(0, 0), ideal_completeness_frac=1.5),
        "schema",
        "ideal_completeness_frac is too large",
        row(0, 0),
    ),
    "negative start": ("legs", replaced(ONE, start_s=-1.0), "schema", "start_s is too small", ONE),
    "negative slew": ("exposures", replaced({"exposure_id": 0}, slew_s=-1.0), "schema", "slew_s is too small", row(0, 0)),
    "visit of no tile": ("tiles", without({"tile_id": 1}), "schema", "no row of tiles has this", row(1, 0)),
    "no robots": (
        "robots",
        lambda t: t.clear(),
        "schema",
        "no row of robots has this survey",
        row(1, 0) | {"table": "visits"},
    ),
    "path of no visit": (
        "visits",
        without(row(1, 1)),
        "schema",
        "no row of visits has this",
        row(1, 1, path=START_TO_PARK) | {"table": "paths"},
    ),
    "visits with a gap": ("visits", without(row(0, 0)), "schema", "visits of a tile are not counted", row(0, 1)),
    "missing path": (
        "paths",
        without(row(0, 1, path=START_TO_PARK)),
        "schema",
        "row is missing",
        row(0, 1, path=START_TO_PARK),
    ),
    "unknown visit held": ("visits", without(row(1, 1)), "schema", "no row of visits has this", row(1, 1, 2)),
    "unknown robot": ("legs", replaced(ONE, robot_id=9), "schema", "no row of robots has this", row(0, 0, 9)),
    "unknown target": ("allocations", replaced(row(0, 0, 1), target_id=99), "schema", "no row of targets", row(0, 0, 1)),
    "missing allocation": ("allocations", without(row(0, 1, 6)), "schema", "row is missing", row(0, 1, 6)),
    "missing robot time": (
        "robot_times",
        without(row(0, 1, 6, PARK_TO_TARGET)),
        "schema",
        "row is missing",
        row(0, 1, 6, PARK_TO_TARGET),
    ),
    "visit in no part": ("allocations", without({"tile_id": 1}), "schema", "row is missing", row(1, 0, 1)),
    "target of no tile": (
        "targets",
        replaced({"target_id": 0}, tile_id=7),
        "schema",
        "no row of tiles has this",
        {"tile_id": 7},
    ),
    "science wants nothing": (
        "targets",
        replaced({"target_id": 1}, wanted_visits=0),
        "schema",
        "science target 1 wants no visit",
        {},
    ),
    "exposure of no visit": ("exposures", replaced({"exposure_id": 0}, visit_id=5), "schema", "no row of visits", row(0, 5)),
    "exposure in no night": ("nights", without({"night": 1}), "schema", "no row of nights has this", row(1, 1)),
    "status of no target": (
        "target_status",
        replaced({"target_id": 1}, target_id=4),
        "schema",
        "no row of targets (science)",
        {},
    ),
    "target without status": ("target_status", without({"target_id": 1}), "schema", "no row of target_status", {}),
    # starts
    "start is elsewhere": (
        "allocations",
        replaced(row(0, 0, 3), x_mm=pl.col("x_mm") + 1e-4),
        "starts",
        "the leg, begun at where the last visit or park left it, does not end at x_mm",
        row(0, 1, 3, START_TO_TARGET),
    ),
    "start of the way to park": (
        "allocations",
        replaced(row(0, 0, 3), x_mm=pl.col("x_mm") + 1e-4),
        "starts",
        "the leg, begun at where the last visit or park left it, does not end at x_mm",
        row(0, 1, 3, START_TO_PARK),
    ),
    "park is elsewhere": (
        "robots",
        replaced({"robot_id": 3}, park_x_mm=1e-4),
        "starts",
        "the leg, begun at where the last visit or park left it, does not end at x_mm",
        row(1, 1, 3, PARK_TO_TARGET),
    ),
    "visit starts from park": (
        "visits",
        replaced(row(0, 1), start="park"),
        "starts",
        "the leg, begun at where the last visit or park left it, does not end at x_mm",
        row(0, 1, 3, START_TO_TARGET),
    ),
    "theta is another": (
        "legs",
        replaced(row(0, 0, 3, START_TO_TARGET), theta_deg=pl.col("theta_deg") + 90, dx_mm=0.0, dy_mm=0.0),
        "starts",
        "the leg, begun at where the last visit or park left it, does not end at theta_deg",
        row(0, 1, 3, START_TO_TARGET),
    ),
    # legs
    "leg ends elsewhere": (
        "legs",
        replaced(WAY | {"leg": 1}, y_mm=pl.col("y_mm") + 1e-4),
        "legs",
        "the leg, begun at the last leg, does not end at x_mm",
        WAY,
    ),
    "leg ends turned": (
        "legs",
        replaced(WAY | {"leg": 1}, rotate_deg=pl.col("rotate_deg") + 1e-4),
        "legs",
        "the leg, begun at the last leg, does not end at theta_deg",
        WAY,
    ),
    "leg number missing": ("legs", replaced(WAY | {"leg": 1}, leg=2), "legs", "legs are not counted from 0", WAY),
    "leg starts early": (
        "legs",
        replaced(WAY | {"leg": 1}, start_s=pl.col("start_s") - 0.51),
        "legs",
        "leg starts before the robot's last one ends",
        WAY,
    ),
    "turns too far": (
        "legs",
        replaced(ONE, rotate_deg=pl.col("rotate_deg") + 90, theta_deg=pl.col("theta_deg") + 90),
        "legs",
        "turns further",
        ONE,
    ),
    "turns and goes along both": (
        "legs",
        replaced(ONE, dx_mm=1.0, dy_mm=1.0),
        "legs",
        "turns and goes along both axes",
        ONE,
    ),
    "does nothing": ("legs", replaced(ONE, rotate_deg=0.0, dx_mm=0.0, dy_mm=0.0), "legs", "neither turns nor goes", ONE),
    "theta above": ("legs", replaced(ONE, theta_deg=180.0), "legs", "theta_deg is outside", ONE),
    "theta below": ("legs", replaced(ONE, theta_deg=-180.5), "legs", "theta_deg is outside", ONE),
    "no precise approach": ("legs", replaced(ONE, precise_mm=0.0), "legs", "precise_mm is not", ONE),
    "precise on the way": ("legs", replaced(WAY | LEG, precise_mm=0.02), "legs", "precise_mm is not", WAY),
    # ends
    "dead robot moves": (
        "legs",
        lambda t: pl.concat([t, t.head(1).with_columns(robot_id=pl.lit(6, pl.Int32))]),
        "ends",
        "a dead robot moves",
        row(0, 0, 6),
    ),
    "unrouted robot moves": ("robot_times", replaced(ONE, reason="no-path"), "ends", "an unrouted robot moves", ONE),
    "ends off its allocation": (
        "allocations",
        replaced(row(0, 1, 3), x_mm=pl.col("x_mm") + 1e-5),
        "ends",
        "path ends away from where it should",
        row(0, 1, 3, START_TO_TARGET),
    ),
    "ends off its allocation from park": (
        "allocations",
        replaced(row(0, 1, 3), x_mm=pl.col("x_mm") + 1e-5),
        "ends",
        "path ends away from where it should",
        row(0, 1, 3, PARK_TO_TARGET),
    ),
    "ends off park": (
        "legs",
        without(row(0, 1, 3, START_TO_PARK)),
        "ends",
        "path ends away from where it should",
        row(0, 1, 3, START_TO_PARK),
    ),
    "dead robot is elsewhere": (
        "allocations",
        replaced(row(0, 0, 6), x_mm=50.0),
        "ends",
        "path ends away from where it should",
        row(0, 0, 6),
    ),
    "unrouted robot is elsewhere": (
        "allocations",
        replaced(row(1, 1, 4), x_mm=41.0),
        "ends",
        "an unrouted robot is said to end away",
        row(1, 1, 4),
    ),
    "unrouted robot holds a target": (
        "allocations",
        replaced(row(1, 1, 4), target_id=10, kind="standard"),
        "ends",
        "an unrouted robot holds a target",
        row(1, 1, 4),
    ),
    # reach
    "rests out of patrol": (
        "robots",
        replaced({"robot_id": 3}, patrol_radius_mm=9.0),
        "reach",
        "resting place outside the patrol disc",
        row(0, 0, 3),
    ),
    "leg ends out of patrol": (
        "robots",
        replaced({"robot_id": 3}, patrol_radius_mm=9.0),
        "reach",
        "end of leg outside the patrol disc",
        row(0, 0, 3, PARK_TO_TARGET),
    ),
    "corner out of patrol": (
        "robots",
        replaced({"robot_id": 2}, patrol_radius_mm=13.0),
        "reach",
        "corner of leg outside the patrol disc",
        row(0, 1, 2, START_TO_TARGET),
    ),
    # targets
    "kind without target": (
        "allocations",
        replaced(row(0, 1, 3), kind="sky"),
        "targets",
        "target_id and kind",
        row(0, 1, 3),
    ),
    "target without kind": ("allocations", replaced(row(0, 0, 3), kind=None), "targets", "target_id and kind", row(0, 0, 3)),
    "dead robot holds a target": (
        "allocations",
        replaced(row(0, 0, 6), target_id=1, kind="science"),
        "targets",
        "a dead robot holds a target",
        row(0, 0, 6),
    ),
    "another survey": (
        "targets",
        replaced({"target_id": 1}, survey="other"),
        "targets",
        "target 1 belongs to another survey",
        row(0, 0, 2),
    ),
    "another tile": (
        "targets",
        replaced({"target_id": 1}, tile_id=1),
        "targets",
        "target 1 belongs to another tile",
        row(0, 0, 2),
    ),
    "another kind": (
        "allocations",
        replaced(row(0, 0, 3), kind="standard"),
        "targets",
        "target 2 is of another kind",
        row(0, 0, 3),
    ),
    "guide robot on a galaxy": (
        "allocations",
        replaced(row(0, 0, 5), target_id=1),
        "targets",
        "target 1 is not for a robot of this kind",
        row(0, 0, 5),
    ),
    "science robot on a guide star": (
        "allocations",
        replaced(row(0, 0, 3), target_id=4),
        "targets",
        "target 4 is not for a robot of this kind",
        row(0, 0, 3),
    ),
    "held twice": (
        "allocations",
        replaced(row(0, 0, 4), target_id=1),
        "targets",
        "target 1 is held by several",
        row(0, 0, 2),
    ),
    "off its target": (
        "targets",
        replaced({"target_id": 2}, dec_deg=pl.col("dec_deg") + 1.2e-3 * hand_run.SCALE / 3600),
        "targets",
        "robot is not where target 2 projects",
        row(0, 0, 3),
    ),
    "held too often": (
        "allocations",
        replaced(row(0, 1, 1), target_id=1),
        "targets",
        "target 1 is held in more visits",
        {"value": 2.0, "limit": 1.0},
    ),
    "unallocated lacks a target": ("unallocated", without({"target_id": 0}), "targets", "target 0 is not listed", {}),
    "unallocated has too many": (
        "unallocated",
        lambda t: pl.concat([t, t.head(1).with_columns(target_id=pl.lit(1, pl.Int64))]),
        "targets",
        "target 1 wants no more visits",
        {},
    ),
    "unallocated miscounts": ("unallocated", replaced({"target_id": 0}, n_allocated=0), "targets", "n_allocated is not", {}),
    # executions
    "execution's times": (
        "executions",
        replaced(row(0, 0, path=START_TO_TARGET), metrology_time_s=9.0),
        "times",
        "configuration_time_s is not what it is when its parts are added up",
        row(0, 0, path=START_TO_TARGET),
    ),
    "execution of no path": (
        "executions",
        replaced(row(0, 0, path=START_TO_TARGET), visit_id=77),
        "schema",
        "no row of paths has this",
        {"table": "executions"},
    ),
    "execution's contacts": (
        "executions",
        replaced(row(0, 0, path=START_TO_TARGET), contacts=2),
        "separation",
        "more pairs in contact",
        {"value": 2.0, "limit": 1.0},
    ),
    # separation
    "too near at rest": (
        "robots",
        replaced({"robot_id": 6}, park_x_mm=hand_run.PARK[2][0] + 8.99),
        "separation",
        "robots nearer than the separation at 0.0 s",
        row(0, 0, 2, START_TO_PARK) | {"other_robot_id": 6},
    ),
    "least separation": (
        "paths",
        replaced(row(0, 0, path=START_TO_TARGET), min_separation_mm=pl.col("min_separation_mm") + 1e-5),
        "separation",
        "min_separation_mm is not",
        row(0, 0, path=START_TO_TARGET),
    ),
    "collisions of a path": (
        "paths",
        replaced(row(0, 0, path=START_TO_TARGET), collisions=1),
        "separation",
        "collisions is not",
        row(0, 0, path=START_TO_TARGET),
    ),
    # tiles
    "targets of a tile": (
        "tiles",
        replaced({"tile_id": 1}, n_target=9),
        "tiles",
        "n_target is not",
        {"tile_id": 1, "value": 9.0},
    ),
    # exposures
    "pointing left out": ("exposures", without({"exposure_id": 0}), "exposures", "exposure 1 is not counted", row(0, 1)),
    "nights in disorder": (
        "exposures",
        replaced({"exposure_id": 0}, night=1),
        "exposures",
        "exposure 1 is of an earlier",
        row(0, 1),
    ),
    "pointings overlap": (
        "exposures",
        replaced({"exposure_id": 0}, exposure_s=1729.0),  # 1728 s before exposure 2 opens
        "exposures",
        "exposure 2 begins before the last one ends",
        row(1, 0),
    ),
    "no time for the slew": (
        "exposures",
        replaced({"exposure_id": 3}, slew_s=800.0),
        "exposures",
        "exposure 3 begins before slew",
        row(1, 0),
    ),
    "time of another path": (
        "exposures",
        replaced({"exposure_id": 3}, configuration_time_s=1.0),
        "exposures",
        "configuration_time_s is not what it is when read from exposure_paths",
        {"exposure_id": 3},
    ),
    # exposure_paths, exposure_allocations, exposure_legs
    "path of no pointing": (
        "exposure_paths",
        replaced({"exposure_id": 4}, exposure_id=9),
        "schema",
        "no row of exposures",
        {"exposure_id": 9},
    ),
    "pointing without path": ("exposure_paths", without({"exposure_id": 4}), "schema", "row is missing", {"exposure_id": 4}),
    "robot missing at a pointing": (
        "exposure_allocations",
        without(at(4, 6)),
        "schema",
        "row is missing",
        at(4, 6),
    ),
    "unknown robot at a pointing": (
        "exposure_legs",
        replaced(at(4, 1), robot_id=9),
        "schema",
        "no row of robots",
        {"exposure_id": 4},
    ),
    "kind unknown at a pointing": (
        "exposure_allocations",
        replaced(at(4, 1), kind="star"),
        "schema",
        "kind 'star'",
        at(4, 1),
    ),
    "leg begun elsewhere than the last pointing ended": (
        "exposure_allocations",
        replaced(at(1, 4), x_mm=pl.col("x_mm") + 1.0),
        "starts",
        "the leg, begun at",
        at(2, 4),
    ),
    "leg of the night's first pointing not from park": (
        "exposure_legs",
        replaced(at(4, 1), dx_mm=pl.col("dx_mm") + 0.1),
        "starts",
        "the leg, begun at",
        at(4, 1),
    ),
    "theta of a robot at a pointing": (
        "exposure_allocations",
        replaced(at(3, 2), theta_deg=pl.col("theta_deg") + 1.0),
        "ends",
        "theta_deg is not that",
        at(3, 2),
    ),
    "robot of a pointing elsewhere than its legs lead": (
        "exposure_allocations",
        replaced(at(4, 1), y_mm=pl.col("y_mm") + 1e-4),
        "ends",
        "path ends away",
        at(4, 1),
    ),
    "dead robot moved at a pointing": (
        "exposure_allocations",
        replaced(at(4, 6), x_mm=49.0),
        "ends",
        "path ends away",
        at(4, 6),
    ),
    "out of reach at a pointing": (
        "exposure_allocations",
        replaced(at(4, 4), x_mm=80.0),
        "reach",
        "resting place outside the patrol disc",
        at(4, 4),
    ),
    "too near at rest at a pointing": (
        "exposure_allocations",
        replaced(at(0, 6), x_mm=30.0, y_mm=-1.0),
        "separation",
        "robots nearer than the separation",
        {"exposure_id": 1},
    ),
    "late leg of a pointing": (
        "exposure_legs",
        replaced(at(4, 5) | LEG, start_s=30.0),
        "times",
        "configuration_time_s is not",
        {"exposure_id": 4},
    ),
    "travel at a pointing": (
        "exposure_allocations",
        replaced(at(4, 1), travel_mm=1.0),
        "exposures",
        "travel_mm is not",
        at(4, 1),
    ),
    "target of another visit at a pointing": (
        "exposure_allocations",
        replaced(at(4, 1), target_id=8),
        "targets",
        "target 8 is not of the visit",
        at(4, 1),
    ),
    "robot beside its target at a pointing": (
        "exposure_allocations",
        replaced(at(4, 1), target_id=8),
        "targets",
        "robot is not where target 8",
        at(4, 1),
    ),
    "target let go at a pointing": (
        "exposure_allocations",
        replaced(at(2, 2), target_id=None, kind=None),
        "targets",
        "target 8 of the visit is neither held nor missed",
        {"exposure_id": 2},
    ),
    "target held twice at a pointing": (
        "exposure_allocations",
        replaced(at(4, 3), target_id=11, kind="science"),
        "targets",
        "target 11 stands for several",
        at(4, 3),
    ),
    "guide target with a science robot": (
        "exposure_allocations",
        replaced(at(4, 1), target_id=13, kind="guide"),
        "targets",
        "target 13 is not for a robot of this kind",
        at(4, 1),
    ),
    "missed for no reason": (
        "exposure_allocations",
        replaced(at(4, 2), reason=None),
        "ends",
        "a target is missed for no reason",
        at(4, 2),
    ),
    "held although not routed": (
        "exposure_allocations",
        replaced(at(4, 2), target_id=12, kind="science", missed_target_id=None),
        "ends",
        "an unrouted robot holds a target",
        at(4, 2),
    ),
    "observed although missed": (
        "target_status",
        replaced({"target_id": 12}, n_observed=1, first_night=1, last_night=1, reason=None),
        "target_status",
        "n_observed is not",
        {},
    ),
    # nights
    "exposure by day": (
        "nights",
        replaced({"night": 0}, evening_mjd=57400.42),
        "nights",
        "exposure 0 is outside its night",
        row(0, 0),
    ),
    "pointings miscounted": ("nights", replaced({"night": 0}, n_exposure=3), "nights", "n_exposure is not", {}),
    "exposing time": ("nights", replaced({"night": 0}, exposing_s=1200.0), "nights", "exposing_s is not", {}),
    "completeness of a programme": (
        "nights",
        replaced({"night": 0}, completeness_frac_case=0.9),
        "nights",
        "completeness_frac_case is not",
        {"value": 0.9},
    ),
    "programme left out": (
        "nights",
        lambda t: t.drop("completeness_frac_case"),
        "nights",
        "completeness_frac_case is absent",
        {},
    ),
    "overhead of a night": (
        "nights",
        replaced({"night": 0}, overhead_s=1.0),
        "nights",
        "overhead_s is not",
        {"value": 1.0},
    ),
    "more time than is clear": (
        "nights",
        replaced({"night": 1}, engineering_s=29_000.0),
        "nights",
        "more time is spent than is clear",
        {"value": 29_000.0},
    ),
    # time_budget, completeness
    "time of an activity": (
        "time_budget",
        replaced({"activity": "reading"}, time_s=pl.col("time_s") + 1.0),
        "time_budget",
        "time_s is not",
        {"survey": SURVEY},
    ),
    "idle time": (
        "time_budget",
        replaced({"activity": "idle"}, time_s=pl.col("time_s") - 1.0),
        "time_budget",
        "time_s is not",
        {"survey": None},
    ),
    "activity left out": (
        "time_budget",
        without({"activity": "weather"}),
        "time_budget",
        "row is missing: weather",
        {},
    ),
    "activity of nobody": (
        "time_budget",
        replaced({"activity": "slewing"}, activity="dining"),
        "time_budget",
        "a row for nothing: dining",
        {},
    ),
    "complete targets of a bin": (
        "completeness",
        replaced({"quantity": "priority"}, n_complete=1),
        "completeness",
        "n_complete of case, priority",
        {"value": 1.0},
    ),
    "targets of a bin": (
        "completeness",
        replaced({"quantity": "mag", "low": 10.0}, n_target=1),
        "completeness",
        "n_target of case, mag",
        {"value": 1.0},
    ),
    "share of a bin": (
        "completeness",
        replaced({"quantity": "all"}, completeness_frac=0.5),
        "completeness",
        "completeness_frac is not",
        {"value": 0.5},
    ),
    "edge of a bin": (
        "completeness",
        replaced({"quantity": "density"}, low=1.0, high=2.0),
        "completeness",
        "n_target of case, density",
        {},
    ),
    "bin left out": (
        "completeness",
        without({"quantity": "latitude", "low": 70.0}),
        "completeness",
        "bins of case, latitude do not",
        {},
    ),
    "complete by the end of a year": (
        "completeness",
        replaced({"quantity": "year"}, n_complete=1),
        "completeness",
        "n_complete of case, year",
        {"value": 1.0},
    ),
    # target_status
    "observed too often": (
        "target_status",
        replaced({"target_id": 1}, n_observed=2),
        "target_status",
        "n_observed",
        {"limit": 1.0},
    ),
    "first night": (
        "target_status",
        replaced({"target_id": 1}, first_night=1),
        "target_status",
        "first_night",
        {"value": 1.0},
    ),
    "last night": ("target_status", replaced({"target_id": 1}, last_night=1), "target_status", "last_night", {"value": 1.0}),
    "survey of a target": (
        "target_status",
        replaced({"target_id": 1}, survey="x"),
        "target_status",
        "survey is not",
        {"survey": "x"},
    ),
    "programme of a target": (
        "target_status",
        replaced({"target_id": 1}, programme="x"),
        "target_status",
        "programme is not",
        {},
    ),
    "reason for nothing": (
        "target_status",
        replaced({"target_id": 1}, reason="crowded"),
        "target_status",
        "target 1: a reason",
        {},
    ),
    "no reason": ("target_status", replaced({"target_id": 0}, reason=None), "target_status", "target 0: a reason", {}),
    "bound below completeness": (
        "visits",
        replaced(row(1, 1), completeness_bound_frac=0.5),
        "visits",
        "completeness above its proven bound",
        row(1, 1),
    ),
}


@pytest.mark.parametrize(("table", "change", "check", "detail", "where"), PLANTED.values(), ids=PLANTED)
def test_planted_fault_is_found(
    run_dir: Path, table: str, change: Callable[[pl.DataFrame], pl.DataFrame], check: str, detail: str, where: Where
) -> None:
    rewrite(run_dir, table, change)
    assert found(run_dir, check, detail, where)


_ONE_UP = {"n_science": 1, "n_standard": 1, "n_sky": 1, "n_guide": 1, "n_idle": 1, "crossings": 1, "collisions": 1}
_ONE_UP |= {f"{name}_shortfall": 1 for name in ("standard", "sky", "guide", "sky_region")}
_ONE_UP |= {"unrouted": 1, "ticks": 1, "completeness_frac": -0.1, "mag_bright": 0.1, "mag_faint": 0.1}
_ONE_UP |= dict.fromkeys(("travel_mean_mm", "travel_p95_mm", "travel_max_mm"), 1e-4)
_ONE_UP |= dict.fromkeys(("configuration_time_s", "configuration_time_p95_s", "lower_bound_s"), 1e-4)


@pytest.mark.parametrize(("column", "step"), _ONE_UP.items())
def test_every_figure_of_a_visit_is_checked(run_dir: Path, column: str, step: float) -> None:
    rewrite(run_dir, "visits", replaced(row(0, 1), **{column: pl.col(column) + step}))
    result = check_run(run_dir)
    assert result.n_faults == {"visits": 1}
    assert found(run_dir, "visits", f"{column} is not", row(0, 1))


_PATH_FIGURES = ("configuration_time_s", "configuration_time_p95_s", "configuration_time_median_s", "lower_bound_s")


@pytest.mark.parametrize("path", hand_run.PATHS)
@pytest.mark.parametrize("column", [*_PATH_FIGURES, "ticks", "unrouted"])
def test_every_time_of_a_path_is_checked(run_dir: Path, column: str, path: str) -> None:
    step = 1e-4 if column.endswith("_s") else 1
    rewrite(run_dir, "paths", replaced(row(1, 1, path=path), **{column: pl.col(column) + step}))
    assert found(run_dir, "times", f"{column} is not", row(1, 1, path=path))


@pytest.mark.parametrize("column", ["rotating_s", "moving_s", "waiting_s"])
def test_every_time_of_a_robot_is_checked(run_dir: Path, column: str) -> None:
    rewrite(run_dir, "robot_times", replaced(row(0, 1, 3, START_TO_PARK), **{column: pl.col(column) + 1e-4}))
    assert check_run(run_dir).n_faults == {"times": 1}
    assert found(run_dir, "times", f"{column} is not", row(0, 1, 3, START_TO_PARK))


def test_travel_is_checked(run_dir: Path) -> None:
    rewrite(run_dir, "allocations", replaced(row(0, 1, 3), travel_mm=pl.col("travel_mm") + 1e-5))
    assert found(run_dir, "visits", "travel_mm is not", row(0, 1, 3))


def test_robot_outside_the_plate_is_found(run_dir: Path) -> None:
    record = json.loads((run_dir / "run.json").read_text())
    record["instrument"]["plate_radius_mm"] = 49.0
    (run_dir / "run.json").write_text(json.dumps(record))
    # Robot 4 stands at (40, 30): 50 mm from the centre.
    for what in ("resting place", "end of leg"):
        assert found(run_dir, "reach", f"{what} outside the plate", row(1, 0, 4))


def test_moving_robots_too_near_are_found(run_dir: Path) -> None:
    """The nearest pair on the way, with the separation set about its distance."""
    record = json.loads((run_dir / "run.json").read_text())
    least = check_run(run_dir).least_separation_mm
    for limit, n in ((least - 1e-7, 0), (least + 0.5e-6, 0), (least + 2e-6, 1)):
        record["instrument"]["min_separation_mm"] = limit
        (run_dir / "run.json").write_text(json.dumps(record))
        rows = check_run(run_dir).faults.filter(check="separation").filter(pl.col("detail").str.contains("nearer"))
        assert rows.height == n


def test_part_missing_in_one_table(run_dir: Path) -> None:
    (run_dir / "legs" / f"{SURVEY}-00001.parquet").unlink()
    assert found(run_dir, "schema", f"part {SURVEY}-00001.parquet is missing", {"table": "legs"})
    assert found(run_dir, "schema", "no row of the parts", row(1, 0))


def test_tile_in_two_parts(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("survey_sim.check.inputs.GROUP_BYTES", 0)
    for table in ("allocations", "legs", "robot_times"):
        shutil.copy(run_dir / table / f"{SURVEY}-00001.parquet", run_dir / table / "again.parquet")
    assert found(run_dir, "schema", "tile is in more than one part", {"tile_id": 1})


def test_configuration_times_without_paths(run_dir: Path) -> None:
    (run_dir / "exposure_paths.parquet").unlink()
    assert found(run_dir, "exposures", "is absent, and configuration times are routed", {"table": "exposure_paths"})


_OPTIONAL = {"executions", "rejected", "unallocated", "exposures", "exposure_paths", "nights", "target_status"} | {
    "time_budget",
    "completeness",
}


@pytest.mark.parametrize("table", sorted(set(TABLES) - _OPTIONAL))
def test_absent_table_is_a_fault(run_dir: Path, table: str) -> None:
    for path in tables.files(run_dir, table):
        path.unlink()
    if TABLES[table].is_in_parts:
        (run_dir / table).rmdir()
    assert found(run_dir, "schema", f"{table}: no such table", {"table": table})


def test_unreadable_file_is_a_fault(run_dir: Path) -> None:
    path = run_dir / "legs" / f"{SURVEY}-00001.parquet"
    content = bytearray(path.read_bytes())
    path.write_bytes(content[: len(content) // 2])
    assert found(run_dir, "schema", "legs: is not a readable Parquet file", {"table": "legs"})
    content[4:-2000] = bytes(len(content) - 2004)
    path.write_bytes(content)
    assert not check_run(run_dir).is_passed


@pytest.mark.parametrize("content", ["", "{}", '{"instrument": {"plate_radius_mm": 1}}', '{"instrument": 3}'])
def test_run_without_instrument(run_dir: Path, content: str) -> None:
    (run_dir / "run.json").write_text(content)
    assert not check_run(run_dir).is_passed
    assert found(run_dir, "schema", "gives no instrument", {"table": "run.json"})


class TestStartPositions:
    """A single field may begin elsewhere than at park: anywhere legal, turned anyhow."""

    @staticmethod
    def set_start(run_dir: Path, position_mm: list, theta_deg: list) -> None:
        start = {"file": "positions.xml", "position_mm": position_mm, "theta_deg": theta_deg}
        hand_run.write_record(run_dir, start_positions=start)

    def test_legs_begin_there(self, tmp_path: Path) -> None:
        first = {robot: (x + 1.0, y - 2.0, 15.0 * robot) for robot, (x, y) in hand_run.PARK.items()}
        run_dir = write_run(tmp_path / "run", make_tables(first=first))
        assert not check_run(run_dir).is_passed
        self.set_start(run_dir, [list(state[:2]) for state in first.values()], [state[2] for state in first.values()])
        assert [str(fault) for fault in check_run(run_dir)] == []

    def test_out_of_reach(self, run_dir: Path) -> None:
        park = [list(place) for place in hand_run.PARK.values()]
        self.set_start(run_dir, [[0.0, -51.0], *park[1:]], [0.0] * 6)
        assert found(run_dir, "reach", "first position outside the patrol disc", row(0, 0, 1))
        # A dead robot is where it is.
        self.set_start(run_dir, [*park[:5], [-160.0, -160.0]], [0.0] * 6)
        assert "reach" not in check_run(run_dir).n_faults

    def test_wrong_number_of_robots(self, run_dir: Path) -> None:
        self.set_start(run_dir, [[0.0, 0.0]], [0.0])
        assert found(run_dir, "schema", "not as a run writes it: ValueError start_positions has 1", {"table": "run.json"})


@pytest.mark.parametrize(
    "more",
    [
        {"start_positions": 3},
        {"start_positions": {"position_mm": [["x"]], "theta_deg": [0]}},
        {"settings": []},
        {"settings": {"schedule": {"configuration_s": "soon"}}},
        {"settings": {"schedule": {"success_frac": {"case": "often"}}}},
    ],
)
def test_odd_run_json_is_a_fault(run_dir: Path, more: dict) -> None:
    (run_dir / "run.json").write_text(json.dumps({"instrument": hand_run.INSTRUMENT, **more}))
    assert found(run_dir, "schema", "not as a run writes it", {"table": "run.json"})


def test_no_run_at_all(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        check_run(tmp_path / "nothing")


def test_constant_configuration_time(run_dir: Path) -> None:
    settings = {"schedule": {"configuration_s": 300.0}}
    (run_dir / "run.json").write_text(
        json.dumps({"instrument": hand_run.INSTRUMENT, "settings": {**settings, "allocation": hand_run.MINIMA}})
    )
    assert check_run(run_dir).n_faults == {"exposures": 5}
    (run_dir / "time_budget.parquet").unlink()
    rewrite(run_dir, "exposures", replaced({}, configuration_time_s=300.0))
    assert check_run(run_dir).is_passed


class TestTargetsThatMayFail:
    """Observations bound what a target can have got."""

    @pytest.fixture
    def uncertain(self, run_dir: Path) -> Path:
        settings = {"schedule": {"success_frac": {"case": 0.8}}}
        (run_dir / "run.json").write_text(
            json.dumps({"instrument": hand_run.INSTRUMENT, "settings": {**settings, "allocation": hand_run.MINIMA}})
        )
        return run_dir

    @pytest.fixture
    def failed(self, uncertain: Path, made: dict[str, pl.DataFrame]) -> Path:
        """Target 3 failed in night 0."""
        lost = {"n_observed": 0, "first_night": None, "last_night": None, "reason": "failed"}
        rewrite(uncertain, "target_status", replaced({"target_id": 3}, **lost))
        (uncertain / "completeness.parquet").unlink()
        one = 1 / made["target_status"].height
        rewrite(uncertain, "nights", replaced({}, completeness_frac_case=pl.col("completeness_frac_case") - one))
        return uncertain

    def test_success_passes(self, uncertain: Path) -> None:
        assert check_run(uncertain).is_passed

    def test_failure_passes(self, failed: Path) -> None:
        assert [str(f) for f in check_run(failed)] == []

    @pytest.mark.parametrize(
        ("table", "change", "detail"),
        [
            ("target_status", replaced({"target_id": 1}, n_observed=3), "target 1 has more than was observed"),
            ("target_status", replaced({"target_id": 11}, first_night=0), "target 11 has more than was observed"),
            ("target_status", replaced({"target_id": 1}, last_night=1), "target 1 has more than was observed"),
            ("target_status", replaced({"target_id": 1}, first_night=None), "target 1 has more than was observed"),
            ("nights", replaced({}, completeness_frac_case=1.0), "completeness_frac_case is above"),
            ("nights", replaced({"night": 1}, completeness_frac_case=0.0), "completeness_frac_case falls"),
            ("nights", replaced({"night": 1}, completeness_frac_case=0.5), "completeness_frac_case does not end"),
        ],
    )
    def test_more_than_observed(
        self, failed: Path, table: str, change: Callable[[pl.DataFrame], pl.DataFrame], detail: str
    ) -> None:
        rewrite(failed, table, change)
        assert found(failed, table, detail, {})


def test_faults_are_bounded_and_counted(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faults, "MAX_ROWS", 3)
    rewrite(run_dir, "robot_times", lambda t: t.with_columns(pl.col("rotating_s") + 1))
    result = check_run(run_dir)
    assert result.n_faults == {"times": 72}
    assert result.faults.height == 3


def test_fault_reads_as_a_line(run_dir: Path) -> None:
    rewrite(run_dir, "legs", replaced(ONE, precise_mm=0.5))
    lines = [str(fault) for fault in check_run(run_dir)]
    wanted = "legs: precise_mm is not what it is when only the last leg ends with the precise approach"
    place = "(legs: survey hand, tile_id 0, visit_id 0, path start_to_target, robot_id 1, value 0.5, limit 0.02)"
    assert f"{wanted} {place}" in lines
