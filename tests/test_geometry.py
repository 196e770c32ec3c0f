"""Projection of a field: exact both ways, equidistant, oriented as seen on the sky."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from survey_sim.geometry import chord, plate_to_sky, sky_to_plate, unit_vectors

SCALE = 67.2  # arcsec/mm


@given(
    ra=st.floats(0, 360, exclude_max=True),
    dec=st.floats(-90, 90),
    x=st.floats(-163.5, 163.5),
    y=st.floats(-163.5, 163.5),
)
def test_plate_to_sky_and_back_is_exact_to_a_nanometre(ra: float, dec: float, x: float, y: float) -> None:
    sky = plate_to_sky(np.array([[x, y]]), (ra, dec), SCALE)
    assert 0 <= sky[0, 0] < 360
    back = sky_to_plate(sky[:, 0], sky[:, 1], (ra, dec), SCALE)
    np.testing.assert_allclose(back, [[x, y]], rtol=0, atol=1e-6)


@given(dec=st.floats(-90, 90), angle=st.floats(0, 2 * np.pi), radius=st.floats(0, 163.5))
def test_radius_on_the_plate_is_scale_times_angle(dec: float, angle: float, radius: float) -> None:
    centre = (123.0, dec)
    sky = plate_to_sky(np.array([[radius * np.cos(angle), radius * np.sin(angle)]]), centre, SCALE)
    apart = np.linalg.norm(unit_vectors(sky[:, 0], sky[:, 1]) - unit_vectors(np.array([123.0]), np.array([dec])))
    assert 2 * np.arcsin(apart / 2) == pytest.approx(np.radians(radius * SCALE / 3600), abs=1e-12)


@pytest.mark.parametrize("dec", [-89.9, -31.0, 0.0, 60.0, 89.9])
def test_x_is_east_and_y_is_north(dec: float) -> None:
    centre = (359.99, dec)
    north = sky_to_plate(np.array([359.99]), np.array([dec + 0.05]), centre, SCALE)[0]
    east = sky_to_plate(np.array([359.99 + 0.01]), np.array([dec]), centre, SCALE)[0]
    assert north[1] == pytest.approx(0.05 * 3600 / SCALE)
    assert abs(north[0]) < 1e-9
    assert east[0] == pytest.approx(0.01 * np.cos(np.radians(dec)) * 3600 / SCALE, rel=1e-6)


@pytest.mark.parametrize("dec", [90.0, -90.0])
def test_a_field_on_the_pole_is_the_limit_of_fields_near_it(dec: float) -> None:
    ra, other = np.array([10.0, 100.0, 250.0]), np.full(3, np.sign(dec) * 88.5)
    on_pole = sky_to_plate(ra, other, (40.0, dec), SCALE)
    near_pole = sky_to_plate(ra, other, (40.0, dec * (1 - 1e-9)), SCALE)
    np.testing.assert_allclose(on_pole, near_pole, atol=1e-4)


def test_no_position_gives_no_position() -> None:
    assert sky_to_plate(np.empty(0), np.empty(0), (0.0, 0.0), SCALE).shape == (0, 2)
    assert plate_to_sky(np.empty((0, 2)), (0.0, 0.0), SCALE).shape == (0, 2)


def test_chord_of_a_right_angle() -> None:
    assert chord(90.0) == pytest.approx(np.sqrt(2.0))
