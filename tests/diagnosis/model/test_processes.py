"""Random processes against their covariances, drawn errors and the simulator."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from diagnosis.model import linearise, processes
from diagnosis.model.groups import process_groups
from diagnosis.model.processes import factor, markov, same
from simulator.effects import EFFECTS, ProcessTimes
from tests.diagnosis.recordings import linear, of_rates, prepared, recorded


@pytest.fixture(scope="module")
def model():
    return prepared(3).model


def test_kernels_by_their_definitions(model):
    t = np.linspace(0, 5000, 60)
    assert np.allclose(markov(t, 700.0)[3, 9], np.exp(-(t[9] - t[3]) / 700))
    np.testing.assert_array_equal(same(np.array([0, 1, 1])), [[1, 0, 0], [0, 1, 1], [0, 1, 1]])
    at = processes.cell_times(model)
    K = EFFECTS["bias_random_walk"].covariance(at, {"gaps": "hold"})
    hours = (at.run_s - at.run_s.min()) / 3600
    assert np.allclose(np.diag(K), hours * np.deg2rad(1 / 3600) ** 2)
    F = factor(K)
    assert np.allclose(F @ F.T, K, atol=1e-6 * K.max())


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


def strongest(U, K):
    """Covariance U K Uᵀ of the observations by its strongest directions, which have nearly all information; and all of it."""
    whole = U @ K @ U.T
    values, vectors = np.linalg.eigh(whole)
    order = np.argsort(-values)
    share = np.cumsum(values[order] ** 2) / np.sum(values**2)
    kept = order[: max(int(np.searchsorted(share, processes.INFORMATION)) + 1, processes.USUAL_COLUMNS)]
    return (vectors[:, kept] * values[kept]) @ vectors[:, kept].T, whole


@pytest.mark.parametrize(("tau", "least"), [(800.0, 0.8), (6000.0, 0.95)])
def test_columns_of_a_process_are_orthogonal_and_the_strongest_of_its_covariance(model, tau, least):
    """C Cᵀ of the projected columns against that of the cells' own columns and covariance."""
    at = processes.cell_times(model)
    K = markov(at.t_s, tau) * same(at.interval) * np.deg2rad(1e-4) ** 2
    for axis in range(3):
        C = model.projected(processes.on_cells(model, axis, factor(K)))
        gram = C.T @ C
        assert np.abs(gram - np.diag(np.diag(gram))).max() < 1e-6 * gram.max()
        assert (np.diff(np.diag(gram)) <= 1e-9 * gram.max()).all()
        expected, whole = strongest(model.projected(model.cell_columns[axis]), K)
        assert np.abs(C @ C.T - expected).max() < 1e-3 * np.abs(whole).max()
        assert np.trace(gram) > least * np.trace(whole)


def test_a_process_of_references_is_the_same_of_their_errors(model):
    at = processes.reference_times(model)
    assert at.t_s.size == len(model.observation_t_s)
    assert (np.diff(at.run_s) >= 0).all()
    K = markov(at.t_s, 1500.0) * np.deg2rad(0.01) ** 2
    C = model.projected(processes.on_references(model, 1, factor(K)))
    expected, whole = strongest(model.projected(model.reference_columns[1]), K)
    assert np.abs(C @ C.T - expected).max() < 1e-3 * np.abs(whole).max()


@pytest.mark.parametrize(
    ("name", "size", "trial", "share"),
    # Flicker noise goes on below the length of a cell, where the covariance takes it for constant: a tenth of its power.
    [("bias_random_walk", 0.5, 0, 0.0), ("noise_flicker", 0.3, 0, 0.15), ("reference_correlated", 0.01, 2, 0.0)],
)
def test_a_simulated_process_has_the_power_of_its_columns(name, size, trial, share):
    """Whole simulations with the process on one axis: along its columns the variance is one plus theirs."""
    effect = EFFECTS[name]
    parameters = effect.trials(prepared(3).model.around)[trial].parameters
    text = ",".join([f"{name}:y={size}", *(f"{key}={value}" for key, value in parameters.items())])
    total, dof = 0.0, 0
    for seed in range(6):
        model = prepared(seed, text).model
        group = next(one for one in process_groups(model, effect, model.around) if one.axis == "y")
        C = size * model.projected(group.columns[trial])
        d = np.sum(C**2, axis=0)
        z = (C / np.sqrt(d)).T @ model.y
        total += np.sum(z**2 / (1 + d))
        dof += d.size
    assert scipy.stats.chi2.sf(total / (1 + share), dof) > 1e-3
    assert scipy.stats.chi2.cdf(total, dof) > 1e-3


