"""Pooling of visits: which tile takes a target, how many visits each tile gets, and that visits are made as planned."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import polars as pl
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching
from scipy.spatial.distance import pdist

from survey_sim.allocation import AllocationSettings, FieldTargets, TileVisits, make_field, plan_visits
from survey_sim.geometry import sky_to_plate
from survey_sim.instrument import load_instrument, make_plate
from survey_sim.survey.pooling import PLAN, PoolRules, pool_survey
from survey_sim.survey.tile import last_group, planned_visits, simulate_tile
from survey_sim.survey.workers import Workers
from survey_sim.tiling import Order, Planned, Pool, TilingSettings, make_pool, make_tiles, pool_visits, pooling
from survey_sim.tiling.exchange import exchange_visits
from tests.test_tile import _job
from tests.test_tiling import make_targets, random_places

PLATE = make_plate(load_instrument("taipan-150"))
FIELD_DEG = PLATE.instrument.field_radius_deg
CAPACITY = 2


def _first_come(orders: Sequence[tuple[Order, ...]]) -> list[tuple[Planned, ...]]:
    """A planner by hand: the most targets that the fibres of all tiles that plan together can hold, the first of them."""
    return [tuple(_matched(some)) for some in orders]


def _matched(orders: tuple[Order, ...]) -> Iterator[Planned]:
    n_fibre = [order.n_visit[0] * CAPACITY for order in orders]
    reach = np.zeros((sum(n_fibre), 1 + max(order.row.max(initial=0) for order in orders)))
    first = np.cumsum([0, *n_fibre])
    for number, order in enumerate(orders):
        reach[first[number] : first[number + 1], order.row] = 1
    held = maximum_bipartite_matching(csr_array(reach), perm_type="column")
    for begin, end in pairwise(first):
        row = np.sort(held[begin:end][held[begin:end] >= 0]).astype(np.int64)
        yield Planned(row, np.zeros(len(row), np.int64), np.arange(len(row)) // CAPACITY)


def _pool(tiles: Sequence[Sequence[int]], home: Sequence[int], wanted_frac: float = 1.0) -> Pool:
    """A pool of one programme: the targets on each tile's plate, and the first home of each."""
    n = len(home)
    pairs = np.concatenate([np.array(row) for row in tiles]), np.repeat(np.arange(len(tiles)), [len(row) for row in tiles])
    return make_pool(
        pairs,
        np.array(home),
        len(tiles),
        group=np.zeros(n, np.int64),
        programme=np.zeros(n, np.int64),
        wanted_visits=np.ones(n, np.int64),
        wanted_frac=np.array([wanted_frac]),
        capacity=CAPACITY,
        min_gain=1,
    )


def test_what_one_tile_cannot_place_goes_to_a_neighbour_with_idle_fibres() -> None:
    """Five targets at home on one tile and three on the other: four visits of two fibres, not three and two."""
    pool = _pool([[0, 1, 2, 3, 4], [3, 4, 5, 6, 7]], [0, 0, 0, 0, 0, 1, 1, 1])
    pool_visits(pool, _first_come)
    assert pool.n_visit[:, 0].tolist() == [2, 2]
    assert pool.is_done.all()
    assert pool.home.tolist() == [0, 0, 0, 0, 1, 1, 1, 1]


def test_a_tile_with_many_waiting_gets_a_visit_more() -> None:
    pool = _pool([[0, 1, 2, 3, 4]], [0, 0, 0, 0, 0])
    pool_visits(pool, _first_come)
    assert pool.n_visit[:, 0].tolist() == [3]
    assert pool.is_done.all()


