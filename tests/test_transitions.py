"""Real transitions: targets matched again, chains routed and kept, tables of what the plate did."""

from dataclasses import replace
from math import dist

import numpy as np
import polars as pl
import pytest

from survey_sim.allocation import match_again, rematch, resting_places
from survey_sim.allocation.resting import has_room
from survey_sim.instrument import load_instrument, make_plate
from survey_sim.motion import alone
from survey_sim.routing import RoutingSettings, route
from survey_sim.survey.tile import State, stream
from survey_sim.survey.transitions import Configurations, PlateRobots, Ways, chains
from survey_sim.survey.workers import Workers
from tests import naive_transitions
from tests.fields import random_field

N_SCIENCE = 5
DEAD = 2
SEPARATION = 9.0


@pytest.fixture(autouse=True)
def _without_exchanges(monkeypatch):
    """Each pointing as it is matched, but for the tests of exchanges."""
    monkeypatch.setattr(chains, "N_EXCHANGE", 0)


@pytest.fixture(scope="module")
def plate():
    """Five science robots, one of them dead, and two guides."""
    plate = make_plate(load_instrument("taipan-150", {"n_science": N_SCIENCE}), dead=(DEAD,))
    keep = np.r_[0:N_SCIENCE, N_SCIENCE : N_SCIENCE + 2]
    columns = ("robot_id", "is_guide", "is_live", "park_mm", "patrol_radius_mm")
    return replace(plate, **{name: getattr(plate, name)[keep] for name in columns})


def legal_places(plate, rng):
    """A place for each robot, in its disc and apart from all others; the dead one's park."""
    while True:
        radius = plate.patrol_radius_mm * np.sqrt(rng.random(plate.n_robot))
        angle = rng.uniform(0.0, 2.0 * np.pi, plate.n_robot)
        place = plate.park_mm + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        place[~plate.is_live] = plate.park_mm[~plate.is_live]
        on_plate = np.hypot(*place.T) <= plate.instrument.plate_radius_mm
        apart = min(dist(place[i], place[j]) for i in range(len(place)) for j in range(i))
        if apart >= SEPARATION and on_plate.all():
            return place


def random_configurations(plate, rng, n_visit=6):
    """Visits of made-up surveys; some robots idle."""
    end_mm = np.array([legal_places(plate, rng) for _ in range(n_visit)])
    has_target = (rng.random((n_visit, plate.n_robot)) < 0.8) & plate.is_live
    target_id = np.where(has_target, np.arange(n_visit * plate.n_robot).reshape(n_visit, -1), -1)
    science, guide = chains.TARGET_KINDS.index("science"), chains.TARGET_KINDS.index("guide")
    kind = np.where(has_target, np.where(plate.is_guide, guide, science), -1).astype(np.int8)
    keys = pl.DataFrame({"survey": ["a"] * 3 + ["b"] * 3, "tile_id": [0, 0, 1, 0, 1, 1], "visit_id": [0, 1, 0, 0, 0, 1]})
    return Configurations(keys, target_id, kind, end_mm, {"a": 4.0, "b": 2.0})


@pytest.mark.parametrize("seed", range(25))
def test_matching_again_is_the_least_of_all_ways(plate, seed):
    rng = np.random.default_rng(seed)
    start, end = legal_places(plate, rng), legal_places(plate, rng)
    has_target = (rng.random(plate.n_robot) < 0.7) & plate.is_live
    giver, goal = match_again(plate, start, end, has_target, 4.0)
    assert sorted(giver[giver >= 0]) == np.flatnonzero(has_target).tolist()
    assert giver[~plate.is_live].tolist() == [-1]
    assert (goal[giver >= 0] == end[giver[giver >= 0]]).all()
    live = np.flatnonzero(plate.is_live)
    holders = np.flatnonzero(has_target)
    may_hold = [
        [
            place
            for place, robot in enumerate(live)
            if plate.is_guide[robot] == plate.is_guide[holder]
            and dist(end[holder], plate.park_mm[robot]) <= plate.patrol_radius_mm[robot]
        ]
        for holder in holders
    ]
    least = naive_transitions.least_cost(start[live].tolist(), end[holders].tolist(), may_hold, 4.0)
    cost = sum(dist(start[robot], goal[robot]) ** 4.0 for robot in np.flatnonzero(giver >= 0))
    assert cost == pytest.approx(least, rel=1e-12)
    assert min(dist(goal[i], goal[j]) for i in range(len(goal)) for j in range(i)) >= SEPARATION - 1e-6
    assert (np.hypot(*(goal - plate.park_mm).T) <= plate.patrol_radius_mm + 1e-6).all()
    assert (goal[~plate.is_live] == start[~plate.is_live]).all()


