"""Random processes against their covariances, drawn errors and the simulator."""

import numpy as np
import pytest
import scipy.stats

from diagnosis.model import linearise, process_projection, processes
from diagnosis.model.process_projection import ProcessProjection, split_cells
from diagnosis.model.processes import build_all_columns, build_usual_columns, list_process_places, markov
from simulator.effects import EFFECTS, ProcessTimes
from tests.diagnosis.recordings import of_rates, prepared, recorded


@pytest.fixture(scope="module")
def model():
    return prepared(3).model


def test_flicker_has_a_flat_allan_variance_at_its_floor():
    """Allan variance of the kernel at cluster times inside its range: 2 ln 2/π B², IEEE Std 952."""
    step = 20.0
    t = step * np.arange(800)
    at = ProcessTimes(t, t, np.zeros(t.size, dtype=np.intp))
    K = EFFECTS["noise_flicker"].covariance(at, {}) / np.deg2rad(1 / 3600) ** 2
    for clusters in (25, 60, 150):
        weight = np.zeros(800)
        weight[:clusters], weight[clusters : 2 * clusters] = -1 / clusters, 1 / clusters
        assert 0.5 * weight @ K @ weight == pytest.approx(2 * np.log(2) / np.pi, rel=0.15)


def test_all_columns_of_a_process_are_its_covariance():
    """C K Cᵀ of any columns, a covariance that has a null space, and directions that nuisance parameters hide."""
    rng = np.random.default_rng(1)
    C = rng.standard_normal((40, 12))
    hidden = np.linalg.qr(rng.standard_normal((40, 3)))[0]
    projected = lambda columns: columns - hidden @ (hidden.T @ columns)  # noqa: E731
    half = rng.standard_normal((12, 5))
    K = half @ half.T
    place = ProcessProjection.build_projection(C, C.T @ projected(C))
    X = projected(build_all_columns(place, K, 0.0))
    np.testing.assert_allclose(X @ X.T, projected(C) @ K @ projected(C).T, atol=1e-10)
    assert X.shape[1] == 5
    assert np.allclose(X.T @ X, np.diag(np.sum(X**2, axis=0)), atol=1e-9)
    powers = np.sum(X**2, axis=0)
    assert build_all_columns(place, K, 0.5 * (powers[1] + powers[2])).shape[1] == 2
    assert build_all_columns(place, K, 2 * powers[0]).shape[1] == 1  # one at least
    assert build_all_columns(place, np.zeros((12, 12))).shape[1] == build_usual_columns(place, np.zeros((12, 12))).shape[1] == 0


@pytest.mark.parametrize(
    ("name", "size", "trial", "share"),
    # Flicker noise goes on below the length of a cell, where the covariance takes it for constant: a tenth of its power.
    [("noise_flicker", 0.3, 0, 0.15), ("reference_correlated", 0.01, 2, 0.0)],
)
def test_a_simulated_process_has_the_power_of_its_columns(name, size, trial, share):
    """Whole simulations with the process on one axis: along its columns the variance is one plus theirs."""
    effect = EFFECTS[name]
    parameters = effect.trials(prepared(3).model.surroundings)[trial].parameters
    text = ",".join([f"{name}:y={size}", *(f"{key}={value}" for key, value in parameters.items())])
    total, dof = 0.0, 0
    for seed in range(2):
        model = prepared(seed, text).model
        covariance, places = list_process_places(model, effect)
        C = size * model.project_out_nuisance(build_usual_columns(places[1], covariance(parameters)))
        d = np.sum(C**2, axis=0)
        z = (C / np.sqrt(d)).T @ model.y
        total += np.sum(z**2 / (1 + d))
        dof += d.size
    assert scipy.stats.chi2.sf(total / (1 + share), dof) > 1e-3
    assert scipy.stats.chi2.cdf(total, dof) > 1e-3


def test_a_process_of_averaged_references_is_that_of_every_reference(monkeypatch):
    """Covariance of the observations against that of the errors of all references; of one that is fast it is much smaller."""
    recording = recorded(3)
    monkeypatch.setattr(linearise, "MOST_OBSERVATIONS", recording.attitudes.t_s.size // 4)
    model = linearise.linearise_recording(recording, np.eye(3), np.zeros(3))
    every, nodes_s = model.references.t_s, processes.compute_node_times(model).t_s
    for axis in range(3):
        error = np.zeros((every.size, 3, every.size))
        error[:, axis] = np.eye(every.size)
        unit, place = model.whiten_and_project(model.observe_reference_error(error)), model.reference_places[axis]
        size = {}
        for tau in (100.0, 1e5):
            expected = unit @ markov(every, tau) @ unit.T
            columns = model.project_out_nuisance(place.columns)
            found = columns @ place.covariance(markov(nodes_s, tau)) @ columns.T
            assert np.linalg.norm(found - expected) < 0.03 * np.linalg.norm(expected)
            size[tau] = np.mean(np.diag(place.covariance(markov(nodes_s, tau))))
        assert size[100.0] < 0.7 * size[1e5]


def test_an_error_that_changes_within_a_cell_of_a_spinning_body_has_its_covariance(monkeypatch):
    """Two turns a cell and a process that forgets within it: what a level in each cell would show is another thing."""
    monkeypatch.setattr(process_projection, "PARTS", 12)
    t_s = np.arange(2000) * 0.5
    rates = np.zeros((t_s.size, 3))
    rates[:, 2] = 2 * np.pi / 5.0
    recording = of_rates(rates, 100, 0.5, 1e-6, 1e-4, 1)
    model = linearise.linearise_recording(recording, np.eye(3), np.zeros(3))
    tau, steps = 5.0, 1000
    own = slice(0, steps)
    error = np.zeros((model.t_s.size, 3, steps))
    error[np.arange(steps), 0, np.arange(steps)] = 1.0
    unit = model.whiten(model.observe_rate_error(error))
    expected = unit @ markov(model.t_s[own], tau) @ unit.T
    first, _ = split_cells(model)
    inside = first < steps
    place = model.cell_places[0]
    K = place.covariance(markov(processes.compute_part_times(model).t_s, tau) * np.outer(inside, inside))
    assert np.linalg.norm(place.columns @ K @ place.columns.T - expected) < 0.05 * np.linalg.norm(expected)
    cells = model.cells
    early = cells.first < steps
    level = model.cell_columns[0] @ (markov(cells.t_s, tau) * np.outer(early, early)) @ model.cell_columns[0].T
    assert np.linalg.norm(level - expected) > 0.3 * np.linalg.norm(expected)
