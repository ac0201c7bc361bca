"""What the calibration under M0 says of its own parameters."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.model.baseline import describe_unobserved
from diagnosis.model.linearise import linearise_recording
from tests.diagnosis.recordings import slews


@pytest.mark.parametrize(("arw_deg_per_sqrt_s", "bias_is_seen"), [(2e-4, False), (0.01, True)])
def test_a_parameter_is_observed_by_the_grade_of_its_own_gyro(arw_deg_per_sqrt_s, bias_is_seen):
    """References of 0.5 deg determine the bias to tens of deg/h: too little for a gyro in orbit, and plenty in a phone."""
    made = slews()
    made = replace(
        made,
        gyro=replace(made.gyro, arw=np.deg2rad(arw_deg_per_sqrt_s)),
        attitudes=replace(made.attitudes, sigma=np.full_like(made.attitudes.sigma, np.deg2rad(0.5))),
    )
    (note,) = describe_unobserved(linearise_recording(made, np.eye(3), np.zeros(3))) or ("",)
    assert ("b_x" not in note) == bias_is_seen


def test_what_the_motion_does_not_show_is_said_of_any_grade():
    """A body that turns about x alone says nothing of the other columns of G."""
    made = slews()
    own, read = tuple(made.intervals[k] for k in (0, 3)), made.attitudes
    rows = np.any([(read.t_s >= part.start_s) & (read.t_s <= part.stop_s) for part in own], axis=0)
    seen = replace(read, t_s=read.t_s[rows], quaternions=read.quaternions[rows], sigma=read.sigma[rows])
    one = replace(made, intervals=own, attitudes=seen, gyro=replace(made.gyro, arw=np.deg2rad(0.01)))
    (note,) = describe_unobserved(linearise_recording(one, np.eye(3), np.zeros(3)))
    assert all(name in note for name in ("G_xy", "G_yz", "G_zz"))
    assert "G_xx" not in note