def test_robots_that_stand_right_stay(plate):
    end = legal_places(plate, np.random.default_rng(3))
    has_target = plate.is_live.copy()
    giver, goal = match_again(plate, end, end, has_target, 4.0)
    assert giver[plate.is_live].tolist() == np.flatnonzero(plate.is_live).tolist()
    assert (goal == end).all()


def test_without_room_for_the_idle_the_visits_own_allocation_is_kept(plate, monkeypatch):
    rng = np.random.default_rng(4)
    start, end = legal_places(plate, rng), legal_places(plate, rng)
    monkeypatch.setattr(rematch, "place_idle", lambda *_: 0)
    giver, goal = match_again(plate, start, end, plate.is_live & ~plate.is_guide, 4.0)
    assert giver.tolist() == [i if plate.is_live[i] and not plate.is_guide[i] else -1 for i in range(plate.n_robot)]
    assert (goal == end).all()


def told_one_by_one(plate, configurations, visits, routing, seed):
    """States and times of a night, step by step from park."""
    position, theta, told = plate.park_mm, np.zeros(plate.n_robot), []
    for visit in visits:
        goal = configurations.goal(visit)
        _, goal_mm = match_again(plate, position, goal.end_mm, goal.target_id >= 0, goal.travel_power)
        routed = route(plate, position, theta, goal_mm, routing, stream(seed, "transition", *goal.visit))
        position, theta = routed.end_mm, routed.end_theta_deg
        told.append((position, theta, routed.configuration_time_s))
    return told


def make_robots(plate, configurations, folder, router="coordinated"):
    return PlateRobots(
        configurations=configurations,
        plate=plate,
        routing=RoutingSettings.load({"router": router}),
        seed=5,
        fixed="all else",
        ways=Ways(folder),
        workers=Workers(),
        on_accept=lambda nights, pointings: None,
    )


def observe(robots, visits, *, is_exact=False, free_s=np.inf):
    """A night of these visits, the times that are told taken as 7 s where they are not known and cost nothing."""
    chain = robots.begin_night(is_exact=is_exact)
    times = []
    for visit in visits:
        times.append(chain.configure(visit, 7.0, free_s).time_s)
        chain.go(visit)
    return chain, times


def prepare(robots, nights):
    for _ in robots.prepare(nights):
        pass


NIGHTS = [(0, 1, 1, 3), (2,), (0, 1, 4)]


@pytest.mark.parametrize("free_s", [np.inf, 0.0])
def test_chains_are_those_of_a_plain_loop(plate, tmp_path, free_s):
    configurations = random_configurations(plate, np.random.default_rng(8))
    robots = make_robots(plate, configurations, tmp_path)
    thought = [observe(robots, visits, free_s=free_s) for visits in NIGHTS]
    assert all((times == [7.0] * len(times)) == (free_s > 0.0) for _, times in thought)
    assert not any(chain.is_known for chain, _ in thought)
    prepare(robots, [chain for chain, _ in thought])
    assert all(chain.is_known for chain, _ in thought)
    for visits in NIGHTS:
        chain, times = observe(robots, visits)
        told = told_one_by_one(plate, configurations, visits, robots.routing, robots.seed)
        assert chain.is_known
        assert times == [time_s for _, _, time_s in told]
        for key, (position, theta, _) in zip(chain.keys, told, strict=True):
            state = robots.state_after(key)
            assert (state.position_mm == position).all()
            assert (state.theta_deg == theta).all()
    # The same visit again: nobody moves.
    assert observe(robots, NIGHTS[0])[1][2] == 0.0


