"""Where a recording departs from M0: p-values under M0, and a discrepancy put at one place."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from scipy.spatial.transform import Rotation

from diagnosis.model import linearise
from diagnosis.model.localization import compute_body_residuals, compute_statistics, list_findings
from diagnosis.model.prepare import prepare
from tests.diagnosis.recordings import prepared, recorded


def test_statistics_of_m0_have_uniform_p_values():
    p = []
    for seed in range(3):
        model = prepared(seed).model
        p += compute_statistics(model)["p_value"].tolist()
    assert len(p) > 100
    assert scipy.stats.kstest(p, "uniform").pvalue > 1e-3


@pytest.fixture(scope="module")
def turned():
    """A turn of the references of the third interval about y, growing and shrinking with time."""
    recording = recorded(33)
    third = recording.intervals[2]
    t = recording.attitudes.t_s
    inside = (t >= third.start_s) & (t <= third.stop_s)
    angle = np.zeros((t.size, 3))
    angle[inside, 1] = np.deg2rad(0.03) * np.sin((t[inside] - third.start_s) / 700)
    q = (Rotation.from_quat(recording.attitudes.quaternions) * Rotation.from_rotvec(-angle)).as_quat()
    return replace(recording, attitudes=replace(recording.attitudes, quaternions=q)), angle


def test_findings_and_residuals_show_the_error_at_its_place_with_its_sign(turned):
    recording, _ = turned
    model = prepare(recording).model
    found = list_findings(compute_statistics(model))
    assert (found[0].interval, found[0].axis) == (recording.intervals[2].name, "y")
    assert found[0].signal == "attitude"
    assert 0 <= found[0].window_s[0] < found[0].window_s[1] <= recording.intervals[2].stop_s - recording.intervals[2].start_s
    assert found[0].p_value < 1e-6
    assert [one.p_value for one in found] == sorted(one.p_value for one in found)
    # θ of N (16) at a reference that is turned by e is e, but for what the calibration takes up.
    recording, angle = turned
    model = prepare(recording).model
    residual, _ = compute_body_residuals(model, model.y)
    own = model.observation_block == 2
    expected = angle[model.reference_rows][own, 1]
    assert np.corrcoef(residual[own, 1], expected)[0, 1] > 0.7
    assert np.polyfit(expected, residual[own, 1], 1)[0] == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize("averaged", [False, True])
def test_residuals_in_body_axes_have_the_sigma_they_state(averaged, monkeypatch):
    if averaged:
        monkeypatch.setattr(linearise, "MOST_OBSERVATIONS", 70)
    rng = np.random.default_rng(34)
    model = prepare(recorded(3)).model
    draws = [compute_body_residuals(model, model.project_out_nuisance(rng.standard_normal(model.size))) for _ in range(40)]
    sigma = draws[0][1]
    assert sigma.shape == (len(model.observation_t_s), 3)
    spread = np.sqrt(np.mean([residual**2 for residual, _ in draws], axis=0))
    kept = sigma > 1e-3 * sigma.max()
    assert np.mean(spread[kept] / sigma[kept]) == pytest.approx(1.0, abs=0.02)
