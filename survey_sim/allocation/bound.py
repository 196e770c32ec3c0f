"""Upper bounds of completeness: what no allocator of one tile can beat."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.optimize import linprog
from scipy.sparse.csgraph import maximum_flow

from survey_sim.allocation.field import Field, make_field
from survey_sim.allocation.kernels.bound import clique_parts, cliques_by_pair, most_apart, windows_within
from survey_sim.allocation.kernels.lists import near_among
from survey_sim.allocation.settings import AllocationSettings
from survey_sim.allocation.targets import FieldTargets, FloatArray, IntArray
from survey_sim.instrument import Plate

# Radii of the windows in which the most targets apart are counted, in separations: neighbours of a target, and a bit more.
WINDOW_RADII = (1.0, 1.5)
# Cliques grown from each target: all of them where targets are not very crowded.
N_SEED = 8
# Parts of a fibre that flows are counted in.
FLOW_UNIT = 100


def completeness_bound(
    targets: FieldTargets,
    plate: Plate,
    n_visits: int,
    *,
    n_done: npt.ArrayLike | None = None,
    n_reserved: int = 0,
    method: Literal["linear", "fast"] = "linear",
    field: Field | None = None,
) -> float:
    """Upper bound of the completeness of a tile after so many visits.

    A visit gives each target at most one fibre, each live robot at most one target, and a set of targets no more fibres than
    it has targets apart from each other: 1 in a clique, and in a window of up to 64 targets a number found exactly. The
    linear programme maximises the completed targets, each counted by its fraction of wanted visits; whole targets are
    counted at the end.

    Parameters
    ----------
    n_visits
        Visits of the whole tile, or of what is left of it where `n_done` is given.
    n_done
        (n_target,) visits that science targets have received already.
    n_reserved
        Fibres of every visit that science cannot have.
    method
        "linear", or "fast": fibres and one partition into cliques alone (under a millisecond, looser).
    field
        The targets on the plate as `make_field` makes them, where they are at hand: it takes longer than a fast bound.

    Returns
    -------
        Complete science targets on the plate / science targets on the plate.
    """
    field = field or make_field(targets, plate, AllocationSettings.load({}))
    n_fibre = max(0, plate.n_science_live - n_reserved)
    if method == "fast":
        return float(_fast(field, n_done, [n_visits], n_fibre)[0])
    n_counted, n_complete, served, missing = _wanted(field, n_done)
    if not n_counted:
        return 1.0
    is_open = missing <= n_visits
    return (n_complete + _linear(field, served[is_open], missing[is_open], n_visits, n_visits * n_fibre)) / n_counted


def fast_bounds(field: Field, most_visits: int) -> FloatArray:
    """(most_visits,) the fast `completeness_bound` of a tile after 1, 2, ... visits, of what `make_field` makes."""
    return _fast(field, None, range(1, most_visits + 1), field.plate.n_science_live)


def _wanted(field: Field, n_done: npt.ArrayLike | None) -> tuple[int, int, IntArray, IntArray]:
    """Numbers of science targets on the plate, and of those complete; the others that can be served, and what each wants."""
    targets, plate = field.targets, field.plate
    is_counted = targets.is_science & field.is_on_plate
    done = np.zeros(targets.n_target, dtype=np.int64) if n_done is None else np.asarray(n_done)
    missing = np.where(is_counted, np.maximum(targets.wanted_visits - done, 0), 0)
    can_be_served = field.is_reached & ~field.blocked_by(plate.park_mm[~plate.is_live])
    served = np.flatnonzero(can_be_served & (missing > 0))
    return int(is_counted.sum()), int((is_counted & (missing == 0)).sum()), served, missing[served]


def _fast(field: Field, n_done: npt.ArrayLike | None, n_visits: Sequence[int], n_fibre: int) -> FloatArray:
    """Completeness at most after each of these numbers of visits, ascending, of so many fibres each.

    By fibres in all, and by a partition into cliques, each of which has a fibre a visit.
    """
    n_counted, n_complete, served, missing = _wanted(field, n_done)
    if not n_counted:
        return np.ones(len(n_visits))
    bound, n_open = np.full(len(n_visits), n_complete), 0
    for k, n in enumerate(n_visits):
        is_open = missing <= n
        if is_open.sum() > n_open:
            n_open = is_open.sum()
            within, fibres = _used_fibres(field, served[is_open], missing[is_open])
        if n_open:
            bound[k] += min(np.searchsorted(within, n, side="right"), np.searchsorted(fibres, n * n_fibre, side="right"))
    return bound / n_counted


def _used_fibres(field: Field, chosen: IntArray, missing: IntArray) -> tuple[IntArray, IntArray]:
    """Fibres used up when each target is complete, those that want few first, ascending: of its clique's, and of all."""
    part = clique_parts(*_neighbours(field, chosen))
    order = np.lexsort((missing, part))
    before = np.cumsum(missing[order])
    starts = np.searchsorted(part[order], np.arange(part.max(initial=-1) + 1))
    within = before - np.concatenate([[0], before])[starts][part[order]]
    return np.sort(within), np.cumsum(np.sort(missing))


