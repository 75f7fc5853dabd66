"""Quaternions and frames against scipy's Rotation and the algebra of rotations."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from twin.frames import (
    cross,
    from_euler,
    multiply,
    quaternion_rate,
    rotation_matrix,
    rotation_vector,
    to_body,
    to_euler,
    to_ned,
)

Array = np.ndarray
angles = st.floats(-np.pi, np.pi)
vectors = arrays(np.float64, 3, elements=st.floats(-1e3, 1e3))
quaternions = (
    arrays(np.float64, 4, elements=st.floats(-1, 1))
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: q / np.linalg.norm(q))
)
directions = (
    arrays(np.float64, 3, elements=st.floats(-1, 1))
    .filter(lambda v: np.linalg.norm(v) > 0.1)
    .map(lambda v: v / np.linalg.norm(v))
)


def scipy_of(q: Array) -> Rotation:
    return Rotation.from_quat(np.roll(q, -1, axis=-1))


@pytest.mark.slow
@given(q=quaternions)
def test_rotation_matrix_is_scipys(q: Array) -> None:
    np.testing.assert_allclose(rotation_matrix(list(q)), scipy_of(q).as_matrix(), atol=1e-14)


@pytest.mark.slow
@given(q=quaternions, v=vectors)
def test_to_ned_and_back(q: Array, v: Array) -> None:
    there = to_ned(list(q), list(v))
    np.testing.assert_allclose(there, scipy_of(q).apply(v), atol=1e-11)
    np.testing.assert_allclose(to_body(list(q), there), v, atol=1e-11)
    assert np.linalg.norm(there) == pytest.approx(np.linalg.norm(v), rel=1e-13, abs=1e-13)


@pytest.mark.slow
@given(a=quaternions, b=quaternions)
def test_multiply_composes_rotations(a: Array, b: Array) -> None:
    product = np.array(multiply(list(a), list(b)))
    assert np.linalg.norm(product) == pytest.approx(1.0, abs=1e-14)
    expected = scipy_of(a).as_matrix() @ scipy_of(b).as_matrix()
    np.testing.assert_allclose(rotation_matrix(list(product)), expected, atol=1e-14)


@pytest.mark.slow
@given(roll=angles, pitch=angles, yaw=angles)
def test_from_euler_is_yaw_then_pitch_then_roll(roll: float, pitch: float, yaw: float) -> None:
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    q = from_euler(roll, pitch, yaw)
    np.testing.assert_allclose(rotation_matrix(list(q)), expected, atol=1e-14)
    turns = np.column_stack([q, from_euler(0.1, 0.2, 0.3)])
    np.testing.assert_allclose(to_euler(turns)[:, 1], [0.1, 0.2, 0.3], atol=1e-12)
    again = Rotation.from_euler("ZYX", to_euler(turns)[::-1, 0]).as_matrix()
    np.testing.assert_allclose(again, expected, atol=1e-7)


@pytest.mark.parametrize(
    ("angles", "body", "ned"),
    [
        ((0, 0, np.pi / 2), (1, 0, 0), (0, 1, 0)),  # nose east
        ((0, np.pi / 2, 0), (1, 0, 0), (0, 0, -1)),  # nose up
        ((np.pi / 2, 0, 0), (0, 1, 0), (0, 0, 1)),  # right wing down
    ],
    ids=["yaw", "pitch", "roll"],
)
def test_positive_angles_turn_nose_right_nose_up_right_wing_down(
    angles: tuple[float, ...], body: tuple[float, ...], ned: tuple[float, ...]
) -> None:
    np.testing.assert_allclose(to_ned(list(from_euler(*angles)), list(body)), ned, atol=1e-15)


@pytest.mark.slow
@given(q=quaternions, omega=vectors)
def test_quaternion_rate_is_the_derivative_of_the_rotation(q: Array, omega: Array) -> None:
    """dR/dt = R [omega]x, checked by a small exact turn."""
    dt = 1e-6 / max(1.0, float(np.linalg.norm(omega)))
    half = scipy_of(q) * Rotation.from_rotvec(omega * dt)
    back = scipy_of(q) * Rotation.from_rotvec(-omega * dt)
    slope = np.roll(half.as_quat(), 1) * np.sign(np.dot(np.roll(half.as_quat(), 1), q))
    slope -= np.roll(back.as_quat(), 1) * np.sign(np.dot(np.roll(back.as_quat(), 1), q))
    rate = np.array(quaternion_rate(list(q), list(omega)))
    np.testing.assert_allclose(
        rate, slope / (2 * dt), atol=1e-8 * (1 + float(np.linalg.norm(omega)))
    )
    assert abs(rate @ q) < 1e-12 * (1 + np.linalg.norm(omega))  # the norm stays


@pytest.mark.slow
@given(a=vectors, b=vectors)
def test_cross(a: Array, b: Array) -> None:
    np.testing.assert_allclose(cross(list(a), list(b)), np.cross(a, b), rtol=1e-13, atol=1e-9)


# -- rotation_vector ----------------------------------------------------------------------


@pytest.mark.slow
@given(base=quaternions, axis=directions, exponent=st.floats(-16, 0), flip=st.booleans())
def test_rotation_vector_of_any_size(base: Array, axis: Array, exponent: float, flip: bool) -> None:
    """From 1e-16 to nearly pi, in the axes of the second attitude, whatever the signs."""
    angle = (np.pi - 1e-6) * 10.0**exponent
    turned = np.array(multiply(list(base), [np.cos(angle / 2), *(axis * np.sin(angle / 2))]))
    vector = rotation_vector((-turned if flip else turned)[None], base[None])[0]
    np.testing.assert_allclose(vector, angle * axis, atol=1e-15 * 10 + 1e-9 * (angle > 3))


@pytest.mark.slow
@given(axis=directions, gap=st.floats(1e-12, 1e-3), beyond=st.booleans())
def test_rotation_vector_near_pi(axis: Array, gap: float, beyond: bool) -> None:
    """Never longer than pi; beyond it the other way round."""
    angle = np.pi + gap if beyond else np.pi - gap
    q = np.array([np.cos(angle / 2), *(axis * np.sin(angle / 2))])
    vector = rotation_vector(q[None], np.array([[1.0, 0, 0, 0]]))[0]
    assert np.linalg.norm(vector) <= np.pi + 1e-15
    np.testing.assert_allclose(vector, axis * (angle - 2 * np.pi if beyond else angle), atol=1e-12)


@pytest.mark.slow
@given(a=quaternions, b=quaternions)
def test_rotation_vector_is_scipys(a: Array, b: Array) -> None:
    vector = rotation_vector(a[None], b[None])[0]
    expected = (scipy_of(b).inv() * scipy_of(a)).as_rotvec()
    if np.linalg.norm(expected) < np.pi - 1e-6:
        np.testing.assert_allclose(vector, expected, atol=1e-9)


def test_rotation_vector_of_equal_attitudes_is_zero() -> None:
    q = np.array([[0.5, 0.5, -0.5, 0.5]])
    np.testing.assert_array_equal(rotation_vector(q, q), np.zeros((1, 3)))
    np.testing.assert_array_equal(rotation_vector(q, -q), np.zeros((1, 3)))


def test_one_definition_serves_arrays_and_casadi() -> None:
    rng = np.random.default_rng(0)
    q, v = rng.standard_normal((4, 7)), rng.standard_normal((3, 7))
    q /= np.linalg.norm(q, axis=0)
    batch = np.array(to_ned(list(q), list(v)))
    q_s, v_s = ca.SX.sym("q", 4), ca.SX.sym("v", 3)
    f = ca.Function("f", [q_s, v_s], [ca.vertcat(*to_ned(ca.vertsplit(q_s), ca.vertsplit(v_s)))])
    for k in range(7):
        np.testing.assert_allclose(np.array(f(q[:, k], v[:, k])).ravel(), batch[:, k], atol=1e-15)
        np.testing.assert_allclose(batch[:, k], to_ned(list(q[:, k]), list(v[:, k])), atol=1e-15)
