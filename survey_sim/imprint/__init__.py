"""The imprint of the allocation: where targets are lost, in pairs, in crowds, on the plate; and weights against it."""

from survey_sim.imprint.bins import completeness_by_bin, local_density, nearest_park_mm, plate_squares
from survey_sim.imprint.pairs import PairCounts, count_pairs, pair_table, sky_patches, uniform_sky
from survey_sim.imprint.weights import pack_bits, pair_weights, popcount, target_weights, unpack_bits

__all__ = [
    "PairCounts",
    "completeness_by_bin",
    "count_pairs",
    "local_density",
    "nearest_park_mm",
    "pack_bits",
    "pair_table",
    "pair_weights",
    "plate_squares",
    "popcount",
    "sky_patches",
    "target_weights",
    "uniform_sky",
    "unpack_bits",
]
