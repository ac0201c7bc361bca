"""The preparation and the calibration with effects in the model, against the calibrator and the truth."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.model.calibration import (
    calibrate_with_effects,
    calibrate_with_remainder,
    describe_unobserved,
    jackknife_calibration,
)
from diagnosis.model.folds import assign_folds
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.prepare import subtract_effects
from gyrocal import calibrate
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import plan, prepared, recorded, slews


def truth():
    return np.append(np.ravel(plan().gyro.true_G), np.deg2rad(plan().gyro.true_bias_deg_s))


def vector(model):
    return np.append(model.G.ravel(), model.bias)


def test_the_calibration_is_the_calibrators_and_its_errors_have_its_covariance():
    """Another implementation of the same estimate: differences are far inside the sigmas."""
    found = prepared(3)
    result = calibrate(recorded(3))
    assert np.abs((vector(found.model) - result.parameters.vector) / result.sigma).max() < 0.05
    assert np.allclose(found.sigma, result.sigma, rtol=0.02)
    # Normalised squared errors of the twelve parameters over recordings of M0.
    nees = 0.0
    for seed in range(6):
        model = prepared(seed).model
        error = vector(model) - truth()
        nees += error @ np.linalg.solve(calibrate_with_effects(model, [])[1], error)
    assert 1e-3 < scipy.stats.chi2.cdf(nees, 12 * 6) < 1 - 1e-3


def test_a_shape_in_the_place_of_a_scale_factor_leaves_the_calibration():
    """Each part of the recording would have another scale beside it; a shape that is there makes them agree and stays."""
    model, rng = prepared(3).model, np.random.default_rng(2)
    parts = np.repeat(assign_folds(model), 3)

    def member(column, process):
        one = np.ones(1)
        return FittedEffect(
            "shape", "shape", None, "", 1.0, 0.1, {}, column[:, None], one, one, 60.0, process, np.zeros(column.size)
        )

    scale = model.calibration[:, 8] / np.linalg.norm(model.calibration[:, 8])
    false = member(30 * scale * (1 + 0.3 * np.sign(np.sin(parts))), False)
    noise = member(rng.standard_normal(model.size), True)
    plain, _ = calibrate_with_remainder(model, (), (noise,))
    left, _ = calibrate_with_remainder(model, (), (noise, false))
    np.testing.assert_array_equal(left, plain)
    shape = rng.standard_normal(model.size) + model.calibration[:, 0] / np.linalg.norm(model.calibration[:, 0])
    moved = replace(model, zeta=model.zeta.copy())
    for block in model.blocks:
        moved.zeta[block.rows] += 60 * block.whitener @ shape[block.rows]
    with_shape, _ = calibrate_with_remainder(moved, (), (member(shape, False),))
    sigma = prepared(3).sigma
    assert np.abs((with_shape - calibrate_with_effects(model, [])[0]) / sigma).max() < 3
    assert np.abs((calibrate_with_effects(moved, [])[0] - calibrate_with_effects(model, [])[0]) / sigma).max() > 3


def test_the_jackknife_is_that_of_fits_without_each_part():
    """Another implementation: least squares of the rows that are left, the prior of G and b as further rows."""
    model = prepared(3).model
    fold, X = np.repeat(assign_folds(model), 3), np.hstack([model.calibration, model.starts])
    prior = np.hstack([0.1 * np.diag(1 / PLAUSIBLE_RANGE), np.zeros((12, model.starts.shape[1]))])
    y = model.whiten(model.zeta)
    each = [
        np.linalg.lstsq(np.vstack([X[fold != one], prior]), np.append(y[fold != one], np.zeros(12)), rcond=1e-14)[0][:12]
        for one in np.unique(fold)
    ]
    count = len(each)
    expected = np.sqrt((count - 1) * np.var(each, axis=0))
    np.testing.assert_allclose(jackknife_calibration(model, []), expected, rtol=1e-4)


@pytest.mark.parametrize(("arw_deg_per_sqrt_s", "bias_is_seen"), [(2e-4, False), (0.01, True)])
def test_a_parameter_is_observed_by_the_grade_of_its_own_gyro(arw_deg_per_sqrt_s, bias_is_seen):
    """References of 0.5 deg determine the bias to tens of deg/h: too little for a gyro in orbit, and plenty in a phone."""
    made = slews()
    made = replace(
        made,
        gyro=replace(made.gyro, arw=np.deg2rad(arw_deg_per_sqrt_s)),
        attitudes=replace(made.attitudes, sigma=np.full_like(made.attitudes.sigma, np.deg2rad(0.5))),
    )
    (note,) = describe_unobserved(linearise_recording(made, np.eye(3), np.zeros(3))) or ("",)
    assert ("b_x" not in note) == bias_is_seen


def test_what_the_motion_does_not_show_is_said_of_any_grade():
    """A body that turns about x alone says nothing of the other columns of G."""
    made = slews()
    own, read = tuple(made.intervals[k] for k in (0, 3)), made.attitudes
    rows = np.any([(read.t_s >= part.start_s) & (read.t_s <= part.stop_s) for part in own], axis=0)
    seen = replace(read, t_s=read.t_s[rows], quaternions=read.quaternions[rows], sigma=read.sigma[rows])
    one = replace(made, intervals=own, attitudes=seen, gyro=replace(made.gyro, arw=np.deg2rad(0.01)))
    (note,) = describe_unobserved(linearise_recording(one, np.eye(3), np.zeros(3)))
    assert all(name in note for name in ("G_xy", "G_yz", "G_zz"))
    assert "G_xx" not in note


def fitted(label, amplitudes, **parameters):
    """An effect as the search would have found it; only amplitudes and parameters count here."""
    effect, _, axis = label.partition(":")
    one, none = np.array(amplitudes, dtype=float), np.empty(0)
    columns = np.empty((0, one.size))
    return FittedEffect(label, effect, axis or None, "", float(one[0]), 0.0, parameters, columns, one, one, 1.0, False, none)


@pytest.mark.parametrize(
    ("text", "amplitudes"),
    [
        ("time_offset=1.0", [1.0]),
        ("reference_horizon:x=0.02,phase_deg=30", [0.02 * np.cos(np.pi / 6), 0.02 * np.sin(np.pi / 6)]),
    ],
)
def test_without_an_effect_the_residuals_are_those_of_m0(text, amplitudes):
    """What is left beside G and b differs by second orders from a recording with the same noise and no effect."""
    with_it, clean = prepared(3, text).model, prepared(3).model
    effect = EFFECTS[text.partition("=")[0].partition(":")[0]]
    one = (effect, fitted(text.partition("=")[0], amplitudes))
    left = subtract_effects(with_it, [one])
    size = np.linalg.norm(with_it.y - clean.y)
    assert size > 5
    assert np.linalg.norm(left.y - clean.y) < 0.05 * size
