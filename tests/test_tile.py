"""One tile: what its visits hold, what is noted, and magnitude ranges."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from polars.testing import assert_frame_equal

from survey_sim.allocation import AllocationSettings, FieldTargets
from survey_sim.errors import InputError
from survey_sim.geometry import plate_to_sky
from survey_sim.instrument import load_instrument, make_plate
from survey_sim.motion import Legs
from survey_sim.routing import RoutingSettings
from survey_sim.simulation import SimulationSettings, execute
from survey_sim.survey import tile
from survey_sim.survey.tile import TileJob, magnitude_groups, simulate_tile, simulate_tiles, stream

CENTRE = (150.0, -30.0)
RANGES = ((5.0, 8.0), (7.0, 10.0), (9.0, 12.0))


def _job(n_science: int, **allocation: object) -> TileJob:
    """A tile of uniform targets, magnitudes 5 to 12."""
    rng = np.random.default_rng(3)
    n = n_science + 100
    radius, angle = 163.0 * np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    sky = plate_to_sky(np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]), CENTRE, 67.2)
    is_science = np.arange(n) < n_science
    targets = pl.DataFrame(
        {
            "target_id": np.arange(n),
            "kind": np.where(is_science, "science", "sky").tolist(),
            "programme": ["stars"] * n_science + [None] * 100,
            "ra_deg": sky[:, 0],
            "dec_deg": sky[:, 1],
            "mag": (5.0 + 7.0 * np.sqrt(rng.random(n))).tolist(),
            "priority": 5,
            "wanted_visits": is_science.astype(int),
        }
    )
    targets = targets.with_columns(mag=pl.when(pl.col("kind") == "science").then("mag"))
    return TileJob(
        survey="stars",
        tile_id=4,
        centre_deg=CENTRE,
        targets=targets,
        wanted_frac={"stars": 0.9},
        plate=make_plate(load_instrument("taipan-150")),
        allocation=AllocationSettings.load({"algorithm": "matching", **allocation}),
        routing=RoutingSettings(router="simple-vector"),
        seed=1,
    )


def test_a_visit_holds_one_magnitude_range() -> None:
    made = simulate_tile(_job(400, mag_ranges=RANGES))
    visits = made["visits"]
    is_in_one = [
        any(low <= bright and faint < high for low, high in RANGES)
        for bright, faint in visits.select("mag_bright", "mag_faint").iter_rows()
    ]
    assert all(is_in_one)
    assert visits["mag_bright"].max() >= 9.0
    assert visits["completeness_frac"].is_sorted()
    assert visits["completeness_frac"][-1] >= 0.88
    assert visits["visit_id"].to_list() == list(range(len(visits)))


def test_overlapping_targets_fill_earlier_ranges_and_are_completed_by_the_last() -> None:
    mag = np.array([4.0, 6.0, 7.5, 8.5, 9.5, 11.0, 13.0, np.nan])
    n = len(mag)
    field = FieldTargets.from_table(
        pl.DataFrame({"target_id": np.arange(n), "x_mm": np.arange(n) * 20.0, "y_mm": 0.0, "mag": mag, "priority": 7})
    )
    groups = list(magnitude_groups(field, RANGES))
    assert [chosen.tolist() for chosen, _ in groups] == [[0, 1, 2, 7], [2, 3, 4, 7], [4, 5, 6, 7]]
    is_filler = [(targets.programme < 0).tolist() for _, targets in groups]
    assert is_filler == [[False, False, True, True], [False, False, True, True], [False] * 4]
    assert groups[0][1].priority.tolist() == [7, 7, 1, 1]


def test_without_ranges_there_is_one_group() -> None:
    field = FieldTargets.from_table(pl.DataFrame({"target_id": [1], "x_mm": [0.0], "y_mm": [0.0]}))
    assert [chosen.tolist() for chosen, _ in magnitude_groups(field, ())] == [[0]]


@pytest.mark.parametrize("ranges", [[[8.0, 5.0]], [[5.0, 8.0], [8.5, 10.0]], [[5.0, 8.0], [4.0, 10.0]]])
def test_ranges_that_leave_a_gap_are_refused(ranges: list) -> None:
    with pytest.raises(InputError, match="mag_ranges"):
        AllocationSettings.load({"mag_ranges": ranges})


def test_tiles_together_have_the_rows_of_each() -> None:
    jobs = [_job(120), replace(_job(90), tile_id=7)]
    together, each = simulate_tiles(jobs), [simulate_tile(job) for job in jobs]
    for table, frame in together.items():
        assert_frame_equal(frame, pl.concat([made[table] for made in each]))


@pytest.mark.parametrize("bound", ["fast", "linear"])
def test_the_bound_stands_beside_every_visit_and_holds(bound: str) -> None:
    visits = simulate_tile(_job(200, bound=bound))["visits"]
    assert (visits["completeness_frac"] <= visits["completeness_bound_frac"] + 1e-12).all()
    assert simulate_tile(_job(20, bound="none"))["visits"]["completeness_bound_frac"].is_null().all()


def test_a_tile_without_targets_has_no_visit() -> None:
    job = _job(10)
    empty = replace(job, targets=job.targets.filter(pl.col("kind") == "sky"))
    assert all(frame.is_empty() for frame in simulate_tile(empty).values())


def test_every_lost_target_has_a_reason() -> None:
    made = simulate_tile(_job(300, visits=1))
    n_observed = made["visits"]["n_science"].sum()
    assert len(made["unallocated"]) == 300 - n_observed
    assert "none" not in made["unallocated"]["reason"].to_list()


def test_random_streams_differ_by_every_key() -> None:
    keys = [(1, "a", "b", 0), (2, "a", "b", 0), (1, "c", "b", 0), (1, "a", "d", 0), (1, "a", "b", 1), (1, "a", "b")]
    draws = [stream(seed, stage, *rest).integers(2**62) for seed, stage, *rest in keys]
    assert len(set(draws)) == len(keys)
    assert stream(1, "a", "b", 0).integers(2**62) == draws[0]


def test_paths_are_played_with_errors_if_there_are_any() -> None:
    """A row a path, as `execute` gives it from the same stream; without errors there are none, and nothing else differs."""
    job = _job(100, visits=2)
    errors = SimulationSettings(leg_speed_scatter_frac=0.05, slip_deg=0.5, mode="resync")
    plain, made = simulate_tile(job), simulate_tile(replace(job, simulation=errors))
    assert plain["executions"].is_empty()
    assert all(plain[name].equals(made[name]) for name in plain if name != "executions")
    executions = made["executions"]
    assert executions.select("visit_id", "path").equals(made["paths"].select("visit_id", "path"))
    assert set(executions["mode"]) == {"resync"}
    legs = made["legs"].filter(visit_id=0, path="start_to_target")
    robot = (legs["robot_id"] - 1).cast(pl.Int32).to_numpy()
    columns = ("leg", "start_s", "rotate_deg", "dx_mm", "dy_mm", "precise_mm", "x_mm", "y_mm", "theta_deg")
    routed = Legs(robot, *(legs[name].to_numpy() for name in columns))
    rng = stream(job.seed, "simulation", job.survey, job.tile_id, 0, "start_to_target")
    done = execute(job.plate, job.plate.park_mm, routed, errors, rng)
    row = executions.row(0, named=True)
    assert row["path"] == "start_to_target"
    for name in ("moving_time_s", "metrology_rounds", "configuration_time_s", "min_separation_mm", "contacts"):
        assert row[name] == getattr(done, name)
    assert row["error_max_um"] == done.error_um.max()
    assert row["moving_time_s"] != made["paths"]["configuration_time_s"][0]


@pytest.mark.parametrize(("algorithm", "n_science"), [("matching", 450), ("plan", 150)])
def test_robots_that_hold_a_path_up_exchange_targets(
    algorithm: str, n_science: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same targets in the first visit, as many in all; fewer paths above the bound."""
    job = replace(_job(n_science, algorithm=algorithm, visits=3), routing=RoutingSettings())
    jobs = [replace(job, seed=k, centre_deg=(CENTRE[0] + 0.3 * k, CENTRE[1])) for k in range(4)]
    settled = [simulate_tile(job) for job in jobs]
    monkeypatch.setattr(tile, "N_EXCHANGE", 0)
    plain = [simulate_tile(job) for job in jobs]
    for made in zip(settled, plain, strict=True):
        first, other = (set(one["allocations"].filter(visit_id=0)["target_id"].drop_nulls()) for one in made)
        assert first == other
        assert made[0]["visits"]["n_science"].to_list() == made[1]["visits"]["n_science"].to_list()
    paths = [pl.concat([made["paths"] for made in some]) for some in (settled, plain)]
    above = [(some["configuration_time_s"] > some["lower_bound_s"] * (1 + 1e-9)).sum() for some in paths]
    assert above[0] < above[1]


