"""Conformal sets of explanations: a set that holds the truth in nine of ten recordings, even if the posterior is wrong.

The score of an explanation compares its probability with that of the likeliest,

    s_k = 1 − p_k / max_j p_j,

zero for the likeliest and one for explanations outside the posterior. Of recordings with known truth, the score of the
truth has a distribution; its quantile at the wanted coverage is the threshold τ, and the set of a new recording that is
exchangeable with them is {k : s_k ≤ τ}, never empty (Vovk, Gammerman and Shafer, Algorithmic Learning in a Random World, 2005).
Ratios of probabilities make shorter sets than the sum of all that are likelier, which one clear answer and many small
probabilities fill up; on sets of least size see Sadinle, Lei and Wasserman (Journal of the American Statistical Association
114, 2019). An explanation with anything unlisted in it is ``unknown``, a member like any other; so is ``none``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

Posterior = Sequence[tuple[Sequence[str], float]]

UNKNOWN, NONE = "unknown", "none"

MISSING = 1.0  # score of an explanation that the posterior does not hold


def name_of(labels: Iterable[str]) -> str:
    """Join the labels of an explanation in order to one name, ``none`` without any."""
    return " + ".join(sorted(labels)) or NONE


def compute_scores(posterior: Posterior) -> dict[str, float]:
    """Compute the score of each explanation of a posterior, by its name; ``unknown`` is always among them."""
    largest = max((probability for _, probability in posterior), default=MISSING)
    scores: dict[str, float] = {}
    for labels, probability in sorted(posterior, key=lambda pair: -pair[1]):
        scores.setdefault(name_of(labels), 1 - probability / largest)
    scores.setdefault(UNKNOWN, MISSING)
    return scores


def build_conformal_set(posterior: Posterior, limit: float) -> tuple[str, ...]:
    """List the explanations with a score of at most the limit, the likeliest first."""
    return tuple(name for name, value in compute_scores(posterior).items() if value <= limit)
