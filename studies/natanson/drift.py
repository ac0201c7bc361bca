"""A bias that walks between the months: N calibrates December's and January's intervals together, with one b.

The scenario "trmm_drift" flies N Table 1 with random walks of the bias of the size that R Table 3's scatter allows at most.
From the middle of December's intervals to January's a walk of K moves the bias by K √T, T = 30 d: 0.11 deg/h for K of R's x.
Three questions, at none, a quarter, a half and all of that scatter:

- what a calibration of all six intervals leaves, in December's and in January's; N's residuals are beside it;
- what one of December's four intervals leaves in January's two, whose residuals it has not seen;
- what is left there if b is solved for again in January and G kept, as R's ground solutions did.

December's four intervals are twelve numbers for twelve parameters, and are met exactly: what they determine worst they
determine badly, and January's residuals show it without any drift too. The rows are to be compared with the first.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from gyrocal import calibrate
from simulator import adopted_scenario
from simulator.adopted_scenario import AdoptedScenario
from studies.calibration.maneuvers_needed import select_intervals
from studies.natanson import flight
from studies.natanson.flight_gap import compute_residuals
from studies.reproduction import call_all

Array = NDArray[np.float64]

SCENARIO = "trmm_drift"
SCATTER_FRACTIONS = (0.0, 0.25, 0.5, 1.0)  # of R Table 3's scatter
DRIFT_SEEDS = 40
DECEMBER, JANUARY = (0, 1, 2, 3), (4, 5)


def build_drift_table(
    entropy: int, seeds: int = DRIFT_SEEDS, scales: Sequence[float] = SCATTER_FRACTIONS, jobs: int = 1
) -> pd.DataFrame:
    """RMS residuals (deg, medians over seeds) by the size of the walks, the flight's in the last row.

    share_below_flight: of the seeds, how many leave as little in January's intervals as the flight did after N's calibration.
    """
    after = flight.read_published_residuals("calibrated")
    limit = _compute_interval_rms(after, JANUARY)
    rows: list[dict[str, object]] = []
    for scale, cases in zip(
        scales, call_all([partial(_run_drift_cases, scale, entropy, seeds) for scale in scales], jobs), strict=True
    ):
        row: dict[str, object] = {"scatter_of_R": scale, **{str(name): x for name, x in cases.median().items()}}
        rows.append(row | {"share_below_flight": float((cases["six_january_deg"] <= limit).mean())})
    known = {"six_december_deg": _compute_interval_rms(after, DECEMBER), "six_january_deg": limit}
    return pd.DataFrame([*rows, {"scatter_of_R": "flight", **known}])


def _run_drift_cases(scale: float, entropy: int, seeds: int) -> pd.DataFrame:
    flown = adopted_scenario.load(SCENARIO)
    return pd.DataFrame([run_drift_case(flown, scale, entropy, number) for number in range(seeds)])


def run_drift_case(flown: AdoptedScenario, scale: float, entropy: int, number: int) -> dict[str, float]:
    """RMS residuals of one seed, deg, by what is calibrated and where they are."""
    effects = [replace(one, size=scale * one.size) for one in flown.effects] if scale > 0 else []
    recording = flown.fly(entropy, number, effects)
    december, january = (select_intervals(recording, which) for which in (DECEMBER, JANUARY))
    six, first = calibrate(recording).parameters, calibrate(december).parameters
    again = calibrate(january, initial=first, solve_for="bias").parameters
    six_residuals = compute_residuals(recording, six)
    return {
        "six_december_deg": _compute_interval_rms(six_residuals, DECEMBER),
        "six_january_deg": _compute_interval_rms(six_residuals, JANUARY),
        "december_january_deg": _compute_interval_rms(compute_residuals(recording, first), JANUARY),
        "new_bias_january_deg": float(flight.compute_rms(compute_residuals(january, again).ravel())),
    }


def _compute_interval_rms(values: Array, intervals: Sequence[int]) -> float:
    return float(flight.compute_rms(values[list(intervals)].ravel()))
