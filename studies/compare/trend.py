"""The trend of a unit: its recordings calibrated one by one, over time and temperature, and the parameters that have changed.

Each gyro has a scale factor, the turn of its axis from the a-priori axis of the first recording, and a bias, ω_raw = K ω + c.
The sigmas are the recommended ones, with the remainder where the residuals do not fit the stated noise. Where no remainder can
be estimated (more gyros than three, references by several sensors) such residuals widen the sigmas by √(χ²/dof).

A slope with the temperature takes one contrast of few. It is free only if a recording is more than 1 K off the first. A unit
with temperatures may thus be tested without the slope at first and with it later: two tests, which share the probability of a
false alarm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import chdtrc

from gyrocal import CalibrationResult, GyroArray, GyrosResult, Recording, calibrate, calibrate_gyros
from gyrocal.calibration.gyros import compute_gain_jacobian, tabulate_gyros
from gyrocal.calibration.parameter_change import ParameterChange, detect_parameter_change
from gyrocal.calibration.plausible_ranges import PlausibleRanges
from gyrocal.calibration.remainder import add_remainder
from gyrocal.calibration.remainder_processes import NOMINAL
from gyrocal.errors import GyrocalError, InputError
from gyrocal.recording.gyros import compute_nominal_gyros
from simulator.effects.housekeeping_columns import find_temperature, no_temperature
from simulator.effects.recording_view import interpolate_housekeeping

Array = NDArray[np.float64]

FALSE_ALARM_PROBABILITY = 0.1  # of any alarm at a unit without a change, in all its recordings
POOR_FIT = 0.01  # p-value of residuals below which they do not fit the stated noise, as of a remainder
SAME_TEMPERATURE_K = 1.0  # K, difference of temperatures that changes no parameter
LARGEST_SHARE = float(np.sqrt(0.5))  # of a plausible range, of a sigma above which the data do not determine the parameter
ALONG_AXIS = 0.99  # component of a unit vector along which a turn is none
ARCSEC_PER_RAD = float(np.rad2deg(1.0) * 3600)
SCALED = "scaled"  # sigmas widened by the residuals, beside nominal ones and those with remainder


@dataclass(frozen=True)
class ParameterTrend:
    """One parameter of one gyro.

    Attributes
    ----------
    gyro, parameter, unit : which
    value, sigma : (n,) by recording; NaN where its data do not determine the parameter
    change : of the recordings that determine it; None where they are fewer than two
    """

    gyro: str
    parameter: str
    unit: str
    value: Array
    sigma: Array
    change: ParameterChange | None

    @property
    def name(self) -> str:
        """Gyro and parameter in words."""
        return f"gyro {self.gyro}, {self.parameter}"

    @property
    def places(self) -> NDArray[np.intp]:
        """Places of the recordings that determine it."""
        return np.flatnonzero(np.isfinite(self.value))


@dataclass(frozen=True)
class Trend:
    """A unit's recordings in their order.

    Attributes
    ----------
    recordings : a row each: recording, time (UTC), temperature_c (NaN without one), chi2, dof, p_value, sigmas
    days : (n,) since the first one; their numbers where one is within another
    is_timed : whether the middle of each is after the end of the one before
    parameters : gyro by gyro
    """

    recordings: pd.DataFrame
    days: Array
    is_timed: bool
    parameters: tuple[ParameterTrend, ...]

    @property
    def log_threshold(self) -> float:
        """Logarithm of the E at which a parameter has changed: Ville's inequality with an equal share for each test."""
        tests = 2 if self.recordings["temperature_c"].notna().any() else 1
        return float(np.log(tests * len(self.parameters) / FALSE_ALARM_PROBABILITY))

    @property
    def has_slope(self) -> bool:
        """Whether the parameters may depend on the temperature."""
        return has_temperature_slope(self.recordings["temperature_c"].to_numpy())

    @property
    def changes(self) -> tuple[tuple[ParameterTrend, ParameterChange, int], ...]:
        """Parameters with an alarm, their changes, and the place of the alarm; the strongest evidence first."""
        found = []
        for one in self.parameters:
            alarm = None if one.change is None else one.change.find_alarm(self.log_threshold)
            if one.change is not None and alarm is not None:
                found.append((one, one.change, int(one.places[alarm])))
        return tuple(sorted(found, key=lambda entry: -float(entry[1].log_e.max())))

    def tabulate_values(self) -> pd.DataFrame:
        """A row for each parameter and recording, with the evidence for a change up to it."""
        known = self.recordings[["recording", "time", "temperature_c"]]
        parts = []
        for one in self.parameters:
            log10_e = np.full(len(known), np.nan)
            if one.change is not None:
                log10_e[one.places] = one.change.log_e / np.log(10)
            part = known.assign(gyro=one.gyro, parameter=one.parameter, unit=one.unit, value=one.value, sigma=one.sigma)
            parts.append(part.assign(log10_e=log10_e))
        return pd.concat(parts, ignore_index=True)


