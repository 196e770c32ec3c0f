"""Comparisons: the statistic by hand, pairs by seed, what is written, and what is refused."""

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from typer.testing import CliRunner

from survey_sim import tables
from survey_sim.cli import app
from survey_sim.errors import InputError
from survey_sim.plotting import RunTables
from survey_sim.plotting.comparison import ComparisonTables, note_if_alike
from survey_sim.plotting.style import new_figure
from survey_sim.study_schema import STUDY_TABLES
from survey_sim.survey.compare import compare_measures, compare_runs, read_runs, write_imprint
from survey_sim.survey.comparison_page import difference_text, text_of
from survey_sim.survey.imprint import imprint_runs
from survey_sim.survey.measures import measure_run, unit_of
from tests.report_run import write_run


def _measures(values: dict[str, list[float | None]]) -> pl.DataFrame:
    return pl.concat(
        pl.DataFrame(
            {"scenario": name, "seed": range(len(own)), "of": "stars", "measure": "wait_h", "unit": "h", "value": own},
            schema_overrides={"value": pl.Float64},
        )
        for name, own in values.items()
    )


def _row(values: dict[str, list[float | None]], scenario: str) -> dict:
    return compare_measures(_measures(values), list(values)).row(by_predicate=pl.col("scenario") == scenario, named=True)


def test_differences_are_paired_and_have_students_interval() -> None:
    row = _row({"base": [1.0, 10.0, 100.0], "more": [2.0, 12.0, 103.0]}, "more")
    assert row["difference"] == pytest.approx(2.0)
    assert row["difference_error"] == pytest.approx(1.0 / np.sqrt(3.0))
    # 4.3027: the 97.5 % quantile of Student's t with two degrees of freedom, from tables.
    assert row["difference_high"] - row["difference"] == pytest.approx(4.3027 / np.sqrt(3.0), rel=1e-4)
    assert row["difference"] - row["difference_low"] == pytest.approx(4.3027 / np.sqrt(3.0), rel=1e-4)
    assert (row["n_seed"], row["n_pair"]) == (3, 3)


def test_a_single_seed_has_no_uncertainty_and_a_missing_value_is_no_pair() -> None:
    row = _row({"base": [1.0], "more": [2.0]}, "more")
    assert row["difference"] == 1.0
    assert row["difference_error"] is row["difference_low"] is row["mean_error"] is None
    row = _row({"base": [1.0, None, 3.0], "more": [2.0, 5.0, None]}, "more")
    assert (row["n_seed"], row["n_pair"], row["difference"], row["difference_error"]) == (2, 1, 1.0, None)
    row = _row({"base": [None], "more": [None]}, "more")
    assert (row["n_seed"], row["mean"], row["difference"]) == (0, None, None)


def _write_runs(folder: Path) -> list[Path]:
    """Two scenarios of two seeds, the second of visits that take twice as long."""
    dirs = []
    for scenario, factor in (("quick", 1.0), ("slow", 2.0)):
        for seed in (1, 2):
            run_dir = write_run(folder / f"{scenario}-{seed}", settings={"run": {"seed": seed}, "routing": {"x": scenario}})
            for name in ("visits", "paths"):
                frame = tables.read(run_dir, name).with_columns(pl.col("configuration_time_s") * factor * seed)
                tables.write(frame, name, run_dir / f"{name}.parquet")
            record = json.loads((run_dir / "run.json").read_text())
            (run_dir / "run.json").write_text(json.dumps({**record, "name": f"{scenario}-{seed}"}))
            dirs.append(run_dir)
    return dirs


def test_runs_that_differ_in_their_seeds_are_one_scenario(tmp_path: Path) -> None:
    dirs = _write_runs(tmp_path)
    folder = compare_runs(dirs, tmp_path / "out")
    about = json.loads((folder / "comparison.json").read_text())
    assert about["scenarios"] == ["quick-1", "slow-1"]
    assert about["n_seed"] == 2
    assert about["shared"] == {"slow-1": "same sky and tiles, weather; 2 pairs"}
    rows = pl.read_parquet(folder / "comparison.parquet").filter(scenario="slow-1", measure="configuration_median_s")
    measured = [measure_run(RunTables(run_dir)) for run_dir in dirs]
    medians = [frame.filter(measure="configuration_median_s").sort("of")["value"].to_numpy() for frame in measured]
    wanted = (medians[2] - medians[0] + medians[3] - medians[1]) / 2.0
    np.testing.assert_allclose(rows.sort("of")["difference"].to_numpy(), wanted)
    curves = pl.read_parquet(folder / "completeness_curves.parquet")
    assert curves["programme"].unique().sort().to_list() == ["cosmology", "galaxy", "stars"]
    for name in ("measures", "comparison", "completeness_curves", "configuration_quantiles", "imprint_pairs"):
        frame = pl.read_parquet(folder / f"{name}.parquet")
        assert frame.columns == STUDY_TABLES[name].names
        assert len(frame), name


def test_the_command_prints_and_writes_text_page_and_figures(tmp_path: Path) -> None:
    dirs = _write_runs(tmp_path)
    out = tmp_path / "out"
    result = CliRunner().invoke(app, ["compare", *map(str, dirs), "--out", str(out), "--reference", "slow-1"])
    assert result.exit_code == 0, result.output
    assert "reference slow-1" in result.output
    assert result.output.splitlines()[1].startswith("  quick-1: same sky and tiles, weather; 2 pairs")
    page = (out / "index.html").read_text(encoding="utf-8")
    assert (
        page.count("<figure")
        == len(list((out / "figures").glob("*.png")))
        == len(list((out / "figures").glob("*.pdf")))
        == 6
    )
    assert "http" not in page.replace("http-equiv", "")
    assert (out / "comparison.txt").read_text(encoding="utf-8").count("\n") > 50


