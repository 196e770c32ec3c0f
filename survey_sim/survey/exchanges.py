"""The search for a visit whose robots are not in each other's way: exchanges of targets, one upon another, best first.

Most visits are at their bound, and of the rest most are after an exchange or two. So what is tried is routed at the bound
first, and what is not to be had there is given up, and routed whole only where nothing better is found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from heapq import heappop, heappush
from itertools import islice
from typing import Generic, TypeVar

import numpy as np

from survey_sim.geometry import FloatArray
from survey_sim.routing import HeldUp, RoutedPath, UnroutedReason

# Time that a path takes beyond its bound counts so much more, and so much again what is far beyond: longer ways that nobody
# crosses are better than robots that must go around each other.
EXCESS_WEIGHT = 2.0
FAR_FRAC, FAR_WEIGHT = 0.05, 10.0
# Times as many exchanges are tried while a path is far beyond its bound.
PATIENCE_IF_FAR = 3
# Who comes next is a little further behind with each exchange that was tried from the same visit.
TRIED_FRAC = 0.01


@dataclass(frozen=True)
class Tried:
    """A visit that was routed, all of it or until a path was given up.

    Attributes
    ----------
    paths
        The visit's paths; those after one that was given up are not routed, but taken to be at their bounds.
    """

    paths: tuple[RoutedPath | HeldUp, ...]

    @cached_property
    def is_whole(self) -> bool:
        """Whether all paths are routed."""
        return not any(isinstance(path, HeldUp) for path in self.paths)

    @property
    def routed(self) -> tuple[RoutedPath, ...]:
        """The paths, if all are routed."""
        return tuple(path for path in self.paths if isinstance(path, RoutedPath))

    @cached_property
    def cost(self) -> tuple[int, float]:
        """Robots that do not arrive, and the time of all paths, s; what lies above the bounds counts more."""
        return sum(len(_lost(path)) for path in self.paths), sum(map(_weighted_s, self.paths))

    @cached_property
    def blamed(self) -> tuple[int, ...]:
        """Robots that do not arrive, or hold the others up, of one path after the other."""
        lost = [robot for path in self.paths for robot in _lost(path)]
        held_up = [robot for path in self.paths for robot in path.held_up]
        return tuple(dict.fromkeys([*lost, *held_up]))

    @cached_property
    def is_far(self) -> bool:
        """Whether a path takes more than `FAR_FRAC` longer than its bound."""
        return any(_far_s(path.configuration_time_s, path.lower_bound_s) > 0.0 for path in self.paths)


T = TypeVar("T", bound=Tried)


@dataclass(frozen=True)
class Proposal(Generic[T]):
    """A visit that may be tried.

    Attributes
    ----------
    goal_mm
        (n_robot, 2) where the robots shall end.
    least_s
        Time that its paths take together at the least.
    routed
        Routes it, whole or until a path is given up.
    """

    goal_mm: FloatArray
    least_s: float
    routed: Callable[[], T]


def _lost(path: RoutedPath | HeldUp) -> list[int]:
    """Robots that do not arrive."""
    return [] if isinstance(path, HeldUp) else np.flatnonzero(path.reason != UnroutedReason.ARRIVED).tolist()


def _weighted_s(path: RoutedPath | HeldUp) -> float:
    time_s, bound_s = path.configuration_time_s, path.lower_bound_s
    return time_s + EXCESS_WEIGHT * (time_s - bound_s) + FAR_WEIGHT * _far_s(time_s, bound_s)


def _far_s(time_s: float, bound_s: float) -> float:
    return max(0.0, time_s - (1.0 + FAR_FRAC) * bound_s)


def least_costly(
    first: Proposal[T], others: Callable[[T], Iterator[Proposal[T] | None]], whole: Callable[[T], T], n_trial: int
) -> T:
    """The visit of least cost that is found from the first on, routed whole.

    Parameters
    ----------
    others
        What a visit becomes by one exchange, one after another; None where one cannot be made.
    whole
        Routes all paths of a visit.
    n_trial
        Trials at most, `PATIENCE_IF_FAR` times as many while the best found has a path far beyond its bound. Goals that
        were tried before, and visits that cannot be better than the best, count as trials, and are not routed.
    """
    tried = [first.routed()]
    known, serial = {first.goal_mm.tobytes()}, 0
    queue = [(*tried[0].cost, serial, 0, tried[0], others(tried[0]))]
    aside: list[Proposal[T]] = []
    while True:
        place = min(range(len(tried)), key=lambda number: tried[number].cost)
        best = tried[place]
        if best.is_whole and not best.blamed:
            return best
        if serial >= n_trial or not queue:
            if not best.is_whole:
                tried[place] = whole(best)
                if aside:  # It may take longer than was thought: they come first now.
                    heappush(queue, (0, 0.0, serial, 0, best, iter(aside)))
                    aside = []
                continue
            if not queue or not best.is_far or serial >= n_trial * PATIENCE_IF_FAR:
                return best
        n_unrouted, time_s, number, n_tried, _, exchanges = visit = heappop(queue)
        for proposal in islice(exchanges, 1):
            serial += 1
            heappush(queue, (n_unrouted, time_s * (1.0 + TRIED_FRAC), number, n_tried + 1, *visit[4:]))
            if proposal is None or proposal.goal_mm.tobytes() in known:
                continue
            if (0, proposal.least_s) > best.cost:
                aside.append(proposal)
                continue
            known.add(proposal.goal_mm.tobytes())
            other = proposal.routed()
            tried.append(other)
            if other.blamed:
                heappush(queue, (*other.cost, serial, 0, other, others(other)))
