"""The allocation study: what its tables say of a small field, and that every figure draws from them."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from survey_sim.errors import InputError
from survey_sim.folders import data_folder
from survey_sim.plotting import find_scripts
from survey_sim.plotting.study import StudyTables, draw_study
from survey_sim.survey import allocation_study, study_fields
from survey_sim.survey.allocation_study import Case, make_study, run_case, study_cases, summarise_study
from tests.mock_targets import clustered_xy, uniform_xy

N_ROBOT = 151
SCRIPTS = {
    "completeness", "efficiency", "fields", "patrol_separation", "patrol_separation_travel", "priorities", "travel",
    "travel_distribution",
}  # fmt: skip


def field(xy_mm: np.ndarray, priorities: tuple[int, ...]) -> pl.DataFrame:
    n, n_sky = len(xy_mm), 120
    xy = np.vstack([xy_mm, uniform_xy(n_sky, 5)])
    drawn = np.random.default_rng(1).choice(priorities, n)
    return pl.DataFrame(
        {
            "target_id": np.arange(n + n_sky),
            "kind": ["science"] * n + ["sky"] * n_sky,
            "priority": np.append(drawn, np.ones(n_sky, int)),
            "x_mm": xy[:, 0],
            "y_mm": xy[:, 1],
        }
    )


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("study")
    done: list[tuple[int, int]] = []
    sources = {"galaxies": field(clustered_xy(300, 1), tuple(range(1, 10))), "stars": field(uniform_xy(200, 2), (7, 9))}
    make_study(sources, out, advance=lambda n, of: done.append((n, of)))
    assert done[-1][0] == done[-1][1] == len(done)
    return out


def rows(study: Path, name: str, **where: object) -> pl.DataFrame:
    return pl.read_parquet(study / f"{name}.parquet").filter(**where)


def test_a_run_for_every_field_algorithm_plate_and_number_of_sky_fibres(study: Path) -> None:
    runs = rows(study, "visits").select("source", "algorithm", "patrol_radius_mm", "min_separation_mm", "min_sky").unique()
    # Four plates each; and 10, 20 and 30 sky fibres for the three algorithms that know them.
    assert len(runs) == 2 * (4 * 4 + 3 * 3)
    sky = rows(study, "visits")
    assert (sky["n_sky"] == sky["min_sky"]).all()


def test_completeness_grows_and_stays_below_the_bound(study: Path) -> None:
    visits = rows(study, "visits", min_sky=0)
    keys = ["source", "patrol_radius_mm", "min_separation_mm", "visit"]
    joined = visits.join(rows(study, "limits"), on=keys, how="left")
    assert joined["bound_frac"].null_count() == 0
    assert (joined["completeness_frac"] <= joined["bound_frac"] + 1e-12).all()
    for run in visits.partition_by("source", "algorithm", "patrol_radius_mm", "min_separation_mm"):
        assert run["visit"].to_list() == list(range(1, len(run) + 1))
        assert (run["completeness_frac"].diff().drop_nulls() > 0).all()


def test_thresholds_and_efficiency_by_hand(study: Path) -> None:
    """Every target wants one visit: the lowest threshold counts them all, and efficiency is fibres used well."""
    visits = rows(study, "visits", source="galaxies", algorithm="plan", min_sky=10)
    own = rows(study, "priorities", source="galaxies", algorithm="plan", min_sky=10)
    assert own["priority_min"].unique().sort().to_list() == [1, 3, 5, 7, 9]
    everything = own.filter(priority_min=1)
    assert everything["completeness_frac"].to_list() == visits["completeness_frac"].to_list()
    used = visits["n_science"].cum_sum() / (visits["visit"] * N_ROBOT)
    assert everything["efficiency_frac"].to_list() == pytest.approx(used.to_list())
    assert rows(study, "priorities", source="stars")["priority_min"].unique().sort().to_list() == [7, 9]


def test_travel_is_that_of_the_robots(study: Path) -> None:
    travel = rows(study, "travel").group_by("source", "algorithm", "visit").agg(
        pl.col("travel_mm").max().alias("most"), pl.col("travel_mm").mean().alias("mean")
    )  # fmt: skip
    plain = rows(study, "visits", min_sky=0, patrol_radius_mm=50.0, min_separation_mm=9.0)
    joined = plain.join(travel, on=["source", "algorithm", "visit"])
    assert len(joined) == len(plain)
    assert joined["travel_max_mm"].to_list() == pytest.approx(joined["most"].to_list())
    assert joined["travel_mean_mm"].to_list() == pytest.approx(joined["mean"].to_list())
    assert (joined["travel_p95_mm"] <= joined["travel_max_mm"]).all()


def test_summary(study: Path) -> None:
    summary = summarise_study(study)
    assert summary.select("source", "algorithm").n_unique() == len(summary) == 8
    assert summary.filter(algorithm="cda-advanced")["crossings"].sum() == 0
    assert (summary["completeness_frac"] <= summary["bound_frac"] + 1e-12).all()
    assert summary.filter(source="galaxies")["visits"].unique().to_list() == [2]


def test_plans_for_other_numbers_of_visits(study: Path) -> None:
    planned = rows(study, "planned", source="galaxies").sort("planned_visits")
    assert planned["planned_visits"].n_unique() == len(planned) >= 2
    assert (planned["completeness_frac"].diff().drop_nulls() >= 0).all()


def test_the_same_in_other_processes(study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(allocation_study, "ALGORITHMS", ("cda-basic",))
    monkeypatch.setattr(allocation_study, "PLANNED_FRACS", ())
    make_study({"stars": field(uniform_xy(200, 2), (7, 9))}, tmp_path, n_worker=2)
    assert rows(tmp_path, "visits").equals(rows(study, "visits", source="stars", algorithm="cda-basic"))


def test_cases_of_the_paper() -> None:
    cases = study_cases({"galaxy-1": 1431})
    plans = {case.planned_visits for case in cases if case.algorithm == "plan" and case.is_shown and case.min_sky == 0}
    assert plans == {10}
    assert {case.planned_visits for case in cases if case.algorithm == "plan" and case.min_sky == 30} == {12}
    basic = run_case(Case("x", "cda-basic", min_sky=30, planned_visits=1), field(uniform_xy(200, 2), (9,)))
    assert basic["visits"]["n_sky"].to_list() == [0]


def test_every_script_draws(study: Path, tmp_path: Path) -> None:
    drawn = {path.stem for path in draw_study(study, tmp_path)}
    assert drawn == set(find_scripts(data_folder("reports") / "allocation")) == SCRIPTS
    for name in drawn:
        for suffix, magic in (("png", b"\x89PNG"), ("pdf", b"%PDF")):
            assert (tmp_path / f"{name}.{suffix}").read_bytes().startswith(magic)


def test_axes_hold_all_that_is_drawn(study: Path) -> None:
    for script in find_scripts(data_folder("reports") / "allocation").values():
        for axes in script.draw(StudyTables(study)).axes:  # type: ignore[arg-type]
            for line in axes.lines:
                height = np.asarray(line.get_ydata(), dtype=float)
                assert height.max(initial=0.0) <= axes.get_ylim()[1] + 1e-9, (script.name, axes.get_title())


def test_no_study(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="survey-sim figures"):
        StudyTables(tmp_path)


def test_stars_of_the_pole_are_real_and_sky_keeps_away() -> None:
    table = study_fields.star_field(study_fields.POLE_DEG, seed=1)
    science = table.filter(kind="science")
    assert len(science) == 448
    assert set(science["priority"]) == {7, 9}
    sky = table.filter(kind="sky").select("x_mm", "y_mm").to_numpy()
    assert len(sky) == study_fields.N_SKY
    apart = sky[:, None] - science.select("x_mm", "y_mm").to_numpy()[None]
    assert np.hypot(*apart.transpose(2, 0, 1)).min() >= study_fields.SKY_CLEARANCE_MM