@dataclass(frozen=True)
class _Calibrated:
    """One recording: its gyros with their covariance, and how they were found."""

    gyros: GyroArray
    covariance: Array
    plausible: PlausibleRanges
    facts: dict[str, float | int | str]


def estimate_trend(
    recordings: Mapping[str, Recording],
    largest_walk: float = np.inf,
    tell: Callable[[str, float], None] = lambda text, share: None,
) -> Trend:
    """Calibrate the recordings of a unit and test every parameter for a change.

    Parameters
    ----------
    recordings : by name, two or more with the same gyros; their epochs give their order
    largest_walk : known limit of what a parameter varies from recording to recording, in sigmas
    tell : is told what is done, and which share of the work is

    Raises
    ------
    InputError
        There are fewer than two, their gyros differ, or one cannot be calibrated.
    """
    check_same_gyros(recordings)
    spans = {name: _compute_span(one) for name, one in recordings.items()}
    names = sorted(recordings, key=lambda name: spans[name])
    done = []
    for k, name in enumerate(names):
        tell(f"calibrating: {name}", k / len(names))
        try:
            done.append(_calibrate_recording(recordings[name]))
        except GyrocalError as error:
            raise InputError(f"{name}: {error}") from None
    middles = [spans[name][0] + (spans[name][1] - spans[name][0]) / 2 for name in names]
    is_timed = all(spans[name][1] <= middle for name, middle in zip(names, middles[1:], strict=False))
    days = np.array([(one - middles[0]) / timedelta(days=1) for one in middles]) if is_timed else np.arange(1.0, len(names) + 1)
    table = pd.DataFrame(
        {
            "recording": names,
            "time": [one.strftime("%Y-%m-%d %H:%M:%S") for one in middles],
            "temperature_c": [_compute_mean_temperature(recordings[name]) for name in names],
            **pd.DataFrame([one.facts for one in done]),
        }
    )
    axes = GyroArray(done[0].gyros.names, *compute_nominal_gyros(recordings[names[0]].gyro)).axes
    parameters = _list_parameters(done, axes, days, table["temperature_c"].to_numpy(), largest_walk)
    return Trend(table, days, is_timed, parameters)


def check_same_gyros(recordings: Mapping[str, Recording]) -> None:
    """Refuse recordings that are no trend of one unit.

    Raises
    ------
    InputError
        There are fewer than two, or their gyros differ.
    """
    if len(recordings) < 2:
        raise InputError(f"{''.join(recordings) or 'nothing'}: one recording has no trend; give two or more of one unit")
    (first, one), *others = recordings.items()
    for name, other in others:
        if other.gyro.names != one.gyro.names:
            has, had = (", ".join(each.gyro.names) for each in (other, one))
            raise InputError(f"{name}: has the gyros {has}, and {first} has {had}; give recordings of one unit")


def has_temperature_slope(temperature: Array) -> bool:
    """Whether all recordings have a temperature, one of them another than the first."""
    return bool(np.isfinite(temperature).all() and np.abs(temperature - temperature[0]).max() > SAME_TEMPERATURE_K)


def _compute_span(recording: Recording) -> tuple[datetime, datetime]:
    """Begin of the first interval and end of the last; an epoch without a zone is UTC."""
    epoch = datetime.fromisoformat(recording.epoch)
    epoch = epoch if epoch.tzinfo else epoch.replace(tzinfo=UTC)
    start, stop = min(one.start_s for one in recording.intervals), max(one.stop_s for one in recording.intervals)
    return epoch + timedelta(seconds=start), epoch + timedelta(seconds=stop)


