"""References of several trackers as those of one sensor, against the covariance that least squares has."""

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import simulator
from gyrocal.recording.merged_references import merge_references
from gyrocal.recording.trackers import compute_body_covariance
from tests.tracker_cases import AGILE, ESTIMATED


def compute_errors(scenario, seed):
    """(m, 3) rad errors of the merged references in body axes, and the merged recording and that of the trackers."""
    recording, motion = simulator.simulate(scenario, seed=seed), simulator.simulate(AGILE, noise=False)
    merged, true = merge_references(recording).attitudes, merge_references(motion).attitudes
    np.testing.assert_array_equal(merged.t_s, np.unique(recording.attitudes.t_s))
    return (Rotation.from_quat(true.quaternions).inv() * Rotation.from_quat(merged.quaternions)).as_rotvec(), merged, recording


def test_two_trackers_have_the_error_of_least_squares():
    chi2_all, dof = 0.0, 0
    for seed in range(10):
        errors, merged, recording = compute_errors(AGILE, seed)
        each = np.linalg.inv(compute_body_covariance(recording.attitudes))
        for t_s, error, sigma in zip(merged.t_s, errors, merged.sigma, strict=True):
            information = each[recording.attitudes.t_s == t_s].sum(axis=0)
            np.testing.assert_allclose(sigma, np.sqrt(np.diag(np.linalg.inv(information))))
            chi2_all, dof = chi2_all + error @ information @ error, dof + 3
    assert chi2.ppf(1e-3, dof) < chi2_all < chi2.ppf(1 - 1e-3, dof)


def test_a_misalignment_that_is_estimated_is_taken_off():
    errors, merged, _ = compute_errors(ESTIMATED, 1)
    assert np.sqrt(np.mean((errors / merged.sigma) ** 2)) < 1.3  # 0.01 to 0.03 deg are 20 sigma and more
