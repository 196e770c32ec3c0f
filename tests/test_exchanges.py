"""The search over exchanges: best first, one upon another, no more trials than given, and routed whole only at need."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest

from survey_sim.motion import Legs
from survey_sim.routing import HeldUp, RoutedPath, UnroutedReason
from survey_sim.survey.exchanges import PATIENCE_IF_FAR, Proposal, Tried, least_costly

BOUND_S = 8.0
NO_LEGS = Legs(np.empty(0, np.int32), np.empty(0, np.int16), *(np.empty(0) for _ in range(8)))


def whole_path(time_s, *, bound_s=BOUND_S, lost=()):
    """A path of three robots that takes so long; robot 1 is to blame if that is above the bound."""
    reason = np.full(3, UnroutedReason.ARRIVED, np.int8)
    reason[list(lost)] = UnroutedReason.NO_PATH
    held_up = (1,) if time_s > bound_s else ()
    return RoutedPath(NO_LEGS, reason, np.zeros((3, 2)), np.zeros(3), bound_s, time_s, held_up)


@dataclass(frozen=True)
class Visit(Tried):
    """A made-up visit."""

    name: str


class Graph:
    """Visits that become others: by name, their times (whole, or given up), and what they become.

    Attributes
    ----------
    seen, made_whole
        Visits that were routed, and that were routed whole besides, in order.
    """

    def __init__(self, times, edges, about=None):
        self.times, self.edges, self.about = times, edges, about or {}
        self.seen, self.made_whole, self.n_asked = [], [], 0

    def proposal(self, name, least_s=0.0) -> Proposal[Visit]:
        return Proposal(np.frombuffer(name.encode(), np.uint8), least_s, lambda: self.routed(name))

    def routed(self, name) -> Visit:
        self.seen.append(name)
        about_s = self.about.get(name)
        path = whole_path(self.times[name]) if about_s is None else HeldUp(BOUND_S, about_s, (1,))
        return Visit((path,), name)

    def whole(self, visit) -> Visit:
        self.made_whole.append(visit.name)
        return replace(visit, paths=(whole_path(self.times[visit.name]),))

    def others(self, visit) -> Iterator[Proposal[Visit] | None]:
        for edge in self.edges.get(visit.name, []):
            self.n_asked += 1
            yield edge if edge is None or isinstance(edge, Proposal) else self.proposal(edge)

    def best(self, n_trial) -> str:
        self.seen, self.made_whole, self.n_asked = [], [], 0
        found = least_costly(self.proposal("a"), self.others, self.whole, n_trial)
        assert found.is_whole
        return found.name


def test_exchanges_add_up_through_a_worse_visit():
    """Neither exchange alone helps; the second upon the first does, and ends the search."""
    times = {"a": 8.2, "b": 8.25, "c": 8.0, "d": 8.4, "e": 8.19}
    graph = Graph(times, {"a": [None, "b", "d", "e"], "b": ["c"]})
    assert graph.best(20) == "c"
    assert graph.seen[-1] == "c"


def test_the_search_ends_after_so_many_trials_with_the_best_so_far():
    graph = Graph({"a": 8.2, "b": 8.1}, {"a": [None, "b", None, None]})
    assert graph.best(0) == "a"
    assert graph.best(1) == "a"
    assert graph.best(3) == "b"
    assert graph.n_asked == 3


def test_the_search_goes_on_longer_while_a_path_is_far_beyond_its_bound():
    """Only while the best is: b is not, and ends it."""
    graph = Graph({"a": 10.0, "b": 8.1}, {"a": [None] * 4 + ["b", None, None]})
    assert graph.best(2) == "b"
    assert graph.n_asked == 5
    assert graph.best(1) == "a"
    assert graph.n_asked == PATIENCE_IF_FAR


def test_of_equal_visits_the_first_is_kept_and_nothing_left_to_try_ends_it():
    assert Graph({"a": 8.2, "b": 8.2}, {"a": ["b"]}).best(99) == "a"


def test_a_visit_at_the_bound_is_left_alone():
    graph = Graph({"a": 8.0, "b": 1.0}, {"a": ["b"]})
    assert graph.best(9) == "a"
    assert graph.n_asked == 0


def test_goals_known_and_visits_that_cannot_be_better_are_not_routed():
    graph = Graph({"a": 8.2, "b": 8.3}, {})
    slow = graph.proposal("slow", least_s=20.0)
    graph.edges = {"a": ["b", "b", slow, "a"], "b": ["a"]}
    assert graph.best(20) == "a"
    assert graph.seen == ["a", "b"]


def test_what_was_given_up_is_routed_whole_only_where_nothing_better_is_found():
    times, edges = {"a": 8.1, "b": 8.0}, {"a": ["b"]}
    graph = Graph(times, edges, about={"a": 8.1})
    assert graph.best(5) == "b"
    assert graph.made_whole == []
    assert Graph(times, {}, about={"a": 8.1}).best(5) == "a"


def test_what_takes_longer_than_it_was_thought_to_gives_way():
    """a and b are given up; b is thought the better, is not, and a is routed whole as well."""
    graph = Graph({"a": 8.2, "b": 8.3}, {"a": ["b"]}, about={"a": 8.15, "b": 8.1})
    assert graph.best(5) == "a"
    assert graph.made_whole == ["b", "a"]


def test_what_seemed_hopeless_is_tried_once_the_best_takes_longer_than_was_thought():
    """b takes longer than a was thought to take, but less than it does."""
    graph = Graph({"a": 20.0, "b": 15.0}, {}, about={"a": 8.1})
    graph.edges = {"a": [graph.proposal("b", least_s=14.0)]}
    assert graph.best(1) == "b"
    assert graph.seen == ["a", "b"]
    near = Graph({"a": 8.2, "b": 8.0}, {}, about={"a": 8.1})
    near.edges = {"a": [near.proposal("b", least_s=14.0)]}
    assert near.best(1) == "a"
    assert near.seen == ["a"]


def test_who_does_not_arrive_costs_most_and_is_blamed_first():
    lost, slow = Tried((whole_path(8.0, lost=[2]),)), Tried((whole_path(20.0),))
    assert slow.cost < lost.cost
    both = Tried((whole_path(8.5), whole_path(8.0, lost=[2])))
    assert both.blamed == (2, 1)
    assert slow.is_far
    assert not lost.is_far
    # 0.1 s above the bound counts three times; the second path is at its bound.
    assert Tried((whole_path(8.1), whole_path(8.0))).cost == (0, pytest.approx(16.3))
