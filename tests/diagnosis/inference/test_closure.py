"""Closure on held-out data of models made by hand: of the truth, of nothing, of a wrong effect, of a random process."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from diagnosis.inference.closure import closure, fixed, found_by, summed
from diagnosis.inference.search import Search
from diagnosis.model.linear import Fold, Member
from tests.diagnosis.linear_models import closure_by_truth, linear_model

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
                log_scale=np.zeros(out.sum()),
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


def test_the_truth_closes_the_gap(columns):
    found = closure(made(columns, 2.0), [Member(0, 0, 4)])
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


def test_nothing_and_a_wrong_effect_close_nothing(columns):
    model = made(columns, 2.0)
    nothing = closure(model, [Member(0, 0, 4)], lambda search: [])
    assert nothing.closed == pytest.approx(0.0, abs=1e-12)
    assert nothing.after == nothing.before
    assert closure(model, [Member(0, 0, 4)], fixed(("e3",))).closed < 0.05


def test_folds_search_among_listed_effects_for_themselves(columns):
    """Told only how many effects there are, they find which; a rival with the same column is not among them."""
    rivals = [*columns, columns[0] + 1e-3 * columns[1]]
    changes = {5: {"listed": False}}
    seen = []

    def watched(search):
        chosen = found_by(1)(search)
        seen.append((len(search.model.candidates), max(chosen, key=lambda pair: pair[0])[1]))
        return chosen

    found = closure(made(rivals, 2.0, changes=changes), [Member(3, 0, 4)], watched)
    assert found.closed == pytest.approx(1.0, abs=0.1)
    assert seen == [(5, (Member(0, 0, seen[0][1][0].scale),))] * PARTS


def test_what_is_held_out_has_no_part_in_choosing_or_fitting(columns):
    """Other values in one fold's rows change the prediction of the other folds, and its own prediction not at all."""
    model = made(columns, 2.0)
    out = PART == 0
    fold = next(iter(model.folds(model.W)))
    assert fold.train_y.size + fold.left_y.size == ROWS
    changed = with_folds(replace(model, y=np.where(out, 50.0, model.y)))
    searches = []

    def watched(search):
        searches.append(search.model.y)
        return found_by(1)(search)

    closure(changed, [Member(0, 0, 4)], watched)
    np.testing.assert_array_equal(searches[0], model.y[~out])
    assert (searches[1] == 50.0).any()


def test_intervals_cover_a_closed_gap_nine_times_in_ten(columns):
    """Of 150 data sets with an effect whose amplitude is well known from the training part."""
    inside, values = 0, []
    for seed in range(150):
        found = closure(made(columns, 1.5, seed), [Member(0, 0, 4)], fixed(("e0",)))
        values.append(found.closed)
        inside += found.interval_90[0] < 1 < found.interval_90[1]
    assert np.mean(values) == pytest.approx(1.0, abs=0.02)
    assert scipy.stats.binomtest(inside, 150, 0.9).pvalue > 1e-3


def test_a_random_process_closes_the_gap_of_the_log_score():
    """Nothing can be predicted of independent errors; that they are larger than stated can."""
    rng = np.random.default_rng(3)
    X = np.eye(ROWS)
    y = np.sqrt(1 + 1.5**2) * rng.standard_normal(ROWS)
    change = {0: {"process": True, "scales": np.array([0.5, 1.0, 1.5, 2.0])}}
    found = closure(with_folds(linear_model([X], y, changes=change)), [Member(0, 0, 2)])
    assert found.measure == "held-out log score"
    assert found.before > found.after
    variance = 1 + 1.5**2
    # eᵀe less the same with the larger covariance and its determinant, on average.
    assert found.before - found.after == pytest.approx(variance - 1 - np.log(variance), rel=0.3)
    assert found.floor == pytest.approx(1 + np.log(variance), abs=0.15)
    assert found.closed == pytest.approx(1.0, abs=0.25)


def test_noise_as_stated_has_no_gap_to_close():
    rng = np.random.default_rng(4)
    values = []
    for _ in range(40):
        model = with_folds(linear_model([rng.standard_normal((ROWS, 1))], rng.standard_normal(ROWS)))
        values.append(closure(model, [Member(0, 0, 4)], fixed(("e0",))).before)
    assert abs(np.mean(values) - 1) < 4 * np.sqrt(2 / ROWS / 40)


def test_response_of_the_truth_closes_the_gap_and_of_half_of_it_three_quarters(columns):
    model = made(columns, 3.0)
    response = 3.0 * columns[0][:, 0]
    assert closure_by_truth(model, response).closed == pytest.approx(1.0, abs=0.03)
    assert closure_by_truth(model, 0.5 * response).closed == pytest.approx(0.75, abs=0.03)
    assert closure_by_truth(model, 0.0 * response).closed == 0.0


def test_without_folds_there_is_no_closure(columns):
    model = linear_model(columns, 2.0 * columns[0][:, 0])
    assert closure(model, [Member(0, 0, 4)]) is None
    assert closure_by_truth(model, columns[0][:, 0]) is None


def test_a_fold_in_which_nothing_can_be_seen_leaves_its_data_as_they_are(columns):
    model = made(columns, 2.0)
    assert fixed(("nothing",))(Search(model)) == []


def test_rows_that_stand_for_more_are_counted_by_their_degrees_of_freedom():
    """Two rows that keep the square sums of ten: the mean is over ten, and the floor is that of ten."""
    part = np.array([[20.0, 8.0, 1.0], [10.0, 4.0, 1.0]])
    fold = Fold(np.empty(0), np.empty((0, 0)), np.empty(2), np.empty((2, 0)), np.zeros(2), np.array(["a", "a"]), {"a": 10.0})
    found = summed([part], [fold], "split", False)
    assert (found.before, found.after, found.floor) == (3.0, 1.2, 1.0)
    assert found.closed == pytest.approx(1 - 0.2 / 2.0)
