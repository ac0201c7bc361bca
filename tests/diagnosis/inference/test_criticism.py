"""Checks of what a named explanation leaves: they pass data of the named model, and see what is beside it."""

import numpy as np
import pytest
import scipy.stats

from diagnosis.inference import criticism
from diagnosis.inference.criticism import Innovations, Layout, check_innovations, combine_checks
from diagnosis.model.linear import SelectedCandidate
from tests.diagnosis.linear_models import linear_model

INTERVALS, EACH = 4, 30
ROWS = INTERVALS * EACH
SINCE_S = np.tile(60.0 * np.arange(EACH), INTERVALS)
T_S = SINCE_S + 8000.0 * np.repeat(np.arange(INTERVALS), EACH)
MEMBERS = (SelectedCandidate(0, 0, 6), SelectedCandidate(1, 0, 2))


@pytest.fixture(scope="module")
def layout():
    rng = np.random.default_rng(1)
    interval = np.repeat(np.arange(INTERVALS), EACH)
    rates = rng.standard_normal((ROWS, 3))
    axes = np.linalg.qr(rng.standard_normal((ROWS, 3, 3)))[0]
    regressors = np.column_stack([rates, np.abs(rates), T_S / T_S.max()])
    return Layout(axes, interval, regressors, np.linalg.norm(rates, axis=1))


@pytest.fixture(scope="module")
def model():
    """A drift and a random process that are named, and nuisance parameters."""
    rng = np.random.default_rng(2)
    drift = np.repeat(np.linspace(-1, 1, ROWS), 3)[:, None]
    wander = np.cumsum(rng.standard_normal((3 * ROWS, 20)), axis=0) / 30
    return linear_model([drift, wander], np.zeros(3 * ROWS), rng.standard_normal((3 * ROWS, 12)))


def drawn(model, rng, count):
    """Observations of the named model, (N, count)."""
    C = np.hstack([model.scale(m) * model.X[:, model.option(m).columns] for m in MEMBERS])
    return model.projected(rng.standard_normal((model.y.size, count))) + C @ rng.standard_normal((C.shape[1], count))


def whiten(model, layout, y):
    """Innovations (ROWS, 3, d) of observations (N, d) of the named model along the body axes, and their missing directions."""
    C = np.hstack([model.scale(m) * model.X[:, model.option(m).columns] for m in MEMBERS])
    L = np.linalg.cholesky(np.eye(model.y.size) + C @ C.T)
    trial = np.random.default_rng(0).standard_normal((model.y.size, model.y.size - model.dof))
    nuisance = np.linalg.qr(trial - model.projected(trial))[0]
    white = np.linalg.solve(L, np.hstack([y, nuisance])).reshape(ROWS, 3, -1)
    body = np.matmul(layout.axes, white)
    return body[:, :, : y.shape[1]], body[:, :, y.shape[1] :]


def checked(model, layout, y):
    e, basis = whiten(model, layout, y[:, None])
    return {one.name: one for one in check_innovations(Innovations(e[:, :, 0], basis), layout)}


def along_body(layout, values):
    """Observations (3 r,) of values (r, 3) along the body axes."""
    return np.einsum("rba,rb->ra", layout.axes, values).ravel()


LEVELS = (0.05, 0.01, 1e-3)
DATA = 500


@pytest.fixture(scope="module")
def p_values(model, layout):
    """P-values of all tests (DATA, tests), of data of the named model."""
    y = drawn(model, np.random.default_rng(4), DATA)
    e, basis = whiten(model, layout, y)
    return np.array([[one.p_value for one in check_innovations(Innovations(e[:, :, k], basis), layout)] for k in range(DATA)])


def test_data_of_the_named_model_are_rejected_at_the_stated_rate(p_values):
    """Each test, and all of them with the allowance for their number."""
    for level in LEVELS:
        error = 4 * np.sqrt(level / DATA)
        assert (np.mean(p_values < level, axis=0) < 1.2 * level + error).all()
        together = np.mean(p_values.min(axis=1) * p_values.shape[1] < level)
        assert 0.4 * level - error < together < level + error


def beside(layout, kind):
    """Something of two sigma or so beside the named effects, (3 r,)."""
    values = np.zeros((ROWS, 3))
    if kind == "step":
        values[:, 2] = 3.0 * (T_S > 10_000)
    elif kind == "rate":
        values[:, 1] = 1.2 * layout.regressors[:, 0]
    return along_body(layout, values)


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("step", "correlation in time"),
        ("rate", "dependence on what is known"),
    ],
)
def test_what_is_beside_the_named_effects_is_seen_for_what_it_is(model, layout, kind, name):
    y = drawn(model, np.random.default_rng(6), 1)[:, 0]
    assert combine_checks(list(checked(model, layout, y).values())) > 1e-3
    found = checked(model, layout, y + model.projected(beside(layout, kind)))
    assert combine_checks(list(found.values())) < 1e-5
    assert found[name].p_value < 1e-6
    assert found[name].value > found[name].expected


def test_single_large_residuals_are_seen_by_the_shape(model, layout):
    y = drawn(model, np.random.default_rng(8), 1)[:, 0]
    odd = np.zeros(3 * ROWS)
    odd[[40, 200]] = 9.0
    found = checked(model, layout, y + model.projected(odd))
    assert found["shape"].p_value < 1e-6


@pytest.mark.parametrize("draw", ["standard_normal", "uniform", "laplace"])
def test_kurtosis_and_its_p_value_are_those_of_scipy(draw):
    x = getattr(np.random.default_rng(41), draw)(size=300)
    kurtosis, p = criticism.compute_kurtosis(x)
    assert kurtosis == pytest.approx(scipy.stats.kurtosis(x, fisher=False))
    assert p == pytest.approx(scipy.stats.kurtosistest(x).pvalue)
