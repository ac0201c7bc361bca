import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulator.simulate import add_reference_errors, list_reference_times
from simulator.truth.maneuvers import Hold, Profile, Slew
from simulator.truth.orbit import CircularOrbit
from simulator.truth.rotation import separation

ORBIT = CircularOrbit(350e3, 0.6)
Z = np.array([0.0, 0.0, 1.0])


def test_ends():
    assert list_reference_times(Profile(ORBIT, 100.0, 700.0, 0.0), None).tolist() == [0.0, 600.0]


def test_series_leaves_out_slews_and_transitions():
    profile = Profile(ORBIT, 0.0, 1030.0, 0.0, (Slew(Z, 1.0, 100.0, 150.0),), Hold(400.0, 900.0, 100.0, np.zeros(3)))
    expected = [0, 50, 100, 250, 300, 350, 400, 500, 550, 600, 650, 700, 750, 800, 900, 950, 1000, 1030]
    assert list_reference_times(profile, 50.0).tolist() == expected


@pytest.mark.parametrize("every", [0.1, 7.0, 60.0, 1e4])
def test_series_holds_both_ends_once(every):
    times = list_reference_times(Profile(ORBIT, 0.0, 60.0, 0.0), every)
    assert times[0] == 0.0
    assert times[-1] == 60.0
    assert np.diff(times).min() > 1e-3


def test_errors_have_the_stated_size_about_each_body_axis():
    count, sigma = 20_000, np.array([1e-4, 3e-4, 5e-5])
    q = Rotation.random(count, rng=np.random.default_rng(1)).as_quat()
    errors = separation(q, add_reference_errors(np.random.default_rng(2), q, sigma)) / sigma
    # 5 sigma: sd of a standard deviation 1/sqrt(2n), of a mean and of a correlation 1/sqrt(n).
    np.testing.assert_allclose(errors.std(axis=0), 1.0, atol=5 / np.sqrt(2 * count))
    np.testing.assert_allclose(errors.mean(axis=0), 0.0, atol=5 / np.sqrt(count))
    np.testing.assert_allclose(np.corrcoef(errors.T), np.eye(3), atol=5 / np.sqrt(count))
