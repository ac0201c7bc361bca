"""The noise of a gyro in a recording, as stretches of rates without the motion.

docs/allan.md defines the stretches. If the references agree with a constant rate, A(t) = exp(−[ω×]t) A₀ with fitted ω and A₀, a
stretch is a *rest*: a constant rate does not enter second differences, and the raw rates are used unchanged. If the references
reject a constant rate, the mean over each sample of the rate of a cubic spline through them is subtracted from the calibrated
rates. This adds the references' errors to the rates; their part of each Allan variance is computed by drawing them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy.interpolate
import scipy.stats
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from diagnosis.detectors.sample_noise import estimate_local_noise, find_quiet_samples
from diagnosis.detectors.sample_report import find_long_runs, mark_consecutive_samples
from gyrocal import GyroParameters, InputError, Recording, UnobservableError, calibrate
from gyrocal.arrays import Array
from gyrocal.attitude import cross_matrix
from gyrocal.masking import mark_interval_samples
from gyrocal.recording import Interval, find_reference_rows

MOTION_MARGIN_SAMPLES = 60  # samples next to a visible motion that are left out, since it may begin gently
GENTLE = (20, 40, 80, 160)  # lengths, in samples, of means that detect a gentle motion
DEPARTS = 4.0  # sigmas: difference of two adjacent means that shows a motion
DENIED = 1e-4  # p-value below which the references reject a constant rate
FEWEST_SAMPLES = 256  # of a stretch
FEWEST_REFERENCES = 5  # for a spline
CONSTANT_RATE_ITERATIONS = 6  # of the fit of a constant rate


@dataclass(frozen=True)
class Stretch:
    """Samples that follow one another, without the motion of the body."""

    interval: str  # name
    samples: slice  # of the recording
    rest: bool  # whether the body turned at a constant rate, and the raw rates are used
    references: int  # how many there are in it
    p_value: float  # of a constant rate by the references, NaN if there are too few
    rates: Array  # (n, 3) rad/s, along the gyros for a rest, otherwise in body axes
    reference_sigma: Array  # (r, 3) rad, and reference_t_s : (r,) s; of the subtracted references, none for a rest
    reference_t_s: Array
    edges: Array  # (n + 1,) begin of each sample and end of the last, s

    def draw_reference_rates(self, rng: np.random.Generator) -> Array:
        """Draw the rates (n, 3) that errors of the references add, rad/s; zero for a rest."""
        if self.rest:
            return np.zeros_like(self.rates)
        errors = rng.standard_normal(self.reference_sigma.shape) * self.reference_sigma
        angle = scipy.interpolate.CubicSpline(self.reference_t_s, errors)(self.edges)
        return np.asarray(np.diff(angle, axis=0) / np.diff(self.edges)[:, None])


def find_stretches(recording: Recording, interval: str | None = None) -> tuple[tuple[Stretch, ...], tuple[str, ...]]:
    """Find the stretches of a recording, or of one interval, that show the gyro's noise, and notes on them.

    Raises `InputError` if the interval does not exist, or no stretch of it shows the noise.
    """
    calibrate_once = cache(lambda: _calibrate_or_use_stated(recording))  # costs seconds, and only a motion needs it
    built = [
        _build_stretch(recording, section, slice(low, high), lambda: calibrate_once()[0])
        for section, (low, high) in _find_quiet_runs(recording, _select_intervals(recording, interval))
    ]
    stretches = tuple(stretch for stretch in built if stretch is not None)
    if not stretches:
        subject = "the recording" if interval is None else f"interval {interval}"
        reason = f"all of it moves, or it is shorter than {FEWEST_SAMPLES} samples"
        raise InputError(f"no stretch of {subject} shows the gyro's noise: {reason}")
    notes = [] if all(stretch.rest for stretch in stretches) else list(calibrate_once()[1])
    if omitted := len(built) - len(stretches):
        notes.append(f"{omitted} stretch(es) moved and had fewer than {FEWEST_REFERENCES} references to say how; left out")
    if any(np.isnan(stretch.p_value) for stretch in stretches):
        notes.append("Without references inside a stretch nobody says that the body did not move: slow motion counts as noise")
    return stretches, tuple(notes)


def _select_intervals(recording: Recording, interval: str | None) -> list[Interval]:
    """Select all intervals, or the one of a name."""
    names = [section.name for section in recording.intervals]
    if interval is not None and interval not in names:
        raise InputError(f"--interval {interval}: no such interval; there are {', '.join(names)}")
    return [section for section in recording.intervals if interval in (None, section.name)]


def _find_quiet_runs(recording: Recording, intervals: list[Interval]) -> list[tuple[Interval, tuple[int, int]]]:
    """Find runs of samples of some intervals in which the rates do not visibly change."""
    gyro, none = recording.gyro, np.zeros(recording.gyro.t_s.size, dtype=bool)
    sigma = gyro.arw / np.sqrt(gyro.sample_s)
    noise = estimate_local_noise(gyro.rates, sigma, np.zeros(3, dtype=bool), np.zeros(3), none)
    usable = mark_interval_samples(recording) & find_quiet_samples(gyro.rates, noise)
    for levels in (noise, None):  # None: a body that moves gently all the time, whose motion the references show
        runs = [(interval, run) for interval in intervals for run in _find_usable_runs(recording, interval, usable, levels)]
        if runs:
            return runs
    return []


def _calibrate_or_use_stated(recording: Recording) -> tuple[GyroParameters, list[str]]:
    """Calibrate G and b from the recording; use the stated ones if it cannot be calibrated. Returns notes, too."""
    gyro = recording.gyro
    try:
        result = calibrate(recording)
        has_prior = result.has_plausible_prior
        return result.parameters, [
            "These maneuvers do not determine all of G and b: plausible ranges stand for the rest"
        ] * has_prior
    except UnobservableError:
        stated = GyroParameters(gyro.apriori_G, gyro.apriori_bias)
        return stated, ["These maneuvers do not determine G and b: the motion is taken out with the stated ones"]


def _find_usable_runs(
    recording: Recording, interval: Interval, usable: NDArray[np.bool_], noise: Array | None
) -> list[tuple[int, int]]:
    """Find unbroken runs of usable samples of an interval, without the beginning and end of visible motions."""
    t = recording.gyro.t_s
    first, last = np.searchsorted(t, [interval.start_s - 1e-6, interval.stop_s - recording.gyro.sample_s + 1e-6], side="left")
    in_interval = np.zeros_like(usable)
    in_interval[first:last] = usable[first:last]
    out = []
    begins = in_interval & ~np.append(False, in_interval[:-1])
    for low, high in find_long_runs(in_interval & (mark_consecutive_samples(recording, in_interval) | begins)):
        begin = low if low == first else low + MOTION_MARGIN_SAMPLES
        end = high if high == last else high - MOTION_MARGIN_SAMPLES
        if noise is not None:
            x = recording.gyro.rates[begin:end] / noise
            end -= 0 if high == last else _count_gentle_samples(x[::-1])
            begin += 0 if low == first else _count_gentle_samples(x)
        if end - begin >= FEWEST_SAMPLES:
            out.append((int(begin), int(end)))
    return out


def _count_gentle_samples(x: Array) -> int:
    """Count the samples (n, 3), in sigmas, that still belong to the motion before them, which ends gently."""
    gentle, k = 0, 0
    while k < len(GENTLE) and gentle + 2 * GENTLE[k] <= len(x):
        length = GENTLE[k]
        first, second = (x[gentle + part * length : gentle + (part + 1) * length].mean(axis=0) for part in (0, 1))
        if np.abs(first - second).max() > DEPARTS * np.sqrt(2 / length):
            gentle, k = gentle + length, 0  # the first mean is of the motion; start again after it, with short means
        else:
            k += 1
    return gentle


def _build_stretch(
    recording: Recording, interval: Interval, part: slice, parameters: Callable[[], GyroParameters]
) -> Stretch | None:
    """Build one stretch; None if it moves and has too few references for its motion."""
    gyro, attitudes = recording.gyro, recording.attitudes
    rows = find_reference_rows(attitudes.t_s, interval)
    end = gyro.t_s[part.stop - 1] + gyro.sample_s
    rows = rows[(attitudes.t_s[rows] >= gyro.t_s[part.start] - 1e-6) & (attitudes.t_s[rows] <= end + 1e-6)]
    t, rotations, sigma = attitudes.t_s[rows], Rotation.from_quat(attitudes.quaternions[rows]), attitudes.sigma[rows]
    p = compute_constant_rate_p(t, rotations, sigma) if rows.size > 2 else float("nan")
    if not p < DENIED:
        edges = np.append(gyro.t_s[part], end)
        return Stretch(interval.name, part, True, rows.size, p, gyro.rates[part], np.empty((0, 3)), np.empty(0), edges)
    if rows.size < FEWEST_REFERENCES:
        return None
    low, high = np.searchsorted(gyro.t_s[part], [t[0] - 1e-6, t[-1] - gyro.sample_s + 1e-6])
    part = slice(part.start + int(low), part.start + int(high))
    if part.stop - part.start < FEWEST_SAMPLES:
        return None
    edges = np.append(gyro.t_s[part], gyro.t_s[part.stop - 1] + gyro.sample_s)
    # A cubic spline of quaternions assumes nothing of the rate at the ends.
    q = rotations.as_quat()
    sign = np.sign(np.sum(q[1:] * q[:-1], axis=1))  # q and −q are one attitude: neighbours are made to agree
    q[1:] *= np.cumprod(np.where(sign == 0, 1.0, sign))[:, None]
    attitude = Rotation.from_quat(scipy.interpolate.CubicSpline(t, q)(edges))
    motion = (attitude[:-1].inv() * attitude[1:]).as_rotvec() / np.diff(edges)[:, None]
    gyro_parameters = parameters()
    rates = gyro.rates[part] @ gyro_parameters.G.T + gyro_parameters.bias - motion
    return Stretch(interval.name, part, False, rows.size, p, rates, sigma, t, edges)


def compute_constant_rate_p(t_s: Array, attitudes: Rotation, sigma: Array) -> float:
    """Compute the p-value of a constant rate in body axes for attitudes with errors of the stated size.

    Parameters
    ----------
    t_s : (m,) times, s; at least three
    attitudes : m rotations from body to inertial axes
    sigma : (m, 3) of their errors, rad
    """
    elapsed = t_s - t_s[0]
    steps = (attitudes[:-1].inv() * attitudes[1:]).as_rotvec() / np.diff(elapsed)[:, None]
    start, rate = attitudes[0], np.median(steps, axis=0)
    weights = 1 / sigma.reshape(-1)
    for _ in range(CONSTANT_RATE_ITERATIONS):
        turn = Rotation.from_rotvec(elapsed[:, None] * rate)
        residuals = (attitudes.inv() * (start * turn)).as_rotvec()
        # A change δω turns the attitude by t times the mean over the elapsed time of exp(−[ω×]s) δω.
        back = turn.inv().as_matrix()
        design = np.concatenate([back, elapsed[:, None, None] * _average_rotation(elapsed, rate)], axis=2).reshape(-1, 6)
        step = np.linalg.lstsq(design * weights[:, None], -residuals.reshape(-1) * weights, rcond=None)[0]
        start, rate = start * Rotation.from_rotvec(step[:3]), rate + step[3:]
    chi2 = float(np.sum((residuals.reshape(-1) * weights) ** 2))
    return float(scipy.stats.chi2.sf(chi2, 3 * t_s.size - 6))


def _average_rotation(elapsed: Array, rate: Array) -> Array:
    """Average exp(−[ω×]s) over s from 0 to each time (m, 3, 3): I − (1 − cos φ)/φ [u×] + (1 − sin φ/φ) [u×]²."""
    size = float(np.linalg.norm(rate))
    unit = rate / max(size, 1e-300)
    cross = cross_matrix(unit)
    angle = np.maximum(size * elapsed, 1e-9)[:, None, None]
    return np.asarray(np.eye(3) - (1 - np.cos(angle)) / angle * cross + (1 - np.sin(angle) / angle) * (cross @ cross))
