"""Completeness of each programme against time; also part of the overview."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from survey_sim.plotting.axes import as_percent, date_axis, say_empty
from survey_sim.plotting.run import RunTables, evening_dates
from survey_sim.plotting.style import programme_lines


def draw_timeline(axes: Axes, run: RunTables) -> None:
    """Share of each programme's targets that are complete at each noon; a dotted line at the share wanted."""
    axes.set_ylabel("Targets complete (% of the programme)")
    axes.set_ylim(0, 1.02)
    as_percent(axes.yaxis)
    nights = run.nights
    if not len(nights) or run.science.is_empty():
        say_empty(axes, "no science targets" if len(nights) else "no nights were scheduled")
        return
    evenings = evening_dates(nights["evening_mjd"].to_numpy())
    days = np.append(evenings, evenings[-1:] + np.timedelta64(1, "D"))
    for programme in run.programmes:
        line, column = programme_lines(run)[programme.name], f"completeness_frac_{programme.name}"
        if column not in nights.columns or not programme.n_target:
            continue
        share = np.append(0.0, nights[column].to_numpy())
        label = f"{programme.name}: {share[-1]:.0%}"
        if programme.wanted_frac is not None:
            axes.axhline(programme.wanted_frac, color=line.color, linewidth=0.8, linestyle=(0, (1, 2)), zorder=1.5)
            label += f" (wanted {programme.wanted_frac:.0%})"
        axes.step(days, share, where="post", color=line.color, linestyle=line.linestyle, label=label)
    date_axis(axes)
