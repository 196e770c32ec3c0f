"""The report: every figure from a small run, the same page whatever names hold, and runs that lack things."""

import subprocess
import sys
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl
import polars.selectors as cs
import pytest
from astropy.visualization.wcsaxes import WCSAxes
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from survey_sim import tables
from survey_sim.errors import InputError
from survey_sim.folders import data_folder
from survey_sim.plotting import RunTables, Script, figure_style, find_scripts, summarise
from survey_sim.plotting.axes import binned
from survey_sim.plotting.plate import read_plate
from survey_sim.plotting.sky import galactic_parallel, paint_tiles, sky_frame
from survey_sim.region import abs_galactic_latitude_deg
from survey_sim.survey import report
from survey_sim.survey.report import make_report
from survey_sim.survey.workers import Workers
from tests.report_run import write_run

SCRIPTS = find_scripts()
# What the labels of each figure must tell of.
UNITS = {
    "completeness_crowding": ("(%)", "arcmin"),
    "completeness_latitude": ("(%)", "(deg)"),
    "completeness_magnitude": ("(%)", "(mag)"),
    "completeness_time": ("(% of the programme)", "(UTC date)"),
    "completeness_visit": ("(%)",),
    "configuration_bound": ("(s)", "(%)"),
    "configuration_time": ("(s)", "(%)"),
    "configuration_visit": ("(s)",),
    "crossings": ("Crossing pairs",),
    "night": ("(h)", "(deg)", "Airmass"),
    "overview": ("(mm)", "(UTC date)"),
    "plate": ("(mm)",),
    "reasons": ("(%)",),
    "robot_timing": ("(s)",),
    "routing": ("(mm)",),
    "sky_map": (),
    "time_budget": ("(h)", "(s)"),
    "travel": ("(mm)", "(%)"),
}
VARIANTS = {
    "no schedule": {"without": ("exposures", "nights", "target_status")},
    "no exposures": {"n_visit": 0},
    "allocations alone": {
        "without": ("exposures", "nights", "target_status", "unallocated", "legs", "paths", "robot_times", "rejected"),
        "record": ("package", "version", "schema_version", "name", "instrument"),
    },
    "no targets": {"n_target": 0},
    "no tiles": {"n_tile": 0},
    "single tile, visit, programme": {"programmes": (("one", "solo"),), "n_tile": 1, "n_visit": 1},
    "unrouted robots": {"unrouted": True},
    "whole sky": {"n_tile": 6, "spread_deg": 60.0},
}


class Reader(HTMLParser):
    """What a page refers to, its tags, and its text."""

    def __init__(self) -> None:
        super().__init__()
        self.references: list[str] = []
        self.tags: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.references += [value or "" for name, value in attrs if name in {"src", "href", "srcset", "data", "action"}]

    def handle_data(self, data: str) -> None:
        self.text += data


def _read_page(path: Path) -> Reader:
    reader = Reader()
    reader.feed(path.read_text(encoding="utf-8"))
    return reader


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp("report") / "small")


@pytest.fixture(scope="module")
def page(run_dir: Path) -> Path:
    return make_report(run_dir)


def _draw(name: str, run: RunTables) -> Figure:
    with figure_style():
        figure = SCRIPTS[name].draw(run)
        figure.draw_without_rendering()
    return figure


def _panels(figure: Figure) -> list[Axes]:
    """Axes that show data: neither colour bars nor panels that say they are empty."""
    return [axes for axes in figure.axes if axes.axison and axes.get_label() != "<colorbar>"]


def _labels(figure: Figure) -> list[str]:
    return [label for axes in _panels(figure) for label in (axes.get_xlabel(), axes.get_ylabel())]


def _is_labelled(axes: Axes, direction: str) -> bool:
    """Whether an axis says what it shows: itself, by one that it shares, or by names at its ticks; or has no ticks."""
    if isinstance(axes, WCSAxes):
        return bool(axes.coords["xy".index(direction)].get_axislabel())
    shared = axes.get_shared_x_axes() if direction == "x" else axes.get_shared_y_axes()
    if any(getattr(one, f"get_{direction}label")() for one in shared.get_siblings(axes)):
        return True
    ticks = [tick.get_text() for tick in getattr(axes, f"get_{direction}ticklabels")()]
    return all(any(letter.isalpha() for letter in tick) for tick in ticks)


@pytest.mark.parametrize("name", SCRIPTS)
def test_every_script_draws_labelled_panels(name: str, run_dir: Path) -> None:
    figure = _draw(name, RunTables(run_dir))
    labels = _labels(figure)
    for unit in UNITS.get(name, ()):
        assert any(unit in label for label in labels), (unit, labels)
    for axes in _panels(figure):
        assert _is_labelled(axes, "x"), axes
        assert _is_labelled(axes, "y"), axes
    assert SCRIPTS[name].title
    assert SCRIPTS[name].caption


