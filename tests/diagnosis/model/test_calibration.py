"""The preparation and the calibration with effects in the model, against the calibrator and the truth."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from diagnosis.inference.amplitudes import FittedEffect, fit
from diagnosis.inference.search import Search
from diagnosis.model.calibration import calibrate_beside_remainder, calibrate_with_effects, jackknife_calibration
from diagnosis.model.folds import assign_folds
from diagnosis.model.linear import SelectedCandidate
from diagnosis.model.prepare import prepare
from gyrocal import calibrate
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from simulator import scenario
from simulator.simulate import simulate
from tests.diagnosis.recordings import linear_of, plan, prepared, recorded


def truth():
    return np.append(np.ravel(plan().gyro.true_G), np.deg2rad(plan().gyro.true_bias_deg_s))


def vector(model):
    return np.append(model.G.ravel(), model.bias)


def test_prepare_finds_the_calibrators_parameters():
    """Another implementation of the same estimate: differences are far inside the sigmas."""
    found = prepared(3)
    result = calibrate(recorded(3))
    assert np.abs((vector(found.model) - result.parameters.vector) / result.sigma).max() < 0.05
    assert np.allclose(found.sigma, result.sigma, rtol=0.02)


def test_errors_of_m0s_calibration_are_those_of_its_covariance():
    """Normalised squared errors of the twelve parameters over recordings of M0."""
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
        return FittedEffect(
            "shape",
            "shape",
            None,
            "",
            1.0,
            0.1,
            {},
            column[:, None],
            np.ones(1),
            np.ones(1),
            60.0,
            process,
            np.zeros(column.size),
        )

    scale = model.calibration[:, 8] / np.linalg.norm(model.calibration[:, 8])
    false = member(30 * scale * (1 + 0.3 * np.sign(np.sin(parts))), False)
    noise = member(rng.standard_normal(model.size), True)
    plain, _ = calibrate_beside_remainder(model, (), (noise,))
    left, covariance = calibrate_beside_remainder(model, (), (noise, false))
    np.testing.assert_array_equal(left, plain)
    spread = jackknife_calibration(model, [noise])
    assert (np.sqrt(np.diag(covariance))[:12] >= spread * (1 - 1e-12)).all()
    shape = rng.standard_normal(model.size) + model.calibration[:, 0] / np.linalg.norm(model.calibration[:, 0])
    moved = replace(model, zeta=model.zeta.copy())
    for block in model.blocks:
        moved.zeta[block.rows] += 60 * block.whitener @ shape[block.rows]
    with_shape, _ = calibrate_beside_remainder(moved, (), (member(shape, False),))
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


def named(label, *effects, seed=21):
    made = linear_of((label.partition(":")[0],), seed, *effects)
    score = Search(made).score(made.find(label), ())
    return prepared(seed, *effects).model, fit(made, [SelectedCandidate(made.find(label), score.option, score.scale)])


def test_size_and_phase_agree_with_least_squares_and_the_truth():
    model, (one,) = named("bias_orbital:z", "bias_orbital:z=0.3,phase_deg=25")
    X = model.project_out_nuisance(one.columns)
    amplitudes = np.linalg.lstsq(X, model.y, rcond=None)[0]
    covariance = np.linalg.inv(X.T @ X)
    # The prior moves them by their variance over the prior's.
    assert np.allclose(one.amplitudes, amplitudes, rtol=2 * np.trace(covariance) / one.prior_sigma**2 + 1e-6)
    assert abs(one.size - 0.3) < 3.5 * one.sigma
    assert abs((float(one.parameters["phase_deg"]) - 25 + 180) % 360 - 180) < 8
    assert np.sqrt(np.diag(covariance)).min() * 0.95 <= one.sigma <= np.sqrt(np.diag(covariance)).max() * 1.05


@pytest.mark.parametrize(
    ("label", "text"),
    [("bias_orbital:z", "bias_orbital:z=0.3,phase_deg=25"), ("bias_drift:x", "bias_drift:x=0.05")],
)
def test_calibration_with_the_effect_in_covers_the_truth(label, text):
    model, effects = named(label, text)
    nees = {}
    for name, fitted in (("with", effects), ("without", [])):
        change, covariance = calibrate_with_effects(model, fitted)
        error = vector(model) + change - truth()
        nees[name] = error @ np.linalg.solve(covariance[:12, :12], error)
    assert scipy.stats.chi2.sf(nees["with"], 12) > 1e-3
    assert nees["without"] > nees["with"]


# ---- the noise of the references -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("stated", "axis"), [((1, 1, 1), None), ((1.5, 1.5, 1.5), None), ((1, 1.6, 1), 1)])
def test_noise_of_the_references(stated, axis):
    recording = recorded(22, every_s=60.0)
    sigma = recording.attitudes.sigma / np.array(stated)
    found = prepare(replace(recording, attitudes=replace(recording.attitudes, sigma=sigma)))
    noise = found.reference_noise
    assert noise.departs == (stated != (1, 1, 1))
    if noise.departs:
        assert noise.axis == axis
        assert np.abs((noise.factor - stated) / noise.sigma).max() < 4
        # The model then has the noise there is.
        model = found.model
        assert scipy.stats.chi2.sf(model.y @ model.y, model.degrees_of_freedom) > 1e-4


@pytest.mark.parametrize("text", ["bias_orbital:y=1.0", "reference_orbital:x=0.05", "bias_random_walk:z=1.0"])
def test_noise_of_the_references_is_no_slow_error(text):
    """Second differences leave a drifting bias and a slow reference error out."""
    assert not prepared(23, text, every_s=60.0).reference_noise.departs


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_noisy_gyro_is_no_noise_of_the_references(seed):
    found = prepared(seed, "noise_excess:y=3", every_s=60.0).reference_noise
    assert found is not None
    assert not found.departs


def test_without_a_series_of_references_their_noise_is_not_tested():
    ends = scenario.override(plan(), {"reference.at": "ends"})
    found = prepare(simulate(ends, seed=1))
    assert found.reference_noise is None
    assert any("degrees of freedom" in note for note in found.notes)
