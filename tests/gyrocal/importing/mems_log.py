"""The log of a simulated MEMS gyro and a motion-capture system, as two tables like a user's.

Body rates are sums of sines about each axis between two rests. They are constant over each sample of the gyro, so that the
attitude is an exact product of rotations by scipy, independent of the calibrator's propagation. ω = G ω_raw + b, as everywhere.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array

MEMS_SAMPLE_S = 0.01
SAMPLES_PER_ATTITUDE = 10  # gyro samples between attitudes
SECONDS = 180.0
REST_S = 6.0
TONES = 4  # about each axis
TURN_RATES_DEG_S = (10.0, 30.0)
FREQUENCIES_HZ = (0.05, 0.6)
G_SIGMA = 0.01
BIAS_DEG_S = 0.4
MEMS_ARW_DEG_PER_SQRT_S = 0.005
REFERENCE_SIGMA_DEG = 0.1
UNIX_MS = 1_700_000_000_123


@dataclass(frozen=True)
class MemsLog:
    """Both tables and the truth."""

    gyro: pd.DataFrame  # timestamp_ms (unix time), gx, gy, gz (deg/s)
    attitude: pd.DataFrame  # timestamp_ms, qw, qx, qy, qz: body to world
    G: Array  # G, bias: (3, 3), and (3,) rad/s
    bias: Array


def log(rng: np.random.Generator, seconds: float = SECONDS) -> MemsLog:
    """Draw a motion, a gyro and their noise."""
    count = round(seconds / MEMS_SAMPLE_S)
    t = np.arange(count) * MEMS_SAMPLE_S
    size, frequency, phase = (rng.uniform(*span, (TONES, 3)) for span in (TURN_RATES_DEG_S, FREQUENCIES_HZ, (0.0, 2 * np.pi)))
    omega = np.sum(size * np.sin(2 * np.pi * frequency * t[:, None, None] + phase), axis=1)
    ramp = np.clip(np.minimum(t - REST_S, seconds - REST_S - t), 0.0, 1.0)
    omega = np.deg2rad(omega * ramp[:, None])
    G = np.eye(3) + rng.normal(size=(3, 3)) * G_SIGMA
    bias = np.deg2rad(BIAS_DEG_S) * rng.choice([-1.0, 1.0], 3)
    white = rng.normal(size=(count, 3)) * np.deg2rad(MEMS_ARW_DEG_PER_SQRT_S) / np.sqrt(MEMS_SAMPLE_S)
    raw = np.linalg.solve(G, (omega - bias).T).T + white
    attitudes = _integrate_attitudes(omega, Rotation.random(random_state=rng).as_matrix())[::SAMPLES_PER_ATTITUDE]
    error = Rotation.from_rotvec(rng.normal(size=(len(attitudes), 3)) * np.deg2rad(REFERENCE_SIGMA_DEG))
    q = np.roll((Rotation.from_matrix(attitudes) * error).as_quat(), 1, axis=1)
    step_ms = round(1e3 * MEMS_SAMPLE_S)
    gyro = pd.DataFrame(np.rad2deg(raw), columns=["gx", "gy", "gz"])
    attitude = pd.DataFrame(q, columns=["qw", "qx", "qy", "qz"])
    gyro.insert(0, "timestamp_ms", UNIX_MS + step_ms * np.arange(count))
    attitude.insert(0, "timestamp_ms", UNIX_MS + step_ms * SAMPLES_PER_ATTITUDE * np.arange(len(q)))
    return MemsLog(gyro, attitude, G, bias)


def _integrate_attitudes(omega: Array, start: Array) -> Array:
    """Integrate body-to-world matrices (n + 1, 3, 3): C ← C exp([ω×]Δt)."""
    steps = Rotation.from_rotvec(omega * MEMS_SAMPLE_S).as_matrix()
    out = np.empty((len(steps) + 1, 3, 3))
    out[0] = start
    for k, step in enumerate(steps):
        out[k + 1] = out[k] @ step
    return out
