"""The recording, and what is known of the gyros beforehand.

Known beforehand of gyros with ω_raw = K ω + c, K a regular tetrahedron turned to the trackers by the import: the turn to
`MOUNTING` (the rates hardly vary, so that the import finds it to a few degrees about the mean rate only), the size of a count
to `SCALE`, each element of K to `SHAPE`, and the biases to `BIAS_DEG_H`.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.gyros import build_prior_covariance
from gyrocal.estimation.predict import prior_covariance
from gyrocal.importing import import_csv, load_mapping, validate_mapping
from gyrocal.importing.build import ImportResult
from gyrocal.recording.gyros import compute_nominal_gyros

Array = NDArray[np.float64]

SENTINEL_FOLDER = Path(__file__).parents[2] / "data" / "sentinel2a"
SENTINEL_ATTRIBUTION = "Contains modified Copernicus Sentinel data 2020."
ARCSEC_PER_RAD = float(np.rad2deg(1.0) * 3600)
LSB_RAD = 5e-9
MOUNTING, SCALE, SHAPE, BIAS_DEG_H = 0.05, 0.01, 1e-3, 1.0
WINDOW_END_S = 65.0  # to where there are attitudes


@cache
def import_flight_data() -> ImportResult:
    """Import the data."""
    mapping = validate_mapping(load_mapping(SENTINEL_FOLDER / "mapping.toml"), "mapping.toml")
    return import_csv(SENTINEL_FOLDER / "imu.csv", SENTINEL_FOLDER / "str.csv", mapping=mapping)


def build_body_prior(mounting: bool = True, scale: bool = True, bias: bool = True) -> Array:
    """(12, 12) covariance of G and b of the body rates; what is not to be fitted is held to 1e-8, or to 1e-8 deg/h."""
    held = 1e-8
    return prior_covariance(
        SHAPE if mounting and scale and bias else held,
        float(np.deg2rad((BIAS_DEG_H if bias else held) / 3600)),
        MOUNTING if mounting else held,
        SCALE if scale else held,
    )


def build_gyro_prior(flown: ImportResult) -> Array:
    """(16, 16) covariance of the four gyros' K and c."""
    K, _ = compute_nominal_gyros(flown.recording.gyro)
    return build_prior_covariance(K, SHAPE, float(np.deg2rad(BIAS_DEG_H / 3600)), MOUNTING, SCALE)
