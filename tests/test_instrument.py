"""Instruments: the presets are the published layouts, and impossible ones are refused."""

from pathlib import Path

import numpy as np
import pytest

from survey_sim.errors import InputError
from survey_sim.instrument import GUIDE_PLACES_MM, PRESETS, load_instrument, make_plate, robots_table


def _distances(park: np.ndarray) -> np.ndarray:
    apart = np.hypot(*(park[:, None] - park[None]).transpose(2, 0, 1))
    np.fill_diagonal(apart, np.inf)
    return apart


@pytest.mark.parametrize(
    ("name", "n_science", "n_guide", "pitch"),
    [("paper", 151, 0, 24.1), ("taipan-150", 150, 9, 24.1), ("taipan-300", 300, 9, 16.98), ("manifest", 600, 0, 47.8)],
)
def test_presets_have_the_published_numbers(name: str, n_science: int, n_guide: int, pitch: float) -> None:
    plate = make_plate(load_instrument(name))
    assert (~plate.is_guide).sum() == n_science
    assert plate.is_guide.sum() == n_guide
    science = plate.park_mm[~plate.is_guide]
    assert _distances(science).min() == pytest.approx(pitch)
    assert np.hypot(*plate.park_mm.T).max() <= plate.instrument.plate_radius_mm
    assert plate.robot_id.tolist() == list(range(1, n_science + n_guide + 1))


def test_paper_lattice_ends_at_root_39_pitches() -> None:
    # Figure 8 counts 151 robots: all lattice points within sqrt(39) pitches of the centre.
    plate = make_plate(load_instrument("paper"))
    assert np.hypot(*plate.park_mm.T).max() == pytest.approx(np.sqrt(39) * 24.1)


def test_guides_of_taipan_150_stand_between_three_robots() -> None:
    plate = make_plate(load_instrument("taipan-150"))
    guides, science = plate.park_mm[plate.is_guide], plate.park_mm[~plate.is_guide]
    assert guides[0].tolist() == [0.0, 0.0]
    apart = np.sort(np.hypot(*(guides[1:, None] - science[None]).transpose(2, 0, 1)), axis=1)
    np.testing.assert_allclose(apart[:, :3], 24.1 / np.sqrt(3))
    assert np.hypot(*(guides - np.array(GUIDE_PLACES_MM)).T).max() < 24.1 / np.sqrt(3)
    assert set(plate.patrol_radius_mm[plate.is_guide]) == {10.0}


def test_guides_of_taipan_300_are_the_as_built_places() -> None:
    plate = make_plate(load_instrument("taipan-300"))
    np.testing.assert_allclose(plate.park_mm[plate.is_guide], GUIDE_PLACES_MM, atol=0.2)


def test_as_built_lattice_lacks_the_four_points_that_reach_furthest_along_an_axis() -> None:
    park = make_plate(load_instrument("taipan-300")).park_mm
    rim = park[np.hypot(*park.T) > 155]
    assert len(rim) == 8
    assert np.abs(rim).max() < 150


def test_dead_robots_are_named_by_id() -> None:
    plate = make_plate(load_instrument("paper"), dead=[3, 151])
    assert plate.robot_id[~plate.is_live].tolist() == [3, 151]
    assert robots_table(plate, "taipan")["state"].to_list().count("dead") == 2
    assert plate.n_science_live == 149
    with pytest.raises(InputError, match=r"unknown robot at rows \[152\].*\n.*1 to 151"):
        make_plate(load_instrument("paper"), dead=[152])


def test_file_starts_from_a_preset(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('preset = "paper"\nmin_separation_mm = 11.65\n')
    instrument = load_instrument(file, {"patrol_radius_mm": 75.0})
    assert (instrument.name, instrument.n_science) == ("mine", 151)
    assert (instrument.min_separation_mm, instrument.patrol_radius_mm) == (11.65, 75.0)


def test_explicit_park_positions_replace_the_lattice() -> None:
    instrument = load_instrument("paper", {"park_positions_mm": [[0.0, 0.0], [20.0, 0.0]]})
    assert make_plate(instrument).park_mm.tolist() == [[0.0, 0.0], [20.0, 0.0]]


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"patrol_radius": 75}, "did you mean 'patrol_radius_mm'"),
        ({"patrol_radius_mm": -1.0}, "greater than or equal to 0"),
        ({"plate_radius_mm": float("nan")}, "finite number"),
        ({"n_science": 400}, "park positions inside the plate, 400 robots wanted"),
        ({"min_separation_mm": 25.0}, "nearer to each other than min_separation_mm"),
        ({"park_positions_mm": [[0.0, 200.0]]}, "outside the plate"),
        ({"precise_speed_mm_s": 3.0}, "must not exceed"),
    ],
)
def test_impossible_instruments_are_refused(overrides: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_plate(load_instrument("paper", overrides))


def test_unknown_preset_names_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean 'taipan-150'"):
        load_instrument("taipan150")
    assert set(PRESETS) == {"paper", "taipan-150", "taipan-300", "manifest"}
