"""Steps at each place of a recording, and a state that no random process may be named for."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.diagnose import diagnose
from diagnosis.model.jumps import place_weights, step_columns
from diagnosis.model.steps import switched_columns
from gyrocal.recording import Recording
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import prepared, recorded


@pytest.fixture(scope="module")
def model():
    return prepared(11).model


def test_a_step_at_a_cell_is_the_step_of_the_bias_from_there_on(model):
    effect, deg_h = EFFECTS["bias_step"], np.deg2rad(1.0) / 3600
    steps = step_columns(model, 1, on_references=False)
    for cell in (3, 40, len(model.cells.first) - 2):
        listed = model.projected(switched_columns(model, effect, "y", {}, model.cells.first[[cell]]))[:, 0]
        own = steps[:, cell] * deg_h
        # The rate is that of the body, and G mixes a few thousandths of the gyros.
        own *= np.sign(own @ listed) * np.linalg.norm(listed) / np.linalg.norm(own)
        assert np.linalg.norm(own - listed) < 0.005 * np.linalg.norm(listed)


def test_a_step_of_the_references_is_there_from_its_observation_on(model):
    """From the first on it is a rotation, which G takes up but for its departure from one of some thousandths."""
    steps = step_columns(model, 2, on_references=True)
    assert np.linalg.norm(steps[:, 0]) < 1e-3 * np.linalg.norm(steps[:, 20])
    difference = model.projected(model.reference_columns[2][:, [7]])[:, 0]
    np.testing.assert_allclose(steps[:, 7] - steps[:, 8], difference, atol=1e-9 * np.abs(difference).max())


@pytest.mark.parametrize("on_references", [False, True])
def test_weights_are_a_prior_that_leaves_no_place_out(model, on_references):
    weights = place_weights(model, on_references)
    assert weights.size == step_columns(model, 0, on_references).shape[1]
    assert weights.sum() == pytest.approx(1.0)
    assert weights.min() > 0.4 / weights.size


def on_and_off(recording: Recording, size_deg_h: float, shares: list[tuple[float, float]]) -> Recording:
    """A bias of the gyro about z that is there in some shares of the samples."""
    share, rates = np.arange(recording.gyro.t_s.size) / recording.gyro.t_s.size, recording.gyro.rates.copy()
    for low, high in shares:
        rates[(share >= low) & (share < high), 2] += np.deg2rad(size_deg_h) / 3600
    return replace(recording, gyro=replace(recording.gyro, rates=rates))


def test_a_bias_that_is_on_or_off_is_no_random_process():
    """Without their evidence it is a random walk with a probability of 0.71."""
    answer = diagnose(on_and_off(recorded(5, every_s=60.0), 0.4, [(0.1, 0.27), (0.45, 0.62), (0.7, 0.75)]))
    assert answer.present
    assert answer.verdict == "unknown"
    assert answer.p_values["check: a few jumps in place of bias_random_walk:z"] < 0.1
