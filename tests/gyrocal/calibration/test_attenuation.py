"""The expected error of G from noise in the rates: its information against the dense covariance, and its size by simulation."""

from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

import simulator
from gyrocal import calibrate
from gyrocal.calibration.attenuation import integrate_information
from gyrocal.calibration.covariance import compute_residual_covariance, integrate_white_noise
from studies.report.calibration import list_remarks
from tests.diagnosis.recordings import of_rates

SAMPLE_S, EACH = 0.02, 5
NOISE = np.deg2rad(5e-3)  # rad/sqrt(s) of the rates, and rad of the references
SWAY = np.deg2rad([0.3, 0.3, 0.3])


@cache
def swaying(seed):
    """A clean gyro on a body that sways by eight times the noise of a sample."""
    t_s = SAMPLE_S * np.arange(1500)
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, 3)
    rates = SWAY * np.sin(2 * np.pi * np.array([0.7, 0.8, 1.5]) * t_s[:, None] + phases)
    return of_rates(rates, EACH, SAMPLE_S, NOISE, NOISE, seed)


@cache
def calibrated(seed, **options):
    return calibrate(swaying(seed), plausible_G=0.1, **options)


def test_information_is_that_of_all_residuals_about_a_turn():
    """Against (V⁻¹)_ab of the covariance that weighs the residuals, with a body that turns and unlike sigmas."""
    rng = np.random.default_rng(4)
    m, arw = 7, 0.3
    A = Rotation.from_rotvec(np.cumsum(rng.standard_normal((m + 1, 3)), axis=0)).as_matrix()
    A = A @ A[0].T  # the propagation's R, from the first reference on
    sigma, t_s = rng.uniform(0.1, 1.0, (m + 1, 3)), np.cumsum(rng.uniform(0.2, 2.0, m))
    zero = np.zeros(m, dtype=np.intp)
    noise = np.einsum("ri,ij->rij", sigma**2, np.eye(3))
    V = compute_residual_covariance(A[1:], zero, zero, np.arange(1, m + 1), noise, integrate_white_noise(t_s, arw))
    weight = np.linalg.inv(V).reshape(m, 3, m, 3)
    expected = np.zeros((3, 3))
    for k, dt in enumerate(np.diff(t_s, prepend=0.0)):
        M = np.einsum("aij,aibl,blm->jm", A[1 + k :], weight[k:, :, k:], A[1 + k :])
        expected += 0.5 * dt * (A[k] @ M @ A[k].T + A[k + 1] @ M @ A[k + 1].T)
    np.testing.assert_allclose(integrate_information(A, noise, t_s, arw), expected, rtol=1e-9, atol=1e-9)


def test_expected_errors_are_those_of_many_clean_gyros():
    found = [calibrated(seed) for seed in range(60)]
    errors = np.array([np.diag(one.G) - 1.0 for one in found])
    expected = np.array([np.diag(one.attenuation[:9].reshape(3, 3)) for one in found])
    spread = errors.std(axis=0, ddof=1) / np.sqrt(len(found))
    assert (np.abs((errors - expected).mean(axis=0)) < 3.5 * spread).all()
    assert (errors.mean(axis=0)[2] / spread[2]) < -4  # where the sway is fastest, and turns the body least
    aside = np.array([one.attenuation for one in found])[:, [1, 2, 3, 5, 6, 7]]
    assert np.abs(aside).max() < 0.2 * np.abs(expected).max()


def test_it_is_told_where_it_matters_and_the_papers_maneuvers_have_none_to_speak_of():
    result, paper = calibrated(1), calibrate(simulator.simulate(simulator.load("trmm"), seed=1))
    assert any(line.startswith("Expected error of G") and "G_zz -" in line for line in list_remarks(result))
    assert np.abs(paper.attenuation / paper.sigma).max() < 0.02
    assert not any(line.startswith("Expected error") for line in list_remarks(paper))
    assert calibrated(1, covariance_model="references only").attenuation is None
