"""Closure on held-out data of models made by hand: of the truth, of nothing, of a wrong effect."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from diagnosis.inference.closure import average_closure, compute_closure
from diagnosis.model.linear import Fold, SelectedCandidate
from tests.diagnosis.linear_models import linear_model

PARTS, EACH = 6, 40
ROWS = PARTS * EACH
PART = np.arange(ROWS) % PARTS
NAMES = np.repeat(["a", "b", "c"], ROWS // 3)


def with_folds(model):
    """A model of independent rows with every sixth of them held out at a time."""

    def folds(W):
        for number in range(PARTS):
            out = number == PART
            yield Fold(
                train_y=model.y[~out],
                train_X=W[~out],
                left_y=model.y[out],
                left_X=W[out],
                owner=NAMES[out],
                dof={name: float(np.sum(NAMES[out] == name)) for name in "abc"},
            )

    return replace(model, folds=folds, split="a sixth of the rows at a time")


@pytest.fixture(scope="module")
def columns():
    rng = np.random.default_rng(1)
    return [rng.standard_normal((ROWS, 1)) for _ in range(5)]


def made(columns, amplitude, seed=2, changes=()):
    y = amplitude * columns[0][:, 0] + np.random.default_rng(seed).standard_normal(ROWS)
    return with_folds(linear_model(columns, y, changes=changes))


def test_the_truth_closes_the_gap_and_nothing_or_a_wrong_effect_does_not(columns):
    found = compute_closure(made(columns, 2.0), [SelectedCandidate(0, 0, 4)])
    assert found.measure == "held-out whitened mean square"
    assert found.split == "a sixth of the rows at a time"
    assert found.floor == 1.0
    assert found.before == pytest.approx(5.0, rel=0.25)
    assert found.closed == pytest.approx(1.0, abs=0.1)
    assert found.interval_90[0] < found.closed < found.interval_90[1]
    table = found.by_interval.set_index("interval")
    assert list(table.index) == ["a", "b", "c"]
    assert table["dof"].tolist() == [ROWS / 3] * 3
    assert table["before"].mean() == pytest.approx(found.before)
    model = made(columns, 2.0)
    nothing = compute_closure(model, [])
    assert nothing.closed == pytest.approx(0.0, abs=1e-12)
    assert nothing.after == nothing.before
    assert compute_closure(model, [SelectedCandidate(3, 0, 4)]).closed < 0.05


def test_intervals_cover_a_closed_gap_nine_times_in_ten(columns):
    """Of 150 data sets with an effect whose amplitude is well known from the training part."""
    inside, values = 0, []
    for seed in range(150):
        found = compute_closure(made(columns, 1.5, seed), [SelectedCandidate(0, 0, 4)])
        values.append(found.closed)
        inside += found.interval_90[0] < 1 < found.interval_90[1]
    assert np.mean(values) == pytest.approx(1.0, abs=0.02)
    assert scipy.stats.binomtest(inside, 150, 0.9).pvalue > 1e-3


def test_rows_that_stand_for_more_are_counted_by_their_degrees_of_freedom():
    """Two rows that keep the square sums of ten: the mean is over ten, and the floor is that of ten."""
    errors = np.sqrt([[20.0, 8.0], [10.0, 4.0]])
    fold = Fold(np.empty(0), np.empty((0, 0)), np.empty(2), np.empty((2, 0)), np.array(["a", "a"]), {"a": 10.0})
    found = average_closure([errors], [fold], "split")
    assert (found.before, found.after, found.floor) == pytest.approx((3.0, 1.2, 1.0))
    assert found.closed == pytest.approx(1 - 0.2 / 2.0)
