"""What is known of some gyros beforehand: each by itself, and what turns or scales them all.

With ω_raw = K ω + c, a rotation of all gyros together by φ about the body's axes changes K by −K [φ×], a common scale factor s
of ω = G ω_raw + b by −s K, to first order.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal import attitude

Array = NDArray[np.float64]


def prior_of_gyros(K: Array, sigma_K: float, sigma_c: float, sigma_mounting: float = 0.0, sigma_scale: float = 0.0) -> Array:
    """(4n, 4n) covariance of K_x, K_y, K_z and c, gyro by gyro, as `gyrocal.calibrate_gyros` takes it.

    Parameters
    ----------
    K : (n, 3) as known beforehand, see `gyrocal.recording.gyros.nominal`
    sigma_K, sigma_c : 1-sigma of each element of K, and of each c, rad/s, by itself
    sigma_mounting : 1-sigma of a rotation of all gyros about each axis, rad
    sigma_scale : 1-sigma of a common scale factor
    """
    n = len(K)
    P = np.diag(np.tile(np.square([sigma_K] * 3 + [sigma_c]), n))
    turns = [sigma_mounting * K @ attitude.cross_matrix(e) for e in np.eye(3)]
    for change in [*turns, sigma_scale * K]:
        direction = np.column_stack([change, np.zeros(n)]).ravel()
        P += np.outer(direction, direction)
    return P
