"""Recordings of a hand-held gyro with a remainder of known kind, simulated without the code under test."""

import numpy as np
from scipy.spatial.transform import Rotation

from gyrocal import Attitudes, GyroParameters, GyroStream, Interval, Recording

SAMPLE_S, SPACING_S, INTERVAL_S, INTERVALS = 0.05, 1.0, 12.0, 6
SIGMA, ARW = np.deg2rad(0.05), np.deg2rad(0.01)
MISALIGNED = np.array([[0.3, -0.5, 0.2], [0.4, -0.2, 0.6], [-0.3, 0.1, 0.5]])
TRUTH = GyroParameters(np.eye(3) + 1e-2 * MISALIGNED, np.deg2rad([0.3, -0.2, 0.1]))


def draw_ou(rng, times, time_scale, sigma):
    """Draw three axes (n, 3) of an Ornstein-Uhlenbeck process."""
    decay = np.exp(-np.diff(times) / time_scale)
    values = np.empty((times.size, 3))
    values[0] = rng.normal(size=3)
    for k, one in enumerate(decay):
        values[k + 1] = one * values[k] + np.sqrt(1 - one**2) * rng.normal(size=3)
    return sigma * values


def simulate_remainder(seed, rate=0.0, rate_scale_s=4.0, reference=0.0, reference_scale_s=4.0, delay_s=0.0):
    """Simulate a recording with a rate error (rad/s), a reference error (rad) and a delay (s) of these 1-sigma sizes."""
    rng = np.random.default_rng(seed)
    count = round(INTERVALS * INTERVAL_S / SAMPLE_S)
    t = SAMPLE_S * np.arange(count)
    phase, period = rng.uniform(0, 2 * np.pi, (3, 2)), np.array([[5.3, 1.9], [4.1, 2.3], [6.7, 1.7]])
    middle = (t + SAMPLE_S / 2)[:, None, None]
    rates = (np.sin(2 * np.pi * middle / period + phase) * np.deg2rad([40.0, 25.0])).sum(axis=2)
    steps = Rotation.from_rotvec(-rates * SAMPLE_S).as_matrix()
    A = np.empty((count + 1, 3, 3))
    A[0] = np.eye(3)
    for k in range(count):
        A[k + 1] = steps[k] @ A[k]
    errors = draw_ou(rng, t, rate_scale_s, rate) if rate else 0.0
    raw = np.linalg.solve(TRUTH.G, (rates + errors - TRUTH.bias).T).T + rng.normal(size=rates.shape) * ARW / np.sqrt(SAMPLE_S)
    every = round(SPACING_S / SAMPLE_S)
    rows = np.arange(0, count + 1, every)
    t_ref = SAMPLE_S * rows
    error = rng.normal(size=(rows.size, 3)) * SIGMA
    if reference:
        error = error + draw_ou(rng, t_ref, reference_scale_s, reference)
    if delay_s:
        error = error + rates[np.minimum(rows, count - 1)] * delay_s * rng.normal()
    observed = Rotation.from_rotvec(error).as_matrix() @ A[rows]
    names = [f"m{k + 1}" for k in range(INTERVALS)]
    intervals = tuple(Interval(name, "test", k * INTERVAL_S, (k + 1) * INTERVAL_S) for k, name in enumerate(names))
    return Recording(
        title="remainder",
        epoch="2000-01-01T00:00:00Z",
        gyro=GyroStream(t, raw, SAMPLE_S, ARW, TRUTH.G, TRUTH.bias),
        attitudes=Attitudes(t_ref, Rotation.from_matrix(observed.transpose(0, 2, 1)).as_quat(), np.full((rows.size, 3), SIGMA)),
        intervals=intervals,
    )
