"""Plain-loop references for routing and simulation: legs walked step by step, distances by dense sampling."""

import math
from functools import partial

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from survey_sim.motion import alone_time_s


def position(instrument, start_mm, legs, robot, when):
    """(x, y) of a robot at `when`, walking its legs one after another."""
    x, y = start_mm[robot]
    for k in np.flatnonzero(legs.robot == robot):
        left = when - legs.start_s[k]
        if left <= 0:
            return x, y
        left -= abs(legs.rotate_deg[k]) / instrument.rotation_speed_deg_s
        length = abs(legs.dx_mm[k]) + abs(legs.dy_mm[k])
        coarse = length - legs.precise_mm[k]
        done = min(max(left, 0) * instrument.coarse_speed_mm_s, coarse)
        left -= coarse / instrument.coarse_speed_mm_s
        done += min(max(left, 0) * instrument.precise_speed_mm_s, legs.precise_mm[k])
        along_x = math.copysign(min(done, abs(legs.dx_mm[k])), legs.dx_mm[k])
        along_y = math.copysign(max(done - abs(legs.dx_mm[k]), 0), legs.dy_mm[k])
        heading = math.radians(legs.theta_deg[k])
        x += math.cos(heading) * along_x - math.sin(heading) * along_y
        y += math.sin(heading) * along_x + math.cos(heading) * along_y
        if done < length - 1e-12:
            return x, y
    return x, y


def least_separation(instrument, start_mm, legs, until_s, n_sample=400):
    """Least distance of any two robots over dense samples of time: never below the true one."""
    least = math.inf
    for when in np.linspace(0, until_s, n_sample):
        here = [position(instrument, start_mm, legs, robot, when) for robot in range(len(start_mm))]
        for i in range(len(here)):
            for j in range(i):
                least = min(least, math.dist(here[i], here[j]))
    return least


def late(knots, rest, delay):
    """Knot times of a shape late by `delay` after its rest."""
    t = knots[0].copy()
    t[rest + 1 :] += delay
    return t


def sampled_distance(t_a, a, t_b, b, n_sample=8001):
    """Least distance of two knot trajectories over dense samples."""
    when = np.linspace(min(t_a[0], t_b[0]) - 1, max(t_a[-1], t_b[-1]) + 1, n_sample)
    ax, ay = (np.interp(when, t_a, a[k]) for k in (1, 2))
    bx, by = (np.interp(when, t_b, b[k]) for k in (1, 2))
    return np.hypot(ax - bx, ay - by).min()


def is_parted(start, goal, fixed, r, park, reach, plate_radius, pitch=0.25):
    """Whether a flood fill over a fine grid cannot get from start to goal; holds where gaps are wider than the pitch."""
    half = int(reach / pitch) + 2
    axis = np.arange(-half, half + 1) * pitch
    x, y = np.meshgrid(axis + park[0], axis + park[1], indexing="ij")
    free = (np.hypot(x - park[0], y - park[1]) <= reach) & (np.hypot(x, y) <= plate_radius)
    for point in fixed:
        free &= np.hypot(x - point[0], y - point[1]) >= r
    free_x, free_y = x[free], y[free]

    def cell(point):
        k = np.hypot(free_x - point[0], free_y - point[1]).argmin()
        return tuple(np.argwhere(free)[k])

    todo, seen, aim = [cell(start)], {cell(start)}, cell(goal)
    while todo:
        i, j = todo.pop()
        if (i, j) == aim:
            return False
        for a, b in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)):
            if 0 <= a < free.shape[0] and 0 <= b < free.shape[1] and free[a, b] and (a, b) not in seen:
                seen.add((a, b))
                todo.append((a, b))
    return True


def around_disc(a, b, r):
    """Length of the shortest way from a to b outside the disc of radius r around the origin."""
    along, out_a, out_b = math.dist(a, b), math.hypot(*a), math.hypot(*b)
    step = (b[0] - a[0], b[1] - a[1])
    share = -(a[0] * step[0] + a[1] * step[1]) / along**2 if along > 0 else 0.0
    share = min(1.0, max(0.0, share))
    if math.hypot(a[0] + share * step[0], a[1] + share * step[1]) >= r:
        return along
    angle = math.acos(max(-1.0, min(1.0, (a[0] * b[0] + a[1] * b[1]) / (out_a * out_b))))
    tangent_a, tangent_b = math.acos(min(1.0, r / out_a)), math.acos(min(1.0, r / out_b))
    arc = max(0.0, angle - tangent_a - tangent_b)
    return math.sqrt(max(0.0, out_a**2 - r * r)) + math.sqrt(max(0.0, out_b**2 - r * r)) + r * arc


def pair_bound_s(start, goal, r, speed):
    """Time below which two robots that may go any way, at up to `speed`, cannot both arrive without coming nearer than r.

    With weights w and 1 - w, the weighted sum of squared speeds is |c'|^2 + w (1 - w) |d'|^2, where c is the weighted mean
    place and d the difference of the two. It is at most speed^2, c goes at least straight, and d around a disc.
    """
    step = np.subtract(goal, start)
    around = around_disc(np.subtract(start[0], start[1]), np.subtract(goal[0], goal[1]), r)
    weight = np.linspace(0, 1, 101)
    centre = weight[:, None] * step[0] + (1 - weight)[:, None] * step[1]
    return np.sqrt((centre**2).sum(axis=1) + weight * (1 - weight) * around**2).max() / speed


