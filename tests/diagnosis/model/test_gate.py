"""The gate of a diagnosis: what it refuses, what it says then, and the real faults that it lets pass."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from diagnosis.detectors.samples import examine
from diagnosis.model.calibration import check_residuals
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.prepare import prepare
from gyrocal import InputError, calibrate
from gyrocal.calibration.gate import LargeResidualError
from gyrocal.importing import explain_refusal
from gyrocal.masking import find_mask
from tests.diagnosis.recordings import slews


@lru_cache
def recording():
    return slews(seed=2)


def with_rates(change):
    gyro = recording().gyro
    return replace(recording(), gyro=replace(gyro, rates=change(gyro.rates)))


def with_quaternions(change):
    return replace(recording(), attitudes=replace(recording().attitudes, quaternions=change(recording().attitudes.quaternions)))


MISREAD = {
    "deg/h for deg/s": (lambda: with_rates(lambda x: 3600 * x), "with the gyro in deg/h, not deg/s"),
    "axes": (lambda: with_rates(lambda x: x[:, [1, 0, 2]] * [1, 1, -1]), "with the gyro's axes as y,x,-z"),
    "scalar first": (lambda: with_quaternions(lambda q: np.roll(q, 1, axis=1)), "with the quaternion's scalar part first"),
    "bias": (lambda: with_rates(lambda x: x + 0.02), "fit each other with a bias of -1.146, -1.146, -1.146 deg/s"),
}


@pytest.mark.parametrize("kind", MISREAD)
def test_what_the_calibration_refuses_the_diagnosis_refuses_in_the_same_line(kind):
    make, words = MISREAD[kind]
    wrong = make()
    with pytest.raises(InputError) as said:
        calibrate(wrong)
    assert words in explain_refusal(said.value)
    assert str(said.value).startswith("interval m")
    assert "t_s = " in str(said.value)
    assert "\n" not in explain_refusal(said.value)
    with pytest.raises(LargeResidualError) as caught:
        prepare(wrong)
    assert explain_refusal(caught.value) == explain_refusal(said.value)


def outlier(angle_deg, row):
    def turned(q):
        out = q.copy()
        out[row] = (Rotation.from_quat(q[row]) * Rotation.from_rotvec(np.deg2rad([angle_deg, 0.0, 0.0]))).as_quat()
        return out

    return lambda: with_quaternions(turned)


REAL = {
    "time offset": lambda: replace(
        recording(), gyro=replace(recording().gyro, rates=np.roll(recording().gyro.rates, 5, axis=0))
    ),
    "step of 300 deg/h": lambda: with_rates(lambda x: x + np.deg2rad(300 / 3600) * (np.arange(len(x)) > 700)[:, None]),
    "clipped": lambda: with_rates(lambda x: np.clip(x, -0.01, 0.01)),
    "outlier at the start": outlier(170.0, 21),
}


@pytest.mark.parametrize("kind", REAL)
def test_real_faults_pass(kind):
    wrong = REAL[kind]()
    model = prepare(find_mask(wrong).apply(wrong)).model
    assert model.size > 100


def test_the_gate_asks_the_repaired_stream_and_refuses_many_outliers():
    """They would be a wrong reading that by chance leaves every second reference where it is."""
    wrong = with_quaternions(lambda q: np.where((np.arange(len(q)) % 5 == 2)[:, None], np.roll(q, 1, axis=1), q))
    with pytest.raises(LargeResidualError):
        prepare(wrong)
    # One sample in seven reads 30 deg/s too much: no reading fits the raw rates, and the repaired ones are within noise.
    one = recording()
    spoilt = one.gyro.rates + np.deg2rad(30.0) * (np.arange(len(one.gyro.rates)) % 7 == 5)[:, None]
    wrong = replace(one, gyro=replace(one.gyro, rates=spoilt))
    G, bias = one.gyro.apriori_G, one.gyro.apriori_bias
    with pytest.raises(LargeResidualError):
        check_residuals(linearise_recording(wrong, G, bias), spoilt)
    check_residuals(linearise_recording(wrong, G, bias, examine(one).rates), examine(one).rates)
