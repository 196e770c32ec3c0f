"""Plain-loop reference of the plate's transitions: every way to share out a visit's targets is tried."""

from itertools import permutations
from math import dist


def least_cost(start, goals, may_hold, power):
    """Least sum of travel^power over all ways to give each goal to a robot that may hold it.

    start: places of robots; goals: places; may_hold: robots that may hold each goal.
    """
    best = float("inf")
    for takers in permutations(range(len(start)), len(goals)):
        if all(taker in may_hold[k] for k, taker in enumerate(takers)):
            best = min(best, sum(dist(start[taker], goals[k]) ** power for k, taker in enumerate(takers)))
    return best
