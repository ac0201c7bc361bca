"""Errors of one of two star trackers are named with its name; two clean ones raise no alarm."""

import numpy as np
import pytest

import simulator
from diagnosis.diagnose import diagnose
from diagnosis.model.folds import SETTINGS as FOLDS
from diagnosis.model.folds import reverse_whitening
from diagnosis.model.linearise import SETTINGS as LINEARISE
from diagnosis.model.linearise import _build_interval_covariance, _build_overlapping_covariance, linearise_recording
from diagnosis.model.localization import compute_body_residuals, compute_statistics
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from simulator.effects import TRACKER_EFFECTS, parse
from tests.diagnosis.recordings import joint_covariance
from tests.tracker_cases import AGILE, ESTIMATED, TETRAHEDRON

LIBRARY = (*TRACKER_EFFECTS, "bias_drift", "bias_step")


def answer(scenario, *texts, seed=3):
    return diagnose(simulator.simulate(scenario, seed=seed, effects=[parse(text) for text in texts]), library=LIBRARY)


def test_two_clean_trackers_raise_no_alarm():
    found = answer(AGILE)
    assert found.verdict == "none"
    assert found.p_values["trackers st1 and st2"] > 1e-3
    assert {"tracker_noise:st1", "tracker_noise:st2"} >= {name for name in found.p_values if name.startswith("tracker_noise")}


@pytest.mark.parametrize(("label", "size"), [("tracker_time_offset:st1", 0.05), ("tracker_aberration:st2", 1.0)])
def test_an_effect_of_one_tracker_is_named(label, size):
    """A misalignment is named below, beside a mounting with a prior."""
    found = answer(AGILE, f"{label}={size}")
    assert [cause.label for cause in found.causes] == [label]
    assert abs(found.causes[0].size - size) < 4 * found.causes[0].sigma


def test_a_mounting_that_is_estimated_is_no_effect():
    """It is turned by 135 arcsec; 58 arcsec beyond a prior are an effect, see below."""
    assert answer(ESTIMATED).verdict == "none"


PRIOR_DEG = 2e-3


def stated(misalignment, sigma=PRIOR_DEG):
    """Two trackers of which the second is turned, and to be estimated with a prior."""
    changes = {"reference.tracker.1.estimated": True, "reference.tracker.1.mounting_sigma_deg": [sigma] * 3}
    return simulator.override(AGILE, {**changes, "reference.tracker.1.misalignment_deg": [misalignment, 0.0, 0.0]})


def test_a_mounting_with_a_prior_is_known_as_well_as_that_says():
    assert answer(stated(PRIOR_DEG)).verdict == "none"
    found = answer(stated(8 * PRIOR_DEG))
    assert [cause.label for cause in found.causes] == ["tracker_misalignment:st2"]
    assert found.causes[0].size == pytest.approx(3600 * 8 * PRIOR_DEG, rel=0.25)


def test_a_prior_is_noise_that_all_intervals_share():
    model = linearise_recording(
        simulator.simulate(stated(0.0), seed=1), np.array(AGILE.gyro.true_G), np.deg2rad(AGILE.gyro.true_bias_deg_s)
    )
    V = np.zeros((model.size, model.size))
    for block in model.blocks:
        V[block.rows, block.rows] = block.whitener @ block.whitener.T
    turns = np.zeros((model.reference_rows.size, 3, 3))
    own = model.recording.attitudes.sensor[model.reference_rows] == 1
    turns[own] = model.recording.attitudes.sensors[1].M.T
    C = model.observe_reference_error(turns) * np.deg2rad(PRIOR_DEG)
    V += C @ C.T
    assert np.allclose(model.whiten(model.whiten(V).T), np.eye(model.size), atol=1e-7)
    assert np.allclose(model.undo_mounting_whitening(model.whiten(C)), model.known_mountings)
    assert model.nuisance.shape[1] == 3 * len(model.blocks) + 12
    free = model.drop_mounting_priors()
    assert free.nuisance.shape[1] == model.nuisance.shape[1] + 3
    plain = linearise_recording(simulator.simulate(AGILE, seed=1), model.G, model.bias)
    starts, calibration = (reverse_whitening(plain, one) for one in (plain.attitude_nuisance, plain.calibration))
    broad = np.hstack([starts * FOLDS.start, calibration * FOLDS.broad * PLAUSIBLE_RANGE])
    whole = V + broad @ broad.T
    assert np.allclose(joint_covariance(model), whole, rtol=1e-9, atol=1e-12 * whole.max())
    residual, sigma = compute_body_residuals(model, model.y)
    chi2 = compute_statistics(model)
    assert 0.8 < np.sqrt(np.mean((residual / sigma) ** 2)) < 1.2
    assert chi2["p_value"].min() > 1e-5


@pytest.mark.long
def test_four_gyros_and_two_trackers_name_the_tracker():
    found = answer(simulator.override(AGILE, {"gyro.array": TETRAHEDRON}), "tracker_time_offset:st2=0.05")
    assert [cause.label for cause in found.causes] == ["tracker_time_offset:st2"]


def test_covariance_of_observations_that_do_not_overlap_is_the_same_by_both_ways():
    rng = np.random.default_rng(1)
    elapsed = np.sort(rng.uniform(0, 100, 8))
    walk = 1e-9 * elapsed[:, None, None] * np.diag([1.0, 2.0, 3.0])
    A_T, sigma, groups = np.linalg.qr(rng.normal(size=(8, 3, 3)))[0], rng.uniform(1e-5, 1e-4, (8, 3)), np.array([0, 3, 5])
    errors = np.einsum("mij,mj,mkj->mik", A_T, sigma**2, A_T)
    direct = _build_interval_covariance(errors, walk, groups, elapsed)
    assert np.allclose(_build_overlapping_covariance(errors, walk, groups, elapsed), direct, rtol=1e-12, atol=1e-24)


def test_many_references_are_averaged_tracker_by_tracker():
    """χ² of the averaged observations is that of their number: their covariance is right though they overlap in time."""
    dense = simulator.override(AGILE, {"reference.every_s": 12.0})
    values = []
    for seed in range(3):
        recording = simulator.simulate(dense, seed=seed)
        assert recording.attitudes.t_s.size > LINEARISE.most_observations
        model = linearise_recording(recording, np.array(AGILE.gyro.true_G), np.deg2rad(AGILE.gyro.true_bias_deg_s))
        sensor = recording.attitudes.sensor[model.reference_rows]
        for block in model.blocks:
            part = sensor[model.interval_of_reference == model.blocks.index(block)]
            assert all(np.unique(one).size == 1 for one in np.split(part, block.groups[1:]))
        values.append((float(model.y @ model.y), model.degrees_of_freedom))
    chi2, dof = np.sum(values, axis=0)
    assert abs(chi2 - dof) < 4 * np.sqrt(2 * dof)