def _linear(field: Field, chosen: IntArray, missing: IntArray, n_visits: int, n_fibre: int) -> int:
    """Complete targets at most, by the linear programme over fibres, cliques, windows and robots in reach."""
    if not len(chosen) or n_fibre <= 0:
        return 0
    rows, rank = _rank_rows(field, chosen, n_visits)
    ranks = _matrix([*rows, np.arange(len(chosen))], len(chosen))
    limits = np.array([*rank, n_fibre], dtype=np.float64)
    worth = 1.0 / missing
    result: Any = linprog(-worth, A_ub=ranks, b_ub=limits, bounds=[(0.0, float(wanted)) for wanted in missing])
    reach = _reach_matrix(field, chosen)
    if not _can_be_reached(reach, result.x, n_visits):
        # A variable a pair of target and robot: some ten times slower, so only where reach matters.
        by_target, by_robot = _pair_matrices(reach)
        result = linprog(
            -worth @ by_target,
            A_ub=sparse.vstack([ranks @ by_target, by_target, by_robot]),
            b_ub=np.concatenate([limits, missing, np.full(reach.shape[1], n_visits)]),
        )
    return int(np.floor(-result.fun + 1e-6))


def _neighbours(field: Field, chosen: IntArray) -> tuple[FloatArray, float, IntArray, npt.NDArray[np.int32]]:
    """Arguments of the clique kernels for some of the targets, numbered among themselves."""
    first, near = near_among(chosen, field.targets.n_target, field.near_first, field.near)
    return np.ascontiguousarray(field.xy_mm[chosen]), field.separation_mm, first, near


def _rank_rows(field: Field, chosen: IntArray, n_visits: int) -> tuple[list[IntArray], list[int]]:
    """Sets of targets that cannot all be served in so many visits, each with the fibres that they can get."""
    xy, separation, first, near = _neighbours(field, chosen)
    rows: dict[tuple[int, ...], int] = {}
    clique_first, member = cliques_by_pair(xy, separation, first, near, n_visits + 1, N_SEED)
    for begin, end in pairwise(clique_first):
        rows[tuple(member[begin:end].tolist())] = n_visits
    for radius in WINDOW_RADII:
        window_first, member = windows_within(xy, radius * separation)
        for begin, end in pairwise(window_first):
            if end - begin > n_visits:
                limit = n_visits * int(most_apart(member[begin:end], xy, separation))
                if end - begin > limit:
                    rows.setdefault(tuple(sorted(member[begin:end].tolist())), limit)
    return [np.array(row, dtype=np.int64) for row in rows], list(rows.values())


def _matrix(rows: list[IntArray], n: int) -> Any:
    pointer = np.concatenate([[0], np.cumsum([len(row) for row in rows])])
    columns = np.concatenate(rows)
    return sparse.csr_array((np.ones(len(columns)), columns, pointer), shape=(len(rows), n))


def _reach_matrix(field: Field, chosen: IntArray) -> sparse.csr_array:
    """(n_chosen, n_robot) robots in reach."""
    pairs = [field.reach_robot[field.reach_first[t] : field.reach_first[t + 1]] for t in chosen]
    pointer = np.concatenate([[0], np.cumsum([len(robots) for robots in pairs])])
    robots = np.concatenate(pairs)
    return sparse.csr_array((np.ones(len(robots)), robots, pointer), shape=(len(chosen), field.plate.n_robot))


def _pair_matrices(reach: sparse.csr_array) -> tuple[sparse.csr_array, sparse.csr_array]:
    """(n_target, n_pair) and (n_robot, n_pair): the pairs of each target and of each robot."""
    pairs = sparse.coo_array(reach)
    n_pair = len(pairs.row)
    one, number = np.ones(n_pair), np.arange(n_pair)
    return (
        sparse.csr_array((one, (pairs.row, number)), shape=(reach.shape[0], n_pair)),
        sparse.csr_array((one, (pairs.col, number)), shape=(reach.shape[1], n_pair)),
    )


def _can_be_reached(reach: sparse.csr_array, fibres: FloatArray, n_visits: int) -> bool:
    """Whether robots in reach can give every target its number of fibres in so many visits (a flow, to a hundredth)."""
    n_target, n_robot = reach.shape
    supply = np.floor(fibres * FLOW_UNIT).astype(np.int32)
    edges = sparse.coo_array(reach)
    source, sink = n_target + n_robot, n_target + n_robot + 1
    tail = np.concatenate([np.full(n_target, source), edges.row, np.arange(n_target, source)])
    head = np.concatenate([np.arange(n_target), edges.col + n_target, np.full(n_robot, sink)])
    width = np.concatenate([supply, supply[edges.row], np.full(n_robot, n_visits * FLOW_UNIT)]).astype(np.int32)
    graph: Any = sparse.coo_array((width, (tail, head)), shape=(sink + 1, sink + 1)).tocsr()
    return bool(maximum_flow(graph, source, sink).flow_value >= supply.sum())
