"""The same visits by several routers: same starts for all, CSV and figures."""

from pathlib import Path

import polars as pl
import pytest

from survey_sim import tables
from survey_sim.errors import InputError
from survey_sim.plotting.routers import PANELS, draw_routers
from survey_sim.plotting.style import figure_style
from survey_sim.schema import PATHS
from survey_sim.survey.field import compare_routers
from tests.test_field import field, instrument, xml  # noqa: F401 - fixtures

ROUTERS = ("simple-vector", "traffic-light")


@pytest.fixture(scope="module")
def made(field: Path, tmp_path_factory: pytest.TempPathFactory):  # noqa: F811 - the fixture
    return compare_routers([field], tmp_path_factory.mktemp("routers"), routers=ROUTERS)


def test_a_row_a_router_visit_and_path(made) -> None:
    assert made.rows.group_by("router", "visit_id", "path").len()["len"].to_list() == [1] * (2 * 3 * 3)
    assert set(made.rows["router"]) == set(ROUTERS)
    assert pl.read_csv(made.file).height == made.rows.height
    assert made.rows["collisions"].sum() == 0
    assert (made.rows["configuration_time_s"] >= made.rows["configuration_time_median_s"]).all()


def test_the_first_visit_is_that_of_route(made, field: Path) -> None:  # noqa: F811 - the fixture
    routed = tables.read(field, "paths").filter(visit_id=0).sort("path")
    own = made.rows.filter(router="simple-vector", visit_id=0).sort("path")
    for name in ("configuration_time_s", "ticks", "unrouted", "min_separation_mm"):
        assert own[name].to_list() == routed[name].to_list()


def test_figures(made) -> None:
    for path in PATHS:
        for suffix, magic in (("png", b"\x89PNG"), ("pdf", b"%PDF")):
            assert (made.file.parent / f"routers_{path}.{suffix}").read_bytes().startswith(magic)
    with figure_style():
        figure = draw_routers(made.rows.filter(path="start_to_target"))
    for axes, (column, _) in zip(figure.axes, PANELS, strict=True):
        for line, router in zip([line for line in axes.lines if line.get_linestyle() == "-"], ROUTERS, strict=True):
            rows = made.rows.filter(path="start_to_target", router=router)
            assert line.get_ydata().tolist() == rows[column].to_list()


def test_unknown_router(field: Path, tmp_path: Path) -> None:  # noqa: F811 - the fixture
    with pytest.raises(InputError, match=r"unknown router 'traffic'(.|\n)*traffic-light"):
        compare_routers(xml(field, "allocation"), tmp_path, routers=["traffic"])
    assert not list(tmp_path.iterdir())