def test_estimates_that_matter_are_the_time_of_robots_that_nobody_disturbs(plate, tmp_path):
    """Asked for from the start, and after pointings for which the usual time was enough."""
    configurations = random_configurations(plate, np.random.default_rng(8))
    robots = make_robots(plate, configurations, tmp_path)
    visits = (0, 3, 5)
    position, theta, expected = plate.park_mm, np.zeros(plate.n_robot), []
    for visit in visits:
        goal = configurations.goal(visit)
        _, goal_mm = match_again(plate, position, goal.end_mm, goal.target_id >= 0, goal.travel_power)
        alone_s, theta = alone(plate.instrument, position, theta, goal_mm)
        position = goal_mm
        expected.append(alone_s.max())
    chain, times = observe(robots, visits, free_s=0.0)
    assert times == expected
    assert [match is not None for match in chain.job().matches] == [True] * 3
    late, _ = observe(robots, visits[:2])
    assert [match is not None for match in late.job().matches] == [False] * 2
    assert late.configure(visits[2], 7.0, 10.4).time_s == expected[2]
    assert [match is not None for match in late.job().matches] == [True] * 2
    assert late.configure(visits[2], 7.0, 10.5).time_s == 7.0


def test_a_match_made_for_robots_that_stand_elsewhere_is_made_again(plate):
    """The first step ends other than was thought; what was thought of the second is void, and changes nothing."""
    configurations = random_configurations(plate, np.random.default_rng(9))
    goals = tuple(configurations.goal(visit) for visit in (0, 3))
    start = State(plate.park_mm, np.zeros(plate.n_robot))
    first = chains.Match.of(plate, goals[0], start)
    elsewhere = State(plate.park_mm[:, ::-1].copy(), np.zeros(plate.n_robot))
    wrong = chains.Match(np.full(plate.n_robot, -1), elsewhere.position_mm)

    def states(matches):
        job = chains.ChainJob(start, ("a", "b"), goals, matches)
        rows = chains.route_chains(chains.ChainBatch((job,), plate, RoutingSettings(), 1)).frames["exposure_allocations"]
        return rows.drop("theta_deg")

    right = states((None, None))
    assert states((first, None)).equals(right)
    assert states((first, chains.Match.of(plate, goals[1], State(first.goal_mm, start.theta_deg)))).equals(right)
    stays = chains.Match(np.full(plate.n_robot, -1), plate.park_mm)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(chains, "route_at_bound", lambda *args: route(*args[:3], plate.park_mm, *args[4:]))
        assert states((first, wrong)).filter(exposure_id=1).equals(states((stays, None)).filter(exposure_id=1))


def test_what_is_not_known_is_routed_at_once_if_it_must_be(plate, tmp_path):
    configurations = random_configurations(plate, np.random.default_rng(9))
    robots = make_robots(plate, configurations, tmp_path)
    chain, times = observe(robots, (0, 3, 5), is_exact=True)
    assert chain.is_known
    told = told_one_by_one(plate, configurations, (0, 3, 5), robots.routing, robots.seed)
    assert times == [time_s for _, _, time_s in told]
    assert not list(tmp_path.glob("*.zip"))
    robots.accept(chain)
    assert len(list(tmp_path.glob("*.zip"))) == 1
    for known in (robots, make_robots(plate, configurations, tmp_path)):
        again, times_again = observe(known, (0, 3, 5))
        assert again.is_known
        assert times_again == times
        for key, (position, theta, _) in zip(again.keys, told, strict=True):
            state = known.state_after(key)
            assert (state.position_mm == position).all()
            assert (state.theta_deg == theta).all()


