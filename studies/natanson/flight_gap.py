"""Predicted compared with flown pre-launch residuals, N Table 2.

Truth is the published calibration, R eq. (9); the six intervals are simulated without noise and processed with the pre-launch
parameters. Two numbers measure the agreement.

The *clean gap* is θ_pre − θ_cal − predicted, with θ_pre and θ_cal the flight's residuals before and after calibration. Both
hold the same noise of gyro and references, so to first order their difference is Θ (x_pre − x_cal): it depends on the flight's
motion and two sets of published parameters, and has no noise but rounding. It tests the simulated motion, and is the headline.
It would vanish for exact motion and digits.

The *gap* is θ_pre − predicted. For exact motion and an exact R (9) it would be θ_cal, cell by cell, the residuals that R (9)
does not explain. So its *floor* is the RMS of θ_cal.

Circularity. The simulated truth, R (9), was fitted by N to the same 18 residuals. A gap near its floor therefore confirms
motion, signs and conventions, and nothing else of the gyro. The angle random walk is from the spread between the step sizes of
N Table 2, the references' sigma from the residuals after calibration: the Monte Carlo has the flight's scatter by construction,
and in its Table 3, centred on R (9), the flight's values are near the 50th percentile by construction. Two results are not
circular: the clean gap with timings that were assumed beforehand, and `studies.natanson.flight_recalibration`, which calibrates
from the flight's 18 residuals with simulated motion only, and compares with N's parameters.

Noise. Skipping samples leaves steps of f samples with the noise of one, so that the residual's noise variance is a²Tf for
f = 1, 2, 4, and the samples are nested: the residuals at the three steps are a random walk in f. Hence the 36 differences
between the columns of N Table 2 are independent, with variances a²T and 2a²T, and their mean square estimates the angle random
walk a without further assumptions.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from gyrocal import GyroParameters, Recording, attitude, propagate
from gyrocal.arrays import Array
from gyrocal.calibration.normal_equations import compute_attitude_residuals
from gyrocal.calibration.sampling import prepare_measurements
from simulator.scenario import Scenario, override
from simulator.simulate import motion, observe
from studies.natanson import flight

COARSE_SAMPLE_S = 2.0  # mean rates over longer samples: the prediction moves by less than 1e-4 deg, at a quarter of the cost
YAW_INTERVALS, MINUS_Y, HOLD = (1, 5), 3, 4


def predict_residuals(scenario: Scenario, truth: GyroParameters | None = None) -> Array:
    """Predict noise-free residuals (intervals, 3) deg under N Table 3's pre-launch parameters; the truth is R (9)."""
    return compute_residuals(simulate_without_noise(scenario, truth))[0]


def simulate_without_noise(scenario: Scenario, truth: GyroParameters | None = None) -> Recording:
    """Simulate the scenario without noise, by default with the gyro of R (9)."""
    truth = truth or flight.read_published_calibration()
    return observe(scenario, motion(scenario), gyro_rng=None, reference_rng=None, G=truth.G, bias=truth.bias)


def compute_residuals(recording: Recording) -> tuple[Array, Array]:
    """Compute residuals (intervals, 3) deg and Θ (intervals, 3, 12) deg per unit under N Table 3's pre-launch parameters.

    They are those of `gyrocal.residual_table`, without their covariance.
    """
    initial, prepared = flight.read_published_parameters("prelaunch"), prepare_measurements(recording)
    propagation = propagate(prepared.arcs, initial.G, initial.bias)
    A = attitude.matrix_from_quaternion(recording.attitudes.quaternions)
    theta = compute_attitude_residuals(propagation.R, A[prepared.start], A[prepared.row])
    return np.rad2deg(theta), np.rad2deg(propagation.Theta)


def compute_gap_rms(predicted: Array, intervals: Iterable[int] | None = None) -> float:
    """Compute the RMS of flown minus predicted at 0.5 s, over all 18 numbers or some intervals', deg."""
    difference = flight.read_published_residuals("prelaunch") - predicted
    return float(flight.compute_rms((difference if intervals is None else difference[list(intervals)]).ravel()))


