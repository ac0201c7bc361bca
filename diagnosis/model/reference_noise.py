"""Whether the references have white noise of the stated size, by second differences of what M0 leaves of them.

Where a gyro hides motion between two references, in a dead zone or on a coarse lattice, that would look like noise. What
follows the motion, or a bias that drifts while the body turns, is taken off before noise that departs is reported.

Each of several star trackers is tested about its own axes. Trackers look on while the body slews, and each may be turned from
its mounting. What second differences of its residuals would show of that is no noise: a constant turn m about its axes,
ζ = φ − Aᵀ Mᵀ m with φ of each interval, is fitted and taken off, and references beside a change of the rate are left out, at
which late tags or a scale factor make a step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.detectors.dead_zone_rests import DeadZoneEvidence
from diagnosis.detectors.reference_noise import ReferenceNoise, ReferenceSeries, reference_noise
from diagnosis.detectors.report import SampleReport
from diagnosis.model.recording import RecordingModel
from diagnosis.settings import DiagnosisSettings
from simulator.effects.timing import delay_columns

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ReferenceNoiseSettings:
    """Constants of `diagnosis.model.reference_noise`."""

    likely: float = 1.0  # log odds of a dead zone from the samples, from which on its axis is left out
    steady: float = 0.02  # of the fastest rate: a larger change to the reference before or after is one of the motion
    alike: float = 13.8  # of χ² with 2 degrees of freedom, p = 0.001: factors of a tracker's noise about its three axes


SETTINGS = ReferenceNoiseSettings()


def measure_reference_noise(
    model: RecordingModel,
    report: SampleReport,
    dead: tuple[DeadZoneEvidence, ...],
    settings: DiagnosisSettings,
    sensor: int | None = None,
) -> ReferenceNoise | None:
    """Test the references' noise, or that of one of several sensors; None where gyros hide motion that would look like it."""
    blind = set(np.flatnonzero(report.hidden | report.lattice).tolist())
    silent = np.zeros(report.rates.shape, dtype=bool)
    for one in dead:
        silent[:, one.axis] |= (one.part >= 0) & (one.log_odds > SETTINGS.likely)
    recording, density = model.recording, np.median(report.density, axis=0)
    if sensor is not None:
        axes = recording.attitudes.sensors[sensor].M
        hidden = np.repeat(np.asarray(silent).any(axis=1).reshape(-1, 1), 3, axis=1)
        found = reference_noise(build_tracker_series(model, sensor), axes**2 @ density, recording.gyro.t_s, hidden, settings)
        return found if found is not None and not blind and is_alike(found) else None
    series = ReferenceSeries(
        t_s=model.references.t_s,
        interval=model.interval_of_reference,
        sigma=recording.attitudes.sigma[model.reference_rows],
        to_inertial=model.at_reference,
        residuals=model.residuals,
        rates=model.rates[model.steps_at_references],
    )
    noise = reference_noise(series, density, recording.gyro.t_s, silent, settings)
    if noise is not None and noise.odd:
        noise = reference_noise(series, density, recording.gyro.t_s, silent, settings, model.turned_by(_follow_motion(model)))
    return None if noise is not None and (noise.axis in blind or len(blind) == 3) else noise


def _follow_motion(model: RecordingModel) -> Array:
    """(n, 3, k) errors of readings that follow the motion: each rate on each axis, its size and its square, and its change.

    So does one of a bias that is not the same in all intervals, where the body turns from one reference to the next.
    """
    raw, mission = model.raw, (model.t_s - model.t_s.mean()) / max(float(np.ptp(model.t_s)), 1.0)
    own = np.zeros((len(raw), 3, 18))
    for axis in range(3):
        own[:, axis, 15 + axis] = mission
        own[:, axis, 3 * axis : 3 * axis + 3] = raw
        own[:, axis, 9 + axis] = np.abs(raw[:, axis])
        own[:, axis, 12 + axis] = raw[:, axis] ** 2
    return np.concatenate([own, delay_columns(model.stream)], axis=2)


# ---- one of several trackers ---------------------------------------------------------------------------------------------


def build_tracker_series(model: RecordingModel, sensor: int) -> ReferenceSeries:
    """Build the series of one tracker's references, in the order of time."""
    attitudes = model.recording.attitudes
    assert attitudes.sensor is not None
    own = np.flatnonzero(attitudes.sensor[model.reference_rows] == sensor)
    own = own[np.lexsort((attitudes.t_s[model.reference_rows[own]], model.interval_of_reference[own]))]
    interval, to_inertial = model.interval_of_reference[own], model.at_reference[own] @ attitudes.sensors[sensor].M.T
    times = attitudes.t_s[model.reference_rows[own]]
    rates = model.rates[model.steps_at(times, interval)]
    kept = _steady(rates, interval)
    residuals = _without_turn(model.residuals[own], to_inertial, interval)
    sigma = attitudes.sigma[model.reference_rows[own]]
    return ReferenceSeries(times[kept], interval[kept], sigma[kept], to_inertial[kept], residuals[kept], rates[kept])


def _steady(rates: Array, interval: NDArray[np.intp]) -> NDArray[np.bool_]:
    """(m,) whether the rate is the same at the references before and after."""
    change = np.linalg.norm(np.diff(rates, axis=0), axis=1) * (np.diff(interval) == 0)
    moved = change > SETTINGS.steady * np.linalg.norm(rates, axis=1).max(initial=0.0)
    return np.asarray(~(np.append(moved, False) | np.append(False, moved)))


def _without_turn(residuals: Array, to_inertial: Array, interval: NDArray[np.intp]) -> Array:
    """ζ (m, 3) less the best φ of each interval and m."""
    if not len(residuals):
        return residuals
    own = np.unique(interval)
    columns = np.concatenate(
        [np.einsum("mb,ij->mibj", interval[:, None] == own, np.eye(3)).reshape(len(residuals), 3, -1), -to_inertial], axis=2
    )
    columns = columns.reshape(residuals.size, -1)
    return np.asarray(residuals - (columns @ np.linalg.lstsq(columns, residuals.ravel(), rcond=None)[0]).reshape(-1, 3))


def is_alike(noise: ReferenceNoise) -> bool:
    """Whether noise that departs does so by one factor about all axes; what does not is no white noise stated too small.

    An error in the field of view acts across the boresight only, and changes from one reference to the next like noise: where
    a factor about x and y alone fits better than one about all three, it is not said to be noise.
    """
    if not noise.departs:
        return True
    weight, factor = 1 / noise.sigma**2, noise.factor
    every, across = _about_mean(weight, factor), _about_mean(weight[:2], factor[:2])
    return every < min(SETTINGS.alike, across + float(weight[2] * (factor[2] - 1) ** 2))


def _about_mean(weight: Array, factor: Array) -> float:
    """χ² of factors about their common one."""
    mean = np.sum(weight * factor) / np.sum(weight)
    return float(np.sum(weight * (factor - mean) ** 2))
