"""The noise of a gyro in a recording, as stretches of rates of which the motion is taken out.

docs/allan.md says which stretches count. Where the references agree with a constant rate, A(t) = exp(−[ω×]t) A₀ with ω and A₀
fitted to them, a stretch is a *rest*: a constant rate does not enter second differences, and the raw rates are used as they
are. Where they deny it, the mean over each sample of the rate of a cubic spline through them is taken out of the calibrated
rates. That puts the references' own errors into the rates; how much these add to each Allan variance is found by drawing them.
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

MOTION_MARGIN_SAMPLES = 60  # samples beside a visible motion that are left out, since it may have begun gently
GENTLE = (20, 40, 80, 160)  # samples whose means show that it has, where they are no rest yet
DEPARTS = 4.0  # sigmas between two such means, one beside the other, from which on the latter belongs to a motion
DENIED = 1e-4  # p-value of a constant rate, below which the references deny it
FEWEST_REFERENCES = 5  # for a spline
CONSTANT_RATE_ITERATIONS = 6  # of the fit of a constant rate


@dataclass(frozen=True)
class Stretch:
    """Samples that follow one another, without the motion of the body."""

    interval: str  # name
    samples: slice  # of the recording
    rest: bool  # whether the body turned at a constant rate, and the raw rates are used
    references: int  # how many there are in it
    p_value: float  # of a constant rate by the references, NaN where they cannot tell
    rates: Array  # (n, 3) rad/s, along the gyros, in body axes where it is no rest
    reference_sigma: Array  # (r, 3) rad, and reference_t_s : (r,) s; of those that were taken out, none for a rest
    reference_t_s: Array
    edges: Array  # (n + 1,) begin of each sample and end of the last, s

    def draw_reference_rates(self, rng: np.random.Generator) -> Array:
        """Rates (n, 3) that errors of the references make, rad/s; zero for a rest."""
        if self.rest:
            return np.zeros_like(self.rates)
        errors = rng.standard_normal(self.reference_sigma.shape) * self.reference_sigma
        angle = scipy.interpolate.CubicSpline(self.reference_t_s, errors)(self.edges)
        return np.asarray(np.diff(angle, axis=0) / np.diff(self.edges)[:, None])


def find_stretches(recording: Recording, interval: str | None = None) -> tuple[tuple[Stretch, ...], tuple[str, ...]]:
    """Find the stretches of a recording, or of one interval, that show the gyro's noise, and notes on them.

    An `InputError` if the interval does not exist, or no stretch of it shows the noise.
    """
    calibrate_once = cache(lambda: _calibrate_or_use_stated(recording))  # costs seconds, and only a motion asks for it
    built = [
        _build_stretch(recording, one, slice(low, high), lambda: calibrate_once()[0])
        for one, (low, high) in _find_quiet_runs(recording, _select_intervals(recording, interval))
    ]
    found = tuple(stretch for stretch in built if stretch is not None)
    if not found:
        where = "the recording" if interval is None else f"interval {interval}"
        raise InputError(f"no stretch of {where} shows the gyro's noise: all of it moves, or it is shorter than 256 samples")
    notes = [] if all(stretch.rest for stretch in found) else list(calibrate_once()[1])
    if lost := len(built) - len(found):
        notes.append(f"{lost} stretch(es) moved and had fewer than {FEWEST_REFERENCES} references to say how; left out")
    if any(np.isnan(stretch.p_value) for stretch in found):
        notes.append("Without references inside a stretch nobody says that the body did not move: slow motion counts as noise")
    return found, tuple(notes)


def _select_intervals(recording: Recording, interval: str | None) -> list[Interval]:
    """All intervals, or the one of a name."""
    names = [one.name for one in recording.intervals]
    if interval is not None and interval not in names:
        raise InputError(f"--interval {interval}: no such interval; there are {', '.join(names)}")
    return [one for one in recording.intervals if interval in (None, one.name)]


def _find_quiet_runs(recording: Recording, intervals: list[Interval]) -> list[tuple[Interval, tuple[int, int]]]:
    """Runs of samples of some intervals in which the rates do not visibly change."""
    gyro, none = recording.gyro, np.zeros(recording.gyro.t_s.size, dtype=bool)
    sigma = gyro.arw / np.sqrt(gyro.sample_s)
    noise = estimate_local_noise(gyro.rates, sigma, np.zeros(3, dtype=bool), np.zeros(3), none)
    usable = mark_interval_samples(recording) & find_quiet_samples(gyro.rates, noise)
    for levels in (noise, None):  # None: of a body that moves gently all the time, the references say how
        runs = [(interval, run) for interval in intervals for run in _find_usable_runs(recording, interval, usable, levels)]
        if runs:
            return runs
    return []


def _calibrate_or_use_stated(recording: Recording) -> tuple[GyroParameters, list[str]]:
    """G and b of the recording's own calibration, as stated where it cannot be calibrated."""
    gyro = recording.gyro
    try:
        found = calibrate(recording)
        free = found.has_plausible_prior
        return found.parameters, ["These maneuvers do not determine all of G and b: plausible ranges stand for the rest"] * free
    except UnobservableError:
        stated = GyroParameters(gyro.apriori_G, gyro.apriori_bias)
        return stated, ["These maneuvers do not determine G and b: the motion is taken out with the stated ones"]


