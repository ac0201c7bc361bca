"""What must not change a diagnosis, and what must change it exactly: signs, epochs, axes, cuts of an interval."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from diagnosis.diagnose import diagnose
from tests.diagnosis.recordings import recorded

LIBRARY = ("bias_step", "bias_drift", "scale_asymmetry", "time_offset")
TIME_S, SIZE = 3000.0, 2.0  # s since the epoch, deg/h
AXES = "xyz"


def plain():
    return recorded(5, f"bias_step:z={SIZE},time_s={TIME_S}", sample_s=5.0, every_s=300.0)


def asked(recording):
    return diagnose(recording, library=LIBRARY)


@cache
def before():
    found = asked(plain())
    assert (found.verdict, [cause.label for cause in found.causes]) == ("named", ["bias_step:z"])
    return found


def assert_same(found, axes=AXES, by_s=0.0, rel=1e-6):
    """The same answer to rounding; an unlikely set worth 1e-4 of the probability may be kept or not by the last bits."""
    named = dict(zip(AXES, axes, strict=True))
    assert found.verdict == before().verdict
    assert found.p_value == pytest.approx(before().p_value, rel=1e-3)
    assert found.unknown_probability == pytest.approx(before().unknown_probability, abs=3e-4)
    (one,), (own,) = found.causes, before().causes
    assert (one.effect, one.axis) == (own.effect, named[own.axis])
    assert (one.size, one.sigma) == pytest.approx((own.size, own.sigma), rel=rel)
    assert one.probability == pytest.approx(own.probability, abs=3e-4)
    assert one.parameters["time_s"] - by_s == pytest.approx(own.parameters["time_s"], rel=rel)
    order = [axes.index(axis) for axis in AXES]  # the axis that has each name now
    np.testing.assert_allclose(found.bias, before().bias[order], rtol=rel)
    np.testing.assert_allclose(found.G, before().G[np.ix_(order, order)], atol=rel * before().sigma_G.min())
    assert found.closure.closed == pytest.approx(before().closure.closed, rel=100 * rel)


def test_epoch_signs_of_quaternions_and_names_of_axes_change_nothing_but_these():
    """The body's axes and its gyros are called otherwise, x what was y or z: a turn by a third about the diagonal."""
    recording, by_s, axes = plain(), 10**8, "yzx"
    P = np.eye(3)[[axes.index(axis) for axis in AXES]]  # components by the new names
    gyro, own = recording.gyro, recording.attitudes
    signs = np.random.default_rng(1).choice([-1.0, 1.0], (len(own.t_s), 1))
    q = signs * (Rotation.from_quat(own.quaternions) * Rotation.from_matrix(P).inv()).as_quat()
    G, bias = P @ gyro.apriori_G @ P.T, P @ gyro.apriori_bias
    changed = replace(
        recording,
        gyro=replace(gyro, t_s=gyro.t_s + by_s, rates=gyro.rates @ P.T, apriori_G=G, apriori_bias=bias),
        attitudes=replace(own, t_s=own.t_s + by_s, quaternions=q, sigma=own.sigma @ P.T),
        intervals=tuple(replace(one, start_s=one.start_s + by_s, stop_s=one.stop_s + by_s) for one in recording.intervals),
    )
    assert_same(asked(changed), axes, by_s)
