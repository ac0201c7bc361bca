"""Simulate any existing recording again: its motion is recovered, and M0 or effects are simulated on it.

The motion is that of the adjusted rates G ω_raw + b, smoothed so that their noise does not enter twice
(`gyrocal.smoothing`), integrated from each interval's first reference attitude by the simulator's own means, and
led near the other references. What they are off by, ζ_k in inertial axes, is followed by the x_k that minimise

    Σ |ζ_k − x_k|²/σ_k² + Σ |x_{k+1} − x_k|²/(q Δt_k)

with q = ARW²: where M0 holds these are the most likely attitude errors of the smoothed gyro (Rauch, Tung and Striebel, AIAA
Journal 3 (1965) 1445), and if they miss the references by more than their sigma q is raised until they do not. x is linear
between references; its slope is added to the rates, and the result is integrated again. The motion so found is the truth of
the replay: true G and b, rates and attitudes agree with each other to rounding.

A replay has the recording's sample tags, reference times, sigmas, ARW and tables, but other draws of the noise. A sample is
taken as constant in rate; holes between samples are bridged by the mean of their neighbours.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import solveh_banded

from gyrocal.arrays import Array
from gyrocal.recording import Recording, find_reference_rows
from simulator.effects import Setting
from simulator.effects.recording_view import compute_durations, find_interval_slices, smooth_rates
from simulator.sensors.gyro import compute_raw_rates
from simulator.simulate import add_effects_and_noise, make_noise_streams
from simulator.truth.integration import accumulate
from simulator.truth.motion import Motion
from simulator.truth.rotation import apply_rotation_errors, convert_to_matrix, separation

PASSES = 2  # the correction is linear in the error; one pass leaves its square
NEAR_MEAN_SQUARE = 1.5  # mean square distance to the references, in sigma, that is near
LOOSER = 10.0  # factor on q where they are missed
MOST_LOOSE = 10  # times
SETTLED_ATTITUDE_TOLERANCE = 1e-9  # rad; of an attitude that another interval has settled


def replay(
    recording: Recording,
    G: Array,
    bias: Array,
    effects: Sequence[Setting] = (),
    seed: int = 0,
    case: int = 0,
    noise: bool = True,
    motion: Motion | None = None,
) -> Recording:
    """Simulate a recording again.

    Parameters
    ----------
    recording : what to repeat
    G, bias : (3, 3), (3,) rad/s: true gyro parameters of the replay, usually the recording's calibration
    effects : errors beyond M0
    seed, case : of the random streams
    noise : whether gyro and references have their white noise
    motion : of `reconstruct_motion`, if it is at hand; the costly part, and the same for every case
    """
    path = reconstruct_motion(recording, G, bias) if motion is None else motion
    noise_free, (gyro_rng, reference_rng) = build_noise_free(recording, path, G, bias), make_noise_streams(seed, case, noise)
    return add_effects_and_noise(noise_free, path, effects, gyro_rng, reference_rng, seed, case)


def build_noise_free(recording: Recording, motion: Motion, G: Array, bias: Array) -> Recording:
    """Build the noise-free recording of a motion by a gyro with G (3, 3) and bias (3,), rad/s; all else as recorded."""
    return replace(
        recording,
        gyro=replace(recording.gyro, rates=compute_raw_rates(motion.rates, G, bias)),
        attitudes=replace(recording.attitudes, quaternions=motion.quaternions),
    )


def reconstruct_motion(recording: Recording, G: Array, bias: Array) -> Motion:
    """Reconstruct the motion of a recording by its calibration G (3, 3) and bias (3,), rad/s."""
    rates = smooth_rates(recording, G, bias)
    duration = compute_durations(recording)
    quaternions = recording.attitudes.quaternions.copy()
    slices = find_interval_slices(recording)
    sigma = np.sqrt((recording.attitudes.sigma**2).mean(axis=1))
    for part, interval in sorted(zip(slices, recording.intervals, strict=True), key=lambda pair: pair[1].start_s):
        rows = find_reference_rows(recording.attitudes.t_s, interval)
        if part.stop > part.start:
            references = _References(recording.attitudes.t_s[rows], quaternions[rows], sigma[rows])
            samples = _Samples(recording.gyro.t_s[part], duration[part], recording.gyro.arw)
            rates[part], quaternions[rows] = _fit_to_references(samples, rates[part], references)
            # Where the next interval starts at the same reference, the attitude is that.
            sigma[rows[-1]] = SETTLED_ATTITUDE_TOLERANCE
    return Motion(recording.gyro.t_s, duration, rates, slices, recording.attitudes.t_s, quaternions)


class _Samples(NamedTuple):
    begin: Array  # (n,) s
    duration: Array  # (n,) s
    arw: float  # rad/√s


class _References(NamedTuple):
    t_s: Array  # (m,)
    quaternions: Array  # (m, 4), observed
    sigma: Array  # (m,) rad


def _fit_to_references(samples: _Samples, rates: Array, references: _References) -> tuple[Array, Array]:
    """Fit the rates of one interval to its references: rates (n, 3), rad/s, and the attitudes at the references (m, 4)."""
    start = references.quaternions[0]
    t_ref = references.t_s
    for _ in range(PASSES):
        path, grid = _integrate_path(samples, rates, t_ref[0], start, t_ref)
        propagated = path[np.searchsorted(grid, t_ref)]
        # In inertial axes, Aᵀ e.
        error = np.einsum("nji,nj->ni", convert_to_matrix(propagated), separation(propagated, references.quaternions))
        x = _smooth_errors(error, references.sigma, np.diff(t_ref), samples.arw)
        start = apply_rotation_errors(start[None], (convert_to_matrix(start) @ x[0])[None])[0]
        slope = np.diff(x, axis=0) / np.diff(t_ref)[:, None]
        gap = np.clip(np.searchsorted(t_ref, samples.begin + 0.5 * samples.duration) - 1, 0, len(slope) - 1)
        at_sample = convert_to_matrix(path[np.searchsorted(grid, samples.begin)])
        # exp([e×]) A with e = A x turns with the body rate ω − A dx/dt.
        rates = rates - np.einsum("nij,nj->ni", at_sample, slope[gap])
    path, grid = _integrate_path(samples, rates, t_ref[0], start, t_ref)
    return rates, path[np.searchsorted(grid, t_ref)]


def _integrate_path(samples: _Samples, rates: Array, first_s: float, first: Array, marks: Array) -> tuple[Array, Array]:
    """Integrate attitudes (k, 4) at a grid of times (k,), all samples' edges and the marks, from the one at first_s."""
    begin = samples.begin
    end = np.minimum(begin + samples.duration, np.append(begin[1:], np.inf))
    grid = np.unique(np.concatenate([begin, end, marks]))
    middle = 0.5 * (grid[1:] + grid[:-1])
    sample = np.clip(np.searchsorted(begin, middle, side="right") - 1, 0, len(begin) - 1)
    next_sample = np.minimum(sample + 1, len(begin) - 1)
    hole = (middle > end[sample])[:, None]
    angles = np.where(hole, 0.5 * (rates[sample] + rates[next_sample]), rates[sample]) * np.diff(grid)[:, None]
    first_index = int(np.searchsorted(grid, first_s))
    if first_index > 0:  # samples that start before the first reference: back from it
        first = accumulate(first, -angles[:first_index][::-1])[-1]
    return accumulate(np.ascontiguousarray(first), angles), grid


def _smooth_errors(error: Array, sigma: Array, dt: Array, arw: float) -> Array:
    """Smooth attitude errors to x_k, (m, 3); see the module."""
    weight = 1 / sigma**2
    q = max(arw, 1e-12) ** 2
    for _ in range(MOST_LOOSE):
        tie = 1 / (q * dt)
        diagonal = weight + np.append(tie, 0.0) + np.append(0.0, tie)
        x = solveh_banded(np.vstack([np.append(0.0, -tie), diagonal]), weight[:, None] * error)
        if np.mean(((error - x) / sigma[:, None]) ** 2) < NEAR_MEAN_SQUARE:
            break
        q *= LOOSER
    return np.asarray(x)
