"""Compiled steps of an error-state Kalman filter: exact transition, exact process noise, covariance, correction.

The state is the attitude error and the error of solved-for gyro parameters, with the signs of the calibration:

    s = (θ, Δx),    A_true = exp([θ×]) A,    Δx = x − x_true

With ω = G ω_raw + b held over a step, θ' = −ω × θ + F Δx + noise to first order. Hence over Δt, N (20)–(22),

    Φ = [[R, ψF], [0, I]],    R = exp(−[ω×]Δt) = I − (1 − d φ²)[φ×] + c [φ×]²,    ψ, c, d as in
    `gyrocal.calibration.propagation`

White rate noise of root PSD ARW (rad/√s) turns with the body and stays white: it adds ARW² Δt I to the attitude. A bias that
walks, b_true' = w of root PSD RRW (rad/s^1.5), moves the state by −(ψ(Δt − τ) w, w) dτ, so that it adds RRW² times

    ∫ψψᵀ dτ = Δt³ (I/3 + e [φ×]²),    e = (φ³/3 − 2φ + 2 sin φ)/φ⁵
    ∫ψ dτ  = Δt² (I/2 − d [φ×] + f [φ×]²),    f = (φ²/2 + cos φ − 1)/φ⁴
    Δt I

to the attitude block, the block between attitude and bias, and the bias block.

A measurement with the residual z = H θ + noise of covariance N changes the state by the Kalman gain, and the covariance by
Joseph's form, which stays positive definite and holds for any gain:

    K = P Hᵀ S⁻¹,  S = H P Hᵀ + N,    ŝ = K z,    P ← (I − K H) P (I − K H)ᵀ + K N Kᵀ

Then A ← exp([θ̂×]) A and x ← x − Δx̂, and the state starts from zero again.
"""

from math import cos, sin, sqrt

import numpy as np

from gyrocal.arrays import Array, Indices
from gyrocal.jit_cache import compile_cached

COVARIANCE_SERIES_LIMIT = 1.0  # rad; the closed forms below lose up to five digits of a covariance there, the series none
SERIES_TERMS = 9


@compile_cached
def compute_step_integrals(phi: float) -> tuple[float, float, float, float]:
    """Compute c, d, e, f of a step that turns by phi ≥ 0 rad."""
    x = phi * phi
    if phi >= COVARIANCE_SERIES_LIMIT:
        return (
            (1 - cos(phi)) / x,
            (phi - sin(phi)) / (x * phi),
            (phi * x / 3 - 2 * phi + 2 * sin(phi)) / (x * x * phi),
            (x / 2 + cos(phi) - 1) / (x * x),
        )
    c = d = e = f = 0.0
    term = 0.5  # (−x)^k / (2k + 2)!
    for k in range(SERIES_TERMS):
        c += term
        d += term / (2 * k + 3)
        f += term / ((2 * k + 3) * (2 * k + 4))
        e += 2 * term / ((2 * k + 3) * (2 * k + 4) * (2 * k + 5))
        term *= -x / ((2 * k + 3) * (2 * k + 4))
    return c, d, e, f


@compile_cached
def compute_rotation(x: float, y: float, z: float, R: Array) -> tuple[float, float]:
    """Write R = exp(−[φ×]) of φ = (x, y, z) rad into (3, 3); return c and d."""
    xx, yy, zz = x * x, y * y, z * z
    squared = xx + yy + zz
    c, d, _, _ = compute_step_integrals(sqrt(squared))
    s = 1 - d * squared
    R[0, 0], R[1, 1], R[2, 2] = 1 - c * (yy + zz), 1 - c * (xx + zz), 1 - c * (xx + yy)
    R[0, 1], R[1, 0] = c * x * y + s * z, c * x * y - s * z
    R[0, 2], R[2, 0] = c * x * z - s * y, c * x * z + s * y
    R[1, 2], R[2, 1] = c * y * z + s * x, c * y * z - s * x
    return c, d


