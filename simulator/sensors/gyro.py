"""Raw gyro samples from true body rates.

The gyro equation is R (7), ω = G ω_raw + b; a gyro therefore shows ω_raw = G⁻¹ (ω − b), plus noise.

Angle random walk is given as a root power spectral density N, rad/√s: the angle error after a time T has the variance
N² T whatever the sampling. A sample that averages the rate over Δt has an angle error of variance N² Δt, so its rate noise
is N/√Δt.
"""

import numpy as np

from gyrocal.arrays import Array
from gyrocal.jit_cache import compile_cached
from simulator.draws import add_normals, read_layers, state_words


def compute_raw_rates(omega: Array, G: Array, bias: Array) -> Array:
    """Compute noise-free raw rates G⁻¹ (ω − b), R (7); ω (n, 3) and b (3,) in rad/s, G rows body, columns gyros."""
    return np.asarray((omega - bias) @ np.linalg.inv(G).T)


def add_white_noise(rng: np.random.Generator, rates: Array, arw: float, duration: Array, out: Array | None = None) -> Array:
    """Add the white noise of the gyros' samples to rates, rad/s.

    Drawing and adding in one compiled loop is several times faster than numpy's own; the numbers are the same to the bit.

    Parameters
    ----------
    rng : source of randomness
    rates : (n, 3) rad/s
    arw : angle random walk, rad/√s
    duration : (n,) time each sample averages over, s
    out : (n, 3) array to write to; a new one by default

    Returns
    -------
    (n, 3)
    """
    out = np.empty_like(rates) if out is None else out
    words = state_words(rng)
    if words is None:
        _add_noise(rng, rates, arw / np.sqrt(duration), out)
    else:
        add_normals(rng, words, read_layers(), rates, arw, duration, out)
    return out


@compile_cached
def _add_noise(rng: np.random.Generator, rates: Array, sigma: Array, out: Array) -> None:
    for k in range(len(rates)):
        for i in range(rates.shape[1]):
            out[k, i] = rates[k, i] + rng.standard_normal() * sigma[k]
