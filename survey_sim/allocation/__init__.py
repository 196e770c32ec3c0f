"""Allocation: which robot goes to which target at which visit of a tile.

`start_allocation` makes a session for one tile. Its `next_visit` gives the next configuration from where the robots really
stand, and its `record` takes what the router could bring about.
"""

from survey_sim.allocation.bound import completeness_bound, fast_bounds
from survey_sim.allocation.field import Field, VisitRequest, make_field, part_of_field
from survey_sim.allocation.ideal import ideal_completeness
from survey_sim.allocation.kernels.choosing import crossings
from survey_sim.allocation.minima import Minima
from survey_sim.allocation.pooling import TileVisits, plan_visits
from survey_sim.allocation.realisations import Realisations
from survey_sim.allocation.rematch import match_again, match_around
from survey_sim.allocation.resting import rest, resting_places
from survey_sim.allocation.session import ALLOCATORS, Allocator, Session, VisitAllocation, start_allocation
from survey_sim.allocation.settings import ALGORITHMS, AllocationSettings, LostReason
from survey_sim.allocation.targets import FieldTargets

__all__ = [
    "ALGORITHMS",
    "ALLOCATORS",
    "AllocationSettings",
    "Allocator",
    "Field",
    "FieldTargets",
    "LostReason",
    "Minima",
    "Realisations",
    "Session",
    "TileVisits",
    "VisitAllocation",
    "VisitRequest",
    "completeness_bound",
    "crossings",
    "fast_bounds",
    "ideal_completeness",
    "make_field",
    "match_again",
    "match_around",
    "part_of_field",
    "plan_visits",
    "rest",
    "resting_places",
    "start_allocation",
]
