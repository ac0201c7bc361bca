"""The references of one of several star trackers as a series whose noise can be tested, about the tracker's own axes.

Trackers look on while the body slews, and each may be turned from its mounting. What second differences of its residuals would
show of that is no noise: a constant turn m about its axes, ζ = φ − Aᵀ Mᵀ m with φ of each interval, is fitted and taken off,
and references beside a change of the rate are left out, at which late tags or a scale factor make a step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.detectors.reference_noise import ReferenceNoise, ReferenceSeries
from diagnosis.model.recording_model import RecordingModel
from diagnosis.model.step_index import find_steps

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrackerNoiseSettings:
    """Constants of `diagnosis.model.tracker_noise`."""

    steady: float = 0.02  # of the fastest rate: a larger change to the reference before or after is one of the motion
    alike: float = 13.8  # of χ² with 2 degrees of freedom, p = 0.001: factors of a tracker's noise about its three axes


SETTINGS = TrackerNoiseSettings()


def build_tracker_series(model: RecordingModel, sensor: int) -> ReferenceSeries:
    """The references of one tracker, in the order of time."""
    attitudes = model.recording.attitudes
    assert attitudes.sensor is not None
    own = np.flatnonzero(attitudes.sensor[model.reference_rows] == sensor)
    own = own[np.lexsort((attitudes.t_s[model.reference_rows[own]], model.interval_of_reference[own]))]
    interval, to_inertial = model.interval_of_reference[own], model.at_reference[own] @ attitudes.sensors[sensor].M.T
    times = attitudes.t_s[model.reference_rows[own]]
    rates = model.rates[find_steps(model, times, interval)]
    kept = _find_steady_rates(rates, interval)
    residuals = _remove_turns(model.residuals[own], to_inertial, interval)
    sigma = attitudes.sigma[model.reference_rows[own]]
    return ReferenceSeries(times[kept], interval[kept], sigma[kept], to_inertial[kept], residuals[kept], rates[kept])


def _find_steady_rates(rates: Array, interval: NDArray[np.intp]) -> NDArray[np.bool_]:
    """(m,) whether the rate is the same at the references before and after."""
    change = np.linalg.norm(np.diff(rates, axis=0), axis=1) * (np.diff(interval) == 0)
    moved = change > SETTINGS.steady * np.linalg.norm(rates, axis=1).max(initial=0.0)
    return np.asarray(~(np.append(moved, False) | np.append(False, moved)))


def _remove_turns(residuals: Array, to_inertial: Array, interval: NDArray[np.intp]) -> Array:
    """ζ (m, 3) less the best φ of each interval and m."""
    if not len(residuals):
        return residuals
    own = np.unique(interval)
    columns = np.concatenate(
        [np.einsum("mb,ij->mibj", interval[:, None] == own, np.eye(3)).reshape(len(residuals), 3, -1), -to_inertial], axis=2
    )
    columns = columns.reshape(residuals.size, -1)
    return np.asarray(residuals - (columns @ np.linalg.lstsq(columns, residuals.ravel(), rcond=None)[0]).reshape(-1, 3))


def is_one_factor(noise: ReferenceNoise) -> bool:
    """Whether noise that departs does so by one factor about all axes; what does not is no white noise stated too small.

    An error in the field of view acts across the boresight only, and changes from one reference to the next like noise: where
    a factor about x and y alone fits better than one about all three, it is not said to be noise.
    """
    if not noise.departs:
        return True
    weight, factor = 1 / noise.sigma**2, noise.factor
    every, across = _compute_factor_chi2(weight, factor), _compute_factor_chi2(weight[:2], factor[:2])
    return every < min(SETTINGS.alike, across + float(weight[2] * (factor[2] - 1) ** 2))


def _compute_factor_chi2(weight: Array, factor: Array) -> float:
    """χ² of factors about their common one."""
    mean = np.sum(weight * factor) / np.sum(weight)
    return float(np.sum(weight * (factor - mean) ** 2))
