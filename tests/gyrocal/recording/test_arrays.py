"""Recordings from memory, what they look like, and how a user's own script fares with the library."""

import numpy as np
import pytest

import gyrocal
from gyrocal import InputError, Recording
from tests.builders import piecewise_recording

RECORDING = piecewise_recording(series_s=100.0)


def arrays(recording=RECORDING, **changes):
    gyro, references = recording.gyro, recording.attitudes
    options = {"sigma": references.sigma, "arw": gyro.arw, "intervals": recording.intervals} | changes
    return Recording.from_arrays(gyro.t_s, options.pop("rates", gyro.rates), references.t_s, references.quaternions, **options)


def test_arrays_make_the_recording_they_came_from():
    made = arrays()
    np.testing.assert_allclose(made.gyro.rates, RECORDING.gyro.rates, rtol=1e-14)
    np.testing.assert_allclose(made.attitudes.sigma, RECORDING.attitudes.sigma, rtol=1e-14)
    assert made.gyro.sample_s == RECORDING.gyro.sample_s
    assert made.intervals == RECORDING.intervals


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Recording.from_arrays([0.0, 1.0], np.zeros((2, 3)), [0.0, 1.0], np.zeros((2, 4)), sigma=1, arw=0), "norm 0"),
        (lambda: RECORDING.to_frame("sun_sensor"), "no such table; there are gyro, attitude"),
    ],
)
def test_what_does_not_fit_is_said(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_drawings_are_axes_that_show_the_numbers():
    import matplotlib.pyplot as plt

    result = gyrocal.calibrate(RECORDING)
    drawn = result.plot_residuals().lines[0].get_xydata()
    np.testing.assert_array_equal(drawn, result.residuals[["t_s", "after_roll_deg"]])
    in_sigma = result.plot_parameters().lines[0].get_xdata()
    np.testing.assert_allclose(in_sigma[9:], (result.bias - RECORDING.gyro.apriori_bias) / result.sigma[9:], rtol=1e-9)
    plt.close("all")
