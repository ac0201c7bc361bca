"""Stated sigmas hold for every grade of gyro and reference, with and without a prior and in both parametrisations."""

import numpy as np
import pytest

from gyrocal import GyroParameters, calibrate
from tests.builders import TRUTH, is_mean_of_chi2, piecewise_recording, squared_error

PRIOR_SIGMA = np.repeat([1e-3, np.deg2rad(2e-4)], [9, 3])
GRADES = {"resonator": (2e-5, 5e-4), "fibre optic": (2.6e-4, 5e-3), "tactical": (2e-3, 2e-2), "MEMS": (1e-2, 0.1)}


@pytest.mark.long
@pytest.mark.parametrize("grade", GRADES)
def test_sigmas_hold_for_every_grade(grade):
    arw, sigma_deg = GRADES[grade]  # deg/√s, deg
    values = {"prior": [], "free": [], "gyro": [], "references only": []}
    for seed in range(40):
        rng = np.random.default_rng([61, seed])
        seen = piecewise_recording(series_s=60.0, sigma_deg=sigma_deg, arw=float(np.deg2rad(arw)), rng=rng)
        near = GyroParameters.from_vector(TRUTH.vector + PRIOR_SIGMA * rng.standard_normal(12))
        for name, found in (
            ("prior", calibrate(seen, initial=near, apriori_covariance=np.diag(PRIOR_SIGMA**2))),
            ("free", calibrate(seen)),
            ("gyro", calibrate(seen, parametrisation="gyro")),
            ("references only", calibrate(seen, covariance_model="references only")),
        ):
            values[name].append(squared_error(found.parameters.vector - TRUTH.vector, found.covariance))
    assert [name for name, nees in values.items() if not is_mean_of_chi2(nees, 12)] == ["references only"]
