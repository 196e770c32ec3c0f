"""What the schedule asks of the robots: how long the way from one configuration to the next takes."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

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

    def configure(self, visit: int, usual_s: float) -> Configuration:
        """The way to a visit from where the robots stand; they do not go yet.

        `usual_s`: what such a way usually takes, the estimate where it is not known.
        """

    def go(self, visit: int) -> None:
        """The pointing is made: the robots go to the visit just asked for."""


class Robots(Protocol):
    """Whoever knows where the robots stand and how they move.

    Attributes
    ----------
    n_ahead
        Nights that are scheduled with estimates at a time, while the ways of the first of them are found.
    """

    n_ahead: int

    def begin_night(self, *, is_exact: bool) -> Chain:
        """All robots at park; exact: no estimate will do."""

    def prepare(self, chains: Iterable[Chain]) -> None:
        """Take all of these nights, each decided when it is asked for, and learn the ways that they would take."""

    def accept(self, chains: Sequence[Chain]) -> None:
        """These nights, the next ones, are as they shall be."""


class UsualRobots:
    """Robots that take the usual time for every way, and of which none is lost."""

    def __init__(self, n_ahead: int) -> None:
        self.n_ahead = n_ahead

    def begin_night(self, *, is_exact: bool) -> UsualChain:
        """A night."""
        return UsualChain()

    def prepare(self, chains: Iterable[Chain]) -> None:
        """Nothing to learn of them."""
        deque(chains, maxlen=0)

    def accept(self, chains: Sequence[Chain]) -> None:
        """Nothing to keep."""


class UsualChain:
    """One night of `UsualRobots`."""

    is_exact = True

    def configure(self, visit: int, usual_s: float) -> Configuration:
        """The usual time."""
        return Configuration(usual_s, np.empty(0, dtype=np.int64))

    def go(self, visit: int) -> None:
        """Nothing to note."""
