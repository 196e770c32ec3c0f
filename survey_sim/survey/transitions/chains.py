"""Chains of configurations: targets matched again to the robots from where the last pointing left them, and routed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import numpy.typing as npt
import polars as pl

from survey_sim import tables
from survey_sim.allocation import match_again, match_around, rest, resting_places
from survey_sim.geometry import FloatArray
from survey_sim.instrument import Plate
from survey_sim.motion import alone_time_s
from survey_sim.routing import HeldUp, RoutedPath, RoutingSettings, UnroutedReason, route, route_at_bound
from survey_sim.schema import TARGET_KINDS
from survey_sim.simulation import simulate
from survey_sim.survey.exchanges import Proposal, Tried, least_costly
from survey_sim.survey.rows import PlayedPath, Rows
from survey_sim.survey.tile import REASON_CODES, State, stream

IntArray = npt.NDArray[np.int64]
Places = Mapping[int, FloatArray]

EXPOSURE_TABLES = ("exposure_allocations", "exposure_legs", "exposure_paths")
VISIT_KEY = ("survey", "tile_id", "visit_id")
# Exchanges tried for a pointing in which robots hold the others up.
N_EXCHANGE = 4
_SCIENCE = TARGET_KINDS.index("science")


@dataclass(frozen=True)
class Goal:
    """A visit's own configuration.

    Attributes
    ----------
    visit
        Survey, tile and visit.
    target_id, kind
        (n_robot,) what each robot holds, -1 if nothing; its kind, place in `TARGET_KINDS`.
    end_mm
        (n_robot, 2) where each robot ends, mm, plate frame.
    travel_power
        Power of travel whose sum is least.
    """

    visit: tuple[str, int, int]
    target_id: IntArray
    kind: npt.NDArray[np.int8]
    end_mm: FloatArray
    travel_power: float

    def digest(self) -> bytes:
        """Of all that it holds."""
        digest = sha256(repr((self.visit, self.travel_power)).encode())
        for array in (self.target_id, self.kind, self.end_mm):
            digest.update(array.tobytes())
        return digest.digest()


@dataclass(frozen=True)
class Configurations:
    """Every visit's own configuration, in order of survey, tile and visit.

    Attributes
    ----------
    visits
        Keys, (n_visit,) rows.
    target_id, kind, end_mm
        (n_visit, n_robot) and (n_visit, n_robot, 2), see `Goal`.
    travel_power
        By survey.
    """

    visits: pl.DataFrame
    target_id: IntArray
    kind: npt.NDArray[np.int8]
    end_mm: FloatArray
    travel_power: Mapping[str, float]

    @classmethod
    def read(cls, run_dir: Path, plate: Plate, travel_power: Mapping[str, float]) -> Configurations:
        """Those of a run's `visits` and `allocations`, which have a row for every robot of every visit."""
        visits = tables.read(run_dir, "visits").sort(VISIT_KEY).select(VISIT_KEY)
        columns = (*VISIT_KEY, "robot_id", "target_id", "kind", "x_mm", "y_mm")
        rows = tables.scan(run_dir, "allocations").select(columns).collect().sort(*VISIT_KEY, "robot_id")
        codes = {kind: code for code, kind in enumerate(TARGET_KINDS)}
        kind = rows["kind"].replace_strict(codes, default=-1, return_dtype=pl.Int8)
        shape = (len(visits), plate.n_robot)
        return cls(
            visits,
            rows["target_id"].fill_null(-1).to_numpy().reshape(shape),
            kind.to_numpy().reshape(shape),
            rows.select("x_mm", "y_mm").to_numpy(order="c").reshape(*shape, 2),
            travel_power,
        )

    def goal(self, visit: int) -> Goal:
        """The configuration of one visit."""
        key = self.visits.row(visit)
        return Goal(key, self.target_id[visit], self.kind[visit], self.end_mm[visit], self.travel_power[key[0]])


