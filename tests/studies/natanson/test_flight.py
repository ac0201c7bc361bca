"""The flight's values agree with each other where they should, and the known slips are as described."""

import numpy as np
import pytest

from studies.natanson import flight

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