def test_ways_are_kept_and_only_new_ones_routed(plate, tmp_path, monkeypatch):
    configurations = random_configurations(plate, np.random.default_rng(10))
    robots = make_robots(plate, configurations, tmp_path)
    prepare(robots, [observe(robots, (0, 1, 3))[0]])
    done = []
    real = chains.route_chains
    monkeypatch.setattr(
        "survey_sim.survey.transitions.robots.route_chains",
        lambda batch: (done.extend([goal.visit for job in batch.jobs for goal in job.goals]), real(batch))[1],
    )
    again = make_robots(plate, configurations, tmp_path)
    chain, _ = observe(again, (0, 1, 4))
    prepare(again, [chain])
    assert done == [("b", 1, 0)]
    assert observe(again, (0, 1, 4))[0].is_known
    told = told_one_by_one(plate, configurations, (0, 1, 4), again.routing, again.seed)
    assert (again.state_after(chain.keys[-1]).position_mm == told[-1][0]).all()


def test_another_seed_or_visit_is_another_way(plate, tmp_path):
    configurations = random_configurations(plate, np.random.default_rng(11))
    robots = make_robots(plate, configurations, tmp_path)
    key = robots.key("from here", 0)
    moved = replace(configurations, end_mm=configurations.end_mm + 1e-9)
    assert make_robots(plate, moved, tmp_path).key("from here", 0) != key
    assert robots.key("from there", 0) != key
    assert make_robots(plate, configurations, tmp_path).key("from here", 0) == key


@pytest.mark.parametrize(
    "spoil", [lambda path: path.write_bytes(path.read_bytes()[:-50]), lambda path: path.write_bytes(b"")]
)
def test_damaged_file_of_ways_is_forgotten(plate, tmp_path, spoil):
    configurations = random_configurations(plate, np.random.default_rng(12))
    robots = make_robots(plate, configurations, tmp_path)
    prepare(robots, [observe(robots, (0, 1))[0]])
    (path,) = tmp_path.glob("*.zip")
    spoil(path)
    assert not Ways(tmp_path).steps
    assert not path.exists()


def test_files_without_a_wanted_way_are_removed(plate, tmp_path):
    configurations = random_configurations(plate, np.random.default_rng(13))
    robots = make_robots(plate, configurations, tmp_path)
    wanted, _ = observe(robots, (0, 1), is_exact=True)
    robots.accept(wanted)
    robots.accept(observe(robots, (3,), is_exact=True)[0])
    robots.ways.prune(set(wanted.keys))
    kept = Ways(tmp_path).steps
    assert set(kept) == set(wanted.keys)


def test_robots_that_are_not_routed_lose_their_targets(plate, tmp_path):
    """Two robots that change places: straight lines cannot do it, and the guides stand aside."""
    end = plate.park_mm.copy()
    a, b = (robot for robot in np.flatnonzero(plate.is_live & ~plate.is_guide)[:2])
    start = State(plate.park_mm.copy(), np.zeros(plate.n_robot))
    middle = (plate.park_mm[a] + plate.park_mm[b]) / 2.0
    along = (plate.park_mm[b] - plate.park_mm[a]) / np.hypot(*(plate.park_mm[b] - plate.park_mm[a]))
    start.position_mm[a], start.position_mm[b] = middle - 6.0 * along, middle + 6.0 * along
    end[a], end[b] = start.position_mm[b], start.position_mm[a]
    has_target = np.isin(np.arange(plate.n_robot), (a, b))
    goal = chains.Goal(
        ("a", 0, 0),
        np.where(has_target, np.arange(plate.n_robot), -1),
        np.where(has_target, 0, -1).astype(np.int8),
        end,
        4.0,
    )
    swapped = chains.ChainBatch(
        (chains.ChainJob(start, ("key",), (goal,), (None,)),), plate, RoutingSettings.load({"router": "simple-vector"}), 1
    )
    with pytest.MonkeyPatch.context() as patch:
        own = np.where(has_target, np.arange(plate.n_robot), -1)
        patch.setattr(chains, "match_again", lambda *_: (own, end))
        result = chains.route_chains(swapped)
    rows = result.frames["exposure_allocations"]
    lost = rows.filter(pl.col("reason").is_not_null())
    assert len(lost)
    assert lost["target_id"].null_count() == len(lost)
    assert set(lost["missed_target_id"]) <= {a, b}
    assert result.steps["lost"][0].to_list() == sorted(lost["missed_target_id"])
    stayed = {robot - 1: (x, y) for robot, x, y in lost.select("robot_id", "x_mm", "y_mm").iter_rows()}
    assert all(tuple(start.position_mm[robot]) == place for robot, place in stayed.items())
    assert result.frames["exposure_paths"]["unrouted"].to_list() == [len(lost)]


