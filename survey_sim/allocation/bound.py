"""Upper bounds of completeness: what no allocator can beat."""
