"""The study of execution errors: its table holds what it says, and every figure is drawn from it."""

from pathlib import Path

import polars as pl
import pytest

from survey_sim.errors import InputError
from survey_sim.plotting.execution import draw_executions, read_executions
from survey_sim.survey import execution_study as study


@pytest.fixture(scope="module")
def rows() -> pl.DataFrame:
    return study.play_field(0, n_visit=1)


def test_each_path_is_played_with_every_margin_mode_and_error(rows: pl.DataFrame) -> None:
    played = len(study.MARGINS_MM) * len(study.MODES) * len(study.SCATTERS_FRAC)
    # From park, nobody has to go back to it.
    assert rows["path"].unique().sort().to_list() == ["park_to_target", "start_to_target"]
    assert rows.height == 2 * played
    assert rows.select("path", "margin_mm", "mode", "scatter_frac").is_unique().all()
    exact = rows.filter(scatter_frac=0.0)
    assert exact["moving_time_s"].to_list() == pytest.approx(exact["planned_time_s"].to_list())
    assert not exact["is_near"].any()
    assert (rows["planned_time_s"] >= rows["lower_bound_s"] - 1e-9).all()
    assert (rows.filter(pl.col("is_touching"))["min_separation_mm"] < 8.0).all()
    assert (rows.filter(pl.col("is_near"))["min_separation_mm"] < 9.0).all()


def test_shares_are_of_all_paths(rows: pl.DataFrame) -> None:
    summary = study.summarise_executions(rows)
    assert (summary["paths"] == 2).all()
    own = rows.filter(margin_mm=0.0, mode="open-loop", scatter_frac=0.05)
    row = summary.filter(margin_mm=0.0, mode="open-loop", scatter_frac=0.05).row(0, named=True)
    assert row["near_frac"] == own["is_near"].sum() / 2
    longer = sum(own["moving_time_s"] / own["planned_time_s"]) / 2 - 1
    assert row["cost_frac"] == pytest.approx(longer)


def test_every_figure_is_drawn(rows: pl.DataFrame, tmp_path: Path) -> None:
    rows.write_parquet(tmp_path / "executions.parquet")
    drawn = list(draw_executions(tmp_path, tmp_path / "figures"))
    assert [path.name for path in drawn] == ["cost.png", "safety.png"]
    assert all(path.stat().st_size > 10_000 and path.with_suffix(".pdf").is_file() for path in drawn)


def test_no_study_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no study of execution errors") as refusal:
        read_executions(tmp_path)
    assert "survey-sim figures --study execution" in str(refusal.value)
