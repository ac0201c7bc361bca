"""Both trackers' attitudes from 65 s to 97 s, by the gyros alone: what ``gyrocal predict --from 65 --step 0.1`` writes of them.

Times go on as the first tracker's did. A row's `sigma_…` is that of a reading of the tracker about its own axes: of the
attitude by gyro, of the mounting, and of the tracker's noise, which is most of it. `attitude_sigma_…` is that of the attitude
and the mounting alone. Quaternions are tracker to inertial, scalar last, as in the data, and go on in their sign.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gyrocal.estimation.predict import predict, steps
from gyrocal.importing.build import Imported
from studies.report.prediction_page import rows
from studies.validation.sentinel2a.flown import WINDOW_S, known

STEP_S = 0.1


def forecast_rows(flown: Imported) -> list[dict[str, Any]]:
    """A row a time."""
    last = float(flown.sensors[0].t_s[-1])
    table = rows(predict(flown.recording, WINDOW_S, steps(flown.recording, last, STEP_S), known()))
    for sensor in flown.sensors:
        names = [f"{sensor.name.lower()}_q{k}" for k in (1, 2, 3, 4)]
        q = table[names].to_numpy()
        table[names] = q * np.sign(q @ sensor.q[-1])[:, None]
    kept = ["t_s", *(name for name in table.columns if name.startswith(tuple(f"{one.name.lower()}_" for one in flown.sensors)))]
    return [
        {"kind": "prediction", **{str(name): value for name, value in row.items()}} for row in table[kept].to_dict("records")
    ]