def _ring_job(*places: tuple[float, float], algorithm: str) -> TileJob:
    """Robot 1 in a ring of six dead ones, robot 8 free; targets at these places, mm."""
    ring = [(10.0 * np.cos(turn), 10.0 * np.sin(turn)) for turn in np.arange(6) * np.pi / 3]
    plate = make_plate(load_instrument("paper", {"park_positions_mm": [(0.0, 0.0), *ring, (40.0, 0.0)]}), range(2, 8))
    sky = plate_to_sky(np.array(places), CENTRE, 67.2)
    job = _job(len(places), algorithm=algorithm)
    targets = job.targets.filter(kind="science").with_columns(ra_deg=pl.Series(sky[:, 0]), dec_deg=pl.Series(sky[:, 1]))
    return replace(job, targets=targets, plate=plate, wanted_frac={"stars": 1.0}, routing=RoutingSettings())


@pytest.mark.parametrize("algorithm", ["matching", "plan"])
def test_a_target_that_its_robot_cannot_reach_is_given_to_another(algorithm: str) -> None:
    """The target is nearer to the robot in the ring; the other gets it, in the same visit."""
    made = simulate_tile(_ring_job((19.6, 0.0), algorithm=algorithm))
    assert made["visits"]["n_science"].to_list() == [1]
    assert made["visits"]["unrouted"].to_list() == [0]
    held = made["allocations"].drop_nulls("target_id")
    assert held.select("visit_id", "robot_id").rows() == [(0, 8)]
    assert made["unallocated"].is_empty()


