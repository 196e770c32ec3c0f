"""Tiles: where the telescope points, which tile each science target is at home on, and in how many visits.

`make_tiles` covers a footprint with tiles; `pool_visits` decides how many visits each tile gets, and which of the tiles that
see a target takes it; `members` lists the calibration targets on each plate.
"""

from survey_sim.tiling.grid import COVERING_DENSITY, covering, icosahedral_grid
from survey_sim.tiling.pool import Order, Planned, Pool, make_pool
from survey_sim.tiling.pooling import pool_visits
from survey_sim.tiling.tiles import Members, TilingSettings, make_tiles, members, pairs_within, plate_pairs

__all__ = [
    "COVERING_DENSITY",
    "Members",
    "Order",
    "Planned",
    "Pool",
    "TilingSettings",
    "covering",
    "icosahedral_grid",
    "make_pool",
    "make_tiles",
    "members",
    "pairs_within",
    "plate_pairs",
    "pool_visits",
]
