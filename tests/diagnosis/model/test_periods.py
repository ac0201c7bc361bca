"""The scan for swings of any period: its products against columns made at once, what its grid loses, and its prior."""

import numpy as np
import pytest

from diagnosis import sinusoids
from diagnosis.inference.evidence import log_bayes
from diagnosis.inference.search import Search
from diagnosis.model import periods
from diagnosis.model.candidates import build_linear_model
from diagnosis.model.linear import SelectedCandidate
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import prepared

BIAS = "bias_periodic:z=0.4,period_s=1307,phase_deg=25"
KINDS = [(False, 2), (True, 0)]


@pytest.fixture(scope="module")
def model():
    return prepared(3).model


@pytest.fixture(scope="module")
def at(model):
    return periods.make_grid(model)


@pytest.fixture(scope="module")
def swinging():
    return prepared(4, BIAS).model


def _chi2(model, columns, y):
    X = model.project_out_nuisance(columns)
    return float(y @ X @ np.linalg.lstsq(X, y, rcond=None)[0])


def test_the_grid_has_all_periods_once_but_the_orbits(model, at):
    span = np.ptp(model.recording.attitudes.t_s)
    assert at.step == pytest.approx(0.25 / span)
    tried = at.tried.ravel()
    np.testing.assert_allclose(np.diff(tried), at.step, rtol=1e-6)
    allowed = np.isfinite(at.log_weight.ravel())
    assert tried[allowed].min() >= 1 / span
    assert 1 / tried[allowed].max() >= 2.5 * 120
    assert np.exp(at.log_weight).sum() == pytest.approx(1.0)
    # Even in the logarithm of the period: the share of an octave is the same anywhere.
    share = [np.exp(at.log_weight)[(at.tried >= f) & (at.tried < 2 * f)].sum() for f in (1e-5, 1.3e-3)]
    assert share[0] == pytest.approx(share[1], rel=0.02)
    for order in (1, 2, 3, 4):
        orbit = order / model.stream.orbit_period_s
        assert np.abs(tried[allowed] - orbit).min() > 0.25 / span
        assert np.abs(tried[allowed] - orbit).min() < 0.75 / span


@pytest.mark.parametrize(("on_references", "axis"), KINDS)
def test_the_scan_scores_as_the_columns_themselves_do(swinging, on_references, axis):
    """Evidence at the best of its scales, from columns that are made for a frequency and projected."""
    at = periods.make_grid(swinging)
    found = periods.compute_wave_products(swinging, at, axis, on_references)
    for j in (3, 40, 120):
        # Exact in the middle; farthest from it, at low frequencies, the curve of a wave over an interval is not quite its own.
        for place, tolerance in ((at.tried.shape[1] // 2, 0.02), (0, 0.06)):
            frequency = at.tried[j, place]
            own = periods.make_period_columns(swinging, axis, on_references, np.array([frequency]))[0]
            X = swinging.project_out_nuisance(own)
            gram = X.T @ X
            scales = np.array(sinusoids.SCALES) / np.sqrt(0.5 * np.trace(gram))
            expected = log_bayes(gram[None], (X.T @ swinging.y)[None], scales).max()
            score = found.compute_log_evidence(np.array([[frequency]]), np.array([j]))[0, 0]
            assert score == pytest.approx(expected, abs=tolerance * abs(expected) + 0.3)


def test_what_lies_between_two_frequencies_keeps_its_chi2(model, at):
    """A swing half a step from the grid loses about 5 % of what it would explain, and one on the finer grid next to nothing."""
    rng = np.random.default_rng(5)
    lost, fine = [], []
    for _ in range(12):
        j, k = rng.integers(10, at.made.size - 10), rng.integers(at.tried.shape[1])
        true = at.tried[j, k] + 0.5 * at.step
        amplitudes = rng.standard_normal(2)
        own = periods.make_period_columns(model, 2, False, true + at.step * np.array([0.0, 0.5, -0.5, 1 / 16]))
        y = model.project_out_nuisance(own[0] @ amplitudes)
        whole = float(y @ y)
        lost.append(1 - max(_chi2(model, own[1], y), _chi2(model, own[2], y)) / whole)
        fine.append(1 - _chi2(model, own[3], y) / whole)
    assert np.mean(lost) < 0.08
    assert max(lost) < 0.16  # two bundles of data at the ends of the span would lose 1 − cos²(π/8)
    assert max(fine) < 0.004


def test_finer_periods_are_around_each_alias_and_share_its_prior(swinging):
    made = build_linear_model(swinging, [EFFECTS["bias_periodic"]], rivals=False)
    k = made.find("bias_periodic:z")
    member = Search(made).optimise_members((SelectedCandidate(k, 0, 0),)).members[0]
    finer = made.refine(made, member)
    before, after = made.candidates[k], finer.candidates[k]
    new = after.options[len(before.options) :]
    assert len(new) % 16 == 0
    shares = np.exp(after.log_weights)
    assert shares[len(before.options) :].sum() == pytest.approx(
        2 * (np.exp(before.log_weights) - shares[: len(before.options)]).sum()
    )
    again = finer.refine(finer, Search(finer).optimise_members((member,)).members[0])
    widths = [
        min(float(option.parameters["period_sigma_s"]) for option in model.candidates[k].options) for model in (finer, again)
    ]
    assert widths[1] < 0.2 * widths[0]
