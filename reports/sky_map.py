"""Completeness on the sky.

Each place has the colour of the tile whose centre is nearest, out to the radius of the field: the share of the targets there
that were observed in all the visits they want, by whatever tile. Grey lines: the Galactic equator, and the parallels at 10
degrees from it (dashed).
"""

from matplotlib.figure import Figure

from survey_sim.plotting import RunTables, main, new_figure
from survey_sim.plotting.axes import empty_figure
from survey_sim.plotting.sky import completeness_bar, draw_completeness, tile_frame
from survey_sim.plotting.style import FULL_WIDTH


def draw(run: RunTables) -> Figure:
    """A map a survey: side by side for a region, one above the other for the whole sky."""
    surveys = run.tiles["survey"].unique().sort().to_list()
    if not surveys:
        return empty_figure(new_figure(), "no tiles")
    frame = tile_frame(run)
    rows, columns = (len(surveys), 1) if frame.is_whole else (1, len(surveys))
    aspect = frame.shape[0] / frame.shape[1]
    width = min((FULL_WIDTH - 1.2) / columns - 0.5, 3.2 / aspect if frame.is_whole else 4.4 / aspect)
    figure = new_figure(min(FULL_WIDTH, columns * width + 2.2), max(2.8, rows * (width * aspect + 0.55)))
    grid = figure.add_gridspec(rows, columns)
    drawn = [draw_completeness(figure, grid[place], run, survey, frame) for place, survey in enumerate(surveys)]
    for (axes, _), survey in zip(drawn, surveys, strict=True):
        tiles = run.tiles.filter(survey=survey)
        axes.set_title(f"{survey}: {len(tiles):,} tiles, {tiles['n_target'].sum():,} targets")
    completeness_bar(figure, run, drawn[0][1], [axes for axes, _ in drawn], shrink=0.8, aspect=30)
    return figure


if __name__ == "__main__":
    main(__file__)
