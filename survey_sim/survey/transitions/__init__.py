"""What the robots really do from pointing to pointing: matched again from where they stand, routed, and kept.

`chains` holds the work of one process, `robots` what the schedule asks and is told, `parts` the tables.
"""

from survey_sim.survey.transitions.chains import EXPOSURE_TABLES, Configurations
from survey_sim.survey.transitions.parts import are_parts_whole, drop_parts, write_parts
from survey_sim.survey.transitions.robots import PlateRobots, Ways, route_and_pack

__all__ = [
    "EXPOSURE_TABLES",
    "Configurations",
    "PlateRobots",
    "Ways",
    "are_parts_whole",
    "drop_parts",
    "route_and_pack",
    "write_parts",
]