def _find_usable_runs(
    recording: Recording, interval: Interval, usable: NDArray[np.bool_], noise: Array | None
) -> list[tuple[int, int]]:
    """Unbroken runs of usable samples of an interval, without what beside a visible motion goes with it beyond the noise."""
    t = recording.gyro.t_s
    first, last = np.searchsorted(t, [interval.start_s - 1e-6, interval.stop_s - recording.gyro.sample_s + 1e-6], side="left")
    own = np.zeros_like(usable)
    own[first:last] = usable[first:last]
    out = []
    begins = own & ~np.append(False, own[:-1])
    for low, high in find_long_runs(own & (mark_consecutive_samples(recording, own) | begins)):
        begin = low if low == first else low + MOTION_MARGIN_SAMPLES
        end = high if high == last else high - MOTION_MARGIN_SAMPLES
        if noise is not None:
            x = recording.gyro.rates[begin:end] / noise
            end -= 0 if high == last else _count_gentle_samples(x[::-1])
            begin += 0 if low == first else _count_gentle_samples(x)
        if end - begin >= 256:
            out.append((int(begin), int(end)))
    return out


def _count_gentle_samples(x: Array) -> int:
    """Count the samples (n, 3), in sigmas, that still belong to the motion before them, which ends gently."""
    left, k = 0, 0
    while k < len(GENTLE) and left + 2 * GENTLE[k] <= len(x):
        count = GENTLE[k]
        near, next_one = (x[left + part * count : left + (part + 1) * count].mean(axis=0) for part in (0, 1))
        if np.abs(near - next_one).max() > DEPARTS * np.sqrt(2 / count):
            left, k = left + count, 0
        else:
            k += 1
    return left


def _build_stretch(
    recording: Recording, interval: Interval, part: slice, parameters: Callable[[], GyroParameters]
) -> Stretch | None:
    """One stretch; None if it moves and too few references say how."""
    gyro, attitudes = recording.gyro, recording.attitudes
    rows = find_reference_rows(attitudes.t_s, interval)
    end = gyro.t_s[part.stop - 1] + gyro.sample_s
    rows = rows[(attitudes.t_s[rows] >= gyro.t_s[part.start] - 1e-6) & (attitudes.t_s[rows] <= end + 1e-6)]
    t, turned, sigma = attitudes.t_s[rows], Rotation.from_quat(attitudes.quaternions[rows]), attitudes.sigma[rows]
    p = compute_constant_rate_p(t, turned, sigma) if rows.size > 2 else float("nan")
    if not p < DENIED:
        edges = np.append(gyro.t_s[part], end)
        return Stretch(interval.name, part, True, rows.size, p, gyro.rates[part], np.empty((0, 3)), np.empty(0), edges)
    if rows.size < FEWEST_REFERENCES:
        return None
    low, high = np.searchsorted(gyro.t_s[part], [t[0] - 1e-6, t[-1] - gyro.sample_s + 1e-6])
    part = slice(part.start + int(low), part.start + int(high))
    if part.stop - part.start < 256:
        return None
    edges = np.append(gyro.t_s[part], gyro.t_s[part.stop - 1] + gyro.sample_s)
    # A cubic spline of quaternions assumes nothing of the rate at the ends.
    q = turned.as_quat()
    same = np.sign(np.sum(q[1:] * q[:-1], axis=1))
    q[1:] *= np.cumprod(np.where(same == 0, 1.0, same))[:, None]
    attitude = Rotation.from_quat(scipy.interpolate.CubicSpline(t, q)(edges))
    motion = (attitude[:-1].inv() * attitude[1:]).as_rotvec() / np.diff(edges)[:, None]
    found = parameters()
    rates = gyro.rates[part] @ found.G.T + found.bias - motion
    return Stretch(interval.name, part, False, rows.size, p, rates, sigma, t, edges)


def compute_constant_rate_p(t_s: Array, attitudes: Rotation, sigma: Array) -> float:
    """P-value of attitudes being those of a constant rate in body axes, with errors of the stated size.

    Parameters
    ----------
    t_s : (m,) times, s; at least three
    attitudes : m rotations from body to inertial axes
    sigma : (m, 3) of their errors, rad
    """
    since = t_s - t_s[0]
    steps = (attitudes[:-1].inv() * attitudes[1:]).as_rotvec() / np.diff(since)[:, None]
    start, rate = attitudes[0], np.median(steps, axis=0)
    weights = 1 / sigma.reshape(-1)
    for _ in range(CONSTANT_RATE_ITERATIONS):
        ahead = Rotation.from_rotvec(since[:, None] * rate)
        left = (attitudes.inv() * (start * ahead)).as_rotvec()
        # A change of ω turns the attitude by the mean over the time since the start of ω seen from the body axes then.
        back = ahead.inv().as_matrix()
        design = np.concatenate([back, since[:, None, None] * _average_rotation(since, rate)], axis=2).reshape(-1, 6)
        step = np.linalg.lstsq(design * weights[:, None], -left.reshape(-1) * weights, rcond=None)[0]
        start, rate = start * Rotation.from_rotvec(step[:3]), rate + step[3:]
    chi2 = float(np.sum((left.reshape(-1) * weights) ** 2))
    return float(scipy.stats.chi2.sf(chi2, 3 * t_s.size - 6))


def _average_rotation(since: Array, rate: Array) -> Array:
    """(m, 3, 3) mean of exp(−[ω×]s) over s from zero to each time: I − (1 − cos φ)/φ [u×] + (1 − sin φ/φ) [u×]²."""
    size = float(np.linalg.norm(rate))
    unit = rate / max(size, 1e-300)
    cross = cross_matrix(unit)
    angle = np.maximum(size * since, 1e-9)[:, None, None]
    return np.asarray(np.eye(3) - (1 - np.cos(angle)) / angle * cross + (1 - np.sin(angle) / angle) * (cross @ cross))
