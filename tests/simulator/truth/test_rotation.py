import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from simulator.truth.rotation import (
    apply_rotation_errors,
    build_turn_matrix,
    convert_to_matrix,
    convert_to_quaternion,
    separation,
    turn_frame,
)


def skew(v: np.ndarray) -> np.ndarray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def test_a_turn_is_the_passive_exponential():
    rng = np.random.default_rng(1)
    axis = rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    angles, vectors = rng.uniform(-4, 4, 5), rng.standard_normal((5, 3))
    expected = np.array([expm(-skew(axis) * angle) for angle in angles])
    np.testing.assert_allclose(build_turn_matrix(axis, angles), expected, atol=1e-14)
    np.testing.assert_allclose(turn_frame(axis, angles, vectors), np.einsum("nij,nj->ni", expected, vectors), atol=1e-14)


def test_quaternion_of_the_wertz_convention():
    """A(q) of a rotation by 30 deg about z, written out: q = (0, 0, sin 15, cos 15)."""
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    A = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    q = np.array([0, 0, np.sin(np.pi / 12), np.cos(np.pi / 12)])
    np.testing.assert_allclose(convert_to_matrix(q), A, atol=1e-15)
    np.testing.assert_allclose(convert_to_quaternion(A), q, atol=1e-15)


def test_perturbed_and_separation_are_inverse():
    rng = np.random.default_rng(3)
    q = Rotation.random(6, rng=rng).as_quat()
    errors = 0.3 * rng.standard_normal((6, 3))
    after = apply_rotation_errors(q, errors)
    expected = np.array([expm(skew(e)) for e in errors]) @ convert_to_matrix(q)
    np.testing.assert_allclose(convert_to_matrix(after), expected, atol=1e-14)
    np.testing.assert_allclose(separation(q, after), errors, atol=1e-14)
