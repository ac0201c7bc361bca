"""Checks of the parts of a recording; each raises an `InputError` with the place of a fault and the remedy."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from gyrocal.arrays import Array, Mask
from gyrocal.errors import InputError
from gyrocal.recording.parts import FORWARD_AXES, TIME_TOLERANCE_S, Attitudes, GyroStream, Interval, find_reference_rows

NORM_TOLERANCE = 1e-6  # |q| - 1 of a quaternion written with 7 digits
SMALLEST_DETERMINANT = 1e-3  # of an invertible G
SMALLEST_EIGENVALUE = 1e-9  # of a correlation matrix that can be inverted
LARGEST_RATE = float(np.deg2rad(1e5))  # rad/s, above the range of any gyro
SIGMA_RANGE = (float(np.deg2rad(1e-9)), float(np.deg2rad(180.0)))  # rad, of a plausible sigma of an attitude


def refuse_rows(table: str, bad: Mask, fault: str) -> None:
    """Refuse a table with bad rows (n,); the message names the first."""
    if bad.any():
        raise InputError(f"{table}: row {int(np.argmax(bad))}: {fault} ({int(bad.sum())} such)")


def check_times(t_s: Array, what: str) -> None:
    """Check that times (n,) are finite and increase."""
    if t_s.ndim != 1 or t_s.size == 0:
        raise InputError(f"{what}: no rows")
    if not np.isfinite(t_s).all():
        raise InputError(f"{what}: t_s row {np.flatnonzero(~np.isfinite(t_s))[0]} is not a finite number")
    back = np.flatnonzero(np.diff(t_s) <= 0)
    if back.size:
        row = back[0] + 1
        raise InputError(f"{what}: time goes backwards or repeats at row {row} (t_s {t_s[row - 1]} then {t_s[row]})")


def check_gyro(gyro: GyroStream) -> None:
    """Check a gyro stream: increasing times, finite rates, an invertible G, and samples as far apart as they are long."""
    check_times(gyro.t_s, "gyro")
    if gyro.rates.shape != (gyro.t_s.size, 3):
        raise InputError("gyro: rates must be three a sample; gyrocal.importing.join_gyros makes three of more gyros")
    if not np.isfinite(gyro.rates).all():
        raise InputError("gyro: rates must be finite numbers")
    if gyro.apriori_G.shape != (3, 3) or not abs(np.linalg.det(gyro.apriori_G)) >= SMALLEST_DETERMINANT:
        raise InputError("gyro: G must be 3×3, and the gyros' axes must not lie in one plane")
    if not gyro.sample_s > 0:
        raise InputError("gyro: sample_s must be positive")
    # The extremes of all rates show that there is such a row in a tenth of the time needed to find it.
    if not -LARGEST_RATE <= gyro.rates.min() <= gyro.rates.max() <= LARGEST_RATE:
        fast = np.flatnonzero((np.abs(gyro.rates) > LARGEST_RATE).any(axis=1))
        raise InputError(f"gyro: the rate in row {fast[0]} is beyond {np.rad2deg(LARGEST_RATE):g} deg/s; is the unit right?")
    spacing = np.diff(gyro.t_s)
    if spacing.size and abs(np.median(spacing) - gyro.sample_s) > 0.01 * gyro.sample_s:
        ratio = float(np.median(spacing)) / gyro.sample_s
        remedy = "is t_s in milliseconds? It is in seconds" if abs(ratio - 1e3) < 10.0 else "is sample_s right?"
        raise InputError(f"gyro: samples are {np.median(spacing):.6g} s apart, but sample_s is {gyro.sample_s:g}; {remedy}")
    close = np.flatnonzero(spacing < 0.5 * gyro.sample_s)
    if close.size:
        row = close[0] + 1
        raise InputError(
            f"gyro: rows {row - 1} and {row} are only {spacing[row - 1]:.6g} s apart; sample_s is {gyro.sample_s:g}"
        )


def check_attitudes(attitudes: Attitudes) -> None:
    """Check reference attitudes: increasing times, unit quaternions, sigmas in range, valid correlations."""
    check_times(attitudes.t_s, "attitude")
    count = attitudes.t_s.size
    if attitudes.quaternions.shape != (count, 4) or attitudes.sigma.shape != (count, 3):
        raise InputError("attitude: four quaternion elements and three sigmas a row are needed")
    norms = np.linalg.norm(attitudes.quaternions, axis=1)
    bad = np.flatnonzero(~(np.abs(norms - 1) <= NORM_TOLERANCE))
    if bad.size:
        text = f"quaternion in row {bad[0]} has norm {norms[bad[0]]:.9g}, not 1 ({bad.size} such); normalise them"
        raise InputError(f"attitude: {text}")
    low, high = SIGMA_RANGE
    bad = np.flatnonzero(~((attitudes.sigma >= low) & (attitudes.sigma <= high)).all(axis=1))
    if bad.size:
        limits = f"{np.rad2deg(low):g} and {np.rad2deg(high):g} deg"
        raise InputError(f"attitude: sigma in row {bad[0]} is not within {limits}")
    if attitudes.correlation is not None:
        if attitudes.correlation.shape != (count, 3):
            raise InputError("attitude: three correlations a row are needed, of x and y, x and z, y and z")
        R = replace(attitudes, sigma=np.ones((count, 3))).compute_covariance()
        bad = np.flatnonzero(~(np.linalg.eigvalsh(R)[:, 0] > SMALLEST_EIGENVALUE))
        if bad.size:
            raise InputError(f"attitude: the correlations in row {bad[0]} are those of no errors ({bad.size} such)")


def check_intervals(intervals: tuple[Interval, ...]) -> None:
    """Check intervals: unique names, positive durations, no overlap."""
    if not intervals:
        raise InputError("no [[interval]] is given")
    names = [interval.name for interval in intervals]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InputError(f"interval name {', '.join(repeated)} is used more than once")
    for interval in intervals:
        if interval.forward not in (None, *FORWARD_AXES):
            raise InputError(f"interval {interval.name}: forward {interval.forward} must be one of {', '.join(FORWARD_AXES)}")
        if not interval.stop_s > interval.start_s:
            raise InputError(f"interval {interval.name}: stop_s {interval.stop_s} is not after start_s {interval.start_s}")
    ordered = sorted(intervals, key=lambda interval: interval.start_s)
    for first, second in pairwise(ordered):
        if second.start_s < first.stop_s - TIME_TOLERANCE_S:
            raise InputError(
                f"intervals {first.name} and {second.name} overlap: "
                f"{second.name} starts at {second.start_s} s, before {first.name} stops at {first.stop_s} s"
            )


def check_references(t_s: Array, intervals: tuple[Interval, ...]) -> None:
    """Check that every interval has two references at least, and that every reference is in an interval."""
    used = np.zeros(t_s.size, dtype=bool)
    for interval in intervals:
        rows = find_reference_rows(t_s, interval)
        used[rows] = True
        if np.unique(t_s[rows]).size < 2:
            raise InputError(
                f"interval {interval.name}: {rows.size} reference attitude(s) inside "
                f"[{interval.start_s}, {interval.stop_s}] s; at least two are needed, the first one to start from"
            )
    if not used.all():
        row = np.flatnonzero(~used)[0]
        raise InputError(
            f"attitude row {row}: reference at t_s = {t_s[row]} lies outside every interval; "
            "widen the interval it belongs to or drop it"
        )
