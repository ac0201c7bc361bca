"""References of several sensors as those of one, for what takes one reference at a time.

References of one time stand for the body attitudes exp([e×]) A, with the covariances P of e (`gyrocal.recording.trackers`).
Their mean by least squares has the covariance (Σ P⁻¹)⁻¹ and the error (Σ P⁻¹)⁻¹ Σ P⁻¹ e. Misalignments that are estimated are
those of the recording's own calibration.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gyrocal import attitude
from gyrocal.calibration.davenport import calibrate
from gyrocal.calibration.trackers import Mountings
from gyrocal.recording import Recording, triad
from gyrocal.recording.parts import Attitudes
from gyrocal.recording.trackers import compute_body_covariance


def merge_references(recording: Recording) -> Recording:
    """The recording with one reference at each time, in body axes; one of a single sensor is left as it is.

    Its sigmas are the roots of the diagonal of the covariance.

    Raises
    ------
    InputError
        A mounting is to be estimated, and the recording cannot be calibrated.
    """
    attitudes = recording.attitudes
    if attitudes.sensor is None:
        return recording
    A = attitude.matrix_from_quaternion(attitudes.quaternions)
    if any(one.estimated for one in attitudes.sensors):
        found = calibrate(triad(recording)).mountings
        assert found is not None
        A = replace(Mountings.build(attitudes), misalignment=found.misalignment).correct_attitudes(A)
    bodies = Rotation.from_matrix(A.transpose(0, 2, 1))
    t_s, first, at = np.unique(attitudes.t_s, return_index=True, return_inverse=True)
    information, pull = np.zeros((t_s.size, 3, 3)), np.zeros((t_s.size, 3))
    each = np.linalg.inv(compute_body_covariance(attitudes))
    np.add.at(information, at, each)
    np.add.at(pull, at, np.einsum("mij,mj->mi", each, (bodies[first[at]].inv() * bodies).as_rotvec()))
    covariance = np.linalg.inv(information)
    merged = bodies[first] * Rotation.from_rotvec(np.einsum("mij,mj->mi", covariance, pull))
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return replace(recording, attitudes=Attitudes(t_s, merged.as_quat(), np.asarray(sigma)))