def test_one_seed_is_said_to_have_no_uncertainty(tmp_path: Path) -> None:
    dirs = _write_runs(tmp_path)
    folder = compare_runs([dirs[0], dirs[2]], tmp_path / "out")
    text = text_of(ComparisonTables(folder))
    assert "one seed: differences have no uncertainty" in text
    assert "±" not in text


def test_a_measure_without_value_in_some_seeds_says_so(tmp_path: Path) -> None:
    folder = compare_runs(_write_runs(tmp_path), tmp_path / "out")
    rows = pl.read_parquet(folder / "comparison.parquet")
    assert " in 1 of 2" not in text_of(ComparisonTables(folder))
    is_row = (pl.col("measure") == "n_visit") & (pl.col("scenario") == "slow-1")
    rows.with_columns(n_seed=pl.when(is_row).then(1).otherwise("n_seed")).write_parquet(folder / "comparison.parquet")
    lines = text_of(ComparisonTables(folder)).splitlines()
    assert [" in 1 of 2" in line for line in lines] == ["visits (configurations)" in line for line in lines]


def test_a_sky_that_several_seeds_share_counts_once(tmp_path: Path) -> None:
    runs = [RunTables(folder) for folder in _write_runs(tmp_path)[:2]]
    alone, together = imprint_runs([("one", runs[0])]), imprint_runs([("one", run) for run in runs])
    assert all(together[name].equals(alone[name]) for name in alone)
    science = runs[1].science.with_columns(pl.col("ra_deg") + 0.5)
    runs[1].__dict__["science"] = science
    pairs = imprint_runs([("one", run) for run in runs])["imprint_pairs"]
    assert pairs["n_pair"].sum() > 1.5 * alone["imprint_pairs"]["n_pair"].sum()


def test_other_skies_are_told(tmp_path: Path) -> None:
    dirs = _write_runs(tmp_path)
    targets = tables.read(dirs[2], "targets").with_columns(pl.col("ra_deg") + 0.5)
    tables.write(targets, "targets", dirs[2] / "targets.parquet")
    folder = compare_runs(dirs, tmp_path / "out")
    words = json.loads((folder / "comparison.json").read_text())["shared"]["slow-1"]
    assert words == "same weather; other sky and tiles; 2 pairs"


def test_what_cannot_be_compared_is_refused(tmp_path: Path) -> None:
    dirs = _write_runs(tmp_path)
    (tmp_path / "empty").mkdir()
    for bad, words in (
        ([dirs[0], dirs[0]], "same scenario and seed"),
        ([tmp_path / "empty"], "no run and no sweep"),
        ([tmp_path / "absent"], "run.json"),
    ):
        with pytest.raises(InputError, match=words):
            compare_runs(bad, tmp_path / "out")
    with pytest.raises(InputError, match="did you mean 'quick-1'"):
        compare_runs(dirs, tmp_path / "out", "quick-2")
    assert not (tmp_path / "out").exists()


def test_runs_of_a_sweep_that_are_not_finished_are_left_out(tmp_path: Path) -> None:
    for number, run_dir in enumerate(_write_runs(tmp_path / "made")):
        place = tmp_path / "sweep" / run_dir.name[:-2] / f"seed-{run_dir.name[-1]}"
        place.parent.mkdir(parents=True, exist_ok=True)
        run_dir.rename(place)
        record = json.loads((place / "run.json").read_text())
        record["stages"] = {"visits": {}} if number == 3 else {"visits": {}, "schedule": {}}
        (place / "run.json").write_text(json.dumps(record))
    found = [(run.scenario, run.seed) for run in read_runs([tmp_path / "sweep"])]
    assert found == [("quick-1", 1), ("quick-1", 2), ("slow-1", 1)]


def test_the_imprint_of_one_run(tmp_path: Path) -> None:
    run_dir = write_run(tmp_path / "one")
    folder = write_imprint(run_dir)
    pairs = pl.read_parquet(folder / "imprint_pairs.parquet")
    assert set(pairs["outcome"]) == {"allocated", "observed"}
    assert pairs["separation_low_deg"].min() == pytest.approx(10.0 / 3600.0)
    assert pairs["separation_high_deg"].max() == pytest.approx(6.0)
    assert {path.stem for path in (folder / "figures").glob("*.png")} == {"imprint_pairs", "imprint_place", "imprint_plate"}


def test_units_stand_in_the_names() -> None:
    assert [unit_of(name) for name in ("wait_h", "within_readout_frac", "n_visit", "travel_mean_mm")] == ["h", "", "", "mm"]


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [(0.455, 0.399, "+0.46 ± 0.40"), (-12.89, 10.08, "-13 ± 10"), (7.0, 0.0, "+7.00 ± 0"), (0.0, 0.0, "0 ± 0")],
)
def test_differences_have_the_digits_of_their_uncertainty(value: float, error: float, text: str) -> None:
    assert difference_text(value, error) == text


@pytest.mark.parametrize(("second", "remarks"), [([0.1, 0.9], ["all scenarios alike"]), ([0.1, 0.8], []), ([0.1], [])])
def test_lines_that_lie_on_one_another_are_told(second: list[float], remarks: list[str]) -> None:
    axes = new_figure().subplots()
    scenarios = ["a", "a", *["b"] * len(second)]
    note_if_alike(axes, pl.DataFrame({"scenario": scenarios, "value": [0.1, 0.9, *second]}), "value")
    assert [text.get_text() for text in axes.texts] == remarks


def test_one_scenario_is_not_said_to_be_alike() -> None:
    axes = new_figure().subplots()
    note_if_alike(axes, pl.DataFrame({"scenario": ["a", "a"], "value": [0.1, 0.9]}), "value")
    assert not axes.texts
