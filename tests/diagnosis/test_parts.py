"""Dead zone, amplitudes, residuals in body axes and closure on a simulated recording, with controls."""

import numpy as np
import pytest

from diagnosis.detectors.dead_zone_rests import find_dead_zone_evidence
from diagnosis.detectors.samples import examine
from diagnosis.diagnose import diagnose
from diagnosis.inference.amplitudes import fit
from diagnosis.inference.closure import compute_closure
from diagnosis.inference.search import Search
from diagnosis.model import localization as where
from diagnosis.model.candidates import build_linear_model
from diagnosis.model.prepare import prepare
from simulator import scenario
from simulator.effects import EFFECTS, parse
from simulator.simulate import simulate
from tests.diagnosis import recordings


@pytest.fixture(scope="module")
def plan():
    return recordings.plan()


@pytest.fixture(scope="module")
def prepared(plan):
    return prepare(simulate(plan, seed=21, effects=[parse("bias_orbital:z=0.3,phase_deg=25")]))


@pytest.fixture(scope="module")
def linear(prepared):
    return build_linear_model(prepared.model, list(EFFECTS.values()))


def _members(linear, *labels):
    """Members at their best options and scales."""
    return Search(linear).find_explanation(labels).members


def test_dead_zone_reads_zero_and_m0_does_not(plan):
    for text, found in (("rate_deadzone:x=3e-4", True), ("bias_step:x=0.1,time_s=20000", False)):
        recording = simulate(plan, seed=24, effects=[parse(text)])
        report = examine(recording)
        usual = float(np.deg2rad(1e-4))
        shown = find_dead_zone_evidence(recording, report.rates, report.noise, usual, np.full(3, usual), report.zones)
        odds = {one.axis: one.log_odds for one in shown}
        assert (odds.get(0, 0.0) > 2) == found


def test_a_gyro_without_bias_is_no_dead_zone(plan):
    """Negative control: raw rates that are zero because there is nothing to read."""
    changes = {"gyro.true_bias_deg_s": (0.0, 0.0, 0.0), "gyro.true_G": np.eye(3).tolist()}
    answer = diagnose(simulate(scenario.override(plan, changes), seed=25))
    assert "none" in answer.conformal_90
    assert "unknown" in answer.conformal_90
    assert answer.verdict == "none"  # whatever the samples look like, no rate is missing in the attitude


def test_amplitudes_agree_with_least_squares_and_the_truth(prepared, linear):
    model = prepared.model
    (numbers,) = fit(linear, _members(linear, "bias_orbital:z"))
    X = model.project_out_nuisance(numbers.columns)
    amplitudes = np.linalg.lstsq(X, model.y, rcond=None)[0]
    # At this signal-to-noise ratio the prior shrinks by less than a hundredth.
    assert np.allclose(numbers.amplitudes, amplitudes, rtol=1e-2)
    assert abs(numbers.size - 0.3) < 3.5 * numbers.sigma
    assert abs((float(numbers.parameters["phase_deg"]) - 25 + 180) % 360 - 180) < 8
    covariance = np.linalg.inv(X.T @ X)
    assert np.sqrt(np.diag(covariance)).min() * 0.98 <= numbers.sigma <= np.sqrt(np.diag(covariance)).max() * 1.02


def test_residuals_in_body_axes_have_the_sigma_they_state(prepared):
    rng = np.random.default_rng(34)
    model = prepared.model
    noise = (model.project_out_nuisance(rng.standard_normal(model.size)) for _ in range(400))
    draws = [where.compute_body_residuals(model, one) for one in noise]
    sigma = draws[0][1]
    kept = sigma > 1e-3 * sigma.max()
    squares = np.array([np.mean((residual[kept] / sigma[kept]) ** 2) for residual, _ in draws])
    sampling = squares.std() / np.sqrt(squares.size)
    assert sampling < 0.01
    assert abs(squares.mean() - 1) < 4 * sampling


def test_closure_of_the_truth_of_nothing_and_of_a_wrong_effect(prepared, linear):
    right_members = _members(linear, "bias_orbital:z")
    right = compute_closure(linear, right_members)
    nothing = compute_closure(linear, [])
    wrong = compute_closure(linear, _members(linear, "scale_quadratic:x"))
    assert right.closed > 0.9
    assert right.interval_90[0] < right.closed < right.interval_90[1]
    assert nothing.closed == pytest.approx(0.0, abs=1e-12)
    assert wrong.closed < 0.2
    assert right.floor == pytest.approx(1.0)
    assert set(right.by_interval["interval"]) == {interval.name for interval in prepared.model.recording.intervals}
