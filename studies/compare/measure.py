"""Statistics of one recording, by the same code for a real or simulated recording and for every flight of a scenario.

A recording is calibrated (G, b; three iterations of N section IV from the plan's parameters), and its statistics are those of
the residuals θ of N (16) that are left, in body axes:

- *mean square*: χ²/dof, θ whitened by the calibrator's own covariance of noise as stated
- *rms*: of each interval and of each phase of the intervals (start, slew, hold, end), by axis
- *residual rate* u_j = (θ_j − R_j θ_{j−1})/Δt_j, R_j the rotation between two references: its correlation from one reference
  to the next (−½ where references' noise is all there is), and its overlapping Allan deviation over 1, 2, 4 … references
- *samples* where the body's motion is smooth: mean square of second differences in units of that of the stated noise, 6 σ²;
  their correlation from one to the next (−⅔ for white noise), largest one, and share of repeated samples
- *parameters*: the calibrated G and b

Only second differences of the samples are used, and only where the smoothed rates have almost no second difference, at least
half a window away from rough motion and from the ends. The motion of a replay still holds the recording's noise below the
corner frequency of the smoothing's window (docs/compare.md, "Effect of smoothing"). A quadratic over n samples passes 9/(4n) of
the noise's power, most of it below 1.5/n cycles a sample.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from diagnosis.model.localization import label_phases
from gyrocal import NAMES, GyroParameters, attitude
from gyrocal.allan.deviation import FEWEST_STRETCH_SAMPLES, overlapping_allan_deviation
from gyrocal.arrays import Array, Indices
from gyrocal.calibration.problem import Problem, State
from gyrocal.calibration.sampling import prepare_measurements
from gyrocal.mask_runs import find_mask_runs
from gyrocal.recording import Recording
from simulator.effects.recording_view import find_interval_slices, smooth_rates
from studies.report.units import PPM_DEG_H, PPM_DEG_H_NAMES

AXES = "xyz"
CALIBRATION_ITERATIONS = 3
FEWEST_RESIDUAL_RATES = 8  # residual rates of all intervals, for a correlation
SHORTEST_QUIET_RUN = 64  # quiet samples in a row
WINDOW = 41  # samples: least window of the smoothing
MOTION_S = 20.0  # s: least window of the smoothing; longer ones show smooth motion no better
SMOOTH = 1 / 3  # of the noise: largest second difference of a smooth motion
GROWN = WINDOW // 2  # samples excluded on either side of rough motion, where the window of the smoothing is short
REPEAT = 1e-12  # rad/s


class Statistic(NamedTuple):
    """Name of a statistic: its kind, the quantity or part of the recording, the axis, and its unit."""

    kind: str
    of: str
    axis: str
    unit: str


@dataclass(frozen=True)
class RecordingStatistics:
    """Statistics of one recording."""

    mean_square: float  # χ²/dof of the calibration
    samples: float  # mean square of the samples' second differences; NaN where too few are quiet
    statistics: Mapping[Statistic, float]  # all of them
    x: Array  # (12,) calibrated parameters


@dataclass(frozen=True)
class MeasurementSetup:
    """Measurement of recordings of one plan, built from one of them and the same for all."""

    problem: Problem  # the calibration problem
    start: Array  # (12,) parameters to start from
    names: tuple[str, ...]  # of the intervals
    t_s: Array  # (m,) times of the residuals
    quiet: tuple[slice, ...]  # stretches of samples where the motion is smooth
    noise: float  # stated noise of a sample, rad/s

    @classmethod
    def build(cls, recording: Recording, start: GyroParameters) -> "MeasurementSetup":
        """Build the setup for recordings with these sample tags, reference times and stated noises."""
        prepared = prepare_measurements(recording)
        gyro = recording.gyro
        noise = gyro.arw / np.sqrt(gyro.sample_s)
        return cls(
            problem=Problem.build(recording, prepared),
            start=start.vector,
            names=tuple(interval.name for interval in recording.intervals),
            t_s=recording.attitudes.t_s[prepared.row],
            quiet=find_quiet_stretches(recording, start, noise),
            noise=noise,
        )

    @property
    def degrees_of_freedom(self) -> int:
        """Degrees of freedom of the calibration."""
        return 3 * len(self.t_s) - len(NAMES)

    @cached_property
    def arc(self) -> Indices:
        """(m,) interval of each residual."""
        return self.problem.measurements.arcs.arc

    @cached_property
    def parts(self) -> tuple[Indices, ...]:
        """Residuals of each interval, in the order of time."""
        return tuple(np.flatnonzero(self.arc == number) for number in range(len(self.names)))

    def case(self, recording: Recording) -> Problem:
        """Build the problem of another recording of the same plan."""
        return self.problem.replace_case(recording.gyro.rates, attitude.matrix_from_quaternion(recording.attitudes.quaternions))

    def state(self, recording: Recording) -> State:
        """Compute whitened residuals and sensitivities at the start."""
        return self.case(recording).state(GyroParameters.from_vector(self.start))

    def measure(self, recording: Recording) -> RecordingStatistics:
        """Calibrate a recording and compute its statistics."""
        problem = self.case(recording)
        iterates = problem.iterate(self.start, CALIBRATION_ITERATIONS)
        theta, x, mean_square = iterates.theta[-1], iterates.x[-1], iterates.chi2 / self.degrees_of_freedom
        values = {Statistic("mean square", "of the calibration", "", "1"): mean_square}
        for statistics in (self._rms(theta), self._rates(problem.A, theta), self._samples(recording)):
            values.update(statistics)
        for name, value, unit in zip(NAMES, x * PPM_DEG_H, PPM_DEG_H_NAMES, strict=True):
            values[Statistic("parameter", name, "", unit)] = float(value)
        return RecordingStatistics(mean_square, self.compute_samples_mean_square(recording), values, x)

    def misfit(self, recording: Recording) -> float:
        """Compute the mean square of a recording's calibration alone."""
        return self.case(recording).iterate(self.start, CALIBRATION_ITERATIONS).chi2 / self.degrees_of_freedom

    def compute_samples_mean_square(self, recording: Recording) -> float:
        """Compute the mean square of the samples' second differences over that of stated noise; NaN if too few are quiet."""
        if not self.quiet or self.noise == 0:
            return float("nan")
        second_differences = np.concatenate([np.diff(recording.gyro.rates[part], n=2, axis=0) for part in self.quiet])
        return float(np.mean(second_differences**2) / (6 * self.noise**2))

    def _rms(self, theta: Array) -> Iterator[tuple[Statistic, float]]:
        """Compute the RMS of the residuals (m, 3) rad by interval, by phase, and of all."""
        phase = label_phases(self.t_s, self.arc) if len(self.t_s) > len(self.names) else np.full(len(self.t_s), "end")
        groups = [(f"interval {name}", rows) for name, rows in zip(self.names, self.parts, strict=True)]
        groups += [(f"phase {name}", np.flatnonzero(phase == name)) for name in ("start", "slew", "hold", "end")]
        for name, rows in [*groups, ("all", np.arange(len(theta)))]:
            for k, axis in enumerate(AXES):
                if rows.size:
                    yield Statistic("rms", name, axis, "deg"), float(np.rad2deg(np.sqrt(np.mean(theta[rows, k] ** 2))))

    def _rates(self, A: Array, theta: Array) -> Iterator[tuple[Statistic, float]]:
        """Compute the statistics of the residual rates from references A (n, 3, 3) and residuals (m, 3), rad."""
        prepared = self.problem.measurements
        residual_turns, spacing = [], []
        for rows in self.parts:
            references = np.append(prepared.start[rows[0]], prepared.row[rows])
            R = A[references[1:]] @ np.swapaxes(A[references[:-1]], 1, 2)
            previous = np.vstack([np.zeros(3), theta[rows[:-1]]])
            spacing.append(np.diff(np.append(0.0, prepared.elapsed_s[rows])))
            # Δt u_j = θ_j − R_j θ_{j−1}, times 3600 so that a quotient by s is in deg/h.
            residual_turns.append(np.rad2deg(theta[rows] - np.einsum("mij,mj->mi", R, previous)) * 3600)
        tau_s = float(np.median(np.concatenate(spacing)))
        if sum(len(turn) - 1 for turn in residual_turns) < FEWEST_RESIDUAL_RATES:
            return
        for k, axis in enumerate(AXES):
            rates = [turn[:, k] / dt for turn, dt in zip(residual_turns, spacing, strict=True)]
            yield Statistic("residual rate", "lag-1 correlation", axis, "1"), compute_lag_correlation(rates)
            for count, deviation in compute_allan_deviations([turn[:, k] / tau_s for turn in residual_turns], tau_s):
                name = f"Allan deviation at {count} reference{'s' if count > 1 else ''}"
                yield Statistic("residual rate", name, axis, "deg/h"), deviation

    def _samples(self, recording: Recording) -> Iterator[tuple[Statistic, float]]:
        """Compute the statistics of the quiet samples' second differences, in sigmas of the stated noise."""
        if not self.quiet or self.noise == 0:
            return
        for k, axis in enumerate(AXES):
            parts = [recording.gyro.rates[part, k] for part in self.quiet]
            second_differences = [np.diff(x, n=2) / (np.sqrt(6) * self.noise) for x in parts]
            all_second = np.concatenate(second_differences)
            yield Statistic("samples' mean square", "", axis, "1"), float(np.mean(all_second**2))
            yield Statistic("samples", "lag-1 correlation", axis, "1"), compute_lag_correlation(second_differences)
            yield Statistic("samples", "largest", axis, "sigma"), float(np.abs(all_second).max())
            repeats = np.concatenate([np.abs(np.diff(x)) < REPEAT for x in parts])
            yield Statistic("samples", "repeated", axis, "1"), float(repeats.mean())


