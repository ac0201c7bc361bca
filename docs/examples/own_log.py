"""Write gyro.csv and mocap.csv as a logger on a desk might: a MEMS gyro at 50 Hz beside motion capture at 2 Hz.

Nothing of gyrocal is used, so that the truth is known by other means: the gyro's scale factors are 1 % high, its biases are
+0.3, −0.2 and +0.1 deg/s, and it shows each rate 12 ms late.

    python docs/examples/own_log.py /tmp/desk
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

SECONDS, STEP_S, EVERY_S = 120.0, 0.02, 0.5
SCALE, BIAS_DEG_S, LATE_S = 1.01, [0.3, -0.2, 0.1], 0.012
NOISE_DEG_PER_SQRT_S, SIGMA_DEG = 0.005, 0.1


def body_to_world(times):
    """The motion: three swinging angles, at rest in the first and the last ten seconds."""
    moving = np.clip(np.minimum(times - 10, SECONDS - 10 - times) / 5, 0, 1) ** 2
    angles = [50 * np.sin(0.9 * times), 40 * np.sin(0.63 * times + 1), 70 * np.sin(0.41 * times)]
    return Rotation.from_euler("ZYX", (np.array(angles) * moving).T, degrees=True)


def gyro(rng):
    """Mean rates over each sample, as the uncalibrated gyro shows them."""
    tags = np.arange(0.0, SECONDS, STEP_S)
    turns = body_to_world(tags - LATE_S).inv() * body_to_world(tags - LATE_S + STEP_S)
    rates = np.rad2deg(turns.as_rotvec()) / STEP_S
    shown = SCALE * rates + BIAS_DEG_S + rng.normal(0, NOISE_DEG_PER_SQRT_S / np.sqrt(STEP_S), rates.shape)
    return pd.DataFrame(shown, columns=["gx", "gy", "gz"]).assign(time_ms=np.round(1e3 * tags).astype(int))


def mocap(rng):
    """Orientations, scalar first, of the body in the world."""
    times = np.arange(0.0, SECONDS, EVERY_S)
    error = Rotation.from_rotvec(np.deg2rad(SIGMA_DEG) * rng.normal(size=(times.size, 3)))
    q = (body_to_world(times) * error).as_quat()[:, [3, 0, 1, 2]]
    return pd.DataFrame(q, columns=["qw", "qx", "qy", "qz"]).assign(time_ms=np.round(1e3 * times).astype(int))


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(7)
    gyro(rng).to_csv(folder / "gyro.csv", index=False)
    mocap(rng).to_csv(folder / "mocap.csv", index=False)
