"""Plain-loop references for targets and tiles."""

import math


def angle_deg(a, b):
    """Angle between two (ra, dec), deg, by the haversine formula."""
    ra1, dec1, ra2, dec2 = (math.radians(value) for value in (*a, *b))
    h = math.sin((dec2 - dec1) / 2) ** 2 + math.cos(dec1) * math.cos(dec2) * math.sin((ra2 - ra1) / 2) ** 2
    return math.degrees(2 * math.asin(min(1.0, math.sqrt(h))))


def merge_close(rows, fibre_arcsec):
    """Kept names, and {lost name: kept name}, of rows (name, ra, dec, mag): bright first, one at a time."""
    kept, lost = [], {}
    for name, ra, dec, _ in sorted(rows, key=lambda row: (row[3], row[0])):
        for other, other_ra, other_dec in kept:
            if angle_deg((ra, dec), (other_ra, other_dec)) <= fibre_arcsec / 3600:
                lost[name] = other
                break
        else:
            kept.append((name, ra, dec))
    return {row[0] for row in kept}, lost


def nearest(point, centres):
    """Index of the nearest centre."""
    return min(range(len(centres)), key=lambda i: angle_deg(point, centres[i]))
