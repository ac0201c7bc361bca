"""What must not change a calibration, and what must change it exactly: axes, epochs, signs, cuts, the order of things."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
import scipy.linalg
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from gyrocal import Interval, calibrate
from gyrocal.recording import find_reference_rows
from tests.builders import PLAN, piecewise_recording

# Few examples, and each the same in every run: a failure is then of the change that was made.
FEW = settings(max_examples=8, phases=[Phase.generate])
TURNS = arrays(float, 3, elements=st.floats(-2.0, 2.0))
SIGMA_DEG, ARW, SERIES_S = 5e-4, np.deg2rad(2e-5), 150.0
# What linearisation leaves: residuals of 1e-5 rad differ by their squares between one cut of an interval and another.
SECOND_ORDER = 1e-3  # sigmas
ROUNDED = 1e-6  # sigmas


@cache
def recorded(touching=False):
    """Noisy references within each interval, of the same sigma about all axes."""
    noise = {"sigma_deg": SIGMA_DEG, "arw": ARW, "rng": np.random.default_rng(12)}
    return piecewise_recording(PLAN, sample_s=10.0, series_s=SERIES_S, gap_s=0.0 if touching else 300.0, **noise)


@cache
def found(touching=False):
    return calibrate(recorded(touching))


def assert_is(result, parameters, covariance, before, within=ROUNDED):
    """Parameters, covariance and χ² are those expected, to so many sigmas."""
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_array_less(np.abs(result.parameters.vector - parameters), within * sigma)
    np.testing.assert_allclose(result.covariance / np.outer(sigma, sigma), covariance / np.outer(sigma, sigma), atol=within)
    assert result.dof == before.dof
    assert result.chi2 == pytest.approx(before.chi2, rel=within)


def expected(before, body, gyros):
    """Parameters and covariance with the body's axes turned by one matrix and the gyros' by another: Q G Pᵀ, Q b."""
    J = scipy.linalg.block_diag(np.kron(body, gyros), body)
    return J @ before.parameters.vector, J @ before.covariance @ J.T


def turned(recording, body, gyros):
    """The same motion in other body axes, seen by gyros that are mixed: ω' = Q ω, A' = Q A, ω_raw' = P ω_raw."""
    gyro, own = recording.gyro, recording.attitudes
    q = (Rotation.from_quat(own.quaternions) * Rotation.from_matrix(body).inv()).as_quat()  # q is Aᵀ as an active rotation
    G, bias = body @ gyro.apriori_G @ gyros.T, body @ gyro.apriori_bias
    changed = replace(gyro, rates=gyro.rates @ gyros.T, apriori_G=G, apriori_bias=bias)
    return replace(recording, gyro=changed, attitudes=replace(own, quaternions=q))


@FEW
@given(TURNS, st.permutations(range(3)), arrays(float, 3, elements=st.sampled_from([-1.0, 1.0])))
def test_other_body_axes_turn_the_rows_of_G_and_other_gyros_its_columns(theta, order, signs):
    Q, P = Rotation.from_rotvec(theta).as_matrix(), signs[:, None] * np.eye(3)[list(order)]
    assert_is(calibrate(turned(recorded(), Q, P)), *expected(found(), Q, P), found())


def shifted(recording, by_s):
    gyro, own = recording.gyro, recording.attitudes
    moved = tuple(
        replace(interval, start_s=interval.start_s + by_s, stop_s=interval.stop_s + by_s) for interval in recording.intervals
    )
    gyro, own = replace(gyro, t_s=gyro.t_s + by_s), replace(own, t_s=own.t_s + by_s)
    return replace(recording, gyro=gyro, attitudes=own, intervals=moved)


@FEW
@given(st.integers(-(10**9), 10**9), st.integers(0, 2**31))
def test_another_epoch_and_the_sign_of_a_quaternion_change_no_bit(by_s, seed):
    """Differences of such times are exact."""
    moved = shifted(recorded(), float(by_s))
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (len(moved.attitudes.t_s), 1))
    result = calibrate(replace(moved, attitudes=replace(moved.attitudes, quaternions=signs * moved.attitudes.quaternions)))
    np.testing.assert_array_equal(result.parameters.vector, found().parameters.vector)
    np.testing.assert_array_equal(result.covariance, found().covariance)


@FEW
@given(st.sets(st.integers(0, 60), min_size=1, max_size=6))
def test_an_interval_that_is_cut_at_references_says_the_same(cuts):
    """The parts share a reference and its error: what one knows of it the other knows too."""
    recording = recorded()
    parts = []
    for interval in recording.intervals:
        inside = recording.attitudes.t_s[find_reference_rows(recording.attitudes.t_s, interval)][1:-1]
        own = [interval.start_s, *inside[[k for k in sorted(cuts) if k < len(inside)]], interval.stop_s]
        parts += [Interval(f"{interval.name} {a:g}", "", a, b) for a, b in pairwise(own)]
    result = calibrate(replace(recording, intervals=tuple(parts)))
    assert_is(result, found().parameters.vector, found().covariance, found(), within=SECOND_ORDER)


@FEW
@given(st.permutations(range(len(PLAN))))
def test_intervals_that_touch_may_stand_in_any_order(order):
    """Of two that share a reference the later one may come first in the file: both branches of their covariance are asked."""
    recording = recorded(touching=True)
    result = calibrate(replace(recording, intervals=tuple(recording.intervals[k] for k in order)))
    assert_is(result, found(True).parameters.vector, found(True).covariance, found(True))
