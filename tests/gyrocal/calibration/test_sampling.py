import dataclasses

import numpy as np
import pytest

from gyrocal import InputError
from gyrocal.calibration.sampling import prepare_measurements
from tests.builders import piecewise_recording

PLAN = ((((0.01, 0, 0), 10.0),), (((0, 0.02, 0), 7.0),))


def with_gyro(recording, **changes):
    return dataclasses.replace(recording, gyro=dataclasses.replace(recording.gyro, **changes))


def test_elapsed_times_are_from_the_start_of_the_interval():
    """Noise adds up from there, and not from the reference before."""
    prepared = prepare_measurements(piecewise_recording(PLAN, series_s=3.0))
    np.testing.assert_allclose(prepared.elapsed_s, [3, 6, 9, 3, 6])
    np.testing.assert_array_equal(prepared.arcs.arc, [0, 0, 0, 1, 1])


@pytest.mark.parametrize("resampling", ["skip", "average"])
def test_coarse_steps(resampling):
    recording = piecewise_recording(PLAN)
    ramp = with_gyro(recording, rates=np.arange(34.0)[:, None] * np.ones(3))
    prepared = prepare_measurements(ramp, 2.0, resampling)
    # 20 samples make 5 steps; 14 make 3 and a half one.
    np.testing.assert_allclose(prepared.arcs.dt, [2, 2, 2, 2, 2, 2, 2, 2, 1])
    first = np.array([0, 4, 8, 12, 16, 20, 24, 28, 32], dtype=float)
    np.testing.assert_array_equal(
        prepared.arcs.raw[:, 0], first if resampling == "skip" else first + np.array([1.5] * 8 + [0.5])
    )
    assert prepared.noise_gain == (4.0 if resampling == "skip" else 1.0)


def test_a_gap_or_a_missing_start_or_end_is_an_error_unless_holding_is_allowed():
    recording = piecewise_recording(PLAN)
    keep = np.delete(np.arange(34), [5, 6])
    holed = with_gyro(recording, t_s=recording.gyro.t_s[keep], rates=recording.gyro.rates[keep])
    with pytest.raises(InputError, match=r"m1: no gyro samples between 2.5 s and 3.5 s"):
        prepare_measurements(holed)
    with pytest.raises(InputError, match="the longest 1 s"):
        prepare_measurements(holed, max_gap_s=0.9)
    held = prepare_measurements(holed, max_gap_s=1.0)
    assert held.held_s == pytest.approx(1.0)
    assert held.arcs.dt[:18].sum() == pytest.approx(10.0)
    assert held.arcs.dt.max() == pytest.approx(1.5)
    late = with_gyro(recording, t_s=recording.gyro.t_s[10:], rates=recording.gyro.rates[10:])
    with pytest.raises(InputError, match="m1: no gyro sample covers"):
        prepare_measurements(late)
    short = with_gyro(recording, t_s=recording.gyro.t_s[:-4], rates=recording.gyro.rates[:-4])
    with pytest.raises(InputError, match="m2: no gyro samples between"):
        prepare_measurements(short)


def test_no_step_reaches_across_a_reference():
    """A mean over samples on both sides of a reference would let the rate after it into the residual before it."""
    recording = piecewise_recording(((((0.0, 0.0, 0.0), 7.0), ((0.2, 0.0, 0.0), 9.0)),), series_s=3.5)
    for resampling in ("skip", "average"):
        prepared = prepare_measurements(recording, 2.0, resampling)
        arcs = prepared.arcs
        starts = np.concatenate([[0.0], np.cumsum(arcs.dt)[:-1]])
        before, after = arcs.raw[starts < 7.0 - 1e-9], arcs.raw[starts >= 7.0 - 1e-9]
        assert np.ptp(before, axis=0).max() < 1e-15
        assert np.ptp(after, axis=0).max() < 1e-15
        np.testing.assert_allclose(np.add.reduceat(arcs.dt, arcs.first), np.diff([0, 3.5, 7, 10.5, 14]))


def test_average_weighs_a_cut_sample_by_what_is_used_of_it():
    recording = piecewise_recording(((((0.01, 0, 0), 10.0),),), series_s=3.3)
    ramp = with_gyro(recording, rates=np.arange(20.0)[:, None] * np.ones(3))
    prepared = prepare_measurements(ramp, 1.0, "average")
    # The last step before 3.3 s: sample 6 over [3.0, 3.3); the first after it: 0.2 s of sample 6 and 0.5 s of sample 7.
    step = prepared.arcs.last[0]
    assert prepared.arcs.raw[step - 1, 0] == pytest.approx(6.0)
    assert prepared.arcs.dt[step - 1] == pytest.approx(0.3)
    assert prepared.arcs.raw[step, 0] == pytest.approx((0.2 * 6 + 0.5 * 7) / 0.7)
