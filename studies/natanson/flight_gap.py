"""The flight's own numbers as real input: predicted against flown pre-launch residuals, N Table 2.

Truth is the published calibration, R eq. (9); the six intervals are simulated without noise and processed with the pre-launch
parameters. Two numbers say how well that goes.

The *clean gap* is θ_pre − θ_cal − predicted, with θ_pre and θ_cal the flight's residuals before and after calibration. Both
hold the same noise of gyro and references, so to first order their difference is Θ (x_pre − x_cal): the flight's motion and
two sets of published parameters, and no noise but that of print. It judges the simulated motion, and is the headline. If the
motion and the digits were right it would vanish.

The *gap* is θ_pre − predicted. If the motion were right and R (9) exact it would be θ_cal, cell by cell, since that is what
R (9) could not explain. So its *floor* is the RMS of θ_cal.

What is circular. The truth put in, R (9), is what N fitted to these very 18 residuals: that the gap comes near its floor says
that motion, signs and conventions are right, and nothing of the gyro beyond that. The angle random walk is taken from the
spread between the step sizes of N Table 2, the references' sigma from the residuals after calibration: the Monte Carlo cannot
but have the flight's scatter, and its Table 3, centred on R (9), cannot but have the flight's values near the 50th percentile.
Not circular are the clean gap with timings that were assumed before looking, and what `studies.natanson.flight_recalibration`
does: it calibrates from the flight's 18 residuals with simulated motion only, and compares with what N found.

Noise. Skipping samples leaves steps of f samples with the noise of one, so that the residual's noise variance is a²Tf for
f = 1, 2, 4, and the samples are nested: the residuals at the three steps are a random walk in f. Hence the 36 differences
between the columns of N Table 2 are independent, with variances a²T and 2a²T, and their mean square gives the angle random
walk a without knowing anything else.
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
    """Noise-free residuals under N Table 3's pre-launch parameters, (intervals, 3) deg; the truth is R (9) by default."""
    return compute_residuals(simulate_without_noise(scenario, truth))[0]


def simulate_without_noise(scenario: Scenario, truth: GyroParameters | None = None) -> Recording:
    """The scenario without noise, its gyro that of R (9) by default."""
    truth = truth or flight.read_published_calibration()
    return observe(scenario, motion(scenario), gyro_rng=None, reference_rng=None, G=truth.G, bias=truth.bias)


def compute_residuals(recording: Recording) -> tuple[Array, Array]:
    """Residuals (intervals, 3) deg and Θ (intervals, 3, 12) deg per unit under N Table 3's pre-launch parameters.

    They are those of `gyrocal.residual_table`, without their covariance.
    """
    initial, prepared = flight.read_published_parameters("prelaunch"), prepare_measurements(recording)
    passed = propagate(prepared.arcs, initial.G, initial.bias)
    A = attitude.matrix_from_quaternion(recording.attitudes.quaternions)
    theta = compute_attitude_residuals(passed.R, A[prepared.start], A[prepared.row])
    return np.rad2deg(theta), np.rad2deg(passed.Theta)


def compute_gap_rms(predicted: Array, intervals: Iterable[int] | None = None) -> float:
    """RMS of flown minus predicted at 0.5 s, over all 18 numbers or some intervals', deg."""
    difference = flight.read_published_residuals("prelaunch") - predicted
    return float(flight.compute_rms((difference if intervals is None else difference[list(intervals)]).ravel()))


def compute_noise_free_residuals() -> Array:
    """θ_pre − θ_cal of the flight at 0.5 s, in which its noise cancels, (6, 3) deg."""
    return flight.read_published_residuals("prelaunch") - flight.read_published_residuals("calibrated")


def compute_clean_gap_rms(predicted: Array) -> float:
    """RMS of the clean gap at 0.5 s, over all 18 numbers, deg."""
    return float(flight.compute_rms((compute_noise_free_residuals() - predicted).ravel()))


def compute_floor_rms() -> float:
    """RMS of the flight's calibrated residuals at 0.5 s, what the gap would be with the true timings, deg."""
    return float(flight.compute_rms(flight.read_published_residuals("calibrated").ravel()))


def build_gap_comparison(scenario: Scenario) -> pd.DataFrame:
    """The 18 numbers: flown, predicted, gap, the flight's residual after calibration, and the clean gap."""
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
    """Gaps with both signs that N's text leaves in doubt: of the residual, and of the rate in -y forward; RMS, deg.

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
    """The flight's angle random walk from the spread between step sizes, and what it means for one residual.

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
