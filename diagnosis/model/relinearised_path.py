"""The attitude path along which a recording is linearised where its propagated one is too far from the references.

With A the true and A_prop the propagated attitude, Aᵀ = E A_propᵀ, and E = exp([ζ×]) obeys Ė Eᵀ = [(Aᵀ δω)×] exactly, δω being
the error of the calibrated rates. The integral of Aᵀ δω, which is linear in δω once the path is known, therefore is the sum of
the small turns of E,

    z_k = Σ_{j<k} log(S_{j+1} S_jᵀ) + log(E_k S_kᵀ),

with S_j a path near E. First order in ζ gives ζ itself, which misses half the square of it: 0.9 deg for 10 deg. The sum misses
half the square of what a reference is off the path S. That is a moving average of ζ over as many references as bring their
noise to a small part of ζ, since noise in S adds up as ½ Σ ε_j × ε_{j+1}.

Source of the kinematics: Natanson (1998), (14) to (16); the sum is the integral of the left Jacobian of SO(3) times ζ̇.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

SMALL = 0.3  # sigmas of a reference in half the square of ζ, up to which first order is enough
NOISE = 0.05  # of the largest ζ, that the noise of the path may be
WIDEST = 0.2  # of the references of an interval in an average


@dataclass(frozen=True)
class RelinearisedPath:
    """Turns from the propagated to the true attitudes of an interval."""

    errors: Array  # (m, 3) z at the references, rad
    turns: Array  # (m, 3) rotation vectors of S there, inertial axes

    def turn_attitudes(self, propagated: Array) -> Array:
        """(m, 3, 3) Aᵀ along the path at the references, of those as propagated."""
        return np.asarray(Rotation.from_rotvec(self.turns).as_matrix() @ propagated)

    def interpolate_turns(self, ends: Indices) -> Array:
        """(n, 3, 3) S in the middle of each step, with (m,) steps done at each reference, of which the last has all."""
        middle = np.arange(ends[-1]) + 0.5
        turns = np.column_stack([np.interp(middle, ends, self.turns[:, axis]) for axis in range(3)])
        return np.asarray(Rotation.from_rotvec(turns).as_matrix())


def find_relinearised_path(zeta: Array, sigma: Array) -> RelinearisedPath | None:
    """The path of an interval; None where first order is enough.

    Parameters
    ----------
    zeta : (m, 3) attitude errors of the propagation in inertial axes at the references, rad
    sigma : (m, 3) of the references, rad
    """
    largest = float(np.linalg.norm(zeta, axis=1).max())
    if 0.5 * largest**2 < SMALL * float(sigma.min()):
        return None
    wanted = (float(sigma.max()) / (NOISE * largest)) ** 2
    count = int(np.clip(np.ceil(wanted), 1, max(1, WIDEST * len(zeta))))
    smooth = scipy.ndimage.uniform_filter1d(zeta, count, axis=0, mode="nearest")
    S, E = Rotation.from_rotvec(smooth), Rotation.from_rotvec(zeta)
    run = np.cumsum((S[1:] * S[:-1].inv()).as_rotvec(), axis=0)
    # S begins at the average of the first references, not at the first, so that its own turn comes first.
    errors = smooth[0] + np.concatenate([np.zeros((1, 3)), run]) + (E * S.inv()).as_rotvec()
    return RelinearisedPath(errors, smooth)
