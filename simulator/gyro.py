"""Raw gyro samples from true body rates.

The gyro equation is R (7), ω = G ω_raw + b; a gyro therefore shows ω_raw = G⁻¹ (ω − b), plus noise.

Angle random walk is given as a root power spectral density N, rad/√s: the angle error after a time T has the variance
N² T whatever the sampling. A sample that averages the rate over Δt has an angle error of variance N² Δt, so its rate noise
is N/√Δt.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def raw_rates(omega: Array, G: Array, bias: Array) -> Array:
    """Noise-free raw rates G⁻¹ (ω − b), R (7) solved for ω_raw.

    Parameters
    ----------
    omega : (n, 3) true body rates, rad/s
    G : (3, 3) rows body axes, columns gyros
    bias : (3,) b, rad/s
    """
    return np.asarray((omega - bias) @ np.linalg.inv(G).T)


def white_noise(rng: np.random.Generator, arw: float, duration: Array) -> Array:
    """White noise of the three gyros' sampled rates, rad/s.

    Parameters
    ----------
    rng : source of randomness
    arw : angle random walk, rad/√s
    duration : (n,) time each sample averages over, s

    Returns
    -------
    (n, 3)
    """
    return np.asarray(rng.standard_normal((duration.size, 3)) * (arw / np.sqrt(duration))[:, None])
