import numpy as np
import pytest

from gyrocal import calibrate
from studies.compare import measure
from studies.compare.gap import Z90, compute_fieller_interval, compute_gap
from studies.compare.measure import MeasurementSetup
from tests.diagnosis import recordings


def test_calibration_and_rms_are_the_calibrators():
    recording = recordings.recorded(1, sample_s=4.0)
    found = calibrate(recording)
    measured = MeasurementSetup.build(recording, found.parameters).measure(recording)
    assert measured.mean_square == pytest.approx(found.chi2 / found.dof, rel=1e-9)
    np.testing.assert_allclose(measured.x, found.parameters.vector, rtol=0, atol=1e-11)
    table = calibrate(recording).residuals
    own = table[table["interval"] == "m2"]
    values = {" ".join(filter(None, statistic[:3])): value for statistic, value in measured.statistics.items()}
    assert values["rms interval m2 y"] == pytest.approx(np.sqrt(np.mean(own["after_pitch_deg"] ** 2)), rel=1e-6)
    assert values["rms all z"] == pytest.approx(np.sqrt(np.mean(table["after_yaw_deg"] ** 2)), rel=1e-6)


def test_statistics_of_white_noise_and_of_a_ramp_are_closed_forms():
    x = [np.random.default_rng(k).standard_normal(4000) for k in range(5)]
    n = sum(map(len, x))
    assert abs(measure.compute_lag_correlation(x)) < 4 / np.sqrt(n)
    assert measure.compute_lag_correlation([np.diff(one, n=2) for one in x]) == pytest.approx(-2 / 3, abs=4 / np.sqrt(n))
    # σ² of white noise of the rate falls as 1/n.
    white = dict(measure.compute_allan_deviations(x, 1.0))
    assert [white[count] for count in (1, 4)] == pytest.approx([1.0, 0.5], rel=0.05)
    # A rate ramp R t has σ = R τ/√2.
    assert dict(measure.compute_allan_deviations([0.3 * np.arange(200.0)], 1.0))[8] == pytest.approx(0.3 * 8 / np.sqrt(2))


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
