"""The robots as the schedule sees them: chains already routed are looked up, others are routed, many nights at once.

What a chain does is named by a digest of all that it depends on: the instrument, the router and its seed, the code, and the
visits since the night began. So ways are kept between runs: a run that was killed, or whose schedule is changed, routes only
what it has not routed before.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from hashlib import sha256
from io import BytesIO
from pathlib import Path

import numpy as np
import polars as pl

from survey_sim import tables
from survey_sim.instrument import Plate
from survey_sim.motion import alone
from survey_sim.routing import RoutingSettings
from survey_sim.schedule.robots import Chain, Configuration
from survey_sim.survey.tile import State
from survey_sim.survey.transitions.chains import (
    ChainBatch,
    ChainJob,
    ChainResult,
    Configurations,
    Goal,
    Match,
    batches,
    joined,
    route_chains,
)
from survey_sim.survey.workers import Workers

# Steps of one task of a worker.
N_STEP_TASK = 60
# A way of so many times the usual time is hardly ever seen: where that costs nothing, the usual time is estimate enough.
FAR_FROM_USUAL = 1.5
_STEPS = "steps"


@dataclass(frozen=True)
class Step:
    """A way that is known: what the schedule needs of it, and the file and place where the rest is."""

    configuration: Configuration
    file: str
    place: int


@dataclass(frozen=True)
class Packed:
    """What came of a batch of chains: name and content of the file that keeps it, and its steps (`ChainResult`)."""

    name: str
    content: bytes
    steps: pl.DataFrame


def route_and_pack(batch: ChainBatch) -> Packed:
    """Do all chains of a batch, and pack what came of it: work for another process."""
    return pack(route_chains(batch))


def pack(result: ChainResult) -> Packed:
    """What came of some chains as a file."""
    content = BytesIO()
    with zipfile.ZipFile(content, "w") as kept:
        for member, frame in ((_STEPS, result.steps), *result.frames.items()):
            buffer = BytesIO()
            frame.write_parquet(buffer, compression="lz4", statistics=False)
            kept.writestr(member, buffer.getvalue())
    name = f"{sha256(''.join(result.steps['key']).encode()).hexdigest()[:32]}.zip"
    return Packed(name, content.getvalue(), result.steps)


def read_ways(source: bytes | Path, table: str) -> pl.DataFrame:
    """Rows of one of `EXPOSURE_TABLES` of a file of ways, or of its content; `exposure_id` is the step's place in it."""
    with zipfile.ZipFile(BytesIO(source) if isinstance(source, bytes) else source) as kept:
        return pl.read_parquet(BytesIO(kept.read(table)))


