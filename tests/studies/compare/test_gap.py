import numpy as np
import pytest

from studies.compare.gap import Z90, compute_fieller_interval, compute_gap


def test_fiellers_bounds_are_those_of_closed_forms():
    low, high = compute_fieller_interval(0.2, 0.5, np.diag([0.01, 0.0]))
    assert (low, high) == pytest.approx(((0.2 - Z90 * 0.1) / 0.5, (0.2 + Z90 * 0.1) / 0.5))
    assert compute_fieller_interval(0.0, 0.1, np.diag([0.01, 0.01])) == (-np.inf, np.inf)
    V = np.array([[0.004, 0.001], [0.001, 0.006]])
    for kappa in compute_fieller_interval(0.1, 0.6, V):
        spread = V[0, 0] - 2 * kappa * V[0, 1] + kappa**2 * V[1, 1]
        assert (0.1 - kappa * 0.6) ** 2 == pytest.approx(Z90**2 * spread)
    errors = np.random.default_rng(0).standard_normal((50, 2)) * 0.01
    plain, shifted = (compute_gap((1.5, 1.0), (1.0, 1.0), errors, shift) for shift in (0.0, 0.02))
    assert shifted.after - plain.after == pytest.approx(0.02)
    assert shifted.shrinkage == pytest.approx(1 - 0.02 / 0.5)


@pytest.mark.parametrize("truth", [(1.0, 0.0), (0.35, 0.35)])
def test_the_interval_of_the_shrinkage_covers(truth):
    rng = np.random.default_rng(1)
    V = np.array([[0.01, 0.003], [0.003, 0.005]])
    root = np.linalg.cholesky(V)
    cases, covered = 2000, 0
    for _ in range(cases):
        recorded = np.array(truth) + 1 + root @ rng.standard_normal(2)
        errors = rng.standard_normal((100, 2)) @ root.T
        low, high = compute_gap((recorded[0], recorded[1]), (1.0, 1.0), errors).shrinkage_90
        covered += low <= 1 - truth[1] / truth[0] <= high
    assert abs(covered / cases - 0.9) < 4 * np.sqrt(0.09 / cases)