def find_quiet_stretches(recording: Recording, parameters: GyroParameters, noise: float) -> tuple[slice, ...]:
    """Find stretches of samples inside an interval, without a gap, in which the smoothed motion is smooth."""
    gyro = recording.gyro
    smooth = smooth_rates(recording, parameters.G, parameters.bias, max(MOTION_S, WINDOW * gyro.sample_s))
    out = []
    for part in find_interval_slices(recording):
        if part.stop - part.start < SHORTEST_QUIET_RUN:
            continue
        t = gyro.t_s[part]
        is_quiet = np.ones(t.size, dtype=bool)
        is_rough = np.abs(np.diff(smooth[part], n=2, axis=0)).max(axis=1) > SMOOTH * np.sqrt(6) * noise
        is_gap = np.diff(t) > 1.5 * gyro.sample_s
        for excluded in [0, *np.flatnonzero(is_rough) + 1, *np.flatnonzero(is_gap), t.size - 1]:
            is_quiet[max(excluded - GROWN, 0) : excluded + GROWN + 1] = False
        out += [slice(part.start + a, part.start + b) for a, b in find_mask_runs(is_quiet) if b - a >= SHORTEST_QUIET_RUN]
    return tuple(out)


def compute_lag_correlation(parts: list[Array]) -> float:
    """Compute Σ u_j u_{j+1}/Σ u_j² over neighbours within the parts."""
    square = sum(float(u @ u) for u in parts)
    return sum(float(u[1:] @ u[:-1]) for u in parts) / square if square > 0 else float("nan")


def compute_allan_deviations(parts: list[Array], tau_s: float) -> Iterator[tuple[int, float]]:
    """Compute overlapping Allan deviations of rates over 1, 2, 4 … references, while there are enough differences."""
    longest = max(map(len, parts))
    if longest < FEWEST_STRETCH_SAMPLES:
        return
    factors = [2**k for k in range(int(np.log2(longest)))]
    differences = [sum(max(len(part) + 1 - 2 * count, 0) for part in parts) for count in factors]
    usable = [m for m, count in zip(factors, differences, strict=True) if count >= 2 * FEWEST_RESIDUAL_RATES * m]
    if usable:
        yield from zip(usable, overlapping_allan_deviation(parts, tau_s, usable).deviation.tolist(), strict=True)
