"""Calibration of the flight's own 18 residuals at each of N's steps, with simulated motion and nothing else of the simulator.

The observed attitudes at the intervals' ends are set so that the residuals under the pre-launch parameters of N Table 3 are the
flight's of N Table 2. Then the calibrator solves for the twelve parameters with equal weights, in gyro space as N did. The
parameters are compared with N Table 3, the residuals with the calibrated columns of N Table 2. The true parameters hardly
matter: those of the raw rates change the motion by a thousandth, and the pre-launch ones in place of R (9) change no residual
by more than 0.0007 deg. The flight's noise is in its 18 numbers, the same on both sides.

N Table 5's second iteration is the second-order term of the first one, and so shows which parameters N iterated in. Printed are
corrections to b and to G⁻¹; their signs are those of x_old − x_new, while the first iteration's are of x_new − x_old (with the
opposite sign all twelve agree in gyro space; as printed none of the larger ones does). In (G, b) there is no term of the
correction to G times that to b, so that its corrections to b nearly vanish. In gyro space that term is c = −G⁻¹ b.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from gyrocal import NAMES, Attitudes, CalibrationResult, GyroParameters, Recording, attitude, calibrate
from gyrocal.arrays import Array
from gyrocal.calibration.gyro_space import Parametrisation
from gyrocal.calibration.propagation import propagate
from gyrocal.calibration.sampling import prepare_measurements
from simulator.scenario import Scenario
from studies.natanson import flight, flight_gap
from studies.natanson.paper_forms import count_digit_changes

CALIBRATION_SPACES: dict[str, Parametrisation] = {"gyro_space": "gyro", "gain_space": "gain"}
BIAS_STEP_S = 1.0  # step of the corrections to b of N Table 5's first iteration
PRINTED = np.array([1e6] * 9 + [1e8] * 3)  # units of N Table 5's second iteration: 1e-6 in G, 1e-8 deg/s in b
EQUAL = np.deg2rad(0.01) ** 2 * np.tile(np.eye(3), (6, 1, 1))  # equal weights, of arbitrary size
DOUBTED = (2.0, 2, 2)  # step, interval and axis of the sign that N Table 4 contradicts


def set_final_attitudes(recording: Recording, cells_deg: Array, step_s: float) -> Recording:
    """Set the last attitudes of the intervals so that the pre-launch residuals are cells_deg (6, 3)."""
    initial = flight.read_published_parameters("prelaunch")
    prepared = prepare_measurements(recording, step_s, "skip")
    R = propagate(prepared.arcs, initial.G, initial.bias).R
    A = attitude.matrix_from_quaternion(recording.attitudes.quaternions)
    A_obs = A.copy()
    for j, theta in enumerate(np.deg2rad(cells_deg)):
        A_obs[prepared.row[j]] = attitude.rotation_matrix(theta) @ R[j] @ A[prepared.start[j]]
    quaternions = attitude.quaternion_from_matrix(A_obs)
    return replace(recording, attitudes=Attitudes(recording.attitudes.t_s, quaternions, recording.attitudes.sigma))


def calibrate_like_paper(
    recording: Recording, step_s: float, iterations: int, space: Parametrisation = "gyro"
) -> CalibrationResult:
    """Calibrate from the pre-launch parameters by skipping samples, with equal weights."""
    initial = flight.read_published_parameters("prelaunch")
    sampling: Any = {"step_s": step_s, "resampling": "skip"}
    return calibrate(
        recording, initial=initial, iterations=iterations, parametrisation=space, interval_covariance=EQUAL, **sampling
    )


# ---- one iteration, compared with N's ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class StepCalibration:
    """Calibration of the flight's residuals at one step."""

    step_s: float
    recording: Recording  # the simulated motion with the flight's residuals
    results: tuple[CalibrationResult, CalibrationResult]  # after one iteration, and after two

    @property
    def after(self) -> tuple[Array, Array]:
        """(6, 3) residuals after one iteration, and after two, deg."""
        names = [f"after_{name}_deg" for name in flight.ROTATIONS]
        first, second = (result.residuals[names].to_numpy() for result in self.results)
        return first, second

    @property
    def flown(self) -> Array:
        """(6, 3) residuals of the flight, with the doubtful sign of N Table 2 as N Table 4 requires, deg."""
        cells = flight.read_published_residuals("calibrated", self.step_s).copy()
        if self.step_s == DOUBTED[0]:
            cells[DOUBTED[1:]] *= -1
        return cells

    @property
    def published(self) -> GyroParameters:
        """Values that N found at this step; those of R (9) at the finest, which have more digits."""
        if self.step_s == flight.FLIGHT_STEPS_S[0]:
            return flight.read_published_calibration()
        return flight.read_published_parameters("calibrated", self.step_s)

    def compute_gradient(self) -> Array:
        """Compute the flown residuals along Θ's column of each parameter (12,), deg; zero at a least-squares solution."""
        prepared = prepare_measurements(self.recording, self.step_s, "skip")
        Theta = propagate(prepared.arcs, self.published.G, self.published.bias).Theta.reshape(18, 12)
        return np.asarray((Theta / np.linalg.norm(Theta, axis=0)).T @ self.flown.ravel())


