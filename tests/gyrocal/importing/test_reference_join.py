"""Attitudes of several sensors joined to one series: mountings with their sigma, and covariances that hold."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from gyrocal import attitude
from gyrocal.errors import InputError
from gyrocal.importing.reference_join import SensorReferences, join_references
from gyrocal.recording import GyroStream

ARCSEC = np.deg2rad(1 / 3600)
SIGMA = np.array([[2.0, 2.0, 16.0], [3.0, 2.0, 20.0]]) * ARCSEC  # about each tracker's axes, z the boresight
MOUNTING = Rotation.from_rotvec([1.0, 0.3, -0.2]).as_matrix()
STEP_S, COUNT = 0.1, 300


def compute_body(t_s):
    """Attitudes (m, 3, 3) of a body that turns at a constant rate about a skew axis."""
    rate = np.deg2rad([0.4, -0.7, 0.5])
    return attitude.rotation_matrix(-np.outer(t_s, rate)), rate


def make_sensors(seed, late_s=0.0):
    """Two trackers' attitudes with noise as stated; the second's mounting is not stated."""
    rng, out = np.random.default_rng(seed), []
    for name, M, sigma, shift in (("st1", np.eye(3), SIGMA[0], 0.0), ("st2", MOUNTING, SIGMA[1], late_s)):
        t_s = STEP_S * np.arange(COUNT) + shift
        A = attitude.rotation_matrix(sigma * rng.normal(size=(COUNT, 3))) @ M @ compute_body(t_s)[0]
        out.append(SensorReferences(name, t_s, attitude.quaternion_from_matrix(A), np.tile(sigma, (COUNT, 1))))
    return out


def make_gyro(sample_s):
    """Exact rates of the body."""
    t_s = np.arange(0.0, STEP_S * COUNT, sample_s)
    return GyroStream(t_s, np.tile(compute_body(0.0)[1], (t_s.size, 1)), sample_s, 0.0)


@pytest.mark.parametrize(
    ("late_s", "sample_s", "rows"),
    [
        (0.0, None, COUNT),
        (0.03, 0.1, COUNT),  # within half a sample: brought to the first's time by the gyro
        (0.03, 0.04, 2 * COUNT),  # rows apart
    ],
)
def test_joined_attitudes_hold_their_covariances(late_s, sample_s, rows):
    squares = 0.0
    for seed in range(20):
        one, two = make_sensors(seed, late_s)
        gyro = None if sample_s is None else make_gyro(sample_s)
        attitudes = join_references((one, replace(two, mounting=MOUNTING)), gyro).attitudes
        assert attitudes.t_s.size == rows
        e = attitude.residual(attitude.matrix_from_quaternion(attitudes.quaternions), compute_body(attitudes.t_s)[0])
        squares += np.einsum("ki,ki->", e, np.linalg.solve(attitudes.compute_covariance(), e[:, :, None])[:, :, 0])
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 3 * rows * 20)
    assert low < squares < high


@pytest.mark.parametrize(("late_s", "sample_s"), [(0.0, 0.1), (0.03, 0.1), (0.03, 0.04)])  # the last ones take turns
def test_mounting_is_estimated_within_its_sigma(late_s, sample_s):
    off = []
    for seed in range(20):
        found = join_references(make_sensors(seed, late_s), make_gyro(sample_s)).sensors[1]
        assert found.common >= COUNT - 1
        assert found.agreement == pytest.approx(1, abs=0.15)
        off.append(attitude.residual(found.mounting, MOUNTING) / found.mounting_sigma)
    assert 0.7 < np.sqrt(np.mean(np.square(off))) < 1.3


def test_prior_of_a_mounting_is_weighed_with_the_rows():
    one, two = make_sensors(3)
    turned = attitude.rotation_matrix(np.deg2rad([0.1, 0.0, 0.0])) @ MOUNTING
    for prior, expected in ((1e-12, turned), (1.0, MOUNTING)):
        found = join_references((one, replace(two, mounting=turned, mounting_sigma=np.full(3, prior)))).sensors[1].mounting
        assert np.linalg.norm(attitude.residual(found, expected)) < 5 * ARCSEC
    loose, equal = (
        join_references((one, replace(two, mounting=turned, mounting_sigma=sigma))).sensors[1]
        for sigma in (np.full(3, 1.0), join_references((one, two)).sensors[1].mounting_sigma)
    )
    off = attitude.residual(equal.mounting, turned) / attitude.residual(loose.mounting, turned)
    assert off[0] == pytest.approx(0.5, abs=0.1)  # half-way, as far as the errors about the axes do not go together


def test_what_cannot_be_joined_is_refused():
    one, two = make_sensors(4)
    with pytest.raises(InputError, match=r"st2 has 0 time.* in common .* --sensor NAME"):
        join_references((one, replace(two, t_s=two.t_s + 1000.0)))
    with pytest.raises(InputError, match="with the other direction"):
        join_references([replace(each, quaternions=each.quaternions * [-1, -1, -1, 1]) for each in (one, two)])
    with pytest.raises(InputError, match=r"st2 is mounted .* deg from where it is stated"):
        join_references((one, replace(two, mounting=MOUNTING.T)))
