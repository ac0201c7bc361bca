"""The null distribution of the attitude test against recordings without an effect, whose noise is known sample by sample."""

import numpy as np
import pytest
import scipy.stats
from scipy.spatial.transform import Rotation

from diagnosis.inference.null import extrapolate_tail
from diagnosis.inference.search import Search
from diagnosis.model import linearise
from diagnosis.model.candidates import build_linear_model
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.prepare import prepare
from simulator import scenario
from simulator.effects import EFFECTS
from simulator.simulate import simulate

NAMES = ("bias_drift", "bias_step", "scale_quadratic", "reference_correlated")
# The gyro's noise turns the propagated attitude by two to four degrees, of which first order is not enough.
PLAN = scenario.override(
    scenario.load("trmm_series"),
    {
        "gyro.arw_deg_per_sqrt_s": 0.02,
        "reference.sigma_deg": (0.15, 0.15, 0.15),
        "gyro.sample_s": 8.0,
        "reference.every_s": 120.0,
    },
)
G, BIAS = np.array(PLAN.gyro.true_G), np.deg2rad(PLAN.gyro.true_bias_deg_s)


@pytest.fixture(scope="module")
def quiet():
    return simulate(PLAN, noise=False)


@pytest.fixture(params=[1, 3], ids=["each", "means of three"])
def truth(quiet, request, monkeypatch):
    """The model of the motion as it was; of each sample and reference, or of steps and observations of three."""
    if request.param > 1:
        monkeypatch.setattr(linearise, "MOST_STEPS", quiet.gyro.t_s.size // request.param + 1)
        monkeypatch.setattr(linearise, "MOST_OBSERVATIONS", quiet.attitudes.t_s.size // request.param + 1)
    made = linearise_recording(quiet, G, BIAS)
    assert made.size < 4 * quiet.attitudes.t_s.size / request.param + 30
    return made


def _search(model):
    return Search(build_linear_model(model, [EFFECTS[name] for name in NAMES], rivals=False, scan=False))


def _statistic(search, y):
    return search.compute_null_statistic(search.model.X.T @ y.reshape(len(y), -1))


def test_the_statistic_is_that_of_the_linear_response_to_the_noise_about_the_true_motion(quiet, truth):
    """What is of second order, and the noise in the columns, move it by next to nothing of its scatter, which is 0.6."""
    recording = simulate(PLAN, seed=23)
    model = prepare(recording).model
    assert np.rad2deg(np.abs(model.residuals).max()) > 2
    # Raw rates of the model are the means, over its steps, of what is given it as smooth.
    readings = linearise_recording(quiet, G, BIAS, smooth=recording.gyro.rates - quiet.gyro.rates).raw
    turned = Rotation.from_quat(recording.attitudes.quaternions).inv() * Rotation.from_quat(quiet.attitudes.quaternions)
    errors = turned.as_rotvec()[truth.reference_rows]
    y = truth.whiten_and_project(truth.reading(readings[:, :, None]) + truth.observe_reference_error(errors[:, :, None]))[:, 0]
    assert np.linalg.norm(truth.project_out_nuisance(model.y) - y) < 0.2  # no score of any column moves by more, in sigma
    assert abs(_statistic(_search(model), model.y)[0] - _statistic(_search(truth), y)[0]) < 0.03


def test_noise_drawn_sample_by_sample_has_the_null_distribution(quiet, truth):
    count, rng, sigma = 300, np.random.default_rng(24), quiet.attitudes.sigma[truth.reference_rows]
    rates = rng.standard_normal((*truth.raw.shape, count)) * (quiet.gyro.arw / np.sqrt(truth.dt))[:, None, None]
    readings = np.einsum("ij,njk->nik", np.linalg.inv(G), rates)
    errors = rng.standard_normal((*sigma.shape, count)) * sigma[:, :, None]
    search = _search(truth)
    noisy = _statistic(search, truth.whiten_and_project(truth.reading(readings) + truth.observe_reference_error(errors)))
    null = _statistic(search, truth.project_out_nuisance(rng.standard_normal((truth.size, count))))
    assert scipy.stats.ks_2samp(noisy, null).pvalue > 1e-3
    assert scipy.stats.binomtest(int(np.sum(noisy > np.quantile(null, 0.95))), count, 0.05).pvalue > 1e-3


def test_the_p_value_of_the_tail_is_uniform_under_m0():
    """The statistic is the log of an average of likelihood ratios, of forty columns here."""
    rng = np.random.default_rng(26)
    drawn = np.sort(np.log(np.mean(np.exp(0.48 * rng.standard_normal((100_000, 40)) ** 2), axis=1)))
    p = np.array([extrapolate_tail(rng.choice(drawn, 1060), x) for x in rng.choice(drawn, 6000)])
    for level in (0.01, 0.002):
        assert scipy.stats.binomtest(int(np.sum(p < level)), p.size, level).pvalue > 1e-3
