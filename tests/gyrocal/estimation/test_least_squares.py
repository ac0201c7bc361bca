"""The banded and the plain solution against dense algebra with the walk's covariance written out."""

import numpy as np
import pytest

from gyrocal.estimation.least_squares import ExactLeastSquares, PlainLeastSquares, Rows

NODES, ROWS, P = 12, 60, 5


@pytest.fixture(scope="module")
def system():
    rng = np.random.default_rng(2)
    rows = Rows(
        np.sort(np.append(rng.integers(0, NODES, ROWS - NODES), np.arange(NODES))),
        30 * rng.normal(size=(ROWS, 3)),
        rng.normal(size=(ROWS, P)) * np.array([1e3, 1e3, 1e3, 10, 10]),
        rng.normal(size=ROWS),
    )
    return rows, rng.uniform(0.01, 0.05, NODES - 1), rng.normal(size=(NODES, 3, 3))


def steps_to(node, count):
    """(3, 3(N − 1)) sum of the increments before a node."""
    return np.kron(np.arange(count - 1) < node, np.eye(3))


def dense(rows, q):
    """Design X, walk B per unit increment, and V of the residuals."""
    X = np.hstack([rows.attitude, rows.parameters])
    B = np.stack([rows.attitude[i] @ steps_to(rows.node[i], NODES) for i in range(ROWS)])
    return X, B, np.eye(ROWS) + (B * np.repeat(q, 3) ** 2) @ B.T


def wanted_maps(maps, nodes):
    """What epoch and parameters, and the increments, contribute to δ and the wanted attitudes."""
    T = np.vstack(
        [np.hstack([np.zeros((P, 3)), np.eye(P)])] + [np.hstack([np.eye(3), -maps[n], np.zeros((3, P - 3))]) for n in nodes]
    )
    E = np.vstack([np.zeros((P, 3 * (NODES - 1)))] + [steps_to(n, NODES) for n in nodes])
    return T, E


def joint(influence, q):
    flat = (influence.walk * q[:, None, None]).transpose(1, 0, 2).reshape(len(influence.measurements), -1)
    return influence.measurements @ influence.measurements.T + flat @ flat.T


def test_plain_errors_are_the_sandwich(system):
    rows, q, maps = system
    nodes = np.array([0, 4, 11])
    X, B, _ = dense(rows, q)
    T, E = wanted_maps(maps, nodes)
    gain = np.linalg.solve(X.T @ X, X.T)
    solver = PlainLeastSquares(rows, NODES)
    influence = solver.compute_influence(nodes, maps[nodes])
    np.testing.assert_allclose(influence.measurements, -T @ gain, atol=1e-12)
    np.testing.assert_allclose(influence.walk.transpose(1, 0, 2).reshape(len(T), -1), E - T @ gain @ B, atol=1e-10)
    gamma, delta, length = solver.step()
    np.testing.assert_allclose(np.concatenate([gamma[5], delta]), gain @ rows.z, rtol=1e-10)
    assert length == pytest.approx(np.sqrt(rows.z @ X @ gain @ rows.z))


def test_exact_is_generalised_least_squares_and_kriging(system):
    rows, q, maps = system
    nodes = np.array([0, 4, 11])
    X, B, V = dense(rows, q)
    T, E = wanted_maps(maps, nodes)
    W = np.linalg.inv(V)
    information = X.T @ W @ X
    estimate = np.linalg.solve(information, X.T @ W @ rows.z)
    walk = (B * np.repeat(q, 3) ** 2).T @ W @ (rows.z - X @ estimate)
    solver = ExactLeastSquares(rows, q, np.zeros((NODES - 1, 3)))
    gamma, delta, length = solver.step()
    np.testing.assert_allclose(delta, estimate[3:], rtol=1e-9)
    for node in range(NODES):
        np.testing.assert_allclose(gamma[node], estimate[:3] + steps_to(node, NODES) @ walk, atol=1e-12)
    # Covariance of the best linear unbiased prediction.
    S = np.diag(np.repeat(q, 3) ** 2)
    K = np.linalg.solve(information, X.T @ W)
    to_z = T @ K + E @ S @ B.T @ W @ (np.eye(ROWS) - X @ K)
    expected = to_z @ V @ to_z.T - to_z @ B @ S @ E.T - (to_z @ B @ S @ E.T).T + E @ S @ E.T
    influence = solver.compute_influence(nodes, maps[nodes])
    np.testing.assert_allclose(influence.measurements, -to_z, atol=1e-9)
    np.testing.assert_allclose(joint(influence, q), expected, rtol=1e-7, atol=1e-12)
    assert length > 0