@dataclass(frozen=True)
class Way(Tried):
    """A way to a visit that was tried.

    Attributes
    ----------
    giver, goal_mm
        As in `Match`.
    barred, places
        What was barred to get there, as in `match_around`; where idle robots were told to rest.
    """

    giver: IntArray
    goal_mm: FloatArray
    barred: frozenset[tuple[int, int]]
    places: Places


@dataclass(frozen=True)
class Match:
    """A visit's targets matched again, as `match_again` gives them.

    Attributes
    ----------
    giver, goal_mm
        (n_robot,) whose target each robot goes to; (n_robot, 2) where it shall end.
    """

    giver: IntArray
    goal_mm: FloatArray

    @classmethod
    def of(cls, plate: Plate, goal: Goal, state: State) -> Match:
        """The match for robots that stand so."""
        return cls(*match_again(plate, state.position_mm, goal.end_mm, goal.target_id >= 0, goal.travel_power))


@dataclass(frozen=True)
class ChainJob:
    """Configurations one after the other.

    Attributes
    ----------
    start
        Where the robots stand before the first.
    keys
        Name of each step: a digest of all that led there.
    matches
        Those made before, each for robots that end every step before it where its match says; None where there is none.
    """

    start: State
    keys: tuple[str, ...]
    goals: tuple[Goal, ...]
    matches: tuple[Match | None, ...]


@dataclass(frozen=True)
class ChainBatch:
    """Chains that one process does at a time, and what they share."""

    jobs: tuple[ChainJob, ...]
    plate: Plate
    routing: RoutingSettings
    seed: int


@dataclass(frozen=True)
class ChainResult:
    """What came of a batch.

    Attributes
    ----------
    frames
        By table of `EXPOSURE_TABLES`; `exposure_id` counts the steps of the batch.
    steps
        Frame key, step, time_s, lost (ids of science targets that no robot reached).
    """

    frames: dict[str, pl.DataFrame]
    steps: pl.DataFrame


def joined(results: Sequence[ChainResult]) -> ChainResult:
    """Results as those of one batch: steps are counted through all of them."""
    first = np.cumsum([0, *(len(result.steps) for result in results)])[:-1].tolist()
    frames = {
        table: pl.concat(
            result.frames[table].with_columns(pl.col("exposure_id") + begin)
            for result, begin in zip(results, first, strict=True)
        )
        for table in EXPOSURE_TABLES
    }
    steps = pl.concat(
        result.steps.with_columns(pl.col("step") + begin) for result, begin in zip(results, first, strict=True)
    )
    return ChainResult(frames, steps)


def route_chains(batch: ChainBatch) -> ChainResult:
    """Do all chains of a batch."""
    rows = {table: Rows(table) for table in EXPOSURE_TABLES}
    steps: list[tuple[str, int, float, list[int]]] = []
    for job in batch.jobs:
        state, is_as_thought = job.start, True
        for key, goal, thought in zip(job.keys, job.goals, job.matches, strict=True):
            match = thought if thought is not None and is_as_thought else Match.of(batch.plate, goal, state)
            state, time_s, lost = _go_on(batch, goal, state, match, len(steps), rows)
            is_as_thought = is_as_thought and np.array_equal(state.position_mm, match.goal_mm)
            steps.append((key, len(steps), time_s, lost))
    schema = pl.Schema({"key": pl.String(), "step": pl.Int32(), "time_s": pl.Float64(), "lost": pl.List(pl.Int64())})
    known = pl.DataFrame(steps, schema=schema, orient="row")
    frames = {table: gathered.frame() for table, gathered in rows.items()}
    return ChainResult(frames, known)


