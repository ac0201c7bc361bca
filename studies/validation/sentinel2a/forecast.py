"""Both trackers' attitudes from 65 s to 97 s, by the gyros alone.

Times go on as the first tracker's did, every 0.1 s. A row's `sigma_…` is that of a reading of the tracker about its own axes:
of the attitude by gyro, of the mounting, and of the tracker's noise, which is most of it. `attitude_sigma_…` is that of the
attitude and the mounting alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gyrocal import attitude
from gyrocal.estimation.predict import predict
from studies.validation.sentinel2a.findings import reading_covariance
from studies.validation.sentinel2a.flown import ARCSEC, WINDOW_S, Flown, known

STEP_S = 0.1
ELEMENTS = [f"q{k}" for k in (1, 2, 3, 4)]


def forecast_rows(flown: Flown) -> list[dict[str, Any]]:
    """A row a time."""
    gyro = flown.recording.gyro
    last = flown.streams.sensors[0].t_s[-1]
    times = last + STEP_S * np.arange(1, int((gyro.t_s[-1] + gyro.sample_s - last) / STEP_S) + 1)
    found = predict(flown.recording, WINDOW_S, times, known())
    columns: dict[str, Any] = {"t_s": found.t_s}
    for name, M in flown.dense.mounting.items():
        # The file's quaternion from tracker to inertial is, scalar last, A(q) of the tracker.
        q = attitude.quaternion_from_matrix(M.T @ found.A)
        before = next(one for one in flown.streams.sensors if one.name == name).q[-1]
        q *= np.sign(q @ before)[:, None]
        whole = reading_covariance(flown, name, found)
        without = whole - np.diag(np.square(flown.sigma[name]))
        columns |= {f"{name.lower()}_{element}": q[:, k] for k, element in enumerate(ELEMENTS)}
        for label, covariance in (("sigma", whole), ("attitude_sigma", without)):
            sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)) * ARCSEC
            columns |= {f"{name.lower()}_{label}_{axis}_arcsec": sigma[:, k] for k, axis in enumerate("xyz")}
    return [{"kind": "prediction", **dict(zip(columns, values, strict=True))} for values in zip(*columns.values(), strict=True)]
