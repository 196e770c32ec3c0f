"""What the schedule asks of the robots: how long the way from one configuration to the next takes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
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
    def is_known(self) -> bool:
        """Whether the ways to all visits that they went to are known by now."""

    def configure(self, visit: int, usual_s: float, free_s: float) -> Configuration:
        """The way to a visit from where the robots stand; they do not go yet.

        `usual_s`: what such a way usually takes; `free_s`: what costs nothing, since the telescope waits anyway.
        """

    def go(self, visit: int) -> None:
        """The pointing is made: the robots go to the visit just asked for."""


class Robots(Protocol):
    """Whoever knows where the robots stand and how they move."""

    def begin_night(self, *, is_exact: bool) -> Chain:
        """All robots at park; exact: no estimate will do."""

    def prepare(self, nights: Iterable[Chain]) -> Iterator[None]:
        """Learn the ways of nights as they are thought to go, each asked for when there is room for it.

        Yields whenever more is known; at its end, all is.
        """

    def accept(self, chain: Chain) -> None:
        """The next night is as it shall be."""


class UsualRobots:
    """Robots that take the usual time for every way, and of which none is lost."""

    def begin_night(self, *, is_exact: bool) -> UsualChain:
        """A night."""
        return UsualChain()

    def prepare(self, nights: Iterable[Chain]) -> Iterator[None]:
        """Nothing to learn: no night need be thought of ahead."""
        return iter(())

    def accept(self, chain: Chain) -> None:
        """Nothing to keep."""


class UsualChain:
    """One night of `UsualRobots`."""

    is_known = True

    def configure(self, visit: int, usual_s: float, free_s: float) -> Configuration:
        """The usual time."""
        return Configuration(usual_s, np.empty(0, dtype=np.int64))

    def go(self, visit: int) -> None:
        """Nothing to note."""
