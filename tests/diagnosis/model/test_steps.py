"""Steps that are looked for over the whole recording."""

import numpy as np
import pytest

from diagnosis.model.candidates import build_linear_model
from diagnosis.model.linear import SelectedCandidate
from diagnosis.model.steps import FINE_STEP_TIMES, MOST_MOMENTS, ResidualProducts, add_step_times
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import prepared

BIAS, SCALE = EFFECTS["bias_step"], EFFECTS["g_matrix_step"]


@pytest.fixture(scope="module")
def stepped():
    """A step of G between the times that are tried, and its linear model."""
    one = prepared(11, "g_matrix_step:y=3000,toward=y,time_s=21456")
    return one.model, build_linear_model(one.model, [BIAS, SCALE], rivals=False)


def test_a_likelihood_ratio_is_that_of_the_dense_covariance(stepped):
    _, linear = stepped
    first = linear.find("bias_step:x")
    members = (SelectedCandidate(first, 1, 2), SelectedCandidate(linear.find("bias_step:z"), 3, 1))
    places, scales, _ = linear.build_design(members)
    C = linear.X[:, places] * scales
    S = np.eye(len(linear.y)) + C @ C.T
    X = linear.X[:, :3] + linear.X[:, 3:6]
    solved = np.linalg.solve(S, X)
    expected = (solved.T @ linear.y) ** 2 / (2 * np.einsum("nk,nk->k", X, solved))
    np.testing.assert_allclose(ResidualProducts(linear, members).log_ratio(X), expected, rtol=1e-8)


def test_the_moment_between_two_that_are_tried_is_found(stepped):
    model, linear = stepped
    place = linear.find("g_matrix_step:y")
    finer = add_step_times(model, linear, {one.name: one for one in (BIAS, SCALE)}, [((), 20.0)])
    more = finer.candidates[place].options[len(linear.candidates[place].options) :]
    best = max(more, key=lambda one: abs(finer.X[:, one.start] @ finer.y) / np.linalg.norm(finer.X[:, one.start]))
    assert best.parameters["toward"] == "y"
    assert abs(best.parameters["time_s"] - 21456) < 60  # half of the spacing of the references
    assert abs(finer.X[:, best.start] @ finer.y) > 0.99 * max(
        abs(finer.X[:, k] @ finer.y) / np.linalg.norm(finer.X[:, k]) for k in range(finer.X.shape[1])
    ) * np.linalg.norm(finer.X[:, best.start])
    # The prior of the step as a whole stays what it was, and no candidate grows without bound.
    for one, other in zip(linear.candidates, finer.candidates, strict=True):
        assert np.exp(other.log_weights).sum() == pytest.approx(np.exp(one.log_weights).sum())
        assert len(other.options) <= len(one.options) + MOST_MOMENTS * FINE_STEP_TIMES