@compile_cached
def compute_transition(x: Array, raw: Array, dt: float, columns: Indices, R: Array, B: Array) -> tuple[float, float, float]:
    """Write R and B = ψF of one step into (3, 3) and (3, p).

    ψ = (I − c [φ×] + d [φ×]²) Δt with φ = ω Δt, and column q of F is e_a times ω_raw or 1. Returns φ, rad.

    x: (12,) G row by row and b
    raw: (3,) rad/s
    columns: (p,) positions of the solved-for parameters among the twelve
    """
    wx = (x[0] * raw[0] + x[1] * raw[1] + x[2] * raw[2] + x[9]) * dt
    wy = (x[3] * raw[0] + x[4] * raw[1] + x[5] * raw[2] + x[10]) * dt
    wz = (x[6] * raw[0] + x[7] * raw[1] + x[8] * raw[2] + x[11]) * dt
    xx, yy, zz = wx * wx, wy * wy, wz * wz
    c, d = compute_rotation(wx, wy, wz, R)
    for q in range(len(columns)):
        axis, h = (columns[q] // 3, raw[columns[q] % 3] * dt) if columns[q] < 9 else (columns[q] - 9, dt)
        if axis == 0:
            B[0, q], B[1, q], B[2, q] = h * (1 - d * (yy + zz)), h * (d * wx * wy - c * wz), h * (d * wx * wz + c * wy)
        elif axis == 1:
            B[0, q], B[1, q], B[2, q] = h * (d * wx * wy + c * wz), h * (1 - d * (xx + zz)), h * (d * wy * wz - c * wx)
        else:
            B[0, q], B[1, q], B[2, q] = h * (d * wx * wz - c * wy), h * (d * wy * wz + c * wx), h * (1 - d * (xx + yy))
    return wx, wy, wz


@compile_cached
def compute_process_noise(angle: tuple[float, float, float], dt: float, arw: float, walk: float) -> tuple[Array, Array, float]:
    """Compute the covariance of one step: attitude (3, 3), attitude and bias (3, 3), variance of each bias."""
    px, py, pz = angle
    Q, cross = np.zeros((3, 3)), np.zeros((3, 3))
    for i in range(3):
        Q[i, i] = arw * arw * dt
    if walk == 0.0:
        return Q, cross, 0.0
    squared = px * px + py * py + pz * pz
    _, d, e, f = compute_step_integrals(sqrt(squared))
    p = np.array([px, py, pz])
    K = np.array([[0.0, -pz, py], [pz, 0.0, -px], [-py, px, 0.0]])
    w = walk * walk
    for i in range(3):
        for j in range(3):
            unit = 1.0 if i == j else 0.0
            square = p[i] * p[j] - squared * unit
            Q[i, j] += w * dt**3 * (unit / 3 + e * square)
            cross[i, j] = w * dt**2 * (unit / 2 - d * K[i, j] + f * square)
    return Q, cross, w * dt


@compile_cached
def propagate_covariance(P: Array, R: Array, B: Array, Q: Array, cross: Array, bias_variance: float) -> None:
    """Propagate P ← Φ P Φᵀ + noise in place, P (3 + p, 3 + p); with a walking bias the last three states are the biases."""
    n = len(P)
    top = np.empty((3, n))
    for i in range(3):
        for j in range(n):
            value = R[i, 0] * P[0, j] + R[i, 1] * P[1, j] + R[i, 2] * P[2, j]
            for q in range(n - 3):
                value += B[i, q] * P[3 + q, j]
            top[i, j] = value
    for i in range(3):
        for j in range(i, 3):
            value = top[i, 0] * R[j, 0] + top[i, 1] * R[j, 1] + top[i, 2] * R[j, 2] + Q[i, j]
            for q in range(n - 3):
                value += top[i, 3 + q] * B[j, q]
            P[i, j] = value
            P[j, i] = value
        for j in range(3, n):
            value = top[i, j] + (cross[i, j - n + 3] if bias_variance > 0 and j >= n - 3 else 0.0)
            P[i, j] = value
            P[j, i] = value
    if bias_variance > 0:
        for i in range(n - 3, n):
            P[i, i] += bias_variance


@compile_cached
def rotate_attitude(A: Array, R: Array) -> None:
    """Rotate A ← R A in place."""
    for j in range(3):
        x, y, z = A[0, j], A[1, j], A[2, j]
        for i in range(3):
            A[i, j] = R[i, 0] * x + R[i, 1] * y + R[i, 2] * z


@compile_cached
def propagate_step(
    A: Array, P: Array, x: Array, raw: Array, dt: float, columns: Indices, arw: float, walk: float, R: Array, B: Array
) -> None:
    """Propagate A (3, 3) and P (3 + p, 3 + p) over one step in place, and set its R and B; the others as in `advance`."""
    angle = compute_transition(x, raw, dt, columns, R, B)
    Q, cross, bias_variance = compute_process_noise(angle, dt, arw, walk)
    propagate_covariance(P, R, B, Q, cross, bias_variance)
    rotate_attitude(A, R)


@compile_cached
def correct_attitude(A: Array, theta: Array) -> Array:
    """Compute exp([θ×]) A, taken to the nearest orthogonal matrix by a Newton step, A ← ½ A (3 I − AᵀA)."""
    R, rotated = np.empty((3, 3)), np.empty((3, 3))
    compute_rotation(-theta[0], -theta[1], -theta[2], R)
    for i in range(3):
        for j in range(3):
            rotated[i, j] = R[i, 0] * A[0, j] + R[i, 1] * A[1, j] + R[i, 2] * A[2, j]
    for i in range(3):
        for j in range(3):
            square = rotated[0, i] * rotated[0, j] + rotated[1, i] * rotated[1, j] + rotated[2, i] * rotated[2, j]
            R[i, j] = 1.5 - 0.5 * square if i == j else -0.5 * square
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = rotated[i, 0] * R[0, j] + rotated[i, 1] * R[1, j] + rotated[i, 2] * R[2, j]
    return out


@compile_cached
def advance(
    A: Array,
    P: Array,
    Phi: Array,
    x: Array,
    columns: Indices,
    tags: Array,
    rates: Array,
    first: int,
    start: float,
    stop: float,
    arw: float,
    walk: float,
) -> int:
    """Propagate over the stream from one time to another, in place, cutting samples at both.

    Returns the sample that holds at `stop`.

    A, P: (3, 3) attitude and (3 + p, 3 + p) covariance, changed
    Phi: (3, 3 + p) upper rows of the transition matrix over the arc, set
    tags: (samples,) when a sample's rate begins to hold, which it does until the next one's does
    rates: (samples, 3) raw rates, rad/s
    first: sample that holds at `start`
    others: as in `compute_transition` and `compute_process_noise`
    """
    p = len(columns)
    R, B = np.empty((3, 3)), np.empty((3, p))
    Phi[:] = 0.0
    for i in range(3):
        Phi[i, i] = 1.0
    k, t = first, start
    while True:
        while k + 1 < len(tags) and tags[k + 1] <= t:
            k += 1
        if t >= stop:
            return k
        until = min(stop, tags[k + 1]) if k + 1 < len(tags) else stop
        propagate_step(A, P, x, rates[k], until - t, columns, arw, walk, R, B)
        for j in range(3 + p):
            a, b, c = Phi[0, j], Phi[1, j], Phi[2, j]
            for i in range(3):
                Phi[i, j] = R[i, 0] * a + R[i, 1] * b + R[i, 2] * c + (B[i, j - 3] if j >= 3 else 0.0)
        t = until


@compile_cached
def compute_kalman_gain(P: Array, H: Array, sigma: Array, z: Array) -> tuple[Array, Array, float]:
    """Compute K (n, m), S (m, m) and zᵀS⁻¹z of a measurement, H (m, 3)."""
    PH = np.ascontiguousarray(P[:, :3]) @ H.T
    S = H @ PH[:3] + np.diag(sigma * sigma)
    weight = np.linalg.inv(S)
    return PH @ weight, S, float(z @ weight @ z)


@compile_cached
def update_covariance(P: Array, K: Array, H: Array, sigma: Array) -> None:
    """Update P ← (I − K H) P (I − K H)ᵀ + K N Kᵀ in place, N = diag(σ²)."""
    complement = np.eye(len(P))
    complement[:, :3] -= K @ H  # which only meets the attitude
    P[:] = complement @ P @ complement.T + (K * (sigma * sigma)) @ K.T
    P[:] = 0.5 * (P + P.T)
