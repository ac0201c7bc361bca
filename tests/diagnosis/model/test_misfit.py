"""The innovations of all references under M0: against dense whitening, under the null, and with what no candidate can show."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from diagnosis.inference.criticism import combine_checks
from diagnosis.model import linearise
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.misfit import check_baseline, compute_innovations, tabulate_references
from diagnosis.model.prepare import prepare
from gyrocal import calibrate
from simulator.truth.rotation import apply_rotation_errors
from tests.diagnosis.recordings import of_rates, prepared, recorded, slews_between_references

DRAWS = 200


@pytest.fixture(scope="module")
def model():
    return prepared(3).model


@pytest.fixture(scope="module")
def drawn(model):
    """Residuals of M0 at every reference: a random walk of the gyro's noise, and white noise of the references."""
    rng = np.random.default_rng(41)
    first = np.flatnonzero(np.diff(model.interval_of_reference, prepend=-1))
    added = np.diff(model.walk, axis=0, prepend=0.0)
    added[first] = 0.0
    walk = np.einsum("mij,dmj->dmi", np.sqrt(np.maximum(added, 0.0)), rng.standard_normal((DRAWS, *model.residuals.shape)))
    total = np.cumsum(walk, axis=1)
    noise = np.einsum("mij,dmj->dmi", np.linalg.cholesky(model.errors), rng.standard_normal(walk.shape))
    return total + noise


def with_errors(recording, error):
    """The recording with errors of the references (m, 3) in body axes, rad."""
    attitudes = recording.attitudes
    return replace(recording, attitudes=replace(attitudes, quaternions=apply_rotation_errors(attitudes.quaternions, error)))


def test_innovations_have_the_sum_of_squares_of_the_dense_model_and_uniform_p_values(model, drawn):
    e, later, taken = compute_innovations(model)
    assert np.sum(e**2) == pytest.approx(model.y @ model.y, rel=1e-9)
    assert e.size - taken.shape[1] == model.degrees_of_freedom
    assert later.sum() == len(model.residuals) - len(model.blocks)
    # Kolmogorov and Smirnov for each statistic; that of all together has the rate it states.
    found = [check_baseline(replace(model, residuals=one)) for one in drawn]
    for k, check in enumerate(found[0]):
        p = np.array([checks[k].p_value for checks in found])
        assert scipy.stats.kstest(p, "uniform").pvalue > 1e-3, check.name
    assert np.mean([combine_checks(checks) < 0.05 for checks in found]) < 0.05 + 3 * np.sqrt(0.0475 / DRAWS)


def test_what_averaging_hides_is_seen(monkeypatch):
    """Errors of alternating sign vanish in means of an even number of references, and are no noise of stated size."""
    recording = recorded(3)
    alternate = np.where(np.arange(recording.attitudes.t_s.size) % 2, 1.0, -1.0)[:, None] * recording.attitudes.sigma * 1.2
    result = calibrate(recording)
    monkeypatch.setattr(linearise, "MOST_OBSERVATIONS", recording.attitudes.t_s.size // 4)
    clean = linearise_recording(recording, result.G, result.bias)
    found = linearise_recording(with_errors(recording, alternate), result.G, result.bias)
    assert found.y @ found.y < clean.y @ clean.y + 5 * np.sqrt(2 * clean.size)
    checks = {one.name: one.p_value for one in check_baseline(found)}
    assert checks["correlation in time"] < 1e-6
    assert checks["size"] < 1e-3
    assert combine_checks(check_baseline(clean)) > 1e-2


def tabulate(model):
    """What all references may follow, (m, q)."""
    return tabulate_references(model, np.ones(model.reference_rows.size, dtype=bool)).regressors


def test_the_rate_at_a_reference_holds_no_noise_from_before_it():
    """Slews between references, and a sway at them that is as large as the gyro's noise."""
    model = prepare(of_rates(slews_between_references(300, 72, 0.5, 3e-5), 72, 0.5, 3.8e-5, 7e-5, 0)).model
    gyro, at = model.recording.gyro, model.references.t_s.size // 2
    early = gyro.t_s < model.references.t_s[at]
    noisy = gyro.rates + 1e-6 * np.random.default_rng(0).standard_normal(gyro.rates.shape) * early[:, None]
    changed = replace(model, recording=replace(model.recording, gyro=replace(gyro, rates=noisy)))
    change = tabulate(changed) - tabulate(model)
    np.testing.assert_allclose(change[at:-1, :9], 0, atol=1e-15)  # after the last one there are no readings
    found = {one.name: one for one in check_baseline(model)}
    assert found["dependence on what is known"].p_value > 1e-3
