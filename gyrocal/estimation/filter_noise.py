"""Fit the noise that a filter takes for a calibrated gyro to turns that the calibration has predicted and not used.

A filter takes the error of the calibrated rate for white noise of density N, beside a bias that walks with K. Over a turn of
length T between two references, the variance of the error about each axis is then

    m(T) = N² T + K² T³/3 + φ σ²,

σ² the stated variance of both references and φ ≥ 1 its factor. The uncertainty of the calibration and its remainder are in
the errors of the turns, so N and K include them as far as they accumulate. An error that does not accumulate goes into φ: that
of the references, of their time tags, or of a gyro that lags. No N and K describe such an error at more than one T.

A mean square v of turns that cover a time C has ν = 3 C/T degrees of freedom, and −2 log L = Σ ν (log m + v/m) over the
lengths. Fisher scoring for N², K² and φ is least squares with the weights ν/m², repeated; none of them falls below what is
stated. Filters take no K of zero, so a K that the turns do not show is made negligible at their longest.

A gyro at rest has less error than in motion. Turns much slower than the others do not count.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.estimation.held_out import USUAL_TURN

Array = NDArray[np.float64]

FILTER_TURNS_S = (1.0, 10.0, 30.0, 60.0)
SLOWEST_MOTION = 0.3  # of the root mean square of the body's rate, below which a turn is rest
SCORING_ROUNDS = 100
SCORING_PRECISION = 1e-9  # relative change of m at which the rounds end
UNSEEN_WALK_SHARE = 0.01  # of the variance of the longest turns, for a random walk that they do not show


@dataclass(frozen=True)
class FilterNoise:
    """Noise of a calibrated gyro as a filter takes it.

    Attributes
    ----------
    noise_density : N, rad/s/√Hz
    random_walk : K of the bias, rad/s²/√Hz
    is_walk_seen : whether the turns show a random walk; otherwise it is negligible in them
    reference_factor : √φ, of the stated sigma of the references
    """

    noise_density: float
    random_walk: float
    is_walk_seen: bool
    reference_factor: float

    def normalise_errors(self, turns: Array) -> Array:
        """Divide the errors of turns (n, 7) of `gather_held_out_turns` by the sigmas that this noise predicts."""
        length = turns[:, 0]
        each = self.noise_density**2 * length + self.random_walk**2 * length**3 / 3
        return np.asarray(turns[:, 1] / np.sqrt(3 * each + np.square(self.reference_factor * turns[:, 4])))


def select_moving_turns(turns: Mapping[float, Array]) -> dict[float, Array]:
    """Leave out turns in which the body nearly rests, lengths without others, and the usual length beside others.

    Raises
    ------
    InputError
        There are no turns.
    """
    if not turns:
        raise InputError(
            "filter noise: no held-out turns; give references of one sensor in at least two blocks that share none"
        )
    turns = {length: rows for length, rows in turns.items() if length != USUAL_TURN or len(turns) == 1}
    least = SLOWEST_MOTION * float(np.sqrt(np.mean(np.square(turns[min(turns)][:, 6]))))
    moving = {length: rows[rows[:, 6] >= least] for length, rows in turns.items()}
    return {length: rows for length, rows in moving.items() if len(rows)}


def fit_filter_noise(turns: Mapping[float, Array], arw: float) -> FilterNoise:
    """Fit N, K and φ to the turns of `select_moving_turns`.

    Parameters
    ----------
    turns : (n, 7) by length
    arw : the least N: that of the gyro at rest, rad/√s
    """
    columns, mean_squares, degrees = [], [], []
    for rows in turns.values():
        length, usual = rows[:, 0], float(np.median(rows[:, 0]))
        covered = np.minimum(np.diff(np.sort(rows[:, 5]), append=np.inf), usual).sum()
        columns.append((length.mean(), np.mean(length**3) / 3, np.mean(np.square(rows[:, 4])) / 3))
        mean_squares.append(np.mean(np.square(rows[:, 1])) / 3)
        degrees.append(3 * covered / usual)
    A, v = np.array(columns), np.array(mean_squares)
    stated = A @ [arw**2, 0.0, 1.0]
    m, excess = np.maximum(v, stated), np.zeros(3)
    for _ in range(SCORING_ROUNDS):
        weights = np.sqrt(degrees) / m
        excess = scipy.optimize.nnls(A * weights[:, None], (v - stated) * weights)[0]
        before, m = m, stated + A @ excess
        if np.allclose(before, m, rtol=SCORING_PRECISION, atol=0.0):
            break
    longest = int(np.argmax(A[:, 0]))
    seen = bool(excess[1] > 0)
    walk = excess[1] if seen else UNSEEN_WALK_SHARE * m[longest] / A[longest, 1]
    return FilterNoise(float(np.sqrt(arw**2 + excess[0])), float(np.sqrt(walk)), seen, float(np.sqrt(1 + excess[2])))


def describe_filter_noise(noise: FilterNoise, turns: Mapping[float, Array], arw: float) -> list[str]:
    """Say which noise a filter should take, and how well the turns fit it and the stated noise."""
    stated = FilterNoise(arw, 0.0, False, 1.0)
    lengths = ", ".join(f"{np.median(rows[:, 0]):.3g}" for rows in turns.values())
    sizes = [
        ", ".join(f"{np.sqrt(np.mean(np.square(one.normalise_errors(rows)))):.2f}" for rows in turns.values())
        for one in (noise, stated)
    ]
    return [
        f"gyroscope_noise_density {noise.noise_density:.3g} rad/s/sqrt(Hz); the stated angle random walk is {arw:.3g}",
        f"gyroscope_random_walk {noise.random_walk:.3g} rad/s^2/sqrt(Hz), "
        f"{'seen' if noise.is_walk_seen else 'not seen and made negligible'} in held-out turns",
        f"take {noise.reference_factor:.3g} times the stated sigma of the references as the noise of their measurements",
        f"normalised errors of held-out turns of {lengths} s: {sizes[0]}; with the stated noise {sizes[1]}",
    ]
