"""Conformal sets of explanations, and their coverage."""

import math

import numpy as np
import pytest
import scipy.stats

from diagnosis.inference.conformal import build_conformal_set, compute_score_threshold, compute_scores, name_of, score

POSTERIOR = [(["a"], 0.3), (["unknown"], 0.1), (["b", "a"], 0.6)]


def test_scores_are_how_much_less_likely():
    assert compute_scores(POSTERIOR) == {"a + b": 0.0, "a": pytest.approx(0.5), "unknown": pytest.approx(5 / 6)}
    assert score(POSTERIOR, ["a", "b"]) == 0.0
    assert score(POSTERIOR, ["c"]) == 1.0
    assert compute_scores([([], 1.0)]) == {"none": 0.0, "unknown": 1.0}
    assert name_of(["z", "a"]) == "a + z"


def test_sets_grow_with_the_limit():
    assert build_conformal_set(POSTERIOR, 0.0) == ("a + b",)
    assert build_conformal_set(POSTERIOR, 0.7) == ("a + b", "a")
    assert build_conformal_set(POSTERIOR, 0.9) == ("a + b", "a", "unknown")


def test_one_clear_answer_is_alone_beside_many_small_ones():
    many = [(["a"], 0.6), *(([str(k)], 0.1) for k in range(4))]
    assert build_conformal_set(many, 0.8) == ("a",)


def test_threshold_is_the_score_that_covers_with_confidence():
    assert compute_score_threshold([0.01 * k for k in range(1, 30)]) == pytest.approx(0.29)  # 0.9²⁹ < 0.05: the largest of 29
    assert compute_score_threshold([0.5] * 28) == math.inf  # too few for nine of ten with 95 % confidence


def test_the_coverage_is_at_least_that_asked_for_with_the_confidence_stated():
    """Of n uniform scores the coverage is the threshold itself, the k-th smallest: below 0.9 if at least k of them are."""
    count, draws = 299, 2000
    rank = next(k for k in range(1, count + 1) if scipy.stats.binom.sf(k - 1, count, 0.9) <= 0.05)
    chance = scipy.stats.binom.sf(rank - 1, count, 0.9)
    limits = np.array([compute_score_threshold(scores) for scores in np.random.default_rng(4).random((draws, count)).tolist()])
    assert np.mean(limits < 0.9) == pytest.approx(chance, abs=4 * np.sqrt(chance * (1 - chance) / draws))


@pytest.mark.parametrize("sharpness", [1.0, 3.0])
def test_sets_cover_whatever_the_posterior_is_worth(sharpness):
    """Posteriors that are overconfident or not: the set covers nine of ten, within the sampling error."""
    rng = np.random.default_rng(3)

    def drawn(count):
        out = []
        for _ in range(count):
            p = rng.dirichlet([0.4] * 5)
            truth = rng.choice(5, p=p)
            stated = p**sharpness / np.sum(p**sharpness)
            out.append(([([str(k)], float(stated[k])) for k in range(5)], str(truth)))
        return out

    limit = compute_score_threshold([score(posterior, [truth]) for posterior, truth in drawn(2000)])
    held = [truth in build_conformal_set(posterior, limit) for posterior, truth in drawn(2000)]
    assert np.mean(held) > 0.9 - 4 * np.sqrt(0.09 * (1 / 2000 + 1 / 2000))