def _go_on(
    batch: ChainBatch, goal: Goal, state: State, match: Match, step: int, rows: Mapping[str, Rows]
) -> tuple[State, float, list[int]]:
    """Configure for one visit: where the robots stand then, how long it took, s, and science targets lost."""
    plate, key = batch.plate, {"exposure_id": step}
    way = best_way(batch, goal, state, match)
    giver, (routed,) = way.giver, way.routed
    played = simulate(plate, state.position_mm, state.theta_deg, routed.legs)
    made = PlayedPath(routed.legs, played, REASON_CODES[routed.reason], routed.lower_bound_s)
    rows["exposure_paths"].add(1, **key, **made.path_columns())
    rows["exposure_legs"].add(len(made.legs), **key, **made.leg_columns(plate))
    is_arrived = routed.reason == UnroutedReason.ARRIVED
    given, kind = np.where(giver >= 0, goal.target_id[giver], -1), np.where(giver >= 0, goal.kind[giver], -1)
    rows["exposure_allocations"].add(
        plate.n_robot,
        **key,
        robot_id=plate.robot_id,
        target_id=np.where(is_arrived & (given >= 0), given, np.nan),
        kind=np.array([*TARGET_KINDS, None], dtype=object)[np.where(is_arrived, kind, -1)],
        x_mm=routed.end_mm[:, 0],
        y_mm=routed.end_mm[:, 1],
        theta_deg=routed.end_theta_deg,
        travel_mm=np.hypot(*(routed.end_mm - state.position_mm).T),
        missed_target_id=np.where(~is_arrived & (given >= 0), given, np.nan),
        reason=made.reason,
    )
    lost = given[~is_arrived & (kind == _SCIENCE)]
    return State(routed.end_mm, routed.end_theta_deg), played.configuration_time_s, sorted(lost.tolist())


def best_way(batch: ChainBatch, goal: Goal, state: State, match: Match) -> Way:
    """The way to a visit: as its targets are matched, and exchanged where robots would be in each other's way."""
    plate, has_target = batch.plate, goal.target_id >= 0

    def paths(router: Callable[..., RoutedPath | HeldUp], goal_mm: FloatArray) -> tuple[RoutedPath | HeldUp]:
        rng = stream(batch.seed, "transition", *goal.visit)
        return (router(plate, state.position_mm, state.theta_deg, goal_mm, batch.routing, rng),)

    def tried(giver: IntArray, goal_mm: FloatArray, barred: frozenset[tuple[int, int]], places: Places) -> Way:
        return Way(paths(route_at_bound, goal_mm), giver, goal_mm, barred, places)

    def proposed(giver: IntArray, goal_mm: FloatArray, barred: frozenset[tuple[int, int]], places: Places) -> Proposal[Way]:
        rest(plate, giver < 0, goal_mm, places)
        least_s = alone_time_s(plate.instrument, state.position_mm, state.theta_deg, goal_mm).max()
        return Proposal(goal_mm, least_s, lambda: tried(giver, goal_mm, barred, places))

    def exchanged(way: Way, barred: frozenset[tuple[int, int]]) -> Proposal[Way] | None:
        found = match_around(
            plate, state.position_mm, goal.end_mm, has_target, goal.travel_power, barred, untangles=True
        )  # fmt: skip
        return None if found is None else proposed(*found, barred, way.places)

    def others(way: Way) -> Iterator[Proposal[Way] | None]:
        if not way.barred and not way.places:
            yield exchanged(way, way.barred)
        for robot in way.blamed:
            if way.giver[robot] >= 0:
                yield exchanged(way, way.barred | {(robot, int(way.giver[robot]))})
            else:
                for place in resting_places(plate, state.position_mm, way.goal_mm, robot):
                    yield proposed(way.giver, way.goal_mm.copy(), way.barred, {**way.places, robot: place})

    def whole(way: Way) -> Way:
        return replace(way, paths=paths(route, way.goal_mm))

    first = Proposal(match.goal_mm, 0.0, lambda: tried(match.giver, match.goal_mm, frozenset(), {}))
    return least_costly(first, others, whole, N_EXCHANGE)


def batches(
    jobs: Iterable[ChainJob], n_step: int, plate: Plate, routing: RoutingSettings, seed: int
) -> Iterator[ChainBatch]:
    """Jobs in order, gathered to about so many steps each; none is asked for before it is needed."""
    some: list[ChainJob] = []
    for job in jobs:
        some.append(job)
        if sum(len(one.keys) for one in some) >= n_step:
            yield ChainBatch(tuple(some), plate, routing, seed)
            some = []
    if some:
        yield ChainBatch(tuple(some), plate, routing, seed)
