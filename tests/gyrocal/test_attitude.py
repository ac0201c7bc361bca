import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gyrocal import attitude

VECTORS = arrays(float, 3, elements=st.floats(-1.5, 1.5))


def test_quaternion_is_scalar_last_inertial_to_body():
    # Wertz: a turn by +90 deg about z takes inertial x to body -y; q = [0, 0, sin 45, cos 45].
    s = np.sqrt(0.5)
    A = attitude.matrix_from_quaternion(np.array([0, 0, s, s]))
    np.testing.assert_allclose(A @ [1, 0, 0], [0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(attitude.quaternion_from_matrix(A), [0, 0, s, s], atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 3.0, 3.3, 6.2])
def test_of_both_quaternions_of_an_attitude_the_scalar_part_is_not_negative(angle):
    for axis in np.array([[0.6, 0.48, -0.64], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -0.6, 0.8]]):
        A = attitude.rotation_matrix(-angle * axis)
        q = attitude.quaternion_from_matrix(A)
        assert q[3] >= 0
        np.testing.assert_allclose(attitude.matrix_from_quaternion(q), A, atol=1e-14)


def test_rate_turns_the_attitude_with_the_stated_sign():
    # dA/dt = -[w x]A: a rate about +z for 90 deg gives the same A as above.
    A = attitude.rotation_matrix(-np.array([0, 0, np.pi / 2]))
    np.testing.assert_allclose(A, attitude.matrix_from_quaternion(np.array([0, 0, 1, 1]) * np.sqrt(0.5)), atol=1e-15)


@given(VECTORS)
def test_residual_inverts_the_exponential(theta):
    A = attitude.rotation_matrix(np.array([0.4, -1.0, 0.3]))
    np.testing.assert_allclose(attitude.residual(attitude.rotation_matrix(theta) @ A, A), theta, atol=1e-14)


@pytest.mark.parametrize("size", [1e-2, 1e-3])
def test_linear_residual_has_the_sign_of_the_full_one_and_third_order_error(size):
    theta = size * np.array([0.6, -0.64, 0.48])
    A = attitude.rotation_matrix(np.array([0.4, -1.0, 0.3]))
    linear = attitude.residual_linear(attitude.rotation_matrix(theta) @ A, A)
    error = np.linalg.norm(linear - theta)
    assert error == pytest.approx(size**3 / 6, rel=1e-3, abs=1e-16)
