"""Compiled functions of the allocation, on flat arrays, and nothing else: see `survey_sim.kernel`."""
