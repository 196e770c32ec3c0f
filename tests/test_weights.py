"""Selection weights: what is random, that they undo the imprint, that they come out the same, whole and again."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from rich.console import Console
from scipy.spatial.distance import pdist, squareform
from typer.testing import CliRunner

from survey_sim import tables
from survey_sim.allocation import AllocationSettings, Realisations, start_allocation
from survey_sim.cli import app
from survey_sim.errors import InputError
from survey_sim.imprint import pack_bits, pair_weights, popcount, target_weights, unpack_bits
from survey_sim.instrument import load_instrument, make_plate
from survey_sim.survey.engine import run_stages
from survey_sim.survey.run import open_run
from survey_sim.survey.weights import weigh_run
from survey_sim.survey.workers import Workers
from tests.mock_targets import clustered_xy, field_targets
from tests.small_survey import write_small_survey

# A small plate of 37 robots, on which clusters cannot be served in the visits given.
PLATE = make_plate(load_instrument("paper", {"n_science": 37, "plate_radius_mm": 90.0}))
NO_CALIBRATION = {"wanted_standard": 0, "wanted_sky": 0, "wanted_guide": 0, "min_sky_region": 0}
N_REALISATION = 192


def _realised(targets, n: int, seed: int, **values) -> np.ndarray:
    """(n_target, n) whether each realisation completes each target."""
    realisations = Realisations(targets, PLATE, AllocationSettings(**NO_CALIBRATION, **values))
    nothing = np.zeros(targets.n_target, dtype=np.int64)
    draws = [realisations.draw(np.random.default_rng([seed, number]), nothing) for number in range(n)]
    return np.column_stack(draws) >= targets.wanted_visits[:, None]


def _clustered(n: int = 110):
    xy = 0.5 * clustered_xy(4 * n, seed=5)
    return field_targets(xy[np.hypot(*xy.T) < 75.0][:n])


@pytest.mark.parametrize("algorithm", ["plan", "matching"])
def test_weights_undo_the_imprint_on_pairs(algorithm: str) -> None:
    """Mean over surveys of PIP-weighted pairs is that of all targets; without weights close pairs are missed."""
    targets = _clustered()
    drawn = {"algorithm": algorithm, "visits": 2, "sub_priority": 1.0}
    bits = pack_bits(_realised(targets, N_REALISATION, seed=1, **drawn))
    surveys = _realised(targets, 48, seed=2, **drawn)
    separation = squareform(pdist(np.column_stack([targets.x_mm, targets.y_mm])))
    first, second = np.triu_indices(targets.n_target, k=1)
    edges = np.array([0.0, 9.0, 18.0, 60.0, 180.0])
    in_bin = np.digitize(separation[first, second], edges) - 1
    both = popcount(bits[first] & bits[second])
    # Pairs that are never both complete cannot be recovered by any weight: they are told apart.
    can_be = both > 0
    weights = pair_weights(bits[first], bits[second], N_REALISATION)
    ratios, raw = [], []
    for is_complete in surveys.T:
        is_pair = is_complete[first] & is_complete[second] & can_be
        found = np.bincount(in_bin[is_pair], weights=weights[is_pair], minlength=4)
        ratios.append(found / np.bincount(in_bin[can_be], minlength=4))
        share = is_complete.mean()
        raw.append(np.bincount(in_bin[is_pair], minlength=4) / share**2 / np.bincount(in_bin, minlength=4))
    error = np.std(ratios, axis=0, ddof=1) / np.sqrt(len(ratios))
    np.testing.assert_array_less(np.abs(np.mean(ratios, axis=0) - 1.0), 3.0 * error + 0.02)
    assert np.mean(raw, axis=0)[0] < 0.85
    assert can_be[in_bin > 0].mean() > 0.98
    counts = [target_weights(bits, N_REALISATION)[is_complete].sum() for is_complete in surveys.T]
    can_be_complete = (popcount(bits) > 0).sum()
    assert np.mean(counts) == pytest.approx(can_be_complete, rel=0.02)


def test_the_lighter_search_has_the_probabilities_of_whole_sessions() -> None:
    targets = _clustered()
    values = {"visits": 2, "sub_priority": 1.0}
    light = _realised(targets, 96, seed=3, **values).mean(axis=1)
    sessions = []
    for number in range(96):
        settings = AllocationSettings(**NO_CALIBRATION, **values)
        session = start_allocation(targets, PLATE, settings, np.random.default_rng([4, number]))
        position = PLATE.park_mm
        while (visit := session.next_visit(position)) is not None:
            session.record(visit, np.ones(PLATE.n_robot, dtype=bool))
            position = visit.goal_mm
        sessions.append(session.is_complete)
    whole = np.mean(sessions, axis=0)
    noise = np.sqrt(np.mean((light * (1 - light) + whole * (1 - whole)) / 95))
    assert np.sqrt(np.mean((light - whole) ** 2)) < 1.5 * noise
    assert light.mean() == pytest.approx(whole.mean(), abs=0.01)


def test_without_sub_priority_nothing_is_drawn_and_priorities_are_never_overtaken() -> None:
    xy = np.array([[0.0, 0.0], [4.0, 0.0], [40.0, 0.0], [44.0, 0.0]])
    targets = field_targets(xy, priority=[5, 6, 5, 5])
    realised = _realised(targets, 200, seed=5, visits=1)
    assert realised.sum(axis=0).tolist() == [2] * 200
    assert realised[0].sum() == 0
    assert realised[1].all()
    assert 60 < realised[2].sum() < 140
    kept = [start_allocation(targets, PLATE, AllocationSettings(visits=1), np.random.default_rng(k)) for k in range(9)]
    assert len({tuple(session.next_visit(PLATE.park_mm).target) for session in kept}) == 1


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small run, magnitude ranges and all."""
    pipeline = write_small_survey(tmp_path_factory.mktemp("sky"))
    changes = ("allocation.algorithm=plan", "allocation.visits=2", "allocation.mag_ranges=[[5.0,10.5],[9.5,14.0]]")
    run = open_run(
        pipeline, Workers(), tmp_path_factory.mktemp("runs") / "small", (*changes, "schedule.end_date=2016-10-01")
    )
    with run.locked():
        run_stages(run, skipped=("report",))
    return run.folder


