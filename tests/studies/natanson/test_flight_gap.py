"""The flight's pre-launch residuals are predicted, and wrong hypotheses about the maneuvers are rejected."""

import numpy as np
import pytest

from gyrocal import residual_table
from simulator import scenario as scenarios
from studies.natanson import flight, flight_gap, flight_recalibration

TRMM = scenarios.load("trmm")


def test_the_gap_is_what_the_flights_calibration_left_and_wrong_signs_are_rejected():
    predicted = flight_gap.predict_residuals(TRMM)
    assert flight_gap.compute_gap_rms(predicted) <= 0.022
    assert flight_gap.compute_clean_gap_rms(predicted) <= 0.0062
    np.testing.assert_allclose(
        flight_gap.build_gap_comparison(TRMM)["clean_gap_deg"], (flight_gap.compute_noise_free_residuals() - predicted).ravel()
    )
    # Truth is the flight's calibration, so the gap should be what that calibration left, cell by cell.
    gap = flight.read_published_residuals("prelaunch") - flight_gap.predict_residuals(TRMM)
    left = flight.read_published_residuals("calibrated")
    untimed = [0, 2, 4]  # no slews: both forward modes, and the hold that one orbit fixes
    # Table 2 is printed to 0.001 deg, twice; R (9)'s rounding and Table 3's angles to 0.001 deg add as much again.
    np.testing.assert_allclose(gap[untimed], left[untimed], atol=0.003)
    assert flight_gap.compute_floor_rms() == pytest.approx(np.sqrt(np.mean(left**2)))
    found = flight_gap.compare_signs(TRMM)
    assert found["minus_y_rate_rpo"]["favoured"] == -1
    assert found["minus_y_rate_rpo"]["gap_rms_deg"]["-1"] < 0.03
    assert found["minus_y_rate_rpo"]["gap_rms_deg"]["1"] > 0.1
    right, wrong = found["residual_sign_gap_rms_deg"].values()
    assert right < 0.02
    assert wrong > 0.3


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


# Six rows, three numbers each, to three digits: a mean of rounded numbers is right to half a digit.
ROUNDING = 0.00051


@pytest.mark.parametrize("phase", ["prelaunch", "calibrated"])
@pytest.mark.parametrize("step", flight.FLIGHT_STEPS_S)
def test_table4_follows_from_table2(phase, step):
    table2 = flight.read_published_residuals(phase, step)
    mean = flight.read_published_statistics(phase, step, "mean")
    if (phase, step) == ("calibrated", 2.0):
        # Table 2's interval 3, yaw, is printed −0.042; with +0.042 Table 4's mean comes out.
        assert abs(table2[:, 2].mean() - mean[2]) > 0.01
        assert table2[2, 2] == -0.042
        table2 = table2.copy()
        table2[2, 2] = 0.042
    np.testing.assert_allclose(table2.mean(axis=0), mean, atol=ROUNDING)
    # What Table 4 calls RMS is the norm divided by n.
    np.testing.assert_allclose(
        flight.compute_paper_rms(table2), flight.read_published_statistics(phase, step, "rms"), atol=ROUNDING
    )
    np.testing.assert_allclose(flight.compute_rms(table2), np.sqrt(6) * flight.compute_paper_rms(table2))
