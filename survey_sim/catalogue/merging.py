"""Objects that one fibre cannot tell apart: the brightest stays, the others are rejected."""

import numpy as np
import numpy.typing as npt
import polars as pl
from scipy.spatial import cKDTree

from survey_sim.errors import InputError
from survey_sim.geometry import chord, unit_vectors
from survey_sim.region import HEALPIX_ORDER

# Pairs beyond which the coordinates cannot be those of a sky that fibres are put on.
MAX_PAIRS = 20_000_000


def merge_close(rows: pl.DataFrame, fibre_arcsec: float) -> tuple[pl.DataFrame, pl.DataFrame]:
    """One object for each group that a fibre cannot tell apart.

    From bright to faint (ties by source_id, catalogue, and the programmes' order), an object stays if no brighter one that
    stays is nearer than a fibre: a chain keeps its brightest, and its far end if that is a fibre away from all that stay.

    Parameters
    ----------
    rows
        source_id, ra_deg, dec_deg, mag, `_healpix_29`, catalogue, order (the programme's place).

    Returns
    -------
        The rows that stay, and the others with `other_source_id` (the brightest that it is too close to) and `reason`:
        too-close-pair, or other-programme where that is the same object of the same catalogue.
    """
    other = _brighter_neighbour(rows, fibre_arcsec / 3600.0)
    lost = np.flatnonzero(other >= 0)
    keeper = rows[other[lost]]
    gone = rows[lost].with_columns(other_source_id=keeper["source_id"])
    same = (gone["source_id"] == keeper["source_id"]) & (gone["catalogue"] == keeper["catalogue"])
    reason = pl.when(same).then(pl.lit("other-programme")).otherwise(pl.lit("too-close-pair"))
    return rows.filter(other < 0), gone.with_columns(reason=reason)


def _brighter_neighbour(rows: pl.DataFrame, fibre_deg: float) -> npt.NDArray[np.int64]:
    """(n,) the brightest row that stays and is nearer than a fibre; -1: the row itself stays."""
    other = np.full(rows.height, -1, dtype=np.int64)
    if rows.height < 2:
        return other
    _check_density(rows["_healpix_29"].to_numpy(), fibre_deg)
    tree = cKDTree(unit_vectors(rows["ra_deg"].to_numpy(), rows["dec_deg"].to_numpy()), balanced_tree=False)
    pairs = tree.query_pairs(chord(fibre_deg), output_type="ndarray")
    members = np.unique(pairs)
    rank = np.empty(rows.height, dtype=np.int64)
    rank[members[_from_bright_to_faint(rows[members])]] = np.arange(len(members))
    pairs = np.take_along_axis(pairs, np.argsort(rank[pairs], axis=1), axis=1)
    for bright, faint in pairs[np.lexsort((rank[pairs[:, 1]], rank[pairs[:, 0]]))].tolist():
        # All pairs in which `bright` is the fainter one came before: it is known by now whether it stays.
        if other[bright] < 0 and other[faint] < 0:
            other[faint] = bright
    return other


def _from_bright_to_faint(rows: pl.DataFrame) -> npt.NDArray[np.int64]:
    keys = rows.with_row_index("row").sort("mag", "source_id", "catalogue", "order", nulls_last=True)
    return keys["row"].to_numpy().astype(np.int64)


def _check_density(cell: npt.NDArray[np.int64], fibre_deg: float) -> None:
    """Refuse coordinates so crowded that their pairs would fill the memory, from the counts in cells about a fibre wide."""
    order = int(np.clip(np.floor(np.log2(58.6 / max(fibre_deg, 1e-9))), 0, HEALPIX_ORDER))
    _, count = np.unique(cell >> (2 * (HEALPIX_ORDER - order)), return_counts=True)
    n_pair = int((count.astype(np.float64) * (count - 1) / 2).sum())
    if n_pair > MAX_PAIRS:
        rule = f"{n_pair:,} pairs of objects are nearer to each other than a fibre"
        raise InputError(rule, place="catalogue", remedy="check the units of the coordinates in the card")
