"""The flight's values agree with each other where they should, and the known slips are as described."""

import numpy as np
import pandas as pd
import pytest

from studies.natanson import flight
from tests import SHARED

# Six rows, three numbers each, to three digits: a mean of rounded numbers is right to half a digit.
ROUNDING = 0.00051


@pytest.mark.parametrize("phase", ["prelaunch", "calibrated"])
@pytest.mark.parametrize("step", flight.STEPS)
def test_table4_follows_from_table2(phase, step):
    table2 = flight.residuals(phase, step)
    mean = flight.statistics(phase, step, "mean")
    if (phase, step) == ("calibrated", 2.0):
        # Table 2's interval 3, yaw, is printed −0.042; with +0.042 Table 4's mean comes out.
        assert abs(table2[:, 2].mean() - mean[2]) > 0.01
        assert table2[2, 2] == -0.042
        table2 = table2.copy()
        table2[2, 2] = 0.042
    np.testing.assert_allclose(table2.mean(axis=0), mean, atol=ROUNDING)
    # What Table 4 calls RMS is the norm divided by n.
    np.testing.assert_allclose(flight.paper_rms(table2), flight.statistics(phase, step, "rms"), atol=ROUNDING)
    np.testing.assert_allclose(flight.rms(table2), np.sqrt(6) * flight.paper_rms(table2))


def test_r9_and_table3_are_one_calibration():
    np.testing.assert_allclose(flight.calibration().G, flight.parameters("calibrated", 0.5).G, atol=1e-5)
    np.testing.assert_allclose(
        np.rad2deg(flight.calibration().bias), np.rad2deg(flight.parameters("calibrated", 0.5).bias), atol=5.1e-7
    )


def test_table5_is_a_correction_of_the_inverse_and_of_another_step():
    before = flight.parameters("prelaunch")
    G_printed, bias_printed = flight.corrections(1)
    inverse = np.linalg.inv(flight.parameters("calibrated", 0.5).G) - np.linalg.inv(before.G)
    # Table 3's angles are given to 0.001 deg = 1.7e-5 rad, Table 5 to 1e-5.
    np.testing.assert_allclose(inverse, G_printed, atol=3e-5)
    direct = flight.parameters("calibrated", 0.5).G - before.G
    assert np.abs(direct - G_printed).max() > 1e-3
    one_second = np.rad2deg(flight.parameters("calibrated", 1.0).bias - before.bias)
    np.testing.assert_allclose(one_second, bias_printed, atol=1e-6)
    half_second = np.rad2deg(flight.parameters("calibrated", 0.5).bias - before.bias)
    assert np.abs(half_second - bias_printed).max() > 2e-6


def test_table1_holds_47790_samples():
    assert flight.durations().sum() / 0.5 == 47790


def test_shipped_numbers_are_those_typed_from_the_papers():
    folder = SHARED / "flight"
    if not folder.is_dir():
        pytest.skip("the reference copy of the published values is not beside this checkout")
    for name in (
        "table1_intervals",
        "table2_residuals",
        "table3_parameters",
        "table4_statistics",
        "table5_corrections",
        "g_matrix",
    ):
        pd.testing.assert_frame_equal(flight.table(name), pd.read_csv(folder / f"{name}.csv"))
