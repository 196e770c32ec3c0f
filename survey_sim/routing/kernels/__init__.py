"""Compiled geometry of routing; kernels that call each other stand in one folder (`survey_sim.kernel`)."""
