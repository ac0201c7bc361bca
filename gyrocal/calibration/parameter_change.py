"""A change of one parameter among the recordings of a unit: a sequential test that is valid at any time, and the change's date.

Null hypothesis. The calibrations x_k of n recordings, with sigma σ_k, at the times t_k and temperatures T_k, are

    x_k = θ + α T_k + w_k + s ε_k + σ_k η_k,    w a random walk, var (w_k − w_j) = q |t_k − t_j|

with θ, α, s and q unknown and ε, η white. s is a scatter from recording to recording beside the stated sigma, such as the bias
of each start; q is the walk of the parameter. Alternative: the same with a step δ from recording c on.

Nuisance parameters. θ and α are those of a group of translations. The densities of the contrasts that they leave unchanged
(restricted likelihoods) do not depend on them, so that a ratio of two such densities is a test martingale at any θ and α
(Pérez-Ortiz, Lardy, de Heide and Grünwald, Ann. Statist. 52, 2024). s and q are not so: the denominator has the s and q that
fit best at each n (universal inference: Wasserman, Ramdas and Balakrishnan, PNAS 117, 2020),

    E_n = Σ_c π_c Σ_j v_j p(x_1 … x_n | step at c, j) / max_{s, q} p(x_1 … x_n | s, q)

It is at most the ratio with the true s and q, a test martingale. Hence E is an e-process, and Ville's inequality holds:

    P(E_n ≥ 1/ε for any n) ≤ ε    whatever θ, α, s and q are.

The numerator is one fixed law of the whole sequence. The change times have the prior π_c = 1/(c (c − 1)), which leaves 1/n for
no change up to recording n. v_j weigh s, q and the variance of δ on a lattice, in units of the smaller sigma of the first two
recordings and of the first interval, which no later recording alters.

The maximum is taken on a grid whose variances are a factor e^d apart. The nearest of its points is within d/2, where the
log likelihood of m contrasts is smaller by at most (m/4)(d/2)² to second order, since its curvature in the logarithms of the
variances is at most m/2. This is added to the maximum.

Several parameters. Each E is an e-process in the history of its own parameter. The errors of parameters correlate, and the mean
of e-processes of different histories is none (Choe and Ramdas, arXiv:2402.09698). The share 1/P of P parameters is therefore
applied to each alone: a parameter changes where E ≥ P/ε, and by the union bound P(any alarm) ≤ ε, whatever the correlation.

Filter. θ is eliminated by the diffuse start of a scalar Kalman filter of θ + w, whose innovations of x, T and the steps are
independent with variances F. α is eliminated by regression on those innovations.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from gyrocal.errors import InputError

Array = NDArray[np.float64]

GRID_STEP = 0.5 * float(np.log(2))  # d of the grid of the null hypothesis, in the logarithm of a variance
SMALLEST_SIGMA_SHARE = 0.25  # scatter, and walk of all recordings, in sigma, below which they are as good as zero
LARGEST_RANGE_SHARE = 2.0  # scatter and walk in the range of the values, above which no maximum lies
PRIOR_SCATTERS = (0.0, 1.0, 4.0, 16.0, 64.0)  # s, and the walk of the first interval, of the numerator, in sigma
PRIOR_STEPS = (2.0, 8.0, 32.0, 128.0, 512.0)  # 1-sigma of δ, in sigma
PRIOR_STEADY = 0.5  # probability of neither scatter nor walk in the numerator
LEAST_INFORMATION = 1e-12  # of a regression, relative to that of the uncentred columns, below which it is none
DATE_PROBABILITY = 0.9  # of the stated interval of change times


@dataclass(frozen=True)
class ParameterChange:
    """Evidence for a change of one parameter, and its date.

    Attributes
    ----------
    log_e : (n,) logarithm of E after each recording
    date_probability : (n,) probability of the change just before each recording if there is one, with equal prior
    step, step_sigma : size of the change at its most probable date, and its 1-sigma with the scatter and walk of the data
    """

    log_e: Array
    date_probability: Array
    step: float
    step_sigma: float

    @property
    def date(self) -> int:
        """Place of the first recording after the change, by the maximum of the likelihood over the change times."""
        return int(self.date_probability.argmax())

    @property
    def date_interval(self) -> tuple[int, int]:
        """First and last place of the shortest range about the date that holds it with a probability of 90 %."""
        total = np.concatenate([[0.0], np.cumsum(self.date_probability)])
        last = np.searchsorted(total[1:], total[:-1] + DATE_PROBABILITY)  # of the range from each place on
        enough = [k for k in range(self.date + 1) if last[k] < last.size]
        low = min(enough, key=lambda k: max(last[k], self.date) - k)
        return low, int(max(last[low], self.date))

    def find_alarm(self, log_threshold: float) -> int | None:
        """Place of the first recording at which E reaches its threshold; None if it never does."""
        reached = np.flatnonzero(self.log_e >= log_threshold)
        return int(reached[0]) if reached.size else None


def detect_parameter_change(
    value: Array, sigma: Array, time: Array, temperature: Array | None = None, largest_walk: float = np.inf
) -> ParameterChange:
    """Test the calibrations of one parameter for a change.

    Parameters
    ----------
    value, sigma : (n,) of each recording, in their order
    time : (n,) ascending, in any unit
    temperature : (n,) of each recording, °C, for a parameter that is linear in it; None for a constant one
    largest_walk : known limit of the scatter, and of the walk from a recording to the next, in the median sigma

    Raises
    ------
    InputError
        Fewer than two recordings, a sigma of zero, or times that do not ascend.
    """
    n = len(value)
    if n < 2 or not (np.asarray(sigma) > 0).all() or not (np.diff(time) > 0).all():
        raise InputError("a change needs two recordings or more, positive sigmas and ascending times")
    null = _Likelihood.build(value, sigma, time, temperature, *_list_null_sizes(value, sigma, time, largest_walk))
    contrasts = np.arange(n)[:, None] - null.has_slope
    maximum = (null.log_likelihood + contrasts * GRID_STEP**2 / 16).max(axis=1)

    unit = float(np.min(sigma[:2]))
    s2, q = (sizes.ravel() for sizes in np.meshgrid(*2 * [np.square(np.multiply(PRIOR_SCATTERS, unit))], indexing="ij"))
    weights = np.where(s2 + q > 0, (1 - PRIOR_STEADY) / (s2.size - 1), PRIOR_STEADY)
    law = _Likelihood.build(value, sigma, time, temperature, s2, q / (time[1] - time[0]))
    information, score = law.fit_steps()
    ratio = reduce(np.logaddexp, (_compute_bayes_factor(information, score, size * unit) for size in PRIOR_STEPS))
    own = np.log(weights) + law.log_likelihood
    by_date = logsumexp(own[:, :, None] + ratio - np.log(len(PRIOR_STEPS)), axis=1)  # (n, n - 1)
    c = np.arange(2, n + 1)
    is_known = c <= np.arange(1, n + 1)[:, None]
    changed = np.where(is_known, by_date - np.log(c * (c - 1)), -np.inf)
    unchanged = logsumexp(own, axis=1) - np.log(np.arange(1, n + 1))
    log_e = logsumexp(np.column_stack([changed, unchanged]), axis=1) - maximum
    log_e[0] = 0.0

    date = int(by_date[-1].argmax())
    best = int((own[-1] + ratio[-1, :, date]).argmax())
    a, b = information[-1, best, date], score[-1, best, date]
    step = (b / a, a**-0.5) if a > 0 else (0.0, np.inf)
    probability = np.exp(by_date[-1] - logsumexp(by_date[-1]))
    return ParameterChange(log_e, np.concatenate([[0.0], probability]), *map(float, step))


def _list_null_sizes(value: Array, sigma: Array, time: Array, largest_walk: float) -> tuple[Array, Array]:
    """Grid of s² and q of the null hypothesis, (g,) each, from what is as good as zero to what no maximum exceeds."""
    low, high = SMALLEST_SIGMA_SHARE * float(np.min(sigma)), LARGEST_RANGE_SHARE * float(np.ptp(value))
    intervals, known = np.diff(time), largest_walk * float(np.median(sigma))
    sizes = []
    for longest, typical, shortest in ((1.0, 1.0, 1.0), (intervals.sum(), np.median(intervals), intervals.min())):
        ends = np.log([low**2 / longest, max(min(high**2 / shortest, known**2 / typical), 1e-300)])
        sizes.append(np.append(0.0, np.exp(np.arange(ends[0], ends[1] + GRID_STEP, GRID_STEP))))
    s2, q = np.meshgrid(*sizes, indexing="ij")
    return s2.ravel(), q.ravel()


def _compute_bayes_factor(information: Array, score: Array, sigma: float) -> Array:
    """Logarithm of the Bayes factor of a step of a-priori size zero with this sigma, against none."""
    gain = sigma**2 * information
    return np.asarray(-0.5 * np.log1p(gain) + 0.5 * (sigma * score) ** 2 / (1 + gain))


@dataclass(frozen=True)
class _Likelihood:
    """Restricted likelihood of the first 1 … n recordings at each of g points (s², q), with whitened innovations.

    Attributes
    ----------
    values : (n, g) innovations of x; 0 for the first recording
    slopes : (n, g) those of T, 0 without a temperature
    gains, noise : (n, g) of the filter
    """

    values: Array
    slopes: Array
    gains: Array
    noise: Array

    @classmethod
    def build(cls, value: Array, sigma: Array, time: Array, temperature: Array | None, s2: Array, q: Array) -> _Likelihood:
        """Filter the values and the temperatures."""
        n = len(value)
        gains, F, P = np.zeros((n, s2.size)), np.ones((n, s2.size)), sigma[0] ** 2 + s2
        for k in range(1, n):
            P = P + q * (time[k] - time[k - 1])
            F[k] = P + sigma[k] ** 2 + s2
            gains[k] = P / F[k]
            P = P * (1 - gains[k])
        T = np.zeros(n) if temperature is None else np.asarray(temperature) - temperature[0]
        x, slopes = (_whiten_columns(one[:, None], gains, F)[:, :, 0] for one in (np.asarray(value), T))
        return cls(x, slopes, gains, F)

    @property
    def _slope_information(self) -> Array:
        return np.cumsum(self.slopes**2, axis=0)

    @property
    def has_slope(self) -> NDArray[np.bool_]:
        """(n, g) whether the temperature has varied, so that its slope takes a contrast."""
        return self._slope_information > 0

    @property
    def log_likelihood(self) -> Array:
        """(n, g), but for constants of the contrasts."""
        A = np.where(self.has_slope, self._slope_information, 1.0)
        square = np.cumsum(self.values**2, axis=0) - np.cumsum(self.slopes * self.values, axis=0) ** 2 / A
        return np.asarray(-0.5 * (np.cumsum(np.log(self.noise), axis=0) + np.log(A) + square))

    def fit_steps(self) -> tuple[Array, Array]:
        """Information on a step at each recording but the first, and its score: hᵀ P h and hᵀ P x, (n, g, n - 1)."""
        n = len(self.values)
        h = _whiten_columns(np.tril(np.ones((n, n)))[:, 1:], self.gains, self.noise)
        x, T = self.values[:, :, None], self.slopes[:, :, None]
        A = np.where(self.has_slope, self._slope_information, 1.0)[:, :, None]
        square, mixed = np.cumsum(h**2, axis=0), np.cumsum(h * T, axis=0)
        information = square - mixed**2 / A
        score = np.cumsum(h * x, axis=0) - mixed * np.cumsum(T * x, axis=0) / A
        is_seen = information > LEAST_INFORMATION * square
        return np.where(is_seen, information, 0.0), np.where(is_seen, score, 0.0)


def _whiten_columns(columns: Array, gains: Array, noise: Array) -> Array:
    """Innovations of columns (n, p) over their sigma, (n, g, p), the first one without any."""
    out = np.zeros((*gains.shape, columns.shape[1]))
    level = np.broadcast_to(columns[0], out.shape[1:]).copy()
    for k in range(1, len(columns)):
        out[k] = columns[k] - level
        level += gains[k][:, None] * out[k]
        out[k] /= np.sqrt(noise[k])[:, None]
    return out
