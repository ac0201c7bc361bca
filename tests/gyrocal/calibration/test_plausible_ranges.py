"""Grade and plausible ranges of a gyro, its mounting, and values that no gyro has."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import polar
from scipy.spatial.transform import Rotation

from gyrocal import NAMES, calibrate
from gyrocal.calibration.mounting import compute_mounting
from gyrocal.calibration.plausible_ranges import (
    DEG_SQRT_H,
    MEMS_BIAS,
    RANGES,
    compute_rest_rates,
    estimate_plausible_ranges,
)
from gyrocal.calibration.verdict import find_implausible_values
from tests.builders import TRUTH, piecewise_recording

RNG = np.random.default_rng(2)
MOVES = ((((0.0, 0.0, 0.0), 20.0), ((0.3, -0.2, 0.1), 20.0), ((-0.1, 0.2, -0.3), 20.0), ((0.0, 0.0, 0.0), 20.0)),)


@pytest.fixture(scope="module")
def moving():
    """A minute of motion between two rests, with a gyro of 0.6 deg/sqrt(h)."""
    arw = 0.6 * DEG_SQRT_H
    return piecewise_recording(MOVES, arw=arw, rng=np.random.default_rng(4), sigma_deg=0.05, series_s=1.0, sample_s=0.05)


@pytest.mark.parametrize(("arw", "grade"), [(0.0, "space"), (0.05, "space"), (0.07, "tactical"), (0.3, "MEMS")])
def test_the_stated_walk_gives_the_grade(arw, grade):
    recording = piecewise_recording(arw=arw * DEG_SQRT_H)
    found = estimate_plausible_ranges(recording)
    assert found.grade == grade
    assert (found.G, found.bias) == next((G, bias) for name, _, G, bias in RANGES if name == grade)


def test_the_bias_in_a_rest_is_found_and_corrects_the_grade(moving):
    rest = compute_rest_rates(moving)
    assert rest is not None
    np.testing.assert_allclose(rest.bias(TRUTH.G), TRUTH.bias, atol=np.deg2rad(0.01))
    assert estimate_plausible_ranges(moving).grade == "MEMS"
    calm = replace(moving.gyro, arw=0.01 * DEG_SQRT_H)
    assert estimate_plausible_ranges(replace(moving, gyro=calm)).grade == "space"
    biased = replace(calm, rates=calm.rates + np.deg2rad([0.0, 1.0, 0.0]))
    found = estimate_plausible_ranges(replace(moving, gyro=biased))
    assert found.grade == "MEMS"
    assert "in the rests, beyond the range of space grade" in found.reason


def test_a_coast_at_orbit_rate_is_no_bias():
    """A body that turns slowly all the time rests by its gyro; the references tell the rate from a bias."""
    slow = (0.0, -1e-3, 0.0)
    plan = (((slow, 60.0), ((0.3, -0.2, 0.1), 20.0), (slow, 60.0)),)
    recording = piecewise_recording(plan, arw=0.01 * DEG_SQRT_H, rng=RNG, sigma_deg=0.001, series_s=1.0, sample_s=0.05)
    assert compute_rest_rates(recording) is not None
    assert estimate_plausible_ranges(recording).grade == "space"


def test_polar_decomposition_and_its_jacobians():
    rng = np.random.default_rng(7)
    turn = Rotation.from_rotvec(np.deg2rad([100.0, -30.0, 60.0])).as_matrix()
    skewed = np.eye(3) + 0.02 * rng.normal(size=(3, 3))
    for G in (turn @ skewed, -turn @ skewed):
        R, _ = polar(G)
        size = 1e-6 * rng.uniform(0.2, 2.0, (3, 3))
        change = size * rng.normal(size=(200, 3, 3))
        moved = [polar(G + one) for one in change]
        rotations = np.array([Rotation.from_matrix(other @ R.T).as_rotvec() for other, _ in moved])
        found = compute_mounting(G, np.diag(size.ravel() ** 2), G, 0.01)
        np.testing.assert_allclose(found.sigma_rotation, rotations.std(axis=0), rtol=0.2)
        np.testing.assert_allclose(found.sigma_S, np.std([other for _, other in moved], axis=0), rtol=0.25)
        assert found.is_mirrored == (np.linalg.det(G) < 0)
        assert found.change == pytest.approx(0.0, abs=1e-7)


def test_motion_about_one_axis_leaves_the_mounting_open():
    plan = ((((0.0, 0.0, 0.5), 60.0), ((0.0, 0.0, -0.5), 60.0)),)
    recording = piecewise_recording(
        plan, arw=0.6 * DEG_SQRT_H, rng=np.random.default_rng(7), sigma_deg=0.05, series_s=2.0, sample_s=0.1
    )
    result = calibrate(recording)
    assert result.mounting.undetermined == ("z",)
    assert "does not determine the rotation about z" in " ".join(result.mounting.format_sentences())
    assert set(result.undetermined) == {"G_xx", "G_xy", "G_yx", "G_yy", "G_zx", "G_zy"}
    assert result.sigma[NAMES.index("G_zz")] < 0.01
    assert result.warnings == ()


def test_values_that_no_gyro_has_are_named(moving):
    ranges = estimate_plausible_ranges(moving)
    none = compute_mounting(TRUTH.G, np.zeros((9, 9)), np.eye(3), ranges.G)
    assert not tuple(find_implausible_values(none, TRUTH.G, TRUTH.bias, np.full(3, 1e-6), ranges))
    turn = Rotation.from_rotvec([0.0, 0.0, np.deg2rad(30.0)]).as_matrix()
    G = turn @ np.diag([1.0, 0.31, 1.0])
    mounting = compute_mounting(G, np.zeros((9, 9)), np.eye(3), ranges.G)
    bias = np.array([4 * MEMS_BIAS, 0.0, 0.0])
    found = tuple(find_implausible_values(mounting, G, bias, np.full(3, 1e-6), ranges))
    assert [text.split()[1] for text in found] == ["scale", "gyro", "bias", "bias"]
    assert "y 0.31" in found[0]
    assert "30 deg away from the stated axes" in found[1]
    assert "4 times the plausible range of the MEMS grade" in found[2]
    assert "off the bias in the rests" in found[3]
