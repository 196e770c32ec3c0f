"""One tile, visit by visit: allocate, route three ways, play, and note what really happened."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import NamedTuple, TypeVar
from zlib import crc32

import numpy as np
import numpy.typing as npt
import polars as pl

from survey_sim.allocation import (
    AllocationSettings,
    FieldTargets,
    Minima,
    Session,
    VisitAllocation,
    part_of_field,
    start_allocation,
)
from survey_sim.geometry import FloatArray, sky_to_plate
from survey_sim.instrument import Plate
from survey_sim.motion import alone_time_s
from survey_sim.routing import HeldUp, RoutedPath, RoutingSettings, UnroutedReason, route, route_at_bound
from survey_sim.simulation import SimulationSettings, execute, simulate
from survey_sim.survey.exchanges import Proposal, Tried, least_costly
from survey_sim.survey.rows import PlayedPath, Rows, TileRows, frames, tile_rows
from survey_sim.tiling import Planned

# A tile that completed so much of what was planned for it makes no visit more.
PLAN_KEPT_FRAC = 0.99
# More visits than planned that a tile may make for what calibration displaced: a galaxy loses all five for one.
MOST_VISITS_MORE = 3
# Exchanges tried for a visit in which robots hold a path up; more if far beyond its bound (`least_costly`).
N_EXCHANGE = 24
# Times that the paths of a visit are routed again, by other random steps, where exchanges leave one above its bound.
N_AGAIN = 6
# What tables say of each `UnroutedReason`.
REASON_CODES = np.array([None if reason == UnroutedReason.ARRIVED else reason.code for reason in UnroutedReason])

# A path that is routed, or may be given up.
P = TypeVar("P")


@dataclass(frozen=True)
class TileJob:
    """All that one tile needs, so that any process can do it.

    Attributes
    ----------
    targets
        Rows of `targets` that this tile may use: its own science targets, and the shared kinds on its plate.
    wanted_frac
        Completeness wanted of each science programme, by name.
    plan
        What pooling planned (targets by their ids); None: as many visits as the completeness wanted of this tile needs.
    simulation
        Errors of execution; each path is played with them too, if there are any.
    """

    survey: str
    tile_id: int
    centre_deg: tuple[float, float]
    targets: pl.DataFrame
    wanted_frac: Mapping[str, float]
    plate: Plate
    allocation: AllocationSettings
    routing: RoutingSettings
    seed: int
    plan: Planned | None = None
    simulation: SimulationSettings = field(default_factory=SimulationSettings)


@dataclass(frozen=True)
class State:
    """Where all robots stand, and how they are turned: (n_robot, 2) mm and (n_robot,) deg."""

    position_mm: FloatArray
    theta_deg: FloatArray


class Routes(NamedTuple):
    """What the targets of a visit are good for: the ways to them, to them from park, and from them home to park.

    `home` is `start_to_park` of the visit after.
    """

    to_target: RoutedPath
    from_park: RoutedPath
    home: RoutedPath

    @property
    def end(self) -> State:
        """Where the visit leaves all robots."""
        return State(self.to_target.end_mm, self.to_target.end_theta_deg)


@dataclass(frozen=True)
class Settled(Tried):
    """A visit that was tried, the (robot, target) pairs barred to get there, and where idle robots were told to rest."""

    visit: VisitAllocation
    barred: frozenset[tuple[int, int]]
    places: Mapping[int, FloatArray]


def simulate_tile(job: TileJob) -> dict[str, pl.DataFrame]:
    """All visits of one tile: a frame for each of `TILE_TABLES`."""
    return simulate_tiles([job])


def simulate_tiles(jobs: Sequence[TileJob]) -> dict[str, pl.DataFrame]:
    """All visits of some tiles, one tile after another.

    Returns
    -------
        A frame for each of `TILE_TABLES`: made once for all tiles, since a column takes its time however short it is.
    """
    rows = tile_rows()
    for job in jobs:
        _add_tile(job, rows)
    return frames(rows)


def _add_tile(job: TileJob, of_tables: Mapping[str, Rows]) -> None:
    """Add all visits of one tile to the rows of the tables."""
    settings = job.allocation
    minima = Minima.of(settings, job.plate)
    rows = TileRows(job.survey, job.tile_id, field_of(job), job.plate, minima, settings.bound, of_tables)
    reason = np.zeros(rows.field.n_target, dtype=np.int8)
    state = _park(job.plate)
    for number, group in enumerate(magnitude_groups(rows.field, settings.mag_ranges)):
        # The last visits that could have held a target say why it was lost.
        state, reason[group[0]] = _visit_group(job, group, number, state, rows)
    rows.add_unallocated(reason)


def magnitude_groups(
    field: FieldTargets, ranges: tuple[tuple[float, float], ...]
) -> Iterator[tuple[np.ndarray, FieldTargets]]:
    """Targets that one exposure can serve together, range after range.

    A science target stands in each range that has its magnitude. Only its last range must complete it: before, it may fill
    fibres that would be idle, so it counts for no programme there and has the lowest priority.

    Returns
    -------
        Places in `field`, and the targets there; targets without a magnitude, and the other kinds, stand in every group.
    """
    if not ranges:
        yield np.arange(field.n_target), field
        return
    bright = [-np.inf, *(low for low, _ in ranges[1:])]
    faint = [*(high for _, high in ranges[:-1]), np.inf]
    has_no_range = ~field.is_science | np.isnan(field.mag)
    for number in range(len(ranges)):
        chosen = np.flatnonzero(has_no_range | ((field.mag >= bright[number]) & (field.mag < faint[number])))
        next_bright = bright[number + 1] if number + 1 < len(ranges) else np.inf
        is_last = (field.mag[chosen] < next_bright) | (next_bright == np.inf)
        yield chosen, _chosen(field, chosen, is_filler=field.is_science[chosen] & ~is_last)


def last_group(mag: FloatArray, ranges: tuple[tuple[float, float], ...]) -> npt.NDArray[np.int64]:
    """(n_target,) the last magnitude range that may serve targets of these magnitudes (NaN: unknown); it completes them."""
    return np.searchsorted([low for low, _ in ranges[1:]], mag, side="right").astype(np.int64)


def subset(field: FieldTargets, chosen: npt.NDArray[np.int64]) -> FieldTargets:
    """The targets at these places."""
    shared = ("programmes", "wanted_frac")
    return replace(field, **{c.name: getattr(field, c.name)[chosen] for c in fields(FieldTargets) if c.name not in shared})


def _chosen(field: FieldTargets, chosen: np.ndarray, *, is_filler: np.ndarray) -> FieldTargets:
    """The targets at these places; fillers have the lowest priority and no programme."""
    part = subset(field, chosen)
    priority, programme = np.where(is_filler, 1, part.priority), np.where(is_filler, -1, part.programme)
    return replace(part, priority=priority, programme=programme)


def _visit_group(
    job: TileJob, group: tuple[np.ndarray, FieldTargets], number: int, state: State, rows: TileRows
) -> tuple[State, np.ndarray]:
    """All visits of one magnitude range, from where the robots stand; where they end, and `LostReason` of its targets."""
    chosen, field = group
    park = _park(job.plate)
    rng = _stream(job, "allocation", number)
    n_done = rows.n_done[chosen]
    settings, field, is_planned = group_as_planned(job, number, field, rows.field.programme[chosen], n_done)
    lists = part_of_field(rows.lists, chosen, field, settings)
    session = start_allocation(field, job.plate, settings, rng, n_done, is_planned, lists)
    visit, home = session.next_visit(state.position_mm), None
    while visit is not None:
        start = park if visit.start == "park" else state
        visit, routes = _settle(job, rows.n_visit, session, visit, start)
        routed, end = routes.to_target, routes.end
        to_target = _note(job, rows, "start_to_target", start, routed)
        _note(job, rows, "start_to_park", state, home or _to_park(job, rows.n_visit, state))
        _note(job, rows, "park_to_target", park, routes.from_park)
        home = routes.home
        is_arrived = routed.reason == UnroutedReason.ARRIVED
        session.record(visit, is_arrived)
        held = np.where(is_arrived & (visit.target >= 0), chosen[visit.target], -1)
        rows.add_visit(visit.start, held, start.position_mm, end.position_mm, to_target)
        state = end
        visit = session.next_visit(state.position_mm)
    return state, session.lost_reasons()


def planned_visits(
    target_id: npt.NDArray[np.int64], plan: Planned, group: int, n_visit: int | None = None
) -> npt.NDArray[np.bool_]:
    """(n_target, n_visit) the plan of a group of visits for the targets with these ids, ascending; others are left out.

    Parameters
    ----------
    n_visit
        Visits of the group; as many as the plan has by default.
    """
    if n_visit is None:
        n_visit = int(plan.visit[plan.group == group].max(initial=-1)) + 1
    is_planned = np.zeros((len(target_id), n_visit), dtype=np.bool_)
    place, is_there = places_among(target_id, plan.row)
    is_known = (plan.group == group) & (plan.visit < n_visit) & is_there
    is_planned[place[is_known], plan.visit[is_known]] = True
    return is_planned


def places_among(
    target_id: npt.NDArray[np.int64], sought: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
    """Where the ids sought (n,) stand among some in ascending order, and whether they do at all."""
    place = np.searchsorted(target_id, sought)
    is_there = place < len(target_id)
    is_there[is_there] = target_id[place[is_there]] == sought[is_there]
    return place, is_there


def group_as_planned(
    job: TileJob, number: int, field: FieldTargets, programme: npt.NDArray[np.int64], n_done: npt.NDArray[np.int64]
) -> tuple[AllocationSettings, FieldTargets, npt.NDArray[np.bool_] | None]:
    """Settings, targets and plan of a group of visits: of a tile whose visits were not pooled as they are, without a plan.

    Parameters
    ----------
    programme, n_done
        (n_target,) of each target, also of fillers; visits received before.
    """
    if job.plan is None:
        return job.allocation, field, None
    is_planned = planned_visits(field.target_id, job.plan, number)
    n_planned = is_planned.shape[1]
    most = n_planned + MOST_VISITS_MORE if n_planned else 0
    settings = job.allocation.model_copy(update={"max_visits": most})
    return settings, _as_planned(field, programme, is_planned, n_done), is_planned


def _as_planned(
    field: FieldTargets, programme: npt.NDArray[np.int64], is_planned: npt.NDArray[np.bool_], n_done: npt.NDArray[np.int64]
) -> FieldTargets:
    """The targets, about as many wanted as are planned or complete; `programme` (n_target,) is also of fillers."""
    is_wanted = field.is_science & (is_planned.any(axis=1) | (n_done >= field.wanted_visits))
    programme = np.where(is_wanted, programme, field.programme)
    is_counted = field.is_science & (programme >= 0)
    n_programme = len(field.programmes)
    n_wanted = np.bincount(programme[is_wanted], minlength=n_programme)
    wanted_frac = PLAN_KEPT_FRAC * n_wanted / np.maximum(np.bincount(programme[is_counted], minlength=n_programme), 1)
    return replace(field, programme=programme, wanted_frac=wanted_frac)


def stream(seed: int, stage: str, *keys: str | int) -> np.random.Generator:
    """Random stream of a stage at a place of the survey: it depends on nothing else, so on no worker and no order."""
    words = [crc32(key.encode()) if isinstance(key, str) else key for key in (stage, *keys)]
    return np.random.default_rng(np.random.SeedSequence([seed, len(words), *words]))


def _stream(job: TileJob, stage: str, *keys: str | int) -> np.random.Generator:
    return stream(job.seed, stage, job.survey, job.tile_id, *keys)


def field_of(job: TileJob) -> FieldTargets:
    """The tile's targets on its plate."""
    ra, dec = (job.targets[name].to_numpy() for name in ("ra_deg", "dec_deg"))
    position = sky_to_plate(ra, dec, job.centre_deg, job.plate.instrument.plate_scale_arcsec_mm)
    on_plate = job.targets.with_columns(x_mm=pl.Series(position[:, 0]), y_mm=pl.Series(position[:, 1]))
    return FieldTargets.from_table(on_plate, job.wanted_frac)


