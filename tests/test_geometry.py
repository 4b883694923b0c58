"""Rotations against their definition, geodesy against pyproj."""

import math

import numpy as np
import pyproj
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from interloc import geometry

angles = st.floats(-math.pi, math.pi, allow_nan=False)
tilts = st.floats(-1.5, 1.5, allow_nan=False)
metres = st.floats(-100, 100, allow_nan=False)


@given(angles, tilts, angles)
def test_rotation_from_angles_is_proper_and_keeps_its_heading(roll: float, pitch: float, yaw: float) -> None:
    rotation = geometry.rotation_from_rpy(roll, pitch, yaw)
    assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1)
    assert abs(geometry.wrap_angle(float(geometry.yaw_of(rotation)) - yaw)) < 1e-9


def test_rotation_axes_are_those_of_kitti() -> None:
    """Body: x forward, y left, z up."""
    rotation, quarter = geometry.rotation_from_rpy, math.pi / 2
    assert_allclose(rotation(0, 0, quarter) @ [1, 0, 0], [0, 1, 0], atol=1e-15)  # yaw: forward looks north
    assert_allclose(rotation(0, quarter, 0) @ [1, 0, 0], [0, 0, -1], atol=1e-15)  # pitch: the nose goes down
    assert_allclose(rotation(quarter, 0, 0) @ [0, 1, 0], [0, 0, 1], atol=1e-15)  # roll: the left goes up


@given(angles, tilts, angles, st.tuples(metres, metres, metres))
def test_a_transform_and_its_inverse_cancel(roll: float, pitch: float, yaw: float, t: tuple[float, ...]) -> None:
    transform = np.eye(4)
    transform[:3, :3] = geometry.rotation_from_rpy(roll, pitch, yaw)
    transform[:3, 3] = t
    assert_allclose(geometry.invert_transform(transform) @ transform, np.eye(4), atol=1e-12)
    assert_allclose(geometry.invert_transform(np.stack([transform] * 3))[2], np.linalg.inv(transform), atol=1e-12)


@given(angles, st.floats(0, math.pi))
def test_rotation_angle_is_the_angle_turned(yaw: float, turn: float) -> None:
    a, b = geometry.rotation_from_rpy(0, 0, yaw), geometry.rotation_from_rpy(0, 0, yaw + turn)
    assert geometry.rotation_angle(a, b) == pytest.approx(turn, abs=1e-6)


@given(st.floats(-100, 100))
def test_wrapped_angles_point_the_same_way(angle: float) -> None:
    wrapped = geometry.wrap_angle(angle)
    assert -math.pi <= wrapped < math.pi + 1e-12
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


@given(angles)
def test_a_bearing_points_where_its_angle_points(angle: float) -> None:
    bearing = math.radians(float(geometry.bearing_deg(angle)))
    assert 0 <= bearing < 2 * math.pi + 1e-12
    assert_allclose([math.sin(bearing), math.cos(bearing)], [math.cos(angle), math.sin(angle)], atol=1e-12)


def test_points_turn_counter_clockwise() -> None:
    assert_allclose(geometry.rotate_2d(np.array([[1.0, 0.0], [0.0, 2.0]]), math.pi / 2), [[0, 1], [-2, 0]], atol=1e-15)
    assert_allclose(
        geometry.rotate_2d(np.array([[1.0, 0.0], [1.0, 0.0]]), np.array([0, math.pi])), [[1, 0], [-1, 0]], atol=1e-15
    )


def topocentric(lat: float, lon: float, alt: float) -> pyproj.Transformer:
    return pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lat_0={lat!r} +lon_0={lon!r} +h_0={alt!r}"
    )


@pytest.mark.parametrize("lat", [49.011, 48.95, 0.0, 70.0, -33.9])
@pytest.mark.parametrize(("limit_m", "tolerance_m"), [(100.0, 1.0e-4), (1000.0, 1.0e-2)])
def test_places_agree_with_pyproj_in_the_plane_at_the_fix(lat: float, limit_m: float, tolerance_m: float) -> None:
    """Against the tangent plane itself: 3D topocentric coordinates at the height of the fix."""
    lon, alt = 8.42, 0.0
    points = np.random.default_rng(2).uniform(-1, 1, (200, 2))
    points *= limit_m / np.linalg.norm(points, axis=1, keepdims=True)
    found = geometry.lonlat_from_enu(lat, lon, points)
    east, north, _ = topocentric(lat, lon, alt).transform(found[:, 0], found[:, 1], np.full(200, alt))
    assert np.hypot(east - points[:, 0], north - points[:, 1]).max() < tolerance_m


@given(st.floats(-75, 75), st.floats(-170, 170), st.tuples(metres, metres), st.sampled_from([1, 100]))
def test_enu_and_lonlat_undo_each_other(lat: float, lon: float, xy: tuple[float, float], scale: int) -> None:
    point = np.array(xy) * scale
    assert_allclose(geometry.enu_from_lonlat(lat, lon, geometry.lonlat_from_enu(lat, lon, point)), point, atol=1e-7)


def test_earth_centred_positions_are_those_of_pyproj() -> None:
    lat, lon, alt = (
        np.array([49.0, -33.9, 89.9, 0.0]),
        np.array([8.4, 151.2, -77.0, 180.0]),
        np.array([115, -20, 0, 9e3]),
    )
    expected = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True).transform(lon, lat, alt)
    assert_allclose(geometry.ecef_from_geodetic(lat, lon, alt), np.stack(expected, axis=-1), atol=1e-8)
