"""Kalibr's imu.yaml: the noise density of a gyro, read and written, and its calibration as Kalibr has it.

gyroscope_noise_density N in rad/s/√Hz is the angle random walk in rad/√s: Kalibr takes N/√Δt for the sigma of a sample,
as here.

Kalibr's gyro of model scale-misalignment measures M C ω + bias, M lower triangular and C (C_gyro_i) a rotation from the IMU's
axes to the gyro's. With ω = G ω_raw + b it measures G⁻¹ ω − G⁻¹ b: so M C = G⁻¹, split by the QR decomposition of its
transpose, G⁻ᵀ = Q R, M = Rᵀ, C = Qᵀ, with signs that make the diagonal of M positive.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal.deprecation import build_getattr
from gyrocal.errors import InputError
from gyrocal.files import open_replacement
from gyrocal.recording import Recording, format_toml
from gyrocal.recording.gyros import need_triad

Array = NDArray[np.float64]


def read_yaml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """A YAML file of keys and values; OpenCV's first line is skipped."""
    try:
        import yaml
    except ImportError:
        raise InputError(f"{path}: PyYAML is needed to read it: pip install 'gyrocal[formats]'") from None
    try:
        text = Path(path).read_text(encoding="utf-8")
        found = yaml.safe_load("\n".join(line for line in text.splitlines() if not line.startswith("%")))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as fault:
        raise InputError(f"{path}: cannot be read as YAML: {' '.join(str(fault).split())}") from None
    if not isinstance(found, dict):
        raise InputError(f"{path}: not a file of keys and values")
    return found


def read_noise_density(path: str | os.PathLike[str]) -> float:
    """Angle random walk, deg/sqrt(s), of Kalibr's imu.yaml or EuRoC's sensor.yaml: rad/s/sqrt(Hz) is rad/sqrt(s).

    Raises
    ------
    InputError
        There is no positive gyroscope_noise_density.
    """
    entries = read_yaml(path)
    value = entries.get("gyroscope_noise_density", next(iter(entries.values()), None))
    if isinstance(value, dict):  # imu0: {gyroscope_noise_density: …}
        value = value.get("gyroscope_noise_density")
    if isinstance(value, str):  # YAML 1.1 takes 1e-3, without a point, for a text
        with suppress(ValueError):
            value = float(value)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1:
        raise InputError(f"{path}: gyroscope_noise_density must be a positive number of rad/s/sqrt(Hz)")
    return float(np.rad2deg(value))


def decompose_gain(G: ArrayLike) -> tuple[Array, Array]:
    """Kalibr's M (3, 3), lower triangular, and C_gyro_i (3, 3), a rotation, of G (3, 3).

    Raises
    ------
    InputError
        G is singular, or turns right-handed axes into left-handed ones.
    """
    G = np.asarray(G, dtype=np.float64)
    if G.shape != (3, 3) or not np.isfinite(G).all() or np.linalg.det(G) < 1e-3:
        raise InputError("Kalibr: G must be 3×3, not singular, of right-handed axes")
    Q, R = np.linalg.qr(np.linalg.inv(G).T)
    signs = np.sign(np.diag(R))
    return np.asarray((signs[:, None] * R).T), np.asarray((Q * signs).T)


def _format_flow(values: ArrayLike) -> str:
    """Numbers as YAML 1.1 reads them: with a point before an exponent."""
    if np.ndim(values):
        return "[" + ", ".join(_format_flow(one) for one in np.asarray(values)) + "]"
    text = repr(float(np.asarray(values)))
    return text if "." in text else text.replace("e", ".0e")


def write_imu_yaml(
    recording: Recording,
    path: str | os.PathLike[str],
    *,
    G: ArrayLike | None = None,
    bias: ArrayLike | None = None,
    random_walk: float | None = None,
    topic: str = "/imu0",
    remarks: Sequence[str] = (),
) -> None:
    """Write what a recording and its calibration say of the gyro.

    Parameters
    ----------
    recording : its noise and rate of samples are written
    path : file
    G, bias : (3, 3), and (3,) rad/s, of a calibration; both or neither
    random_walk : of the bias, rad/s/√s (Kalibr: rad/s²/√Hz); Kalibr needs one, and no recording states it
    topic : of ROS
    remarks : lines of comment

    Raises
    ------
    InputError
        A number cannot be Kalibr's, or the gyros are others than x, y and z.
    """
    need_triad(recording.gyro)
    if not recording.gyro.arw > 0:
        raise InputError("Kalibr: the recording's angle random walk is zero, and Kalibr takes positive noise only")
    if random_walk is not None and not 0 < random_walk < 1:
        raise InputError("Kalibr: the random walk of the bias must be positive, in rad/s/sqrt(s)")
    if (G is None) != (bias is None):
        raise InputError("Kalibr: give G and bias of a calibration, or neither")
    lines = [
        f"# {' '.join(recording.title.split())}, by gyrocal. Kalibr also needs accelerometer_noise_density and _random_walk.",
        *(f"# {line}" for line in remarks),
        f"gyroscope_noise_density: {_format_flow(recording.gyro.arw)}  # rad/s/sqrt(Hz): the angle random walk in rad/sqrt(s)",
        "# gyroscope_random_walk is not known: the recording does not state it"
        if random_walk is None
        else f"gyroscope_random_walk: {_format_flow(random_walk)}  # rad/s^2/sqrt(Hz)",
        f"rostopic: {format_toml(topic)}",
        f"update_rate: {_format_flow(1 / recording.gyro.sample_s)}",
    ]
    if G is not None and bias is not None:
        M, C = decompose_gain(G)
        offset = -np.linalg.solve(np.asarray(G, dtype=np.float64), np.asarray(bias, dtype=np.float64))
        lines += ["model: scale-misalignment  # measured = M C_gyro_i w + bias", "gyroscopes:"]
        lines += [f"  {name}: {_format_flow(values)}" for name, values in (("M", M), ("C_gyro_i", C))]
        lines += ["  A: [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]  # of accelerations: not estimated"]
        lines += [f"# bias, which Kalibr estimates anew: {_format_flow(offset)} rad/s"]
    with open_replacement(path) as file:
        file.write(("\n".join(lines) + "\n").encode())


__getattr__ = build_getattr(__name__, {"noise_density": "read_noise_density"})
