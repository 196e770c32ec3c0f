"""What the schedule asks of the robots: how long the way from one configuration to the next takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from survey_sim.schedule.kernels import Visits, configuration_time

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Configuration:
    """The way to a visit's configuration.

    Attributes
    ----------
    time_s
        When the last robot comes to rest, s.
    lost
        Ids of the visit's targets that no robot reaches.
    """

    time_s: float
    lost: IntArray


class Chain(Protocol):
    """The robots through one night: from park, each configuration from the one before."""

    @property
    def is_exact(self) -> bool:
        """Whether no time that was given is an estimate."""

    def configure(self, visit: int) -> Configuration:
        """The way to a visit from where the robots stand; they do not go yet."""

    def go(self, visit: int) -> None:
        """The pointing is made: the robots go to the visit just asked for."""


class Robots(Protocol):
    """Whoever knows where the robots stand and how they move.

    Attributes
    ----------
    n_ahead
        Nights to be scheduled with estimates before the ways of all of them are asked for at once.
    """

    n_ahead: int

    def begin_night(self, *, is_exact: bool) -> Chain:
        """All robots at park; exact: no estimate will do."""

    def prepare(self, chains: Sequence[Chain]) -> None:
        """Learn the ways that these nights would take."""

    def accept(self, chains: Sequence[Chain]) -> None:
        """These nights, the next ones, are as they shall be."""


class TabledRobots:
    """Robots whose times are looked up: a constant, or those of the visits' paths.

    Parameters
    ----------
    constant_s
        Time of every configuration, s; < 0: that of `kernels.configuration_time`.
    """

    def __init__(self, visits: Visits, constant_s: float, n_ahead: int) -> None:
        self.visits, self.constant_s, self.n_ahead = visits, constant_s, n_ahead

    def begin_night(self, *, is_exact: bool) -> TabledChain:
        return TabledChain(self.visits, self.constant_s)

    def prepare(self, chains: Sequence[Chain]) -> None:
        """Nothing to learn."""

    def accept(self, chains: Sequence[Chain]) -> None:
        """Nothing to keep."""


class TabledChain:
    """One night of `TabledRobots`."""

    is_exact = True

    def __init__(self, visits: Visits, constant_s: float) -> None:
        self.visits, self.constant_s, self.previous = visits, constant_s, -1

    def configure(self, visit: int) -> Configuration:
        time_s = configuration_time(self.visits, visit, self.previous, self.constant_s)
        return Configuration(time_s, np.empty(0, dtype=np.int64))

    def go(self, visit: int) -> None:
        self.previous = visit