def test_robots_that_hold_a_pointing_up_exchange_targets(monkeypatch):
    """Every target of the visit held by a robot that may; more pointings at the bound."""
    plate = make_plate(load_instrument("taipan-150", {"n_science": 60}))
    routing = RoutingSettings()
    jobs = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        start, end = (random_field(plate, plate.park_mm, rng).goal_mm for _ in range(2))
        has_target = rng.random(plate.n_robot) < 0.7
        target_id = np.where(has_target, np.arange(plate.n_robot), -1)
        goal = chains.Goal(("a", 0, seed), target_id, np.where(has_target, 0, -1).astype(np.int8), end, 4.0)
        jobs.append(chains.ChainJob(State(start, np.zeros(plate.n_robot)), (str(seed),), (goal,), (None,)))
    made = []
    for n_exchange in (0, 8):
        monkeypatch.setattr(chains, "N_EXCHANGE", n_exchange)
        made.append(chains.route_chains(chains.ChainBatch(tuple(jobs), plate, routing, 1)).frames)
    plain, exchanged = (frames["exposure_paths"] for frames in made)
    above = [(some["configuration_time_s"] > some["lower_bound_s"] * (1 + 1e-9)).sum() for some in (plain, exchanged)]
    assert above[1] < above[0]
    assert exchanged["unrouted"].sum() == 0
    for step, job in enumerate(jobs):
        rows = made[1]["exposure_allocations"].filter(exposure_id=step).sort("robot_id")
        held, goal = rows["target_id"], job.goals[0]
        assert sorted(held.drop_nulls()) == np.flatnonzero(goal.target_id >= 0).tolist()
        place = rows.select("x_mm", "y_mm").to_numpy()
        is_held = held.is_not_null().to_numpy()
        np.testing.assert_array_equal(place[is_held], goal.end_mm[held.drop_nulls().cast(int).to_numpy()])
        assert (np.hypot(*(place - plate.park_mm).T) <= plate.patrol_radius_mm + 1e-6).all()


def test_a_target_barred_to_a_robot_goes_to_another_or_the_match_is_none(plate):
    """Two robots that reach both targets; a guide's is in nobody else's reach."""
    end = legal_places(plate, np.random.default_rng(3))
    has_target = plate.is_live.copy()
    guide = int(np.flatnonzero(plate.is_guide)[0])
    assert rematch.match_around(plate, end, end, has_target, 4.0, {(guide, guide)}) is None
    free = np.flatnonzero(plate.is_live & ~plate.is_guide)
    has_target[free[1:]] = False
    giver, goal = rematch.match_around(plate, end, end, has_target, 4.0, {(int(free[0]), int(free[0]))})
    taker = int(np.flatnonzero(giver == free[0])[0])
    assert taker in free[1:]
    np.testing.assert_array_equal(goal[taker], end[free[0]])
    assert giver[free[0]] == -1


def test_a_dead_robot_has_no_other_place_to_rest(plate):
    start = legal_places(plate, np.random.default_rng(5))
    dead = int(np.flatnonzero(~plate.is_live)[0])
    assert resting_places(plate, start, start, dead).shape == (0, 2)
    assert not has_room(plate, start, dead, start[dead])
    assert has_room(plate, start, 0, start[0])
