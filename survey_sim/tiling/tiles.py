"""Tiles: where the telescope points, which tile each science target is nearest to, and what else each plate can see."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import polars as pl
from pydantic import Field
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from survey_sim import tables
from survey_sim.errors import InputError
from survey_sim.geometry import chord, unit_vectors
from survey_sim.region import HEALPIX_ORDER, Region, healpix_29, healpix_positions
from survey_sim.settings import Settings
from survey_sim.tiling.grid import covering

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# Plate edges are kept off by this share of the radius, so that a target at the edge is inside by any way of computing it.
_EDGE = 1e-9
# A footprint is tried as HEALPix cells, up to so fine and so many: order 12 is 0.9 arcmin wide.
_FINEST_FOOTPRINT = 12
_MOST_FOOTPRINT_CELLS = 10_000
_KINDS_OF_SUPPLY = ("standard", "sky", "guide")


class TilingSettings(Settings):
    """How a survey's footprint is covered with tiles."""

    # Part of the sky that the run is limited to.
    region: Region = Region()
    # Furthest that a target may be from the nearest tile's centre, in field radii: 1 gives the fewest tiles. Measured
    # (docs/tiling.md): somewhat less gives more overlap, which serves what one tile alone cannot.
    max_distance_frac: float = Field(0.95, gt=0.05, le=1)
    # Leave out tiles whose targets are all on other plates, those with the fewest first.
    drop_redundant: bool = True
    # Share visits out among tiles: a target goes to whichever tile on whose plate it lies has a fibre for it, and a survey
    # has the completeness that it wants as a whole. Without it a target is at home on the nearest tile; each tile has it.
    pool: bool = True
    # Orientations of the grid tried on each survey's footprint; the one with the fewest tiles is taken. Measured on
    # 440 sq deg: 25 tiles with one, 21 to 24 with 32 to 128; on all of dec < +20: 1308 and 1302.
    n_orientation: int = Field(64, ge=1, le=10_000)