def _draw_only(script: Script, run: RunTables, folder: Path) -> tuple[bytes, tuple[float, float]]:
    """Stands for `draw_script` where files do not matter: they are most of the time."""
    return b"", tuple(_draw(script.name, run).get_size_inches())


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.filterwarnings("error")
def test_lacking_runs_draw(variant: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "draw_script", _draw_only)
    folder = write_run(tmp_path / "run", **VARIANTS[variant])
    page = _read_page(make_report(folder))
    assert page.tags.count("img") == len(SCRIPTS)


@pytest.mark.parametrize("change", [pl.DataFrame.clear, lambda nights: nights.with_columns(cs.ends_with("_s") * 0.0)])
@pytest.mark.filterwarnings("error")
def test_a_schedule_of_no_night_or_no_darkness_completes_nothing(change, tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run")
    status = tables.read(folder, "target_status").with_columns(n_observed=0, reason=pl.lit("not-allocated"))
    nights = change(tables.read(folder, "nights"))
    for table, rows in {"exposures": tables.empty("exposures"), "nights": nights, "target_status": status}.items():
        tables.write(rows, table, folder / f"{table}.parquet")
    run = RunTables(folder)
    assert {programme.n_observed for programme in run.programmes} == {0}
    text = make_report(folder).read_text()
    assert "targets complete" in text
    assert "targets allocated" not in text


def test_empty_figures_say_why(tmp_path: Path) -> None:
    run = RunTables(write_run(tmp_path / "run", n_visit=0, without=("nights", "exposures")))
    for name, words in {
        "plate": "no visits",
        "night": "no exposures",
        "time_budget": "no nights",
        "travel": "no visits",
    }.items():
        texts = [text.get_text() for axes in _draw(name, run).axes for text in axes.texts]
        assert any(words in text for text in texts), (name, texts)


def test_page_refers_to_nothing_outside(page: Path) -> None:
    reader = _read_page(page)
    assert all(reference.startswith(("data:image/png;base64,", "#", "players/")) for reference in reader.references)
    assert not {"script", "link", "iframe", "object"} & set(reader.tags)
    assert "@import" not in page.read_text(encoding="utf-8")
    assert "url(" not in page.read_text(encoding="utf-8")


def test_page_links_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for reference in _read_page(page).references:
        if reference.startswith("#"):
            assert f'id="{reference[1:]}"' in text
        elif not reference.startswith("data:"):
            assert (page.parent / reference).is_file()


def test_figures_are_files_too(page: Path) -> None:
    for name in SCRIPTS:
        assert (page.parent / "figures" / f"{name}.png").read_bytes()[1:4] == b"PNG"
        assert (page.parent / "figures" / f"{name}.pdf").read_bytes()[:4] == b"%PDF"


def test_same_run_gives_same_bytes(run_dir: Path, page: Path) -> None:
    before = {path: path.read_bytes() for path in page.parent.rglob("*.*")}
    make_report(run_dir)
    assert {path: path.read_bytes() for path in page.parent.rglob("*.*")} == before


def test_two_workers_draw_the_same_bytes(run_dir: Path, page: Path) -> None:
    before = {path: path.read_bytes() for path in page.parent.rglob("*.*")}
    for path in before:
        path.unlink()
    workers = Workers(2)
    try:
        make_report(run_dir, workers)
    finally:
        workers.close()
    assert workers.cpu_s > 0.0
    assert {path: path.read_bytes() for path in page.parent.rglob("*.*")} == before


@pytest.mark.filterwarnings("ignore::astropy.io.votable.exceptions.W02")
def test_names_are_text_not_markup(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "draw_script", _draw_only)
    evil = "<script>alert('x')</script> $a_{b & \"c\""
    settings = {
        "report": {"title": f"{evil} title", "plate": None, "dpi": 50},
        "tiling": {"note": "</pre><script>1</script>"},
    }
    folder = write_run(tmp_path / "run", programmes=((evil, "a<b>$^{$"),), settings=settings)
    page = _read_page(make_report(folder))
    assert "script" not in page.tags
    assert f"{evil} title" in page.text
    assert "</pre><script>1</script>" in page.text
    assert "survey <b>taipan</b>: a warning" in page.text


def test_numbers_are_those_of_the_tables(run_dir: Path) -> None:
    run = RunTables(run_dir)
    summary, status = summarise(run), pl.read_parquet(run_dir / "target_status.parquet")
    for programme in summary.programmes:
        own = status.filter(programme=programme.row.name)
        assert programme.row.n_target == len(own)
        assert programme.done_frac == own["reason"].is_null().mean()
        lost = own.join(pl.read_parquet(run_dir / "unallocated.parquet"), on="target_id", how="semi")
        assert 0 < programme.row.n_allocated == len(own) - len(lost)
        assert programme.reached == "2016-01-05"  # 0.6 x 5/5 is the first of the steps at or above 0.5
    taipan = next(survey for survey in summary.surveys if survey.name == "taipan")
    visits = pl.read_parquet(run_dir / "visits.parquet").filter(survey="taipan")
    assert taipan.configuration_median_s == visits["configuration_time_s"].median()
    assert taipan.bound_frac == (visits["configuration_time_s"] <= visits["lower_bound_s"]).mean()
    assert (taipan.n_short_standard, taipan.n_short_sky_region, taipan.n_short_guide) == (0, 0, 0)
    assert taipan.n_short_sky == len(visits) // 2  # every other visit of a tile lacks two
    # Configuration never outlasts a 60 s readout here; at 300 s it would by 240 s a pointing.
    assert taipan.waited_h == 0.0
    assert taipan.constant_waited_h == pytest.approx(taipan.n_pointing * 240 / 3600)
    assert summary.nights is not None
    assert summary.nights.unused_h == pytest.approx(5 * (28_000 - 8_000 - 2_400 - 300) / 3600)


def test_short_visits_are_not_counted_where_nobody_knows(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run")
    path = folder / "visits.parquet"
    unknown = pl.read_parquet(path).with_columns(guide_shortfall=pl.lit(None, pl.Int32))
    tables.write(unknown, "visits", path)
    summary = summarise(RunTables(folder))
    assert [survey.n_short_guide for survey in summary.surveys] == [None, None]
    assert summary.surveys[0].n_short_sky is not None


def test_ways_lead_from_start_to_end(run_dir: Path) -> None:
    run = RunTables(run_dir)
    visit = run.shown_visit
    assert visit is not None
    plate = read_plate(run, visit)
    starts = plate.robots.filter(pl.col("travel_mm") > 0).select("start_x_mm", "start_y_mm").to_numpy()
    ends = plate.robots.filter(pl.col("travel_mm") > 0).select("x_mm", "y_mm").to_numpy()
    assert len(plate.ways_mm) == len(starts)
    for way, start, end in zip(plate.ways_mm, starts, ends, strict=True):
        np.testing.assert_allclose(way[0], start)
        np.testing.assert_allclose(way[1], [end[0], start[1]], atol=1e-9)  # own x first, theta being 0
        np.testing.assert_allclose(way[-1], end)


def test_galactic_parallels_are_at_their_latitude() -> None:
    for latitude in (-10.0, 0.0, 35.0):
        ra, dec = galactic_parallel(latitude, 50)
        np.testing.assert_allclose(abs_galactic_latitude_deg(ra, dec), abs(latitude), atol=1e-6)


@pytest.mark.parametrize(
    "centres", [[(10.0, -30.0), (14.0, -30.0)], [(0.0, 90.0), (120.0, 87.0)], [(0.0, 0.0), (180.0, 0.0)]]
)
def test_cells_take_the_nearest_tile(centres: list[tuple[float, float]]) -> None:
    ra, dec = np.array(centres).T
    frame = sky_frame(ra, dec, 3.0)
    tiles = pl.DataFrame({"ra_deg": ra, "dec_deg": dec})
    painted = []

    class Paper:
        def imshow(self, values: np.ndarray, **_: object) -> None:
            painted.append(values)

    paint_tiles(Paper(), frame, tiles, np.array([1.0, 2.0]), 3.0)
    x, y = frame.wcs.wcs_world2pix(ra, dec, 0)
    assert painted[0][round(y[0]), round(x[0])] == 1.0
    assert painted[0][round(y[1]), round(x[1])] == 2.0
    assert np.isnan(painted[0]).any()


def test_binned_means_against_a_loop() -> None:
    rng = np.random.default_rng(2)
    x, y, edges = rng.uniform(0, 5, 200), rng.random(200) < 0.4, np.array([0.0, 1.0, 2.5, 4.9, 5.0])
    middle, mean, error = binned(x, y, edges, least=4)
    expected = [y[(x >= low) & (x < high)] for low, high in pairwise(edges)]
    expected = [values for values in expected if len(values) >= 4]
    np.testing.assert_allclose(mean, [values.mean() for values in expected])
    np.testing.assert_allclose(error, [values.std() / np.sqrt(len(values)) for values in expected])
    assert (np.diff(middle) > 0).all()


def test_script_runs_alone(run_dir: Path, tmp_path: Path) -> None:
    script = data_folder("reports") / "plate.py"
    subprocess.run([sys.executable, str(script), str(run_dir), str(tmp_path)], check=True, capture_output=True)
    assert (tmp_path / "plate.png").is_file()
    failed = subprocess.run([sys.executable, str(script), str(tmp_path)], check=False, capture_output=True, text=True)
    assert failed.returncode == 1
    assert "run.json: no such file" in failed.stderr


def test_no_run_is_an_error_in_words(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"run\.json: no such file"):
        make_report(tmp_path)
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(InputError, match="is not JSON"):
        make_report(tmp_path)
    (tmp_path / "run.json").write_text("{}")
    with pytest.raises(InputError, match="not the record of a run"):
        make_report(tmp_path)