def compute_noise_free_residuals() -> Array:
    """Compute θ_pre − θ_cal (6, 3) of the flight at 0.5 s, in which its noise cancels, deg."""
    return flight.read_published_residuals("prelaunch") - flight.read_published_residuals("calibrated")


def compute_clean_gap_rms(predicted: Array) -> float:
    """Compute the RMS of the clean gap at 0.5 s, over all 18 numbers, deg."""
    return float(flight.compute_rms((compute_noise_free_residuals() - predicted).ravel()))


def compute_floor_rms() -> float:
    """Compute the RMS of the flight's calibrated residuals at 0.5 s, the gap with the true timings, deg."""
    return float(flight.compute_rms(flight.read_published_residuals("calibrated").ravel()))


def build_gap_comparison(scenario: Scenario) -> pd.DataFrame:
    """Build a row for each of the 18 numbers: flown, predicted, gap, calibrated residual, and clean gap."""
    flown, after = flight.read_published_residuals("prelaunch"), flight.read_published_residuals("calibrated")
    predicted = predict_residuals(scenario)
    count, axes, gap = len(flown), flight.ROTATIONS, flown - predicted
    columns = {"flight": flown, "predicted": predicted, "gap": gap, "flight_calibrated": after, "clean_gap": gap - after}
    return pd.DataFrame(
        {
            "interval": np.repeat(np.arange(1, count + 1), len(axes)),
            "activity": np.repeat([interval.activity for interval in scenario.interval[:count]], len(axes)),
            "axis": list(axes) * count,
            **{f"{name}_deg": values.ravel() for name, values in columns.items()},
        }
    )


def compare_signs(scenario: Scenario) -> dict[str, Any]:
    """Compare the gaps with both signs of the residual, and of the rate in -y forward; RMS, deg.

    N (16) has exp([θ×]) = A_obs A_propᵀ, N (29) as printed the opposite sign.
    """
    predicted = predict_residuals(scenario)
    by_rate = {sign: compute_gap_rms(predict_residuals(set_minus_y_rate(scenario, sign)), [MINUS_Y]) for sign in (-1, 1)}
    by_sign = {"N (16)": compute_gap_rms(predicted), "N (29) as printed": compute_gap_rms(-predicted)}
    rates = {str(sign): gap for sign, gap in by_rate.items()}
    favoured = min(by_rate, key=by_rate.__getitem__)
    return {"residual_sign_gap_rms_deg": by_sign, "minus_y_rate_rpo": {"favoured": favoured, "gap_rms_deg": rates}}


def set_minus_y_rate(scenario: Scenario, sign: int) -> Scenario:
    """Return the scenario with ω_x = sign RPO in interval 4: −1 is −y forward, +1 needs +y forward, the slews reversed."""
    slews = scenario.interval[MINUS_Y].slew
    return override(
        scenario, {f"interval.{MINUS_Y}.slew.{j}.angle_deg": sign * abs(s.angle_deg) * (-1) ** j for j, s in enumerate(slews)}
    )


def estimate_noise_from_steps() -> dict[str, float]:
    """Estimate the flight's angle random walk from the spread between step sizes, and its noise in one residual.

    Returns
    -------
    arw_deg_per_sqrt_s with its relative_sigma, rate_noise_deg_s of one 0.5 s sample, and residual_rms_deg, the RMS noise of the
    18 residuals at 0.5 s that comes from the gyro.
    """
    columns = [flight.read_published_residuals("prelaunch", step) for step in flight.FLIGHT_STEPS_S]
    T = flight.compute_interval_durations()[:, None]
    samples = np.concatenate([((columns[1] - columns[0]) ** 2 / T).ravel(), ((columns[2] - columns[1]) ** 2 / (2 * T)).ravel()])
    arw = float(np.sqrt(samples.mean()))
    return {
        "arw_deg_per_sqrt_s": arw,
        "relative_sigma": float(1 / np.sqrt(2 * samples.size)),
        "rate_noise_deg_s": arw / np.sqrt(0.5),
        "residual_rms_deg": float(arw * np.sqrt(T.mean())),
    }
