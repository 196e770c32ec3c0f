"""Kernels of the upper bounds: cliques of targets too close, and how many of a few targets one visit can hold."""

# ruff: noqa: PLR0912
# mypy: allow-untyped-defs

import numpy as np

from survey_sim.kernel import kernel

# Targets of one window, and bits of a mask.
MOST = 64
# Branchings after which a window's number is left at what a cover by cliques allows.
MAX_NODES = 2000


@kernel
def _bits(mask):
    n = 0
    while mask:
        mask &= mask - np.uint64(1)
        n += 1
    return n


@kernel
def most_apart(window, xy, separation):
    """Most targets of a window (at most 64) of which no two are nearer than the separation; at least that.

    Found by branching on the target with the most neighbours left; a target with none or one is always taken. An upper bound
    (a cover by cliques) is returned where that takes too long.
    """
    n = len(window)
    one = np.uint64(1)
    near = np.zeros(n, np.uint64)
    for a in range(n):
        for b in range(n):
            dx, dy = xy[window[a], 0] - xy[window[b], 0], xy[window[a], 1] - xy[window[b], 1]
            if a != b and dx * dx + dy * dy < separation * separation:
                near[a] |= one << np.uint64(b)
    everything = ~np.uint64(0) if n == MOST else (one << np.uint64(n)) - one
    left_stack, taken_stack = np.empty(4 * MOST, np.uint64), np.empty(4 * MOST, np.int64)
    left_stack[0], taken_stack[0], n_stack = everything, 0, 1
    best, n_node = 0, 0
    while n_stack > 0:
        n_stack -= 1
        left, taken = left_stack[n_stack], taken_stack[n_stack]
        n_node += 1
        if n_node > MAX_NODES:
            return _clique_cover(everything, near)
        while left:
            if taken + _clique_cover(left, near) <= best:
                break
            crowded, most, lonely = 0, -1, -1
            for a in range(n):
                if left & (one << np.uint64(a)):
                    degree = _bits(left & near[a])
                    if degree <= 1:
                        lonely = a
                        break
                    if degree > most:
                        crowded, most = a, degree
            a = lonely if lonely >= 0 else crowded
            if lonely < 0:
                left_stack[n_stack], taken_stack[n_stack] = left & ~(one << np.uint64(a)), taken
                n_stack += 1
            left &= ~(near[a] | (one << np.uint64(a)))
            taken += 1
        if not left and taken > best:
            best = taken
    return best


@kernel
def _clique_cover(left, near):
    """Number of cliques of a greedy cover: no set of targets that are apart has more."""
    one = np.uint64(1)
    n_clique = 0
    while left:
        candidates = left
        n_clique += 1
        while candidates:
            a = 0
            while not candidates & (one << np.uint64(a)):
                a += 1
            left &= ~(one << np.uint64(a))
            candidates &= near[a]
    return n_clique


@kernel
def windows_within(xy, radius):
    """Targets within a radius of each target, itself first, the nearest 64: (first (n + 1,), member)."""
    n = len(xy)
    first = np.zeros(n + 1, np.int64)
    member = np.empty(n * MOST, np.int32)
    distance = np.empty(n)
    found = np.empty(n, np.int64)
    order = np.argsort(xy[:, 0])
    begin = 0
    m = 0
    starts = np.zeros(n, np.int64)
    for a in range(n):
        i = order[a]
        while xy[order[begin], 0] < xy[i, 0] - radius:
            begin += 1
        starts[i] = begin
    for i in range(n):
        k = 0
        for b in range(starts[i], n):
            j = order[b]
            if xy[j, 0] > xy[i, 0] + radius:
                break
            d = (xy[j, 0] - xy[i, 0]) ** 2 + (xy[j, 1] - xy[i, 1]) ** 2
            if d < radius * radius:
                found[k], distance[k] = j, -1.0 if j == i else d
                k += 1
        nearest = np.argsort(distance[:k])[:MOST]
        for b in nearest:
            member[m] = found[b]
            m += 1
        first[i + 1] = m
    return first, member[:m].copy()


@kernel
def _grow(grown, size, i, xy, separation, first, near, is_shut):
    """Add neighbours of i to a clique that holds i, each time the one whose farthest member is nearest; the new size."""
    mine = near[first[i] : first[i + 1]]
    farthest = np.zeros(len(mine))
    for q in range(len(mine)):
        if is_shut[mine[q]]:
            farthest[q] = np.inf
    n_seen = 0
    while True:
        best, nearest = -1, separation * separation
        for q in range(len(mine)):
            for b in range(n_seen, size):
                d = (xy[mine[q], 0] - xy[grown[b], 0]) ** 2 + (xy[mine[q], 1] - xy[grown[b], 1]) ** 2
                farthest[q] = max(farthest[q], np.inf if grown[b] == mine[q] else d)
            if farthest[q] < nearest:
                best, nearest = q, farthest[q]
        n_seen = size
        if best < 0:
            return size
        grown[size] = mine[best]
        size += 1


@kernel
def clique_parts(xy, separation, first, near):
    """(n_target,) number of the clique that each target is in, every target in one (a greedy partition)."""
    part = np.full(len(xy), -1, np.int64)
    is_shut = np.zeros(len(xy), np.bool_)
    grown = np.empty(len(xy), np.int32)
    n = 0
    for i in range(len(xy)):
        if is_shut[i]:
            continue
        grown[0] = i
        size = _grow(grown, 1, i, xy, separation, first, near, is_shut)
        for b in range(size):
            part[grown[b]] = n
            is_shut[grown[b]] = True
        n += 1
    return part


@kernel
def cliques_by_pair(xy, separation, first, near, least, n_seed):
    """Cliques of at least so many members: (first (n_clique + 1,), member).

    One is grown from every pair of near targets, or, of a target with more neighbours than `n_seed`, from about so many.
    """
    is_shut = np.zeros(len(xy), np.bool_)
    grown = np.empty(len(xy), np.int32)
    clique_first = np.zeros(len(near) + 1, np.int64)
    member = np.empty(1024, np.int32)
    n = m = 0
    for i in range(len(xy)):
        n_near = first[i + 1] - first[i]
        for k in range(first[i], first[i + 1], max(1, n_near // n_seed)):
            if near[k] < i and n_near <= n_seed:
                continue
            grown[0], grown[1] = i, near[k]
            size = _grow(grown, 2, i, xy, separation, first, near, is_shut)
            if size < least:
                continue
            while m + size > len(member):
                member = np.concatenate((member, np.empty(len(member), np.int32)))
            member[m : m + size] = np.sort(grown[:size])
            m += size
            n += 1
            clique_first[n] = m
    return clique_first[: n + 1].copy(), member[:m].copy()
