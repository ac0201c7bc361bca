import numpy as np
import pytest

from gyrocal import calibrate
from studies.compare import measure
from studies.compare.measure import MeasurementSetup
from tests.studies.compare.recordings import recorded


@pytest.fixture(scope="module")
def recording():
    return recorded(1)


@pytest.fixture(scope="module")
def measured(recording):
    return MeasurementSetup.build(recording, calibrate(recording).parameters).measure(recording)


def test_calibration_and_rms_are_the_calibrators(recording, measured):
    found = calibrate(recording)
    assert measured.mean_square == pytest.approx(found.chi2 / found.dof, rel=1e-9)
    np.testing.assert_allclose(measured.x, found.parameters.vector, rtol=0, atol=1e-11)
    table = calibrate(recording).residuals
    own = table[table["interval"] == "m2"]
    values = {statistic.name: value for statistic, value in measured.statistics.items()}
    assert values["rms interval m2 y"] == pytest.approx(np.sqrt(np.mean(own["after_pitch_deg"] ** 2)), rel=1e-6)
    assert values["rms all z"] == pytest.approx(np.sqrt(np.mean(table["after_yaw_deg"] ** 2)), rel=1e-6)


def test_statistics_of_white_noise_and_of_a_ramp_are_closed_forms():
    x = [np.random.default_rng(k).standard_normal(4000) for k in range(5)]
    n = sum(map(len, x))
    assert abs(measure.compute_lag_correlation(x)) < 4 / np.sqrt(n)
    assert measure.compute_lag_correlation([np.diff(one, n=2) for one in x]) == pytest.approx(-2 / 3, abs=4 / np.sqrt(n))
    _, power = measure.average_spectrum(x)
    np.testing.assert_allclose(power[4:-1], 1, atol=0.2)
    for count in (1, 4):
        # σ² of white noise of the rate falls as 1/n.
        paths = [np.append(0, np.cumsum(one)) for one in x]
        assert measure.compute_allan_deviation(paths, count, 1.0) == pytest.approx(1 / np.sqrt(count), rel=0.05)
    # A rate ramp R t has σ = R τ/√2.
    path = 0.5 * 0.3 * np.arange(200.0) ** 2
    assert measure.compute_allan_deviation([path], 8, 1.0) == pytest.approx(0.3 * 8 / np.sqrt(2))
