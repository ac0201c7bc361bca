"""The flight's own 18 residuals calibrated: N's solution and its second iteration come out, the rival space's do not."""

import numpy as np
import pytest

from gyrocal import residual_table
from simulator import scenario as scenarios
from studies.natanson import flight, flight_gap, flight_recalibration

TRMM = scenarios.load("trmm")


@pytest.fixture(scope="module")
def found():
    return flight_recalibration.calibrate_each_step(TRMM)


def test_residuals_are_those_that_were_set_and_those_calibrated_follow(found):
    step, step_s = found[0], found[0].step_s
    table = residual_table(step.recording, flight.read_published_parameters("prelaunch"), step_s=step_s, resampling="skip")
    before = table[[f"before_{name}_deg" for name in flight.ROTATIONS]].to_numpy()
    np.testing.assert_allclose(before, flight.read_published_residuals("prelaunch", step_s), rtol=0, atol=1e-10)
    table = flight_recalibration.compare_residuals_by_step(found).set_index("step_s")
    assert table["rms_difference_deg"].round(4).to_dict() == {0.5: 0.0064, 1.0: 0.0032, 2.0: 0.0043}
    # With the sign as printed in the doubtful cell it would not.
    assert table.loc[2.0, "as_printed_deg"] > 4 * table.loc[2.0, "rms_difference_deg"]
    assert table.loc[0.5, "steepest"] == "b_z"
    assert table.loc[0.5, "gradient_deg"] == pytest.approx(0.025, abs=5e-4)


def test_what_is_found_is_least_squares_and_the_truth_takes_no_part(found):
    step = found[0]
    own = step.after[1]
    prepared = flight_recalibration.prepare_measurements(step.recording, step.step_s, "skip")
    last = step.results[1].parameters
    Theta = flight_recalibration.propagate(prepared.arcs, last.G, last.bias).Theta.reshape(18, 12)
    assert np.abs((Theta / np.linalg.norm(Theta, axis=0)).T @ own.ravel()).max() < 1e-4
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(flight, "read_published_calibration", lambda: flight.read_published_parameters("prelaunch"))
        recording = flight_gap.simulate_without_noise(TRMM)
    other = flight_recalibration.set_final_attitudes(recording, flight.read_published_residuals("prelaunch"), 0.5)
    after = (
        flight_recalibration.calibrate_like_paper(other, 0.5, 1)
        .residuals[[f"after_{name}_deg" for name in flight.ROTATIONS]]
        .to_numpy()
    )
    np.testing.assert_allclose(after, step.after[0], rtol=0, atol=7e-4)


def test_second_iteration_is_that_of_gyro_space():
    table = flight_recalibration.build_second_iteration_table(TRMM)
    correlation = flight_recalibration.score_second_iteration(table)
    assert correlation["gyro_space"] > 0.94
    assert correlation["gain_space"] < 0.55
    # All twelve have the sign that is turned against the first iteration's.
    assert (np.sign(table["gyro_space"]) == np.sign(table["flight"])).all()
    assert not (np.sign(table["gain_space"]) == np.sign(table["flight"])).all()
