"""Roots of small covariances against numpy's."""

import numpy as np
import pytest

from gyrocal.small_matrices import compute_lower_root, solve_lower


@pytest.mark.parametrize("scale", [1.0, 1e-12])
def test_roots_are_numpys(scale):
    rng = np.random.default_rng(6)
    for _ in range(20):
        A = rng.standard_normal((3, 5))
        S, b = scale * A @ A.T, rng.standard_normal((3, 4))
        L = compute_lower_root(S)
        np.testing.assert_allclose(L, np.linalg.cholesky(S), rtol=1e-10, atol=1e-12 * np.sqrt(scale))
        np.testing.assert_allclose(L @ solve_lower(L, b), b, rtol=1e-10, atol=1e-10)


def test_what_is_no_covariance_is_refused():
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        compute_lower_root(np.diag([1.0, -1.0, 1.0]))