class Ways:
    """Ways already routed, on disk: files of some chains each, whole or absent.

    Parameters
    ----------
    folder
        Where they are kept.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.steps: dict[str, Step] = {}
        self._held: dict[str, ChainResult] = {}
        self.read = lru_cache(maxsize=16)(self._read)
        for path in sorted(folder.glob("*.zip")):
            try:
                with zipfile.ZipFile(path) as kept:
                    is_whole = kept.testzip() is None
                    steps = pl.read_parquet(BytesIO(kept.read(_STEPS)))
            except (zipfile.BadZipFile, pl.exceptions.PolarsError, KeyError, OSError):
                is_whole = False
            if is_whole:
                self._index(path.name, steps)
            else:
                path.unlink(missing_ok=True)

    def keep(self, packed: Packed) -> None:
        """Write what came of a batch."""
        tables.write_bytes(packed.content, self.folder / packed.name)
        self._index(packed.name, packed.steps)

    def hold(self, result: ChainResult) -> None:
        """Keep what came of a chain in memory until `release`: a file for each step would take longer than its way."""
        name = f"held {len(self._held)}"
        self._held[name] = result
        self._index(name, result.steps)

    def release(self) -> None:
        """Write what is held, as one file."""
        results, self._held = list(self._held.values()), {}
        if not results:
            return
        for key in (key for result in results for key in result.steps["key"]):
            del self.steps[key]
        self.read.cache_clear()
        self.keep(pack(joined(results)))

    def source(self, name: str, *, is_near: bool) -> bytes | Path:
        """A file, for `read_ways` on this machine, or anywhere."""
        return self.folder / name if is_near else (self.folder / name).read_bytes()

    def prune(self, keys: set[str]) -> None:
        """Remove the files that hold none of these steps."""
        wanted = {self.steps[key].file for key in keys}
        for path in self.folder.glob("*.zip"):
            if path.name not in wanted:
                path.unlink()

    def _index(self, name: str, steps: pl.DataFrame) -> None:
        for key, place, time_s, lost in steps.iter_rows():
            self.steps.setdefault(key, Step(Configuration(time_s, np.array(lost, dtype=np.int64)), name, place))

    def _read(self, name: str, table: str) -> pl.DataFrame:
        held = self._held.get(name)
        return read_ways(self.folder / name, table) if held is None else held.frames[table]


@dataclass
class PlateRobots:
    """The robots of a plate, for the schedule; see `schedule.robots.Robots`.

    Attributes
    ----------
    fixed
        Digest of all that ways depend on besides the visits and the attributes here.
    on_accept
        Called with the nights and pointings that are as they shall be.
    nights
        Steps of each night accepted so far.
    """

    configurations: Configurations
    plate: Plate
    routing: RoutingSettings
    seed: int
    fixed: str
    ways: Ways
    workers: Workers
    on_accept: Callable[[int, int], None]
    nights: list[list[str]] = field(default_factory=list)
    _digests: dict[int, bytes] = field(default_factory=dict)
    _keys: dict[tuple[str, int], str] = field(default_factory=dict)

    @property
    def parked(self) -> State:
        """All robots at park, theta 0."""
        return State(self.plate.park_mm, np.zeros(self.plate.n_robot))

    def begin_night(self, *, is_exact: bool) -> PlateChain:
        """All robots at park; exact: what is not known is routed at once."""
        return PlateChain(self, must_be_exact=is_exact)

    def prepare(self, nights: Iterable[Chain]) -> Iterator[None]:
        """Route what is not known of these nights, the first of them while others are still asked for."""
        tasks = batches(self._jobs(nights), N_STEP_TASK, self.plate, self.routing, self.seed)
        for packed in self.workers.stream(route_and_pack, tasks):
            self.ways.keep(packed)
            yield

    def _jobs(self, nights: Iterable[Chain]) -> Iterator[ChainJob]:
        """What is not known, once: nights that begin with the same visits share their ways."""
        asked: set[str] = set()
        for night in nights:
            job = night.job() if isinstance(night, PlateChain) else None
            if job is not None and job.keys[-1] not in asked:
                asked.update(job.keys)
                yield job

    def accept(self, chain: Chain) -> None:
        """This night, the next one, is as it shall be."""
        if isinstance(chain, PlateChain):
            self.ways.release()
            self.nights.append(chain.keys)
            self.on_accept(1, len(chain.keys))

    def key(self, before: str, visit: int) -> str:
        """Name of the step to a visit after another step (or `fixed`, from park)."""
        if (before, visit) not in self._keys:
            if visit not in self._digests:
                self._digests[visit] = self.configurations.goal(visit).digest()
            self._keys[before, visit] = sha256(before.encode() + self._digests[visit]).hexdigest()[:32]
        return self._keys[before, visit]

    def state_after(self, key: str) -> State:
        """Where the robots stand after a known step."""
        step = self.ways.steps[key]
        rows = self.ways.read(step.file, "exposure_allocations").filter(exposure_id=step.place)
        return State(rows.select("x_mm", "y_mm").to_numpy(order="c"), rows["theta_deg"].to_numpy())

    def route_now(self, job: ChainJob) -> None:
        """Route a chain here."""
        for batch in batches([job], 1, self.plate, self.routing, self.seed):
            self.ways.hold(route_chains(batch))


@dataclass(frozen=True)
class Thought:
    """A way to a visit were no robot in another's way.

    Attributes
    ----------
    end, time_s
        How the robots stand after it, and when the last of them does, s.
    """

    match: Match
    end: State
    time_s: float

    @classmethod
    def of(cls, plate: Plate, goal: Goal, start: State) -> Thought:
        """The way from where the robots stand."""
        match = Match.of(plate, goal, start)
        alone_s, theta_deg = alone(plate.instrument, start.position_mm, start.theta_deg, match.goal_mm)
        return cls(match, State(match.goal_mm, theta_deg), float(alone_s.max()))


class PlateChain:
    """One night of `PlateRobots`.

    A way that is not known is estimated. Where its time matters, targets are matched as they will be and robots go straight,
    as if each were alone: nearly always they can. Else it takes the usual time.

    Attributes
    ----------
    visits, keys
        Pointings so far: places of their visits, names of their steps.
    """

    def __init__(self, robots: PlateRobots, *, must_be_exact: bool) -> None:
        self.robots, self.must_be_exact = robots, must_be_exact
        self.visits: list[int] = []
        self.keys: list[str] = []
        # What was thought of the pointings so far, as far as it was needed, and of the visit that was asked for last.
        self._thoughts: list[Thought | None] = []
        self._asked: Thought | None = None

    @property
    def is_known(self) -> bool:
        """Whether all steps are known."""
        return all(key in self.robots.ways.steps for key in self.keys)

    def configure(self, visit: int, usual_s: float, free_s: float) -> Configuration:
        """The way to a visit from where the robots stand."""
        key, steps = self._key(visit), self.robots.ways.steps
        if key not in steps and self.must_be_exact:
            self.robots.route_now(self._job(len(self.keys), [key], [visit], [None]))
        self._asked = None
        if key in steps:
            return steps[key].configuration
        if usual_s * FAR_FROM_USUAL > free_s:
            self._asked = self._think(visit)
        return Configuration(usual_s if self._asked is None else self._asked.time_s, np.empty(0, dtype=np.int64))

    def go(self, visit: int) -> None:
        """The pointing is made."""
        self.keys.append(self._key(visit))
        self.visits.append(visit)
        self._thoughts.append(self._asked)

    def job(self) -> ChainJob | None:
        """What is not known of the pointings so far."""
        steps = self.robots.ways.steps
        n_known = next((n for n, key in enumerate(self.keys) if key not in steps), len(self.keys))
        if n_known == len(self.keys):
            return None
        matches = [None if thought is None else thought.match for thought in self._thoughts[n_known:]]
        return self._job(n_known, self.keys[n_known:], self.visits[n_known:], matches)

    def _think(self, visit: int) -> Thought:
        """A visit after the pointings so far."""
        steps, known = self.robots.ways.steps, len(self.keys)
        while known > 0 and self._thoughts[known - 1] is None and self.keys[known - 1] not in steps:
            known -= 1
        for n in range(known, len(self.keys)):
            self._thoughts[n] = self._thought(n, self.visits[n])
        return self._thought(len(self.keys), visit)

    def _thought(self, n_before: int, visit: int) -> Thought:
        before = self._thoughts[n_before - 1] if n_before else None
        start = self._state_after(n_before) if before is None else before.end
        return Thought.of(self.robots.plate, self.robots.configurations.goal(visit), start)

    def _key(self, visit: int) -> str:
        return self.robots.key(self.keys[-1] if self.keys else self.robots.fixed, visit)

    def _state_after(self, n_step: int) -> State:
        """Where the robots stand after so many steps, which are known."""
        return self.robots.state_after(self.keys[n_step - 1]) if n_step else self.robots.parked

    def _job(self, n_before: int, keys: Sequence[str], visits: Sequence[int], matches: Sequence[Match | None]) -> ChainJob:
        goals = tuple(self.robots.configurations.goal(visit) for visit in visits)
        return ChainJob(self._state_after(n_before), tuple(keys), goals, tuple(matches))