def _park(plate: Plate) -> State:
    return State(plate.park_mm, np.zeros(plate.n_robot))


def _settle(
    job: TileJob, number: int, session: Session, visit: VisitAllocation, start: State
) -> tuple[VisitAllocation, Routes]:
    """A visit, and its routes, after robots that hold a path up, or do not arrive, have exchanged targets with others.

    The target of such a robot is barred to it, and what all are given instead is tried, first with no way longer than the
    longest there is; an idle one rests elsewhere. Bars add up from exchange to exchange.
    """

    def others(settled: Settled) -> Iterator[Proposal[Settled] | None]:
        for may_lengthen in (False, True):
            for robot in settled.blamed:
                target = int(settled.visit.target[robot])
                if target >= 0:
                    barred = settled.barred | {(robot, target)}
                    yield proposed(session.exchanged(visit, barred, may_lengthen=may_lengthen), barred, settled.places)
                elif may_lengthen:
                    for place in session.resting_places(settled.visit, robot):
                        yield proposed(settled.visit, settled.barred, {**settled.places, robot: place})

    def proposed(
        other: VisitAllocation | None, barred: frozenset[tuple[int, int]], places: Mapping[int, FloatArray]
    ) -> Proposal[Settled] | None:
        if other is None:
            return None
        rested = session.rested(other, places) if places else other
        least_s = sum(_least_s(job, rested, start))
        return Proposal(
            rested.goal_mm, least_s, lambda: Settled(_paths_at_bound(job, number, rested, start), rested, barred, places)
        )  # fmt: skip

    def whole(settled: Settled) -> Settled:
        return replace(settled, paths=_paths(job, number, settled.visit, start))

    first = Proposal(visit.goal_mm, 0.0, lambda: Settled(_paths_at_bound(job, number, visit, start), visit, frozenset(), {}))
    best = least_costly(first, others, whole, N_EXCHANGE)
    if best.blamed:
        return best.visit, _paths(job, number, best.visit, start, 1 + N_AGAIN)
    return best.visit, Routes(*best.routed)


