"""Configuration time.

Share of visits whose robots are at rest within so many seconds: all robots (solid), 95 % of those that move (dashed),
and the slowest robot were it alone (dotted; where it is not seen it lies under the solid line). Left: every visit, from
where the last visit of its tile ended. Right: at the telescope, for every pointing that was made, from the configuration
before, whatever its tile. Vertical: readout of the CCD, and the constant 5 minutes that surveys charge for configuration,
which is also TAIPAN's requirement.
"""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim.plotting import RunTables, main, new_figure
from survey_sim.plotting.axes import as_percent, draw_cumulative, log_scale, panels, say_empty
from survey_sim.plotting.style import BOUND_DASHES, IDEAL_DASHES, INK, LIMIT_DASHES, survey_colours
from survey_sim.plotting.summary import CONSTANT_S

MEASURES = {
    "configuration_time_s": ("all robots", "-"),
    "configuration_time_p95_s": ("95 % of the robots", IDEAL_DASHES),
    "lower_bound_s": ("slowest robot alone", BOUND_DASHES),
}


def draw(run: RunTables) -> Figure:
    """Cumulative configuration times: of visits, and of pointings."""
    figure = new_figure()
    left, right = panels(figure, ["Visits, from where the last visit of the tile ended", "Pointings at the telescope"])
    _draw_visits(left, run)
    _draw_pointings(right, run)
    left.set_ylabel("Share within that time (%)")
    handles, labels = left.get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncol=len(handles))
    return figure


def _draw_visits(axes: Axes, run: RunTables) -> None:
    visits = run.visits.filter(run.visits["configuration_time_s"] > 0)
    if visits.is_empty():
        say_empty(axes, "no visits: no robot moves")
        return
    for column, (label, linestyle) in MEASURES.items():
        for survey, colour in survey_colours(run).items():
            values = visits.filter(survey=survey)[column].to_numpy()
            draw_cumulative(axes, values, color=colour, linestyle=linestyle, linewidth=1.5)
        axes.plot([], [], color=INK, linestyle=linestyle, linewidth=1.5, label=label)
    for survey, colour in survey_colours(run).items():
        axes.plot([], [], color=colour, label=survey)
    _finish(axes, run)


def _draw_pointings(axes: Axes, run: RunTables) -> None:
    pointings = run.exposures.filter(run.exposures["configuration_time_s"] > 0)
    if pointings.is_empty():
        say_empty(axes, "no exposures: nothing was pointed at")
        return
    for survey in pointings["survey"].unique().sort():
        for column, linestyle in (("configuration_time_s", "-"), ("configuration_time_p95_s", IDEAL_DASHES)):
            values = pointings.filter(survey=survey)[column].drop_nulls().to_numpy()
            draw_cumulative(axes, values, color=survey_colours(run)[survey], linestyle=linestyle, linewidth=1.5)
    _finish(axes, run)


def _finish(axes: Axes, run: RunTables) -> None:
    limits = {"readout": run.readout_s, "5 minutes": CONSTANT_S}
    for name, limit in limits.items():
        if limit:
            axes.axvline(limit, color=INK, linewidth=1.0, linestyle=LIMIT_DASHES)
            axes.text(limit, 0.03, f" {name}", rotation=90, va="bottom", ha="right", fontsize=8, color=INK)
    axes.set(xlabel="Configuration time (s)", ylim=(0, 1.02))
    as_percent(axes.yaxis)
    log_scale(axes, "x")
    axes.set_xlim(right=1.5 * CONSTANT_S)


if __name__ == "__main__":
    main(__file__)