def calibrate_each_step(scenario: Scenario) -> list[StepCalibration]:
    """Calibrate the flight's residuals at each of N's steps with the scenario's motion."""
    recording, calibrations = flight_gap.simulate_without_noise(scenario), []
    for step_s in flight.FLIGHT_STEPS_S:
        flight_recording = set_final_attitudes(recording, flight.read_published_residuals("prelaunch", step_s), step_s)
        results = (calibrate_like_paper(flight_recording, step_s, 1), calibrate_like_paper(flight_recording, step_s, 2))
        calibrations.append(StepCalibration(step_s, flight_recording, results))
    return calibrations


def compare_residuals_by_step(calibrations: list[StepCalibration]) -> pd.DataFrame:
    """Build a row per step: differences to the flight's residuals, and the gradient of N's solution."""
    rows = []
    for calibration in calibrations:
        printed = flight.read_published_residuals("calibrated", calibration.step_s)
        gradient = np.abs(calibration.compute_gradient())
        rows.append(
            {
                "step_s": calibration.step_s,
                "rms_difference_deg": float(flight.compute_rms((calibration.after[0] - calibration.flown).ravel())),
                "as_printed_deg": float(flight.compute_rms((calibration.after[0] - printed).ravel())),
                "steepest": NAMES[int(gradient.argmax())],
                "gradient_deg": gradient.max(),
            }
        )
    return pd.DataFrame(rows)


def count_changed_digits(calibrations: list[StepCalibration]) -> dict[str, dict[str, int]]:
    """Count, for each step, the printed digits of N Tables 2 and 4 that the second iteration changes, N's criterion."""
    counts = {f"{step.step_s:g}": count_digit_changes(*(theta[None] for theta in step.after)) for step in calibrations}
    return {step: {"table2": int(table2[0]), "table4": int(table4[0])} for step, (table2, table4) in counts.items()}


# ---- the second iteration of N Table 5 -------------------------------------------------------------------------------------


def compute_second_correction(result: CalibrationResult) -> Array:
    """Compute the second iteration's x_old − x_new (12,) of G⁻¹ and b, in N Table 5's units: 1e-6 and 1e-8 deg/s."""
    change = result.corrections[1]
    G = result.G - change.G
    inverse = np.linalg.inv(G) - np.linalg.inv(result.G)
    return np.concatenate([inverse.ravel(), -np.rad2deg(change.bias)]) * PRINTED


def build_second_iteration_table(scenario: Scenario) -> pd.DataFrame:
    """Build N Table 5's second iteration beside the one computed from the flight's residuals, in both spaces.

    The step is 1 s, from which the printed corrections to b are.
    """
    recording = flight_gap.simulate_without_noise(scenario)
    flight_recording = set_final_attitudes(recording, flight.read_published_residuals("prelaunch", BIAS_STEP_S), BIAS_STEP_S)
    G, bias = flight.read_published_corrections(2)
    table = pd.DataFrame(
        {
            "quantity": ["G_inverse"] * 9 + ["bias"] * 3,
            "row": [*np.repeat(list("xyz"), 3), *[""] * 3],
            "gyro": list("xyz") * 4,
            "unit": ["1e-6"] * 9 + ["1e-8 deg/s"] * 3,
            "flight": np.concatenate([G.ravel(), bias]) * PRINTED,
        }
    )
    for name, space in CALIBRATION_SPACES.items():
        table[name] = compute_second_correction(calibrate_like_paper(flight_recording, BIAS_STEP_S, 2, space))
    return table


def score_second_iteration(table: pd.DataFrame) -> dict[str, float]:
    """Compute the correlation of each space's prediction with N Table 5's second iteration."""
    return {name: float(np.corrcoef(table[name], table["flight"])[0, 1]) for name in CALIBRATION_SPACES}