def test_unlisted_processes_are_about_each_axis_and_can_be_seen():
    made = linear(3)
    names = {candidate.effect for candidate in made.candidates if candidate.process and not candidate.listed}
    assert len(names) >= 4
    for name in names:
        assert {c.axis for c in made.candidates if c.effect == name} == set("xyz")


def test_a_rival_is_no_process_that_is_on_the_list(model):
    """Of any size; the others stay."""
    at, longest = processes.cell_times(model), max(float(block.elapsed_s[-1]) for block in model.blocks)
    name = "random bias, correlated in time"
    known = [7.0 * same(at.interval) * markov(at.t_s, longest / share) for share in (20, 6)]
    count = {one.name: len(one.columns) for one in processes.unlisted(model)}
    left = {one.name: len(one.columns) for one in processes.unlisted(model, known)}
    assert (count[name], left[name]) == (3, 1)
    assert {key: left[key] for key in left if key != name} == {key: count[key] for key in count if key != name}
    assert name not in {
        one.name for one in processes.unlisted(model, [*known, same(at.interval) * markov(at.t_s, longest / 60)])
    }


def test_cells_of_a_coarse_recording_stay_few():
    """Cells cost the cube of their number: references every 10 s make no more than those every two minutes."""
    few, many = prepared(3).model, prepared(3, every_s=10.0).model
    assert recorded(3, every_s=10.0).attitudes.t_s.size > 10 * recorded(3).attitudes.t_s.size
    assert many.cells.first.size < 3 * few.cells.first.size


def test_a_process_of_averaged_references_has_the_covariance_of_averages(monkeypatch):
    """Against the mean over all pairs of references of two observations; at the times of the averages it would be too large."""
    recording = recorded(3)
    monkeypatch.setattr(linearise, "MOST_OBSERVATIONS", recording.attitudes.t_s.size // 4)
    model = linearise.linearised(recording, np.eye(3), np.zeros(3))
    nodes, first = processes.reference_nodes(model)
    found = processes.averaged(markov(nodes.run_s, 300.0), first)
    every = model.references.t_s
    rows = model.reference_rows_of_observations - np.concatenate([block.counts for block in model.blocks]) // 2
    whole = processes.averaged(markov(every, 300.0), rows)
    own = model.observation_block
    within = own[:, None] == own
    assert found.shape == (len(model.observation_t_s),) * 2
    np.testing.assert_allclose(found[within], whole[within], atol=0.02)
    assert np.diag(found).max() <= 1 + 1e-12
    assert np.median(np.diag(found)) < 0.8


def test_a_walk_goes_on_only_over_gaps_that_leave_it_a_walk():
    """Over days between intervals of an hour all that would be seen of it are levels, each its own."""
    around = prepared(3).model.around
    walk = EFFECTS["bias_random_walk"]
    stream = around.stream
    closer = np.concatenate([stream.t_s[part] - stream.t_s[part][0] for part in stream.intervals])
    closer += np.concatenate([np.full(part.stop - part.start, 2e4 * k) for k, part in enumerate(stream.intervals)])
    near = replace(around, stream=replace(stream, t_s=closer))
    for found, gaps in ((around, {"hold", "reset"}), (near, {"hold", "grow", "reset"})):
        trials = walk.trials(found)
        assert {trial.parameters["gaps"] for trial in trials} == gaps
        assert sum(trial.weight for trial in trials) == pytest.approx(1.0)


def test_errors_of_averaged_references_are_about_the_axes_of_each(monkeypatch):
    """Columns of the nodes against the error of the residuals that those of single references make."""
    recording = recorded(3, every_s=30.0)
    monkeypatch.setattr(linearise, "MOST_OBSERVATIONS", recording.attitudes.t_s.size // 3)
    model = linearise.linearised(recording, np.eye(3), np.zeros(3))
    rows, _ = model.nodes
    assert max(block.counts.max() for block in model.blocks) == 3
    sizes = np.random.default_rng(2).standard_normal(rows.size)
    for axis in range(3):
        error = np.zeros((len(model.at_reference), 3, 1))
        error[rows, axis, 0] = sizes
        expected = model.whitened(model.reference_error(error)[:, 0])
        np.testing.assert_allclose(model.node_columns[axis] @ sizes, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(("turn_deg", "turns"), [(0.0, False), (4.0, False), (20.0, True)])
def test_turns_between_averaged_references_are_seen(turn_deg, turns, monkeypatch):
    t_s = 0.5 * np.arange(1200)
    recording = of_rates(np.deg2rad(turn_deg / 4.0) * np.ones((t_s.size, 3)) / np.sqrt(3), 8, 0.5, 1e-5, 1e-4, 1)
    monkeypatch.setattr(linearise, "MOST_OBSERVATIONS", recording.attitudes.t_s.size // 2)
    assert linearise.linearised(recording, np.eye(3), np.zeros(3)).turns_in_observations == turns