def make_tiles(
    targets: pl.DataFrame, settings: TilingSettings, field_radius_deg: float
) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Tiles of every survey, and the targets with their home tiles.

    Each survey has its own tiles. A science target's home is the nearest centre, and always within the field radius.

    Parameters
    ----------
    targets
        Table `targets`.
    field_radius_deg
        Radius of the plate on the sky.

    Returns
    -------
        Table `tiles`, and table `targets` with `tile_id` set for science targets.
    """
    radius_deg = field_radius_deg * settings.max_distance_frac * (1.0 - _EDGE)
    grid = covering(radius_deg)
    tree = cKDTree(grid)
    is_science = (targets["kind"] == "science").to_numpy()
    home = np.full(targets.height, -1, dtype=np.int64)
    tiles = [tables.empty("tiles")]
    for survey in targets["survey"].unique().sort().to_list():
        mine = np.flatnonzero(is_science & (targets["survey"] == survey).to_numpy())
        if not len(mine):
            continue
        rows = targets[mine]
        turn = _best_turn(rows["_healpix_29"].to_numpy(), tree, radius_deg, settings)
        vectors = unit_vectors(rows["ra_deg"].to_numpy(), rows["dec_deg"].to_numpy())
        used, place = np.unique(_homes(_turned(vectors, turn), tree, radius_deg, settings), return_inverse=True)
        ra_deg, dec_deg = _ra_dec(_turned(grid[used], turn.T))
        order = np.argsort(healpix_29(ra_deg, dec_deg), kind="stable")
        home[mine] = np.argsort(order)[place]
        tiles.append(_tiles_table(survey, ra_deg[order], dec_deg[order], home[mine]))
    tile_id = pl.Series("tile_id", home, dtype=pl.Int32)
    return tables.conform(pl.concat(tiles), "tiles"), targets.with_columns(tile_id.set(tile_id < 0, None))


def _homes(vectors: FloatArray, grid: cKDTree, radius_deg: float, settings: TilingSettings) -> IntArray:
    """(n_target,) the centre of the grid at which each target is at home."""
    target, tile, _ = pairs_within(vectors, grid, radius_deg)
    used = np.zeros(grid.n, dtype=np.bool_)
    used[_nearest(len(vectors), target, tile)] = True
    if settings.drop_redundant:
        target, tile = target[used[tile]], tile[used[tile]]
        used = _needed(len(vectors), target, tile, used)
    return _nearest(len(vectors), target[used[tile]], tile[used[tile]])


def _nearest(n_target: int, target: IntArray, tile: IntArray) -> IntArray:
    """(n_target,) nearest tile of each target, from pairs that are sorted by target, then from near to far."""
    first = np.flatnonzero(np.diff(target, prepend=-1))
    if len(first) < n_target:
        rule = f"{n_target - len(first)} targets are on no tile"
        raise InputError(rule, place="tiling.max_distance_frac", remedy="a smaller one: the tiles overlap more")
    return tile[first]


def _needed(n_target: int, target: IntArray, tile: IntArray, used: BoolArray) -> BoolArray:
    """Tiles left when those whose targets are all on other plates go, fewest home targets first."""
    needed = used.copy()
    n_home = np.bincount(_nearest(n_target, target, tile), minlength=len(used))
    n_plate = np.bincount(target, minlength=n_target)
    order = np.argsort(tile, kind="stable")
    start = np.searchsorted(tile[order], np.arange(len(used) + 1))
    for candidate in np.flatnonzero(used)[np.argsort(n_home[used], kind="stable")]:
        on_plate = target[order[start[candidate] : start[candidate + 1]]]
        if (n_plate[on_plate] > 1).all():
            needed[candidate] = False
            n_plate[on_plate] -= 1
    return needed


def _best_turn(cell: IntArray, grid: cKDTree, radius_deg: float, settings: TilingSettings) -> FloatArray:
    """(3, 3) rotation that takes a footprint, given as cells of order 29, to the grid where it needs the fewest tiles.

    Every tile ends in a visit that its targets only fill in part, so fewer tiles are fewer visits. (Counting whole visits
    instead was tried: it fits the noise, as the last visits depend on what the allocator reaches.)
    """
    quaternions = np.random.default_rng(0).standard_normal((settings.n_orientation, 4))
    quaternions[0] = (0.0, 0.0, 0.0, 1.0)
    turns = list(Rotation.from_quat(quaternions).as_matrix())
    if len(turns) == 1:
        return turns[0]
    vectors = _footprint(cell)
    return min(turns, key=lambda turn: len(np.unique(_homes(_turned(vectors, turn), grid, radius_deg, settings))))


def _footprint(cell: IntArray) -> FloatArray:
    """(n, 3) centres of the cells that hold targets, as fine as their number allows."""
    cell = np.sort(cell)
    for order in range(_FINEST_FOOTPRINT, 0, -1):
        coarse = cell >> (2 * (HEALPIX_ORDER - order))
        occupied = coarse[np.flatnonzero(np.diff(coarse, prepend=-1))]  # numpy's unique hashes, and such cells collide
        if len(occupied) <= _MOST_FOOTPRINT_CELLS:
            break
    return unit_vectors(*healpix_positions(occupied, order))


def _turned(vectors: FloatArray, turn: FloatArray) -> FloatArray:
    return np.einsum("ij,nj->ni", turn, vectors)  # not by BLAS, whose last digits depend on the number of threads


def _tiles_table(survey: str, ra_deg: FloatArray, dec_deg: FloatArray, home: IntArray) -> pl.DataFrame:
    return pl.DataFrame(
        {
            "survey": [survey] * len(ra_deg),
            "tile_id": np.arange(len(ra_deg), dtype=np.int32),
            "ra_deg": ra_deg,
            "dec_deg": dec_deg,
            "n_target": np.bincount(home, minlength=len(ra_deg)).astype(np.int32),
        }
    )


@dataclass(frozen=True)
class Members:
    """Rows of the calibration targets on each tile's plate.

    Attributes
    ----------
    start
        (n_tile + 1,) where each tile's rows begin in `row`.
    row
        Row numbers of `targets`, ascending within a tile.
    """

    start: IntArray
    row: IntArray

    def of(self, tile: int) -> IntArray:
        """Rows of the `tile`-th row of `tiles`."""
        return self.row[self.start[tile] : self.start[tile + 1]]


def members(tiles: pl.DataFrame, targets: pl.DataFrame, field_radius_deg: float) -> Members:
    """Calibration targets (standard, sky, guide) of its own survey on each tile's plate.

    Parameters
    ----------
    tiles, targets
        Tables of those names.
    field_radius_deg
        Radius of the plate on the sky.
    """
    is_supply = targets["kind"].is_in(_KINDS_OF_SUPPLY)
    rows, places = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    for survey in tiles["survey"].unique().to_list():
        row = (is_supply & (targets["survey"] == survey)).arg_true().to_numpy().astype(np.int64)
        place = (tiles["survey"] == survey).arg_true().to_numpy().astype(np.int64)
        supply, centre = targets[row], tiles[place]
        points = unit_vectors(supply["ra_deg"].to_numpy(), supply["dec_deg"].to_numpy())
        centres = unit_vectors(centre["ra_deg"].to_numpy(), centre["dec_deg"].to_numpy())
        point, tile, _ = pairs_within(points, cKDTree(centres), field_radius_deg * (1.0 - _EDGE))
        rows.append(row[point])
        places.append(place[tile])
    row, place = np.concatenate(rows), np.concatenate(places)
    order = np.lexsort((row, place))
    return Members(np.searchsorted(place[order], np.arange(tiles.height + 1)), row[order])


def plate_pairs(targets: pl.DataFrame, tiles: pl.DataFrame, radius_deg: float) -> tuple[IntArray, IntArray]:
    """Rows of targets and tiles, pair by pair, that are no further apart than an angle, as a target from its home."""
    points = unit_vectors(targets["ra_deg"].to_numpy(), targets["dec_deg"].to_numpy())
    centres = unit_vectors(tiles["ra_deg"].to_numpy(), tiles["dec_deg"].to_numpy())
    target, tile, _ = pairs_within(points, cKDTree(centres), radius_deg * (1.0 - _EDGE))
    return target, tile


def pairs_within(points: FloatArray, centres: cKDTree, radius_deg: float) -> tuple[IntArray, IntArray, FloatArray]:
    """All pairs of a point and a centre no further apart than an angle.

    Parameters
    ----------
    points
        (n, 3) unit vectors.
    centres
        Tree of the centres' unit vectors.

    Returns
    -------
        Index of the point, index of the centre, and their chord; sorted by point, then from near to far.
    """
    if not len(points):
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0)
    n_near = 4
    while True:
        n_asked = min(n_near, centres.n)
        found = centres.query(points, k=list(range(1, n_asked + 1)), distance_upper_bound=chord(radius_deg))
        distance, index = np.asarray(found[0]), np.asarray(found[1])
        if n_asked == centres.n or np.isinf(distance[:, -1]).all():
            break
        n_near *= 2
    point, rank = np.nonzero(np.isfinite(distance))
    return point, index[point, rank].astype(np.int64), distance[point, rank]


def _ra_dec(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Right ascension in [0, 360) and declination of unit vectors, deg."""
    ra_deg = np.degrees(np.arctan2(vectors[:, 1], vectors[:, 0])) % 360.0
    return np.where(ra_deg >= 360.0, 0.0, ra_deg), np.degrees(np.arcsin(vectors[:, 2].clip(-1.0, 1.0)))