@pytest.mark.parametrize("algorithm", ["matching", "plan"])
def test_a_target_that_was_not_reached_is_given_to_another_later(algorithm: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without exchanges the other robot gets it at the next visit."""
    monkeypatch.setattr(tile, "N_EXCHANGE", 0)
    made = simulate_tile(_ring_job((19.6, 0.0), algorithm=algorithm))
    assert made["visits"]["n_science"].to_list() == [0, 1]
    assert made["visits"]["unrouted"].to_list() == [1, 0]
    failed = made["robot_times"].filter(pl.col("reason").is_not_null(), path="start_to_target")
    assert failed.select("visit_id", "robot_id", "reason").rows() == [(0, 1, "unreachable")]
    held = made["allocations"].drop_nulls("target_id")
    assert held.select("visit_id", "robot_id").rows() == [(1, 8)]
    assert made["unallocated"].is_empty()


@pytest.mark.parametrize("algorithm", ["matching", "plan"])
def test_a_target_that_only_a_robot_in_the_ring_has_in_reach_is_unrouted(algorithm: str) -> None:
    made = simulate_tile(_ring_job((-30.0, 0.0), (60.0, 0.0), algorithm=algorithm))
    assert made["unallocated"].select("target_id", "reason").rows() == [(0, "unrouted")]
    assert made["visits"]["completeness_frac"].to_list()[-1] == 0.5
