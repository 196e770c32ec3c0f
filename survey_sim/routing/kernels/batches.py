"""The batches of `simple-vector`."""

# Kernels take flat arrays and untyped scalars, and are long where splitting them would cost calls.
# ruff: noqa: PLR0912
# mypy: disable-error-code="no-untyped-def"
import numpy as np

from survey_sim.kernel import kernel
from survey_sim.routing.kernels.geometry import point_segment2, segment_segment2


@kernel
def simple_vector_batches(start, goal, has_to_move, separation):
    """(n,) batch in which each robot goes straight to its goal, -1 for those that stay.

    A batch holds robots whose swept lines keep the separation from each other, whatever their timing, and from all that
    stand meanwhile. Robots with fewest crossings join first.
    """
    n = len(start)
    r2 = separation * separation
    is_crossing = np.zeros((n, n), dtype=np.bool_)
    n_crossing = np.zeros(n, dtype=np.int64)
    for i in range(n):
        for j in range(i):
            if (has_to_move[i] or has_to_move[j]) and segment_segment2(start[i], goal[i], start[j], goal[j]) < r2:
                is_crossing[i, j] = is_crossing[j, i] = True
                n_crossing[i] += 1
                n_crossing[j] += 1
    order = np.argsort(n_crossing, kind="mergesort")
    batch = np.full(n, -1, dtype=np.int64)
    now = start.copy()
    members = np.empty(n, dtype=np.int64)
    k = 0
    while True:
        n_member = 0
        for i in order:
            if not has_to_move[i] or batch[i] >= 0:
                continue
            is_clear = True
            for j in range(n):
                if j == i:
                    continue
                if batch[j] == k:
                    blocked = is_crossing[i, j]
                else:
                    blocked = point_segment2(now[j, 0], now[j, 1], start[i, 0], start[i, 1], goal[i, 0], goal[i, 1]) < r2
                if blocked:
                    is_clear = False
                    break
            if is_clear:
                batch[i] = k
                members[n_member] = i
                n_member += 1
        if n_member == 0:
            return batch
        for m in range(n_member):
            now[members[m]] = goal[members[m]]
        k += 1
