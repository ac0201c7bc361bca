"""Predictions with the remainder of a calibration have errors of the size that they claim, on simulated and real recordings."""

from dataclasses import replace

import numpy as np
import pytest

from gyrocal import calibrate
from gyrocal.calibration.remainder import add_remainder
from gyrocal.estimation.prediction_consistency import compute_prediction_errors, cut_recording
from gyrocal.estimation.remainder_noise import KnownCalibration, RemainderNoise
from tests import SHARED
from tests.gyrocal.calibration.remainder_cases import simulate_remainder

HALF_S, END_S = 36.0, 72.0
REMAINDERS = ({}, {"rate": np.deg2rad(0.2)}, {"reference": np.deg2rad(0.2)}, {"delay_s": 0.01})


def predict_second_half(recording):
    first, second = cut_recording(recording, 0.0, HALF_S), cut_recording(recording, HALF_S, END_S)
    result = add_remainder(first, calibrate(first))
    known = KnownCalibration.build(result)
    stated = replace(known, covariance=result.covariance, noise=RemainderNoise())
    return [compute_prediction_errors(second, one, (1.0, 5.0), most_starts=10) for one in (known, stated)]


@pytest.mark.parametrize("remainder", REMAINDERS, ids=["none", "rate error", "correlated reference error", "delay"])
def test_normalised_errors_in_the_second_half_are_one(remainder):
    squares = {name: [[], []] for name in ("with", "without")}
    for seed in range(6):
        for name, found in zip(squares, predict_second_half(simulate_remainder(seed, **remainder)), strict=True):
            for k, one in enumerate(found):
                squares[name][k].append(np.square(one.normalised).mean())
    with_remainder, without = (np.sqrt(np.mean(squares[name], axis=1)) for name in ("with", "without"))
    assert ((with_remainder > 0.7) & (with_remainder < 1.4)).all(), with_remainder
    if remainder:
        assert without.max() > 1.6, without


REAL = SHARED / "real" / "broad"


@pytest.mark.skipif(not REAL.is_dir(), reason="the public recordings are not kept in the repository")
def test_normalised_errors_of_a_real_recording_are_near_one():
    from studies.validation.broad import build_recording, read

    recording = build_recording(read(REAL / "05_undisturbed_slow_rotation_with_breaks_B.parquet")).recording
    start_s, stop_s = recording.intervals[0].start_s, recording.intervals[-1].stop_s
    half_s = 0.5 * (start_s + stop_s)
    first, second = cut_recording(recording, start_s, half_s), cut_recording(recording, half_s, stop_s)
    known = KnownCalibration.build(add_remainder(first, calibrate(first)))
    for error in compute_prediction_errors(second, known):
        assert 0.8 < np.sqrt(np.mean(np.square(error.normalised))) < 1.25
