r"""Expected error of G from noise in the rates (errors in variables), which makes G too small.

The rates that are propagated are also those that G multiplies. With white noise n of density ARW² in them, the residuals hold
G n, and so does Θ: for G_ij, Θ_a,ij has the noise ∫ Φ_a(s) e_i n_j(s) ds where θ_a has ∫ Φ_a(s) G n(s) ds, Φ_a(s) being the
rotation from the time s to residual a. At the solution of N (31)–(33), E[Θᵀ V⁻¹ (Θ Δx + θ_n)] = 0 leaves an error

    E[Δx] = −P E[Θᵀ V⁻¹ θ_n],    E[Θᵀ V⁻¹ θ_n]_ij = ARW² e_iᵀ ∫ M(s) ds G e_j,
    M(s) = Σ_{a,b after s} Φ_a(s)ᵀ (V⁻¹)_ab Φ_b(s),

the attenuation of regression on a noisy variable (Fuller, Measurement Error Models, Wiley 1987, section 1.1). It is small next
to sigma where the body turns by much more than the noise between two references, as in the papers' maneuvers, and grows with
the number of references.

M(s) is the information of all residuals about a turn at s. In inertial axes, differences of residuals that follow each other
have the block tridiagonal covariance T of the steps between references,

    T_kk = ARW² Δt_k + S_(k−1) + S_k,    T_k,k+1 = −S_k,    S_k = A_kᵀ diag(σ_k²) A_k,

and a turn within step k is in difference k alone, so that M = (T⁻¹)_kk there. By elimination from both ends,

    F_k = T_kk − S_(k−1) F_(k−1)⁻¹ S_(k−1),    B_k = T_kk − S_k B_(k+1)⁻¹ S_k,    (T⁻¹)_kk = (F_k + B_k − T_kk)⁻¹.

A reference that ends one interval and starts the next is taken as two. Within a step M turns with the body; its mean is taken
from both ends, which is exact where σ is the same about all axes.
"""

import numpy as np

from gyrocal.arrays import Array
from gyrocal.calibration.problem import Problem


def integrate_information(A: Array, noise: Array, elapsed_s: Array, arw: float) -> Array:
    """Integrate M(s) over an interval.

    Returns (3, 3) in body axes, s/rad².

    A: (m + 1, 3, 3) attitudes at the references of the interval
    noise: (m + 1, 3, 3) covariance of these about the body axes, rad²
    elapsed_s: (m,) s from the first to the others
    arw: rad/sqrt(s)
    """
    dt = np.diff(elapsed_s, prepend=0.0)
    S = A.swapaxes(1, 2) @ noise @ A
    T = arw**2 * dt[:, None, None] * np.eye(3) + S[:-1] + S[1:]
    forward, backward = T.copy(), T.copy()
    for k in range(1, len(T)):
        forward[k] -= S[k] @ np.linalg.solve(forward[k - 1], S[k])
        backward[-1 - k] -= S[-1 - k] @ np.linalg.solve(backward[-k], S[-1 - k])
    M = np.linalg.inv(forward + backward - T)
    ends = [np.einsum("aij,ajk,alk->ail", attitudes, M, attitudes) for attitudes in (A[:-1], A[1:])]
    return np.asarray(np.einsum("a,aij->ij", 0.5 * dt, ends[0] + ends[1]))


def estimate_attenuation(problem: Problem, G: Array, P: Array) -> Array:
    """Estimate E[Δx] (12,) of G and b, in the order of `gyrocal.NAMES`; b in rad/s.

    problem: with the full covariance
    G, P: (3, 3) calibrated, and the (12, 12) covariance of G and b
    """
    measurements = problem.measurements
    arw = problem.arw * float(np.sqrt(measurements.noise_gain))
    total = np.zeros((3, 3))
    for arc in np.unique(measurements.arcs.arc):
        members = np.flatnonzero(measurements.arcs.arc == arc)
        rows = np.append(measurements.start[members[0]], measurements.row[members])
        total += integrate_information(problem.A[rows], problem.noise[rows], measurements.elapsed_s[members], arw)
    return np.asarray(-P @ np.append((arw**2 * total @ G).ravel(), np.zeros(3)))
