"""Plain-loop references for the check: where a robot is at a time, and the least distance of two by search."""

from itertools import pairwise
from math import copysign, cos, hypot, inf, radians, sin

COARSE, PRECISE, TURNING = 2.0, 0.3, 35.0


def leg_end_s(leg: dict) -> float:
    """When a leg ends."""
    length = abs(leg["dx_mm"]) + abs(leg["dy_mm"])
    travel_s = (length - leg["precise_mm"]) / COARSE + leg["precise_mm"] / PRECISE
    return leg["start_s"] + abs(leg["rotate_deg"]) / TURNING + travel_s


def position(start: tuple[float, float, float], legs: list[dict], t: float) -> tuple[float, float]:
    """Where a robot is at time t: legs are dictionaries in order; start is x, y, theta."""
    x, y, theta = start
    for leg in legs:
        if t <= leg["start_s"]:
            break
        theta += leg["rotate_deg"]
        going_s = t - leg["start_s"] - abs(leg["rotate_deg"]) / TURNING
        length = abs(leg["dx_mm"]) + abs(leg["dy_mm"])
        fast = length - leg["precise_mm"]
        if going_s <= 0:
            gone = 0.0
        elif going_s <= fast / COARSE:
            gone = going_s * COARSE
        else:
            gone = min(length, fast + (going_s - fast / COARSE) * PRECISE)
        along_x = copysign(min(gone, abs(leg["dx_mm"])), leg["dx_mm"])
        along_y = copysign(max(gone - abs(leg["dx_mm"]), 0.0), leg["dy_mm"])
        c, s = cos(radians(theta)), sin(radians(theta))
        x, y = x + c * along_x - s * along_y, y + s * along_x + c * along_y
    return x, y


def instants(legs: list[dict]) -> list[float]:
    """Times at which a robot's motion changes."""
    out = []
    for leg in legs:
        turned = leg["start_s"] + abs(leg["rotate_deg"]) / TURNING
        fast_end = turned + (abs(leg["dx_mm"]) + abs(leg["dy_mm"]) - leg["precise_mm"]) / COARSE
        corner = abs(leg["dx_mm"])
        slow = max(corner - (abs(leg["dx_mm"]) + abs(leg["dy_mm"]) - leg["precise_mm"]), 0.0)
        out += [leg["start_s"], turned, turned + (corner - slow) / COARSE + slow / PRECISE, fast_end, leg_end_s(leg)]
    return out


def least_distance(a: tuple, legs_a: list[dict], b: tuple, legs_b: list[dict]) -> float:
    """Least distance of two robots: ternary search in each stretch of even motion, where the distance is convex."""

    def distance(t: float) -> float:
        (xa, ya), (xb, yb) = position(a, legs_a, t), position(b, legs_b, t)
        return hypot(xa - xb, ya - yb)

    times = sorted({0.0, *instants(legs_a), *instants(legs_b)})
    least = min(map(distance, times))
    for low, high in pairwise(times):
        lo, hi = low, high
        for _ in range(100):
            third = (hi - lo) / 3
            if distance(lo + third) < distance(hi - third):
                hi -= third
            else:
                lo += third
        least = min(least, distance(lo))
    return least


def least_of_all(starts: list[tuple], legs: list[list[dict]]) -> float:
    """Least distance of any two robots; infinite for fewer than two."""
    least = inf
    for i in range(len(starts)):
        for j in range(i):
            least = min(least, least_distance(starts[i], legs[i], starts[j], legs[j]))
    return least
