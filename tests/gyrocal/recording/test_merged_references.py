"""References of several trackers as those of one sensor, against the covariance that least squares has."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import simulator
from gyrocal.recording.merged_references import merge_references
from gyrocal.recording.trackers import compute_body_covariance, keep_rows
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


def test_a_tracker_of_unknown_mounting_without_common_times_is_left_out_with_a_word():
    recording = simulator.simulate(ESTIMATED, seed=1)
    attitudes = recording.attitudes
    own = attitudes.sensor == 1
    apart = keep_rows(attitudes, ~own | ~np.isin(attitudes.t_s, [one.stop_s for one in recording.intervals]))
    apart = replace(apart, t_s=apart.t_s + 7.0 * (apart.sensor == 1))
    order = np.argsort(apart.t_s, kind="stable")
    name = attitudes.sensors[1].name
    with pytest.warns(UserWarning, match=f"the references of {name}, whose mounting is estimated, are left out"):
        merged = merge_references(replace(recording, attitudes=keep_rows(apart, order)))
    np.testing.assert_array_equal(merged.attitudes.t_s, attitudes.t_s[~own])