def _least_s(job: TileJob, visit: VisitAllocation, start: State) -> tuple[float, float, float]:
    """Time that each of the paths of a visit takes at the least, s: none is turned on the way home."""
    instrument, park = job.plate.instrument, _park(job.plate)
    to_target_s, from_park_s = (
        float(alone_time_s(instrument, state.position_mm, state.theta_deg, visit.goal_mm).max()) for state in (start, park)
    )
    home_mm = np.hypot(*(visit.goal_mm - park.position_mm)[job.plate.is_live].T).max()
    return to_target_s, from_park_s, float(home_mm) / instrument.coarse_speed_mm_s


def _paths_at_bound(job: TileJob, number: int, visit: VisitAllocation, start: State) -> tuple[RoutedPath | HeldUp, ...]:
    """The three paths of a visit, each at its bound; after one that is given up none is routed."""
    to_target = _route(route_at_bound, job, number, "start_to_target", start, visit.goal_mm)
    if isinstance(to_target, HeldUp):
        return to_target, *(HeldUp(bound_s, bound_s, ()) for bound_s in _least_s(job, visit, start)[1:])
    end = State(to_target.end_mm, to_target.end_theta_deg)
    from_park = _route(route_at_bound, job, number, "park_to_target", _park(job.plate), end.position_mm)
    if isinstance(from_park, HeldUp):
        home_s = _least_s(job, visit, start)[2]
        return to_target, from_park, HeldUp(home_s, home_s, ())
    return to_target, from_park, _route(route_at_bound, job, number + 1, "start_to_park", end, _home_mm(job, end))


