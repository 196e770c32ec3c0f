"""The schedule: nights of a site, twilight, Moon and weather, and which visit is observed when."""

from survey_sim.schedule.nightly import Schedule, make_schedule
from survey_sim.schedule.outcome import make_completeness, make_time_budget
from survey_sim.schedule.robots import Chain, Configuration, Robots
from survey_sim.schedule.settings import Programme, ScheduleSettings

__all__ = [
    "Chain",
    "Configuration",
    "Programme",
    "Robots",
    "Schedule",
    "ScheduleSettings",
    "make_completeness",
    "make_schedule",
    "make_time_budget",
]
