"""The search for a visit whose robots are not in each other's way: exchanges of targets, one upon another, best first."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from heapq import heappop, heappush
from typing import Protocol, TypeVar

from survey_sim.routing import RoutedPath, UnroutedReason

# Time that a path takes beyond its bound counts so much more, and so much again what is far beyond: longer ways that nobody
# crosses are better than robots that must go around each other.
EXCESS_WEIGHT = 2.0
FAR_FRAC, FAR_WEIGHT = 0.05, 10.0
# Times as many exchanges are tried while a path is far beyond its bound.
PATIENCE_IF_FAR = 3
# Who comes next is a little further behind with each exchange that was tried from the same visit.
TRIED_FRAC = 0.01


class Tried(Protocol):
    """A visit that was routed."""

    @property
    def cost(self) -> tuple[int, float]:
        """Robots that do not arrive, and time, s."""

    @property
    def blamed(self) -> Sequence[int]:
        """Robots that are in the way, or do not arrive."""

    @property
    def is_far(self) -> bool:
        """Whether a path is far beyond its bound (`is_any_far`)."""


T = TypeVar("T", bound=Tried)


def cost_of(*paths: RoutedPath) -> tuple[int, float]:
    """Robots that do not arrive, and the time of all paths, s; what lies above the bounds counts more."""
    n_unrouted = sum(int((path.reason != UnroutedReason.ARRIVED).sum()) for path in paths)
    return n_unrouted, sum(_weighted_s(path.configuration_time_s, path.lower_bound_s) for path in paths)


def is_any_far(*paths: RoutedPath) -> bool:
    """Whether one of the paths takes more than `FAR_FRAC` longer than its bound."""
    return any(_far_s(path.configuration_time_s, path.lower_bound_s) > 0.0 for path in paths)


def _weighted_s(time_s: float, bound_s: float) -> float:
    return time_s + EXCESS_WEIGHT * (time_s - bound_s) + FAR_WEIGHT * _far_s(time_s, bound_s)


def _far_s(time_s: float, bound_s: float) -> float:
    return max(0.0, time_s - (1.0 + FAR_FRAC) * bound_s)


def least_costly(first: T, others: Callable[[T], Iterator[T | None]], n_trial: int) -> T:
    """The visit of least cost that is found from the first on.

    Parameters
    ----------
    n_trial
        Trials at most, `PATIENCE_IF_FAR` times as many while the best found has a path far beyond its bound.
    others
        What a visit becomes by one exchange, one after another; None where one cannot be made.
    """
    best, serial = first, 0
    queue = [(*first.cost, serial, 0, first, others(first))]
    while queue and best.blamed and serial < n_trial * (PATIENCE_IF_FAR if best.is_far else 1):
        n_unrouted, time_s, number, n_tried, _, exchanges = visit = heappop(queue)
        for other in exchanges:
            serial += 1
            key = (n_unrouted, time_s * (1.0 + TRIED_FRAC), number, n_tried + 1)
            heappush(queue, (*key, *visit[4:]))
            if other is not None:
                if other.blamed:
                    heappush(queue, (*other.cost, serial, 0, other, others(other)))
                best = min(best, other, key=lambda tried: tried.cost)
            break
    return best
