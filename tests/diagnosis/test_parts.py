"""Reference noise, dead zone, random processes, amplitudes, localization and closure on simulated recordings, with controls."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from diagnosis.detectors.deadzone import dead_zone_evidence
from diagnosis.detectors.samples import examine
from diagnosis.diagnose import diagnose
from diagnosis.inference.amplitudes import fit
from diagnosis.inference.closure import closure, fixed
from diagnosis.inference.search import Search
from diagnosis.model import localization as where
from diagnosis.model.calibration import calibrated
from diagnosis.model.candidates import linear_model
from diagnosis.model.prepare import prepare
from simulator import scenario
from simulator.effects import EFFECTS, parse
from simulator.simulate import simulate


@pytest.fixture(scope="module")
def plan():
    changes = {"gyro.arw_deg_per_sqrt_s": 1.5e-4, "reference.sigma_deg": (0.005, 0.005, 0.008)}
    return scenario.override(scenario.load("trmm_series"), changes)


@pytest.fixture(scope="module")
def prepared(plan):
    return prepare(simulate(plan, seed=21, effects=[parse("bias_orbital:z=0.3,phase_deg=25")]))


@pytest.fixture(scope="module")
def linear(prepared):
    return linear_model(prepared.model, list(EFFECTS.values()))


def _members(linear, *labels):
    """Members at their best options and scales."""
    return Search(linear).of(labels).members


def _strong(linear, label, snr):
    """Response of the middle option of a candidate, of a given signal-to-noise ratio."""
    options = linear.candidates[linear.find(label)].options
    X = linear.X[:, options[len(options) // 2].columns][:, 0]
    return snr * X / np.linalg.norm(X)


@pytest.mark.parametrize(("stated", "axis"), [((1, 1, 1), None), ((1.5, 1.5, 1.5), None), ((1, 1.6, 1), 1)])
def test_reference_noise(plan, stated, axis):
    recording = simulate(plan, seed=22)
    sigma = recording.attitudes.sigma / np.array(stated)
    noise = prepare(replace(recording, attitudes=replace(recording.attitudes, sigma=sigma))).reference_noise
    assert noise.departs == (stated != (1, 1, 1))
    if noise.departs:
        assert noise.axis == axis
        assert np.abs((noise.factor - stated) / noise.sigma).max() < 4


def test_reference_noise_is_blind_to_slow_errors(plan):
    """Second differences leave a drifting bias and a slow reference error out."""
    for text in ("bias_orbital:y=1.0", "reference_orbital:x=0.05", "bias_random_walk:z=1.0"):
        assert not prepare(simulate(plan, seed=23, effects=[parse(text)])).reference_noise.departs


def test_a_noisy_gyro_is_no_noise_of_the_references(plan):
    for seed in (1, 2, 3):
        found = prepare(simulate(plan, seed=seed, effects=[parse("noise_excess:y=3")])).reference_noise
        assert found is not None
        assert not found.departs


def test_a_dead_zone_is_no_noise_of_the_references(plan):
    prepared = prepare(simulate(plan, seed=4, effects=[parse("rate_deadzone:z=9e-4")]))
    assert 2 in [one.axis for one in prepared.dead]
    assert prepared.reference_noise is None or not prepared.reference_noise.departs


def test_the_search_leaves_a_wrong_set_for_the_right_one(linear):
    """Whatever the beam began with: members are taken out and exchanged until nothing is better."""
    right = {"bias_drift:y", "g_matrix_step:x"}
    strong = replace(linear, y=_strong(linear, "bias_drift:y", 35.0) + _strong(linear, "g_matrix_step:x", 35.0))
    search = Search(strong)
    start = search.of(("bias_drift:y", "scale_quadratic:z", "bias_orbital:x"))
    found = {start.key: start}
    search._exchange(found)
    best = max(found.values(), key=lambda explanation: explanation.log_posterior)
    assert {linear.candidates[k].label for k in best.key} == right
    assert best.log_posterior > start.log_posterior + 100


def test_dead_zone_reads_zero_and_m0_does_not(plan):
    for text, found in (("rate_deadzone:x=3e-4", True), ("bias_step:x=0.1,time_s=20000", False)):
        recording = simulate(plan, seed=24, effects=[parse(text)])
        report = examine(recording)
        usual = float(np.deg2rad(1e-4))
        shown = dead_zone_evidence(recording, report.rates, report.noise, usual, usual, report.zones)
        odds = {one.axis: one.log_odds for one in shown}
        assert (odds.get(0, 0.0) > 2) == found


def test_a_gyro_without_bias_is_no_dead_zone(plan):
    """Negative control: raw rates that are zero because there is nothing to read."""
    changes = {"gyro.true_bias_deg_s": (0.0, 0.0, 0.0), "gyro.true_G": np.eye(3).tolist()}
    answer = diagnose(simulate(scenario.override(plan, changes), seed=25))
    assert answer.verdict == "none"  # whatever the samples look like, no rate is missing in the attitude


def test_amplitudes_agree_with_least_squares_and_the_truth(prepared, linear):
    model = prepared.model
    (numbers,) = fit(linear, _members(linear, "bias_orbital:z"))
    X = model.projected(numbers.columns)
    amplitudes = np.linalg.lstsq(X, model.y, rcond=None)[0]
    # At this signal-to-noise ratio the prior shrinks by less than a hundredth.
    assert np.allclose(numbers.amplitudes, amplitudes, rtol=1e-2)
    assert abs(numbers.size - 0.3) < 3.5 * numbers.sigma
    assert abs((float(numbers.parameters["phase_deg"]) - 25 + 180) % 360 - 180) < 8
    covariance = np.linalg.inv(X.T @ X)
    assert np.sqrt(np.diag(covariance)).min() * 0.98 <= numbers.sigma <= np.sqrt(np.diag(covariance)).max() * 1.02


def test_calibration_with_the_effect_in_covers_the_truth(plan, prepared, linear):
    model = prepared.model
    numbers = fit(linear, _members(linear, "bias_orbital:z"))
    truth = np.append(np.ravel(plan.gyro.true_G), np.deg2rad(plan.gyro.true_bias_deg_s))
    nees = {}
    for name, effects in (("with", numbers), ("without", [])):
        change, covariance = calibrated(model, effects)
        error = np.append(model.G.ravel(), model.bias) + change - truth
        nees[name] = error @ np.linalg.solve(covariance[:12, :12], error)
    assert scipy.stats.chi2.sf(nees["with"], 12) > 1e-3
    assert nees["without"] > nees["with"]


def test_statistics_of_m0_have_uniform_p_values(plan):
    p = []
    for seed in (31, 32):
        model = prepare(simulate(plan, seed=seed)).model
        p += where.statistics(model, model.y)["p_value"].tolist()
    assert len(p) > 60
    assert scipy.stats.kstest(p, "uniform").pvalue > 1e-3


def test_where_points_at_the_interval_and_axis(plan):
    """A turn of the references of one interval about one axis, growing with time."""
    recording = simulate(plan, seed=33)
    from scipy.spatial.transform import Rotation

    third = recording.intervals[2]
    t = recording.attitudes.t_s
    inside = (t >= third.start_s) & (t <= third.stop_s)
    angle = np.zeros((t.size, 3))
    angle[inside, 1] = np.deg2rad(0.03) * np.sin((t[inside] - third.start_s) / 700)
    q = (Rotation.from_quat(recording.attitudes.quaternions) * Rotation.from_rotvec(-angle)).as_quat()
    model = prepare(replace(recording, attitudes=replace(recording.attitudes, quaternions=q))).model
    (first, *_) = where.findings(where.statistics(model, model.y))
    assert (first.interval, first.axis) == (third.name, "y")


def test_residuals_in_body_axes_have_the_sigma_they_state(prepared):
    rng = np.random.default_rng(34)
    model = prepared.model
    draws = [where.body_residuals(model, model.projected(rng.standard_normal(model.size))) for _ in range(40)]
    sigma = draws[0][1]
    spread = np.sqrt(np.mean([residual**2 for residual, _ in draws], axis=0))
    kept = sigma > 1e-3 * sigma.max()
    assert np.mean(spread[kept] / sigma[kept]) == pytest.approx(1.0, abs=0.01)


def test_closure_of_the_truth_of_nothing_and_of_a_wrong_effect(prepared, linear):
    right_members = _members(linear, "bias_orbital:z")
    right = closure(linear, right_members, fixed(("bias_orbital:z",)))
    nothing = closure(linear, right_members, lambda search: [])
    wrong = closure(linear, _members(linear, "scale_quadratic:x"), fixed(("scale_quadratic:x",)))
    assert right.closed > 0.9
    assert right.interval_90[0] < right.closed < right.interval_90[1]
    assert nothing.closed == pytest.approx(0.0, abs=1e-12)
    assert wrong.closed < 0.2
    assert right.floor == pytest.approx(1.0)
    assert set(right.by_interval["interval"]) == {interval.name for interval in prepared.model.recording.intervals}


def test_closure_before_is_at_the_floor_for_m0(plan):
    values = []
    for seed in (35, 36, 37):
        model = prepare(simulate(plan, seed=seed)).model
        linear = linear_model(model, [EFFECTS["bias_drift"]], rivals=False)
        values.append(closure(linear, _members(linear, "bias_drift:x"), lambda search: []).before)
    assert abs(np.mean(values) - 1.0) < 4 * np.sqrt(2 / (3 * model.size))
