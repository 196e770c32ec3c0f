"""Orders of rows that their content alone decides, so that the order of a catalogue's rows has no say."""

import numpy as np
import numpy.typing as npt
import polars as pl


def content_order(numbers: tuple[npt.NDArray[np.number], ...], text: pl.Series) -> npt.NDArray[np.intp]:
    """Indices that sort rows by numbers (the first counts most), then by text.

    Text, slow to sort, is looked at only where rows agree in all numbers.
    """
    keys = numbers[::-1]
    order = np.lexsort(keys)
    same = np.ones(max(len(order) - 1, 0), dtype=np.bool_)
    for key in keys:
        same &= key[order[1:]] == key[order[:-1]]
    if not same.any():
        return order
    tied = order[np.union1d(np.flatnonzero(same), np.flatnonzero(same) + 1)]
    rank = np.zeros(len(order), dtype=np.int64)
    rank[tied] = text[tied].rank("dense").to_numpy()
    return np.lexsort((rank, *keys))
