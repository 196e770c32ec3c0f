"""Plotting: what the figure scripts of `reports/` share. Each reads a run once, as `RunTables`, and gives one figure.

The scripts hold the figures; here are the reading (`run`), the colours of things (`style`), the sky, the plate, and the
drawing of scripts to files (`figures`).
"""

from survey_sim.plotting.figures import Script, draw_script, find_scripts, load_script, main, save_figure
from survey_sim.plotting.run import ProgrammeRow, RunTables, Visit
from survey_sim.plotting.style import figure_style, new_figure
from survey_sim.plotting.summary import Summary, summarise

__all__ = [
    "ProgrammeRow",
    "RunTables",
    "Script",
    "Summary",
    "Visit",
    "draw_script",
    "figure_style",
    "find_scripts",
    "load_script",
    "main",
    "new_figure",
    "save_figure",
    "summarise",
]
