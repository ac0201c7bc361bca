r"""Whether a few jumps explain what other effects are named for.

A state that is on or off, a switch that throws now and then, a step at each slew: what jumps between levels is on no list. A
random process that is free to be anything slow takes it up, or several effects that are switched do. It can be asked without
draws. With y the observations, S_o the covariance of what else is named, C the columns of what may be imitated and D those of
steps at each place, the marginal likelihoods are

    named:      N(y; 0, S_o + C Cᵀ)
    jumps:      Σ_k 1/K Σ_A k! Π_A w_j N(y; 0, S_o + s² D_A D_Aᵀ),        A of k places, k = 1 … K,

averaged over some sizes s. A state that is on or off has jumps of one size, up and down in turn: D_A is then one column, the
sum of the steps with alternating signs. Both kinds are as likely. The prior w of the places is that of the moments, and half
of it that of the body's turns and of the changes of its rate: what a slew leaves jumps there. One set A found by a search is a
lower bound of the sum. Half of the prior is that of jumps at all of some known moments, such as each turn of the body, where
there are such; these pay for no places. A ratio B of marginal likelihoods has P(B ≥ b) ≤ 1/b under what is named by Markov's
inequality, so that 1/B is a p-value of it, and the jumps have paid for their number, their places and their sizes.

The set grows by the step that gains most, and each step is moved once to where it gains most beside the others. With
b = Dᵀ S_o⁻¹ y and G = Dᵀ S_o⁻¹ D, a step j beside the set A gains g² / 2h,

    g = b_j − G_jA G_AA⁻¹ b_A,        h = G_jj − G_jA G_AA⁻¹ G_Aj.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from diagnosis.inference.evidence import averaged, log_bayes

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

MOST = 32  # jumps
PATIENCE = 4  # jumps more without a gain, after which no more are looked for
SIZES = np.geomspace(3.0, 3000.0, 7)  # sigmas that the usual step of a size shows
SEEN = 1e-6  # of its power, that a step must have beside others
TINY = 1e-300


def log_evidence(b: Array, G: Array, weights: Array, sets: Sequence[Indices] = ()) -> float:
    """log of the marginal likelihood of a few jumps beside what else is named, at least, over that of none; see the module.

    Parameters
    ----------
    b, G : (c,) Dᵀ S_o⁻¹ y and (c, c) Dᵀ S_o⁻¹ D, of unit steps at each place
    weights : (c,) prior of a step at each place; their sum is one
    sets : places at all of which there may be jumps
    """
    prior, usual = np.log(np.maximum(weights, TINY)), max(float(np.sqrt(np.median(np.diag(G)))), TINY)
    best, reached = -np.inf, 0
    for number, grown in enumerate(_grown(b, G, prior)):
        chosen = np.sort(_moved(b, G, prior, grown))
        gram, own, turns = G[np.ix_(chosen, chosen)], b[chosen], (-1.0) ** np.arange(chosen.size)
        free = _of_free_sizes(b, G, chosen, usual)
        of_one_size = np.array([[[turns @ gram @ turns]]]), np.array([[turns @ own]])
        on_or_off = averaged(log_bayes(*of_one_size, SIZES / usual), np.zeros(1))
        places = float(gammaln(chosen.size + 1) + prior[chosen].sum())
        found = float(np.logaddexp(free, on_or_off)) - float(np.log(2.0)) + places
        if found > best:
            best, reached = found, number
        elif number > reached + PATIENCE:
            break
    best -= float(np.log(MOST))
    known = [_of_free_sizes(b, G, own, usual) for own in sets if own.size]
    if not known:
        return best
    return float(np.logaddexp(best, np.logaddexp.reduce(known) - np.log(len(known))) - np.log(2.0))


def _of_free_sizes(b: Array, G: Array, chosen: Indices, usual: float) -> float:
    """log evidence of jumps at some places, each of its own size."""
    return averaged(log_bayes(G[np.ix_(chosen, chosen)][None], b[None, chosen], SIZES / usual), np.zeros(1))


def _grown(b: Array, G: Array, prior: Array) -> Iterator[Indices]:
    """Sets of one step to `MOST`, each the one before and the step that gains most beside it, its prior (c,) with that."""
    chosen = np.empty(0, dtype=np.intp)
    for _ in range(min(MOST, b.size)):
        gains = _gains(b, G, prior, chosen)
        if not np.isfinite(gains.max()):
            break
        chosen = np.append(chosen, np.intp(np.argmax(gains)))
        yield chosen


def _moved(b: Array, G: Array, prior: Array, chosen: Indices) -> Indices:
    """Each step where it gains most beside the others."""
    out = chosen.copy()
    for k in range(out.size):
        gains = _gains(b, G, prior, np.delete(out, k))
        if np.isfinite(gains.max()):
            out[k] = np.intp(np.argmax(gains))
    return out


def _gains(b: Array, G: Array, prior: Array, chosen: Indices) -> Array:
    """(c,) what each further step gains beside those chosen, and its prior; −∞ where it is one of them or as good as."""
    power = np.diag(G)
    if chosen.size:
        solved = np.linalg.solve(G[np.ix_(chosen, chosen)], np.column_stack([b[chosen], G[chosen]]))
        g = b - G[:, chosen] @ solved[:, 0]
        h = power - np.einsum("ja,aj->j", G[:, chosen], solved[:, 1:])
    else:
        g, h = b, power
    good = h > SEEN * np.maximum(power, TINY)
    return np.asarray(np.where(good, 0.5 * g**2 / np.where(good, h, 1.0) + prior, -np.inf))
