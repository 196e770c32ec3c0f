"""The search over exchanges: best first, one upon another, and no more trials than given."""

from collections.abc import Iterator
from dataclasses import dataclass

from survey_sim.survey.exchanges import PATIENCE_IF_FAR, least_costly


@dataclass(frozen=True)
class Visit:
    """A made-up visit."""

    name: str
    time_s: float
    is_above: bool = True
    is_far: bool = False

    @property
    def cost(self) -> tuple[int, float]:
        return 0, self.time_s

    @property
    def blamed(self) -> tuple[int, ...]:
        return (1,) if self.is_above else ()


def graph(edges: dict[str, list[Visit | None]], seen: list[str]):
    def others(visit: Visit) -> Iterator[Visit | None]:
        for other in edges.get(visit.name, []):
            seen.append(other.name if other else "-")
            yield other

    return others


def test_exchanges_add_up_through_a_worse_visit():
    """Neither exchange alone helps; the second upon the first does, and ends the search."""
    first, worse, best = Visit("a", 10.0), Visit("b", 10.5), Visit("c", 8.0, is_above=False)
    seen: list[str] = []
    others = graph({"a": [None, worse, Visit("d", 12.0), Visit("e", 9.0)], "b": [best]}, seen)
    assert least_costly(first, others, 20) is best
    assert seen[-1] == "c"


def test_the_search_ends_after_so_many_trials_with_the_best_so_far():
    better = Visit("b", 9.0)
    seen: list[str] = []
    others = graph({"a": [None, better, None, None]}, seen)
    first = Visit("a", 10.0)
    assert least_costly(first, others, 0) is first
    assert least_costly(first, others, 1) is first
    assert least_costly(first, others, 3) is better
    assert len(seen) == 4


def test_the_search_goes_on_longer_while_a_path_is_far_beyond_its_bound():
    far, near = Visit("b", 9.0, is_far=True), Visit("c", 8.0)
    first = Visit("a", 10.0, is_far=True)
    seen: list[str] = []
    assert least_costly(first, graph({"a": [None] * 4 + [far, near, None, None]}, seen), 2) is near
    assert len(seen) == 2 * PATIENCE_IF_FAR
    assert least_costly(near, graph({"c": [None] * 9}, seen := []), 2) is near
    assert len(seen) == 2


def test_of_equal_visits_the_first_is_kept_and_nothing_left_to_try_ends_it():
    first = Visit("a", 10.0)
    assert least_costly(first, graph({"a": [Visit("b", 10.0)]}, []), 99) is first


def test_a_visit_at_the_bound_is_left_alone():
    seen: list[str] = []
    first = Visit("a", 10.0, is_above=False)
    assert least_costly(first, graph({"a": [Visit("b", 1.0)]}, seen), 9) is first
    assert not seen
