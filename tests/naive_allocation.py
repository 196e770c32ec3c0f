"""Allocation by exhaustion and plain loops: what the kernels are held against on tiny plates."""

from itertools import combinations, permutations, product

import numpy as np


def near_pairs(xy, radius):
    """Pairs (i, j) nearer to each other than a radius."""
    n = len(xy)
    return {(i, j) for i in range(n) for j in range(n) if i != j and np.hypot(*(xy[i] - xy[j])) < radius}


def crossings(start, end):
    """Pairs of ways that share a point, by solving for it."""
    count = 0
    for i, j in combinations(range(len(start)), 2):
        u, w = end[i] - start[i], end[j] - start[j]
        matrix = np.column_stack([u, -w])
        if abs(np.linalg.det(matrix)) < 1e-12:
            continue
        s, t = np.linalg.solve(matrix, start[j] - start[i])
        count += 0 <= s <= 1 and 0 <= t <= 1
    return count


def most_apart(xy, separation):
    """Most points of which no two are nearer than the separation."""
    for size in range(len(xy), 0, -1):
        for chosen in combinations(range(len(xy)), size):
            if not near_pairs(xy[list(chosen)], separation):
                return size
    return 0


def best_visit(park, patrol, xy, value, separation, power, start=None, pull=0.0):
    """(most value, then least sum of travel^power + pull (distance from park)^power) over all legal visits."""
    start = park if start is None else start
    best = (0.0, 0.0)
    for size in range(1, min(len(park), len(xy)) + 1):
        for chosen in combinations(range(len(xy)), size):
            if near_pairs(xy[list(chosen)], separation):
                continue
            for robots in permutations(range(len(park)), size):
                travel, away = (np.hypot(*(xy[list(chosen)] - place[list(robots)]).T) for place in (start, park))
                if (away <= patrol).all():
                    found = (sum(value[t] for t in chosen), -float((travel**power + pull * away**power).sum()))
                    if found[0] > best[0] + 1e-9 or (abs(found[0] - best[0]) < 1e-9 and found[1] > best[1]):
                        best = found
    return best[0], -best[1]


def feasible_sets(park, patrol, xy, separation):
    """All sets of targets that one visit can hold, as frozensets."""
    found = {frozenset()}
    for size in range(1, min(len(park), len(xy)) + 1):
        for chosen in combinations(range(len(xy)), size):
            if near_pairs(xy[list(chosen)], separation):
                continue
            for robots in permutations(range(len(park)), size):
                if (np.hypot(*(xy[list(chosen)] - park[list(robots)]).T) <= patrol).all():
                    found.add(frozenset(chosen))
                    break
    return found


def most_complete(park, patrol, xy, wanted, separation, n_visit):
    """Most targets that get all their wanted visits in so many visits."""
    sets = feasible_sets(park, patrol, xy, separation)
    reached = {tuple([0] * len(xy))}
    for _ in range(n_visit):
        reached = {
            tuple(min(n + (t in chosen), wanted[t]) for t, n in enumerate(counts)) for counts in reached for chosen in sets
        }
    return max(sum(n == w for n, w in zip(counts, wanted, strict=True)) for counts in reached)


def least_distance_with_delay(a, b, delay, n_step=4000):
    """Least distance of two points that go straight from a[0] to a[1] and b[0] to b[1] at speed 1, b by `delay` later."""
    length_a, length_b = (np.hypot(*(way[1] - way[0])) for way in (a, b))
    time = np.linspace(min(0.0, delay), max(length_a, delay + length_b), n_step)
    at_a = a[0] + np.clip(time / length_a, 0, 1)[:, None] * (a[1] - a[0])
    at_b = b[0] + np.clip((time - delay) / length_b, 0, 1)[:, None] * (b[1] - b[0])
    return np.hypot(*(at_a - at_b).T).min()


def most_covered(value, near, reach, is_shut, capacity):
    """Most value of items in visits, and the rule that says whether visits of items (-1: none) are allowed.

    `near`: pairs of items; `reach`: of each visit, the robots that reach each item.
    """

    def has_robots(items, reach, free):
        return not items or any(has_robots(items[1:], reach, free - {robot}) for robot in reach[items[0]] & free)

    def may_be(visit_of):
        for visit, most in enumerate(capacity):
            items = [i for i, v in enumerate(visit_of) if v == visit]
            is_apart = all((a, b) not in near for a in items for b in items)
            if (
                len(items) > most
                or is_shut[items, visit].any()
                or not is_apart
                or not has_robots(items, reach[visit], set().union(*reach[visit]))
            ):
                return False
        return True

    tried = product(range(-1, len(capacity)), repeat=len(value))
    return max(value[np.array(visit_of) >= 0].sum() for visit_of in tried if may_be(visit_of)), may_be


def ways_cost(slot, start, park, xy, delay, power, pull):
    """Cost of a plan: `slot[visit, robot]` says the item held; moves, distances from park and delays, summed up."""
    total = 0.0
    for robot in range(slot.shape[1]):
        place = start[robot]
        for visit, item in enumerate(slot[:, robot]):
            if item >= 0:
                total += np.hypot(*(xy[item] - place)) ** power + visit * delay[item]
                total += pull * np.hypot(*(xy[item] - park[robot])) ** power
                place = xy[item]
    return total


def exchanges(slot):
    """All plans that one exchange makes of a plan: of two places' items, one perhaps empty, or of all from a visit on."""
    n_visit, n_robot = slot.shape
    places = list(product(range(n_visit), range(n_robot)))
    for one, other in combinations(places, 2):
        changed = slot.copy()
        changed[one], changed[other] = slot[other], slot[one]
        yield changed
    for visit, one, other in product(range(n_visit), range(n_robot), range(n_robot)):
        changed = slot.copy()
        changed[visit:, one], changed[visit:, other] = slot[visit:, other], slot[visit:, one]
        yield changed


def is_legal(slot, reach, near, capacity):
    """Whether all items of a plan are in reach (`reach[item]`), apart from those of their visit, and not too many."""
    held = [[item for item in row if item >= 0] for row in slot]
    apart = all(b not in near[a] for row in held for a, b in combinations(row, 2))
    in_reach = all(item < 0 or robot in reach[item] for row in slot for robot, item in enumerate(row))
    return apart and in_reach and all(len(row) <= capacity for row in held)
