"""Simulation: routed legs played as the instrument would, exactly or with errors of execution."""

from survey_sim.simulation.execution import ExecutedPath, SimulationSettings, execute
from survey_sim.simulation.play import SimulatedPath, simulate
from survey_sim.simulation.ticks import Ticks, legs_from_ticks, make_ticks

__all__ = [
    "ExecutedPath",
    "SimulatedPath",
    "SimulationSettings",
    "Ticks",
    "execute",
    "legs_from_ticks",
    "make_ticks",
    "simulate",
]
