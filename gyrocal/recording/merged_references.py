"""References of several sensors as those of one, for what takes one reference at a time.

References of one time stand for the body attitudes exp([e×]) A, with the covariances P of e (`gyrocal.recording.trackers`).
Their mean by least squares has the covariance (Σ P⁻¹)⁻¹ and the error (Σ P⁻¹)⁻¹ Σ P⁻¹ e. The constant error of a sensor whose
mounting is estimated is the mean, by least squares, of its differences from the sensors whose mounting is known.
"""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gyrocal.recording.parts import Attitudes
from gyrocal.recording.recording_data import Recording
from gyrocal.recording.trackers import compute_body_covariance, keep_rows

Array = NDArray[np.float64]


def merge_references(recording: Recording) -> Recording:
    """The recording with one reference at each time, in body axes; one of a single sensor is left as it is.

    Its sigmas are the roots of the diagonal of the covariance. A sensor whose mounting is estimated, and that has no reference
    at a time of a known one, is left out with a warning.
    """
    attitudes = recording.attitudes
    if attitudes.sensor is None:
        return recording
    unknown = np.array([one.estimated for one in attitudes.sensors])
    t_s, known, covariance = _average(keep_rows(attitudes, ~unknown[attitudes.sensor]))
    for number in np.flatnonzero(unknown):
        own = attitudes.sensor == number
        common = np.flatnonzero(own & np.isin(attitudes.t_s, t_s))
        if not common.size:
            name = attitudes.sensors[number].name
            warnings.warn(
                f"the references of {name}, whose mounting is estimated, are left out: they have no time in common with a "
                "sensor of known mounting",
                stacklevel=2,
            )
            attitudes = keep_rows(attitudes, ~own)
            continue
        at, bodies = np.searchsorted(t_s, attitudes.t_s[common]), Rotation.from_quat(attitudes.quaternions)
        weight = np.linalg.inv(covariance[at] + compute_body_covariance(attitudes)[common])
        pull = np.einsum("mij,mj->i", weight, (bodies[common].inv() * known[at]).as_rotvec())
        turn = Rotation.from_rotvec(own[:, None] * np.linalg.solve(weight.sum(axis=0), pull))
        attitudes = replace(attitudes, quaternions=(bodies * turn).as_quat())
    t_s, merged, covariance = _average(attitudes)
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return replace(recording, attitudes=Attitudes(t_s, merged.as_quat(), np.asarray(sigma)))


def _average(attitudes: Attitudes) -> tuple[Array, Rotation, Array]:
    """Times (k,), the mean attitude of each, and its covariance (k, 3, 3) in body axes, rad²."""
    bodies, each = Rotation.from_quat(attitudes.quaternions), np.linalg.inv(compute_body_covariance(attitudes))
    t_s, first, at = np.unique(attitudes.t_s, return_index=True, return_inverse=True)
    information, pull = np.zeros((t_s.size, 3, 3)), np.zeros((t_s.size, 3))
    np.add.at(information, at, each)
    np.add.at(pull, at, np.einsum("mij,mj->mi", each, (bodies[first[at]].inv() * bodies).as_rotvec()))
    covariance = np.asarray(np.linalg.inv(information), dtype=float)
    return t_s, bodies[first] * Rotation.from_rotvec(np.einsum("mij,mj->mi", covariance, pull)), covariance