def length_around(start, goal, discs, r, is_inside, n_corner=96):
    """Length of the shortest way from start to goal outside discs of radius r, or a little less; inf if there is none.

    A visibility graph over polygons inscribed in the discs, so what it goes around is smaller than they are. `is_inside`
    says of (n, 2) points whether the robot may stand there; the region is convex, so corners are enough.
    """
    angle = 2 * np.pi * np.arange(n_corner) / n_corner
    ring = r * np.column_stack([np.cos(angle), np.sin(angle)])
    inner = r * math.cos(math.pi / n_corner) * (1 - 1e-9)
    nodes = np.vstack([[start, goal], *(disc + ring for disc in discs)])
    apart = np.hypot(*(nodes[:, None] - np.asarray(discs)[None]).transpose(2, 0, 1))
    nodes = nodes[(apart >= inner).all(axis=1) & is_inside(nodes)]
    step = nodes[None] - nodes[:, None]
    length = np.hypot(*step.transpose(2, 0, 1))
    is_clear = np.ones(length.shape, dtype=bool)
    for disc in discs:
        to_disc = disc - nodes[:, None]
        share = np.clip((to_disc * step).sum(axis=2) / np.maximum(length, 1e-12) ** 2, 0, 1)
        is_clear &= np.hypot(*(to_disc - share[..., None] * step).transpose(2, 0, 1)) >= inner
    distance = dijkstra(csr_matrix(np.where(is_clear, length, 0.0)), indices=0)
    return float(distance[1])


def time_around_s(plate, start_mm, theta_deg, goal_mm, is_counted):
    """A bound that takes dead robots for discs: the slowest robot alone, on its shortest way around them."""
    instrument, dead = plate.instrument, start_mm[~plate.is_live]
    alone_s = alone_time_s(instrument, start_mm, theta_deg, goal_mm)
    r, slowest = instrument.min_separation_mm - 1e-6, 0.0
    for i in np.flatnonzero(is_counted & plate.is_live & (alone_s > 0)):
        a, b, park, reach = start_mm[i], goal_mm[i], plate.park_mm[i], plate.patrol_radius_mm[i]
        share = np.clip((dead - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        own_s = alone_s[i]
        if (np.hypot(*(dead - a - share[:, None] * (b - a)).T) < r).any():
            near = dead[np.hypot(*(dead - park).T) < reach + r]
            inside = partial(_is_in_reach, park=park, reach=reach, plate_radius=instrument.plate_radius_mm)
            slow = instrument.precise_approach_mm * (1 / instrument.precise_speed_mm_s - 1 / instrument.coarse_speed_mm_s)
            own_s = max(own_s, length_around(a, b, near, r, inside) / instrument.coarse_speed_mm_s + slow)
        slowest = max(slowest, own_s)
    return slowest


def _is_in_reach(points, park, reach, plate_radius):
    return (np.hypot(*(points - park).T) <= reach + 1e-6) & (np.hypot(*points.T) <= plate_radius + 1e-6)


def grid_cells(radius, pitch):
    """(n, 2) points of a square grid in a disc, mm."""
    axis = np.arange(-int(radius / pitch), int(radius / pitch) + 1) * pitch
    points = np.array([(x, y) for x in axis for y in axis])
    return points[np.hypot(*points.T) <= radius]


def joint_components(cells, pitch, n_robot, r):
    """Which placements of robots on cells can be turned into which: by moves of one robot at a time, to a next cell.

    All placements at least r apart, and all moves that keep r on the way. Gives an array over cells, one axis a robot: the
    same number where one can be turned into the other, -1 where two robots are too near.
    """
    n = len(cells)
    gap = np.hypot(*(cells[:, None] - cells[None]).transpose(2, 0, 1))
    legal = np.ones((n,) * n_robot, dtype=bool)
    for a in range(n_robot):
        for b in range(a):
            shape = [1] * n_robot
            shape[a] = shape[b] = n
            legal &= (gap >= r).reshape(shape)
    number = np.full(legal.shape, -1, dtype=np.int64)
    number[legal] = np.arange(legal.sum())
    rows, columns = [], []
    for i, j in np.argwhere(np.isclose(gap, pitch)):
        step = cells[j] - cells[i]
        share = np.clip(((cells - cells[i]) @ step) / pitch**2, 0, 1)
        is_clear = np.hypot(*(cells - cells[i] - share[:, None] * step).T) >= r
        for robot in range(n_robot):
            before, after = np.take(number, i, axis=robot), np.take(number, j, axis=robot)
            ok = (before >= 0) & (after >= 0)
            for axis in range(n_robot - 1):
                shape = [1] * (n_robot - 1)
                shape[axis] = n
                ok &= is_clear.reshape(shape)
            rows.append(before[ok])
            columns.append(after[ok])
    rows, columns = np.concatenate(rows), np.concatenate(columns)
    graph = csr_matrix((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(legal.sum(),) * 2)
    found = np.full(legal.shape, -1, dtype=np.int64)
    found[legal] = connected_components(graph, directed=False)[1]
    return found