def _one_by_one(orders: Sequence[tuple[Order, ...]]) -> list[tuple[Planned, ...]]:
    """A planner by hand of targets that want three visits each and are all too near to each other."""
    plans = []
    for some in orders:
        n = [min(len(order.row), order.n_visit[0] // 3) for order in some]
        rows = [np.repeat(order.row[:k], 3) for order, k in zip(some, n, strict=True)]
        plans.append(tuple(Planned(row, np.zeros(len(row), np.int64), np.arange(len(row))) for row in rows))
    return plans


def test_where_one_visit_more_brings_nothing_as_many_as_a_target_wants_are_tried() -> None:
    pool = replace(_pool([[0, 1]], [0, 0]), wanted_visits=np.array([3, 3]), n_visit=np.array([[3]]))
    pool_visits(pool, _one_by_one)
    assert pool.n_visit[:, 0].tolist() == [6]
    assert pool.is_done.all()


def test_a_visit_that_the_survey_can_do_without_is_given_up() -> None:
    pool = _pool([[0, 1, 2, 3], [4]], [0, 0, 0, 0, 1], wanted_frac=0.8)
    pool_visits(pool, _first_come)
    assert pool.n_visit[:, 0].tolist() == [2, 0]
    assert pool.is_done.tolist() == [True, True, True, True, False]


def test_what_was_tried_and_has_not_changed_since_is_not_planned_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Six tiles, apart from each other, of which the survey may lose a few targets: every order is a new one."""
    tiles = [list(range(5 * t, 5 * t + 1 + t % 5)) for t in range(6)]
    targets = {target: number for number, target in enumerate(target for tile in tiles for target in tile)}
    home = [t for t, tile in enumerate(tiles) for _ in tile]
    pool = _pool([[targets[i] for i in tile] for tile in tiles], home, wanted_frac=0.7)
    asked = []

    def planner(orders: Sequence[tuple[Order, ...]]) -> list[tuple[Planned, ...]]:
        asked.extend((o.tile, o.row.tobytes(), o.n_visit.tobytes(), o.kept.row.tobytes()) for (o,) in orders)
        return _first_come(orders)

    monkeypatch.setattr(pooling, "exchange_visits", lambda pool, plan_tiles: None)

    pool_visits(pool, planner)
    assert pool.is_done.mean() >= 0.7
    assert len(asked) > 6
    assert len(set(asked)) == len(asked)


def _planned(pool: Pool, *rows: list[int]) -> None:
    """Give each tile a plan that holds these targets, in as many visits as they fill."""
    for tile, row in enumerate(rows):
        n_visit = np.array([-(-len(row) // CAPACITY)])
        plan = Planned(np.array(row, np.int64), np.zeros(len(row), np.int64), np.arange(len(row)) // CAPACITY)
        pool.accept([replace(pool.order(tile), n_visit=n_visit)], [plan])


def test_a_visit_is_given_up_if_neighbours_take_its_targets() -> None:
    """Of three targets in two visits, the neighbour's idle fibre can take one: none is lost with a visit less."""
    pool = _pool([[0, 1], [1, 2, 3]], [0, 1, 1, 1])
    _planned(pool, [0], [1, 2, 3])
    exchange_visits(pool, _first_come)
    assert pool.n_visit[:, 0].tolist() == [1, 1]
    assert pool.home.tolist() == [0, 0, 1, 1]
    assert pool.is_done.all()
    _is_held_at_home(pool)


def test_a_visit_is_made_where_it_brings_more_than_another_that_is_given_up() -> None:
    pool = _pool([[0, 1], [2]], [0, 0, 1], wanted_frac=1 / 3)
    _planned(pool, [], [2])
    exchange_visits(pool, _first_come)
    assert pool.n_visit[:, 0].tolist() == [1, 0]
    assert pool.is_done.tolist() == [True, True, False]
    _is_held_at_home(pool)


def test_a_survey_that_lacks_targets_exchanges_no_visits() -> None:
    pool = _pool([[0, 1], [2]], [0, 0, 1])
    _planned(pool, [], [2])
    exchange_visits(pool, _first_come)
    assert pool.n_visit[:, 0].tolist() == [0, 1]


def test_what_wants_several_visits_stays_on_its_tile_when_tiles_plan_together() -> None:
    pool = replace(_pool([[0, 1, 2], [0, 1, 2]], [0, 0, 1]), wanted_visits=np.array([1, 2, 2]))
    orders = pool.together(np.array([0, 1]), np.array([[2], [2]]))
    assert [order.row.tolist() for order in orders] == [[0, 1], [0, 2]]


def _is_held_at_home(pool: Pool) -> None:
    """Each target that is done stands once, in the plan of its home."""
    rows = np.concatenate([plan.row for plan in pool.plans])
    homes = np.repeat(np.arange(pool.n_tile), [len(plan.row) for plan in pool.plans])
    assert np.sort(rows).tolist() == np.flatnonzero(pool.is_done).tolist()
    assert pool.home[rows].tolist() == homes.tolist()


def test_fibres_are_left_for_calibration_that_is_to_be_had() -> None:
    rules = _rules(wanted_standard=4, wanted_sky=20)
    n_science = PLATE.n_science_live
    assert rules.capacity == n_science - 24
    assert rules.among({"science", "sky"}).capacity == n_science - 20
    assert rules.among({"science"}).capacity == n_science


def test_tiles_of_a_colour_share_no_target() -> None:
    rng = np.random.default_rng(5)
    tiles = [np.sort(rng.choice(60, 8, replace=False)) for _ in range(20)]
    pool = _pool([*tiles, np.arange(60)], [20] * 60)
    for a in range(21):
        for b in range(a):
            share = np.intersect1d(*(pool.row[pool.first[t] : pool.first[t + 1]] for t in (a, b)))
            assert (len(share) > 0) == (b in pool.near[a])
            assert pool.colours[a] != pool.colours[b] or not len(share)


def _rules(**allocation: object) -> PoolRules:
    return PoolRules("s", {"p": 0.95}, PLATE, AllocationSettings.load({"min_gain": 5, **allocation}), seed=1)


@pytest.fixture(scope="module")
def sky() -> tuple[pl.DataFrame, pl.DataFrame]:
    """Targets with the nearest tiles, and tiles: 12 by 12 deg, 21 targets a square degree, a third of them bright."""
    targets = make_targets(random_places(3000, 3, dec=(-6.0, 6.0), ra=(40.0, 52.0)))
    mag = np.random.default_rng(8).choice([6.0, 11.0], len(targets), p=[1 / 3, 2 / 3])
    tiles, targets = make_tiles(targets.with_columns(mag=mag), TilingSettings(n_orientation=4), FIELD_DEG)
    return targets, tiles


def _check_plan(targets: pl.DataFrame, tiles: pl.DataFrame, plan: pl.DataFrame) -> None:
    """Each target once, on its home's plate; no visit beyond its fibres, no two of its targets too close."""
    assert plan["target_id"].is_unique().all()
    joined = plan.join(targets.select("target_id", "ra_deg", "dec_deg", home="tile_id"), on="target_id", how="left")
    assert (joined["tile_id"] == joined["home"]).all()
    for (tile_id, _, _), visit in joined.partition_by("tile_id", "group", "visit", as_dict=True).items():
        centre = tiles.filter(tile_id=tile_id).select("ra_deg", "dec_deg").row(0)
        place = sky_to_plate(visit["ra_deg"].to_numpy(), visit["dec_deg"].to_numpy(), centre, 67.2)
        assert len(visit) <= PLATE.n_science_live
        assert np.hypot(*place.T).max() <= PLATE.instrument.plate_radius_mm
        assert len(visit) < 2 or pdist(place).min() >= 9.0


def test_a_survey_has_the_completeness_that_it_wants_in_few_visits(sky: tuple[pl.DataFrame, pl.DataFrame]) -> None:
    targets, plan = pool_survey(_rules(), *sky, Workers())
    _check_plan(targets, sky[1], plan)
    assert 0.95 <= len(plan) / len(targets) < 0.965
    n_visit = plan.select("tile_id", "visit").n_unique()
    assert n_visit <= 1.4 * 0.95 * len(targets) / PLATE.n_science_live
    assert plan.schema == pl.Schema(PLAN)
    assert (targets["tile_id"] != sky[0]["tile_id"]).mean() > 0.02, "targets in overlaps go where they are served"


def test_visits_of_a_range_hold_its_magnitudes(sky: tuple[pl.DataFrame, pl.DataFrame]) -> None:
    ranges = ((5.0, 8.0), (7.0, 12.0))
    targets, plan = pool_survey(_rules(mag_ranges=ranges), *sky, Workers())
    _check_plan(targets, sky[1], plan)
    mag = plan.join(targets, on="target_id")
    assert mag.filter(group=0)["mag"].max() == 6.0
    assert mag.filter(group=1)["mag"].min() == 11.0
    assert last_group(np.array([3.0, 6.9, 7.0, 7.5, 20.0, np.nan]), ranges).tolist() == [0, 0, 1, 1, 1, 1]


def test_tiles_that_plan_together_exchange_targets() -> None:
    """Two plates half a radius apart, a visit each: together they lose no more than one after the other."""
    rules = _rules()
    targets = make_targets(random_places(500, 4, dec=(-2.0, 2.0), ra=(100.0, 105.0)))
    known = FieldTargets.from_table(targets.with_columns(x_mm=pl.lit(0.0), y_mm=pl.lit(0.0)), rules.wanted_frac)
    fields = []
    for ra_deg in (101.5, 103.0):
        x_mm, y_mm = sky_to_plate(targets["ra_deg"].to_numpy(), targets["dec_deg"].to_numpy(), (ra_deg, 0.0), 67.2).T
        fields.append(make_field(replace(known, x_mm=x_mm.copy(), y_mm=y_mm.copy()), PLATE, rules.allocation))
    rng = np.random.default_rng(1)
    nothing, everything = np.zeros((500, 1), dtype=bool), np.ones(500, dtype=bool)
    (first,) = plan_visits([TileVisits(fields[0], everything, nothing)], 150, rng)
    (second,) = plan_visits([TileVisits(fields[1], ~first.any(axis=1), nothing)], 150, rng)
    both = plan_visits([TileVisits(field, everything, nothing) for field in fields], 150, rng)
    assert not (both[0] & both[1]).any()
    assert both[0].sum() + both[1].sum() >= first.sum() + second.sum() > 250
    for field, planned in zip(fields, both, strict=True):
        assert (field.is_on_plate & field.is_reached)[planned[:, 0]].all()
        assert pdist(field.xy_mm[planned[:, 0]]).min() >= 9.0


def test_a_tile_makes_the_visits_that_are_planned() -> None:
    """Of 300 targets a plan wants 180, in two visits: so many are observed, and no third visit is made for the rest."""
    job = _job(300, algorithm="plan")
    planned = Planned(np.arange(180), np.zeros(180, np.int64), np.arange(180) % 2)
    made = simulate_tile(replace(job, plan=planned))
    assert made["visits"]["visit_id"].to_list() == [0, 1]
    held = made["allocations"].filter(kind="science")["target_id"].unique()
    assert len(held) >= 180
    assert len(set(planned.row) & set(held)) > 120


def test_a_tile_without_a_plan_makes_no_visit_and_gives_reasons() -> None:
    made = simulate_tile(replace(_job(30, algorithm="plan"), plan=Planned.empty()))
    assert not len(made["visits"])
    assert made["unallocated"].height == 30
    assert set(made["unallocated"]["reason"]) == {"no-visit"}


def test_planned_visits_of_a_group() -> None:
    plan = Planned(np.array([5, 9, 9, 7]), np.array([1, 1, 1, 0]), np.array([0, 0, 2, 0]))
    assert planned_visits(np.array([5, 7, 9]), plan, 1).tolist() == [[True, False, False], [False] * 3, [True, False, True]]
    assert planned_visits(np.array([5, 7]), plan, 1, n_visit=1).tolist() == [[True], [False]]
    assert planned_visits(np.array([5]), Planned.empty(), 0).shape == (1, 0)
