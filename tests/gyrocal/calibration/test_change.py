"""Change between two calibrations, against the inverse of its covariance and the distribution of χ²."""

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrocal import GyroParameters, InputError
from gyrocal.calibration.change import compute_change

SIZES = np.array([1e-4] * 9 + [1e-7] * 3)


def draw_covariance(rng, solved):
    """A covariance of parameters of two units with strong correlations, zero for the held ones."""
    A = rng.normal(size=(12, 12)) * SIZES[:, None] * solved[:, None]
    return A @ A.T


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6), held=st.sets(st.integers(0, 11), max_size=11), same=st.booleans())
def test_sigmas_and_chi2_are_those_of_the_covariance_of_the_difference(seed, held, same):
    rng = np.random.default_rng(seed)
    solved = np.array([k not in held for k in range(12)])
    first, second = draw_covariance(rng, solved), draw_covariance(rng, solved)
    x = np.append(np.eye(3).ravel(), np.zeros(3))
    d = rng.normal(size=12) * SIZES * solved
    found = compute_change(GyroParameters.from_vector(x), first, GyroParameters.from_vector(x + d), second, same)
    V = (first if same else first + second)[np.ix_(solved, solved)] / np.outer(SIZES[solved], SIZES[solved])
    z = d[solved] / SIZES[solved]
    assert found.chi2 == pytest.approx(z @ np.linalg.solve(V, z), rel=1e-4)
    assert found.dof == solved.sum()
    assert found.p_value == pytest.approx(scipy.stats.chi2.sf(found.chi2, found.dof), abs=1e-12)
    np.testing.assert_allclose(found.in_sigma[solved], np.abs(z) / np.sqrt(np.diag(V)), rtol=1e-6)
    np.testing.assert_array_equal(found.in_sigma[~solved], 0)


def test_combination_that_is_held_counts_no_degree_of_freedom():
    """One gyro's scale factor alone: three elements of G that move together."""
    column = np.zeros(12)
    column[[2, 5, 8]] = [0.6, 0.0, 0.8]
    P, x = 1e-8 * np.outer(column, column), GyroParameters(np.eye(3), np.zeros(3))
    found = compute_change(x, P, GyroParameters.from_vector(x.vector + 3e-4 * column), P, False)
    assert (found.dof, found.chi2) == (1, pytest.approx(4.5))


def test_held_parameters_are_exact_and_must_be_held_in_both():
    x, moved = GyroParameters(np.eye(3), np.zeros(3)), GyroParameters(np.eye(3), [0, 0, 1e-9])
    P = np.diag([1e-8] * 9 + [0.0] * 3)
    assert compute_change(x, P, moved, P, False).in_sigma[11] == np.inf
    with pytest.raises(InputError, match="only one of the saved and this calibration: b_x, b_y, b_z; use"):
        compute_change(x, P, x, np.diag([1e-8] * 9 + [1e-14] * 3), False)