def _compute_mean_temperature(recording: Recording) -> float:
    """Mean of the gyro's temperature over the samples, °C; NaN without one."""
    housekeeping = interpolate_housekeeping(recording, recording.gyro.t_s)
    if no_temperature(housekeeping) is not None:
        return float("nan")
    return float(find_temperature(housekeeping, {}, "gyro", "trend").mean())


def _calibrate_recording(recording: Recording) -> _Calibrated:
    """Calibrate one recording, with the sigmas that hold."""
    found = calibrate_gyros(recording) if recording.is_array else add_remainder(recording, calibrate(recording))
    if isinstance(found, GyrosResult):
        gyros, covariance, sigmas = found.gyros, found.covariance, NOMINAL
    else:
        K = np.asarray(np.linalg.inv(found.G))
        gyros, sigmas = GyroArray(recording.gyro.names, K, -K @ found.bias), found.recommended
        J = np.linalg.inv(compute_gain_jacobian(gyros))
        covariance = J @ found.recommended_covariance @ J.T
    excess = _compute_excess(found)
    if excess > 1:
        covariance, sigmas = covariance * excess, SCALED
    assert found.plausible is not None
    facts: dict[str, float | int | str] = {
        "chi2": found.chi2,
        "dof": found.dof,
        "p_value": found.p_value,
        "sigmas": sigmas.replace("_", " "),
    }
    return _Calibrated(gyros, covariance, found.plausible, facts)


def _compute_excess(found: CalibrationResult | GyrosResult) -> float:
    """Compute χ²/dof of residuals that do not fit the stated noise and have no remainder; 1 if they do fit.

    Attitude and parity of several gyros are judged one by one: the parity has a degree of freedom a sample.
    """
    parts = [(found.chi2, found.dof)]
    if isinstance(found, GyrosResult):
        parity = (found.parity_chi2, found.parity_dof)
        parts = [(found.chi2 - parity[0], found.dof - parity[1]), parity]
    elif found.remainder is not None:
        return 1.0
    return max([1.0, *(chi2 / dof for chi2, dof in parts if dof > 0 and chdtrc(dof, chi2) < POOR_FIT)])


def _list_parameters(
    done: list[_Calibrated], axes: Array, days: Array, temperature: Array, largest_walk: float
) -> tuple[ParameterTrend, ...]:
    """Test all parameters of all gyros; their slope with the temperature is free where it can be told."""
    tables = [tabulate_gyros(one.gyros, axes, one.covariance) for one in done]
    ranges_G, ranges_c = (np.array([getattr(one.plausible, name) for one in done]) for name in ("G", "bias"))
    out = []
    for i, gyro in enumerate(done[0].gyros.names):
        quantities = [("scale factor", "ppm", "scale_factor", "sigma_scale_factor", 1e6, 1e6 * ranges_G, 1.0)]
        for k, axis in enumerate("xyz"):
            if abs(axes[i, k]) < ALONG_AXIS:
                names = f"misalignment_{axis}_deg", f"sigma_{axis}_deg"
                quantities.append((f"misalignment {axis}", "arcsec", *names, 3600.0, ARCSEC_PER_RAD * ranges_G, 0.0))
        quantities.append(("bias", "deg/h", "bias_deg_s", "sigma_bias_deg_s", 3600.0, ARCSEC_PER_RAD * ranges_c, 0.0))
        for parameter, unit, value_name, sigma_name, factor, plausible, zero in quantities:
            value, sigma = (np.array([float(one[name][i]) for one in tables]) for name in (value_name, sigma_name))
            value, sigma = factor * (value - zero), factor * sigma
            known = (sigma > 0) & (sigma < LARGEST_SHARE * plausible)
            T = temperature[known] if has_temperature_slope(temperature) else None
            enough = known.sum() >= 2
            change = detect_parameter_change(value[known], sigma[known], days[known], T, largest_walk) if enough else None
            value, sigma = (np.where(known, one, np.nan) for one in (value, sigma))
            out.append(ParameterTrend(gyro, parameter, unit, value, sigma, change))
    return tuple(out)
