"""Single fields, on files alone: allocate, route, simulate, as instrument people do field by field.

Each command is one function: files in; a run's folder with tables and exchange files out, written when all of it is known.
"""

from survey_sim.survey.field.allocate import FieldAllocation, allocate_field
from survey_sim.survey.field.compare import RouterComparison, compare_routers
from survey_sim.survey.field.files import export_exchange
from survey_sim.survey.field.route import FieldRoutes, route_field
from survey_sim.survey.field.rows import visits_of_run
from survey_sim.survey.field.simulate import FieldSimulation, simulate_field, standing_at
from survey_sim.survey.field.view import view_field, view_page

__all__ = [
    "FieldAllocation",
    "FieldRoutes",
    "FieldSimulation",
    "RouterComparison",
    "allocate_field",
    "compare_routers",
    "export_exchange",
    "route_field",
    "simulate_field",
    "standing_at",
    "view_field",
    "view_page",
    "visits_of_run",
]