def _paths(job: TileJob, number: int, visit: VisitAllocation, start: State, n_attempt: int = 1) -> Routes:
    """The three paths of a visit, each the best of some attempts."""
    to_target = _best_path(job, number, "start_to_target", start, visit.goal_mm, n_attempt)
    end = State(to_target.end_mm, to_target.end_theta_deg)
    from_park = _best_path(job, number, "park_to_target", _park(job.plate), end.position_mm, n_attempt)
    return Routes(to_target, from_park, _to_park(job, number + 1, end, n_attempt))


def _to_park(job: TileJob, number: int, state: State, n_attempt: int = 1) -> RoutedPath:
    """From here to park."""
    return _best_path(job, number, "start_to_park", state, _home_mm(job, state), n_attempt)


def _home_mm(job: TileJob, state: State) -> FloatArray:
    """(n_robot, 2) park; dead robots stay."""
    return np.where(job.plate.is_live[:, None], job.plate.park_mm, state.position_mm)


def _best_path(job: TileJob, number: int, path: str, start: State, goal_mm: FloatArray, n_attempt: int) -> RoutedPath:
    """The first path at its bound, or else the best, of some attempts by other random steps."""
    tried: list[Tried] = []
    for attempt in range(n_attempt):
        tried.append(Tried((_route(route, job, number, path, start, goal_mm, attempt),)))
        if not tried[-1].blamed:
            break
    return min(tried, key=lambda one: one.cost).routed[0]


def _route(
    router: Callable[..., P], job: TileJob, number: int, path: str, start: State, goal_mm: FloatArray, attempt: int = 0
) -> P:
    """Route one path of the visit with this number."""
    rng = _stream(job, "routing", number, path, *([attempt] if attempt else []))
    return router(job.plate, start.position_mm, start.theta_deg, goal_mm, job.routing, rng)


def _note(job: TileJob, rows: TileRows, path: str, start: State, routed: RoutedPath) -> PlayedPath:
    """Play one path of the visit that comes next, and note its legs and times."""
    played = simulate(job.plate, start.position_mm, start.theta_deg, routed.legs)
    made = PlayedPath(routed.legs, played, REASON_CODES[routed.reason], routed.lower_bound_s)
    rows.add_path(path, made)
    if job.simulation.has_errors:
        errors = _stream(job, "simulation", rows.n_visit, path)
        executed = execute(job.plate, start.position_mm, routed.legs, job.simulation, errors)
        rows.add_execution(path, job.simulation.mode, executed)
    return made