def test_the_table_holds_every_science_target_and_is_the_same_again(run_dir: Path) -> None:
    console = Console(quiet=True)
    path, remarks = weigh_run(run_dir, 70, Workers(), console)
    content = path.read_bytes()
    table = pl.read_parquet(path)
    science = pl.read_parquet(run_dir / "targets.parquet").filter(kind="science")
    assert table["target_id"].to_list() == science["target_id"].sort().to_list()
    assert table.columns == ["target_id", "survey", "programme", "n_realisation", "probability_frac", "bits_0", "bits_1"]
    realised = unpack_bits(table.select("bits_0", "bits_1").to_numpy(), 70)
    np.testing.assert_array_equal(realised.mean(axis=1), table["probability_frac"].to_numpy())
    assert 0.2 < table["probability_frac"].mean() < 1.0
    assert set(table["programme"]) == {"bright", "faint"}
    assert len(remarks) == 1
    assert "sub_priority" in remarks[0]
    parts = sorted((run_dir / ".state" / "weights").glob("*.parquet"))
    before = {part: part.stat().st_mtime_ns for part in parts}
    parts[0].unlink()
    path.unlink()
    weigh_run(run_dir, 70, Workers(2), console)
    assert path.read_bytes() == content
    again = {part: part.stat().st_mtime_ns for part in parts}
    assert [part for part in parts if again[part] != before[part]] == parts[:1]


def test_realisations_of_pooled_tiles_are_as_complete_as_the_run(tmp_path: Path) -> None:
    """Where calibration takes fibres, tiles make more visits than pooling planned: realisations do so too."""
    changes = (
        *(
            "allocation.algorithm=plan",
            "instrument.n_science=61",
            "allocation.wanted_sky=15",
            "allocation.wanted_standard=10",
        ),
        *("programme.bright.visits=4", "programme.bright.completeness_frac=0.8", "schedule.end_date=2016-10-01"),
    )
    run = open_run(write_small_survey(tmp_path), Workers(), tmp_path / "run", changes)
    with run.locked():
        run_stages(run, skipped=("schedule", "report"))
    path, remarks = weigh_run(run.folder, 24, Workers(), Console(quiet=True))
    assert "pooling" in remarks[-1]
    reached = tables.scan(run.folder, "allocations").group_by("target_id").agg(n_visit=pl.len()).collect()
    targets = tables.read(run.folder, "targets").select("target_id", "wanted_visits")
    rows = pl.read_parquet(path).join(targets, on="target_id").join(reached, on="target_id", how="left")
    is_done = pl.col("n_visit").fill_null(0) >= pl.col("wanted_visits")
    is_never = pl.col("probability_frac") == 0.0
    shares = rows.group_by("programme").agg(
        more=(pl.col("probability_frac") - is_done).mean().abs(), unforeseen=(is_done & is_never).mean()
    )
    assert shares["programme"].n_unique() == 2
    assert shares["more"].max() < 0.05
    assert shares["unforeseen"].max() < 0.02


def test_bad_requests_are_refused(run_dir: Path) -> None:
    result = CliRunner().invoke(app, ["weights", str(run_dir), "--survey", "starz"])
    assert isinstance(result.exception, (SystemExit, InputError))
    for realisations in (0, 5000):
        with pytest.raises(InputError, match="--realisations"):
            weigh_run(run_dir, realisations, Workers(), Console(quiet=True))
    with pytest.raises(InputError, match=r"run\.json"):
        weigh_run(run_dir / "absent", 4, Workers(), Console(quiet=True))
