"""Test whether gyro rates and attitudes agree as read, and name the reading of the tables that fits if they do not.

The mean body rate between two attitudes follows from the attitudes, dA/dt = −[ω×] A, and from the gyro:

    w_ref = s C w_gyro(t + τ) + b + noise

with the gyro's bias b; if everything is read correctly, s = 1, C = I and τ = 0. A reading error changes s (unit of rate or of
time), C (order and sign of the axes, mounting), τ or the clock rate (time tags), or w_ref itself (order of the quaternion's
elements, its direction). `readings` lists the readings and their misfits. Each stage below is tried if the one before leaves a
misfit, and has to halve it:

1. named readings: units, the 48 orders and signs of the axes, and an offset of the tags;
2. numbers: the rotation that maximises tr(Cᵀ Σ w_ref wᵀ), a free factor, and a clock rate;
3. a free 3×3 matrix in place of s C: the rows of its inverse are the gyros' axes and scale factors.

Among readings that fit nearly as well as the best, the one with the fewest changes is reported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrocal.arrays import Array
from gyrocal.calibration.gate import LargeResidualError
from gyrocal.importing.alignment import SIGNIFICANT_IN_SIGMA
from gyrocal.importing.motion import Motion, build_motion, estimate_constant_bias, locate_misfit
from gyrocal.importing.readings import (
    FEWEST_RATE_WINDOWS,
    SIGNED_AXES,
    AttitudeReading,
    Reading,
    Tags,
    align_tags,
    compute_rms,
    list_attitudes,
    list_free_axes,
    list_numeric_readings,
    list_readings,
    list_scales,
    pair_rates,
)
from gyrocal.recording import Recording

FITTING_RESIDUAL = 0.1  # residual over motion up to which a reading fits: it has errors of G and noise
USABLE_RESIDUAL = 0.5  # residual over motion above which a mapping is refused
LARGEST_RESIDUAL_RATIO = 0.5  # times the residual before: an alternative must fit so much better
RESIDUAL_TIE_FACTOR = 1.25  # times the smallest residual: readings up to it fit equally well
LARGE_DRIFT = np.deg2rad(10.0)  # by a bias over the longest interval


@dataclass(frozen=True)
class Agreement:
    """Agreement of the rates and attitudes of the tables."""

    residual: float  # as read, RMS over that of the motion
    best: Reading | None = None  # of the readings that fit best, much better than as read, the one with the fewest changes
    where: str = ""  # place in time of a misfit that no reading removes

    @property
    def fits(self) -> bool:
        """Whether the rates agree with the attitudes as read; a calibration estimates rotated or skew axes."""
        return self.residual <= USABLE_RESIDUAL and (self.best is None or self.best.kind in ("rotation", "axes"))

    @property
    def sentence(self) -> str:
        """The misfit as read, and the reading that fits."""
        lead = f"rates and attitudes do not fit each other: they differ by {100 * self.residual:.0f} % of the motion"
        if self.best is not None:
            return f"{lead}; {self.best.sentence}"
        return (
            f"{lead}, and no other unit, order of elements, direction, order or sign of axes, factor, clock rate or time "
            f"offset fits{f'; {self.where}' if self.where else ''}; are they of the same body and time? With --unchecked they "
            "are imported all the same, and gyrocal diagnose names causes if the calibration is possible"
        )

    @property
    def summary(self) -> str:
        """The misfit as read; a large misfit is never called a fit."""
        share = f"they differ by {100 * self.residual:.2g} % of the motion"
        if self.residual <= FITTING_RESIDUAL:
            return f"rates and attitudes fit each other: {share}"
        return f"rates and attitudes fit only roughly: {share}{f'; {self.where}' if self.where else ''}"


def evaluate_agreement(
    windows: Motion,
    unit: str = "",
    time_unit: str = "",
    order: str = "",
    reverse: bool = False,
    alternatives: Sequence[AttitudeReading] = (),
    G: Array | None = None,
    accumulated: bool = False,
) -> Agreement:
    """Compare rates and attitudes, as read and under alternative mappings.

    Parameters
    ----------
    unit, time_unit, order : of rates, times and quaternions as read; the alternatives to each are tried, none to ""
    reverse : whether the quaternions on file have been conjugated to be inertial to body
    alternatives : further readings of the attitudes
    G : (3, 3) from the readings of three gyros to the rates of the windows; with None the gyros' axes are not estimated
    accumulated : whether the rates are differences of an accumulated angle, which a factor of time makes smaller
    """
    as_read = _evaluate_as_read(windows)
    if as_read <= FITTING_RESIDUAL:
        return Agreement(as_read)
    given = AttitudeReading((), windows.q), *alternatives
    attitudes = [attitude for reading in given for attitude in list_attitudes(reading, order, reverse)]
    scales = list_scales(unit, time_unit)
    pairs = pair_rates(Tags(windows), attitudes)
    named = [reading for pair in pairs for reading in list_readings(pair, scales, SIGNED_AXES)]
    if not any(reading.residual <= FITTING_RESIDUAL for reading in named):
        aligned = [pair for tags in align_tags(windows, attitudes, accumulated) for pair in pair_rates(tags, attitudes)]
        named += [reading for pair in aligned if pair.tags.factor == 1 for reading in list_readings(pair, scales, SIGNED_AXES)]
        pairs += aligned
    best, smallest = _choose_reading(named, None, min(as_read, 2 * USABLE_RESIDUAL))
    if smallest > FITTING_RESIDUAL:
        numeric = [reading for pair in pairs for reading in list_numeric_readings(pair, scales)]
        best, smallest = _choose_reading(numeric, best, smallest)
    if smallest > FITTING_RESIDUAL and G is not None:
        # Only with the tags of the best reading so far: a free matrix with other tags fits errors of both.
        offset_s = 0.0 if best is None else best.offset_s
        same_tags = [pair for pair in pairs if pair.tags.offset_s == offset_s and pair.tags.factor == 1]
        free_axes = [reading for pair in same_tags for reading in list_free_axes(pair, scales, G)]
        best, _ = _choose_reading(free_axes, best, smallest)
    is_removed = best is not None and best.kind in ("named", "alignment")
    return Agreement(as_read, best, "" if is_removed else _describe_misfit(windows))


def explain_refusal(error: LargeResidualError) -> str:
    """Return the text of an error with the reading of the tables that would fit, if there is one."""
    reason = "" if error.start is None else _explain_residuals(*error.start)
    return f"{error}; {reason}" if reason else str(error)


def _explain_residuals(recording: Recording, G: Array, bias: Array) -> str:
    """Explain large residuals of a recording at its a-priori G and bias; empty without an explanation."""
    gyro, references = recording.gyro, recording.attitudes
    if not gyro.rates.any():
        return "all rates are zero"
    windows = build_motion(gyro.t_s, gyro.rates @ G.T + bias, gyro.sample_s, references.t_s, references.quaternions)
    if windows is None:
        return ""
    agreement = evaluate_agreement(windows, "deg/s", "s", "scalar-last")
    if agreement.best is not None and agreement.fits:
        return f"rates and attitudes fit much better if imported anew: {agreement.best.sentence}"
    if agreement.best is not None:
        return f"{agreement.sentence}{', as an option of gyrocal import' if agreement.best.kind == 'alignment' else ''}"
    bias_error = None if windows.is_coarse else estimate_constant_bias(windows)
    if bias_error is None:
        return f"{agreement.summary}; {_describe_misfit(windows)}" if not agreement.where else agreement.summary
    longest = max(interval.stop_s - interval.start_s for interval in recording.intervals)
    if np.linalg.norm(bias_error) * longest < LARGE_DRIFT:
        return ""
    values = ", ".join(f"{value:.4g}" for value in np.rad2deg(bias + bias_error))
    return (
        f"rates and attitudes fit each other with a bias of {values} deg/s: give it as apriori_bias_deg_s, as the mean "
        f"of a rest would, or split the intervals, of which the longest has {longest:.6g} s"
    )


def _describe_misfit(windows: Motion) -> str:
    """Describe where a misfit lies that no alternative mapping removes."""
    if windows.is_coarse:
        return "the attitudes are too far apart for the mean rates between them to be compared well"
    return locate_misfit(windows)


def _evaluate_as_read(windows: Motion) -> float:
    """Compute the RMS misfit of the tables as read over the RMS motion, with or without a constant bias, whichever is less."""
    gyro, inside = windows.compute_gyro_rates()
    reference = windows.compute_attitude_rates()[inside]
    if len(reference) < FEWEST_RATE_WINDOWS:
        return np.inf
    residual = reference - gyro[inside]
    centred = compute_rms(residual - residual.mean(axis=0)) / compute_rms(reference - reference.mean(axis=0))
    return min(compute_rms(residual) / compute_rms(reference), centred)


def _choose_reading(readings: Sequence[Reading], previous: Reading | None, residual: float) -> tuple[Reading | None, float]:
    """Choose the reading with the fewest changes among those that fit best; the previous one unless its residual halves."""
    smallest = min((reading.residual for reading in readings), default=np.inf)
    if smallest > LARGEST_RESIDUAL_RATIO * residual:
        return previous, residual
    good = [reading for reading in readings if reading.residual <= max(RESIDUAL_TIE_FACTOR * smallest, smallest + 0.02)]
    best = min(good, key=lambda candidate: (candidate.count, candidate.residual))
    is_tied = best.kind == "named" and sum(reading.count == best.count for reading in good) > 1
    return replace(best, is_tied=is_tied), best.residual


# ---- a nearly constant motion ----------------------------------------------------------------------------------------------


def describe_mean_rates(windows: Motion) -> str:
    """Describe a difference between the mean rates of a nearly constant motion by gyro and attitudes; empty without one.

    A constant bias explains any difference of the two, so no reading is refused for it. No mounting changes the size.
    """
    gyro, inside = windows.compute_gyro_rates()
    reference, gyro = windows.compute_attitude_rates()[inside], gyro[inside]
    if len(gyro) < FEWEST_RATE_WINDOWS:
        return ""
    mean_ref, mean_gyro = reference.mean(axis=0), gyro.mean(axis=0)
    by_attitudes, by_gyro = float(np.linalg.norm(mean_ref)), float(np.linalg.norm(mean_gyro))
    if windows.is_coarse or compute_rms(gyro - mean_gyro) > FITTING_RESIDUAL * by_gyro:
        return ""  # the motion decides
    span = float(windows.stop_s[inside][-1] - windows.start_s[inside][0])
    independent = max(span / float(np.median(windows.stop_s - windows.start_s)), 1.0)
    sigma = compute_rms(reference - mean_ref) / np.sqrt(independent)
    difference = float(np.linalg.norm(mean_ref - mean_gyro))
    is_seen = by_attitudes >= SIGNIFICANT_IN_SIGMA * sigma
    if not is_seen or difference <= max(FITTING_RESIDUAL * by_attitudes, SIGNIFICANT_IN_SIGMA * sigma):
        return ""
    # Errors across the rate lengthen it by half their square over it.
    along = float(np.std((reference - mean_ref) @ mean_ref)) / by_attitudes / np.sqrt(independent)
    size_sigma = along + sigma**2 / (2 * by_attitudes)
    shown = np.rad2deg([by_gyro, by_attitudes, size_sigma, difference])
    sizes = f"the mean rate is {shown[0]:.4g} deg/s by the gyro, {shown[1]:.4g} ± {shown[2]:.1g} deg/s by the attitudes"
    if abs(by_gyro - by_attitudes) <= max(FITTING_RESIDUAL * by_attitudes, SIGNIFICANT_IN_SIGMA * size_sigma):
        return f"{sizes}, in another direction: a bias of {shown[3]:.3g} deg/s, or a rotation (--mounting estimate)"
    return (
        f"{sizes}, which no rotation explains: a bias of {shown[3]:.3g} deg/s, gyros that are not at right angles (--axes), "
        f"or a factor (--rate-factor {by_attitudes / by_gyro:.4g}); the motion does not tell them apart"
    )
