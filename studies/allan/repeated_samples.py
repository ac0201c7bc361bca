"""Gyro samples that repeat the one before, removed ahead of an Allan deviation, and notes on the readings' number format.

The tests are those of a diagnosis (`diagnosis.detectors.repeats`, `diagnosis.detectors.number_format`). A repeated sample is no
measurement. Two processes make them:

* A slower gyro is read too often. The measurements come at a regular rate, so the number of repeats in windows of the same
  length differs by one at most. A measurement then lasts 1/(1 − f) samples, with f the share of repeats.
* Samples are lost and the logger holds the last one. The number of repeats in a window scatters with the variance
  W f (1 − f) or more. A measurement lasts one sample.

Windows with an expected variance of `WINDOW_VARIANCE` for lost samples separate the two: a regular rate has at most 1/4.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from diagnosis.detectors.number_format import find_lattice_step
from diagnosis.detectors.repeats import bridge_repeats
from diagnosis.detectors.sample_noise import DITHERED
from diagnosis.detectors.sample_report import Stream, mark_consecutive_samples
from diagnosis.settings import DEFAULT
from gyrocal import Recording
from gyrocal.arrays import Array, Mask
from gyrocal.calibration.parameters import AXIS_NAMES
from gyrocal.mask_runs import find_mask_runs
from gyrocal.masking import mark_interval_samples

WINDOW_VARIANCE = 30.0  # of the number of lost samples in a window
MOST_REGULAR_VARIANCE = 2.0  # of the number of repeats in a window at a regular rate, with room for jitter of a sample
FEWEST_WINDOWS = 3
NEGLIGIBLE_SHARE = 0.01  # of lost samples: angle random walk and averaging times then change by 1 % at most


class MeasuredSamples(NamedTuple):
    """A recording whose samples were measured."""

    recording: Recording  # without the repeats of a slower gyro
    measured: Mask  # (n,) its samples that stand for no lost one
    notes: tuple[str, ...]  # on the removed samples and the number format, a sentence each


def select_measured_samples(recording: Recording) -> MeasuredSamples:
    """Remove the repeated samples of a slower gyro, or mark those that stand for lost samples."""
    used = mark_interval_samples(recording)
    rates = recording.gyro.rates
    stream = Stream(recording, rates, np.zeros_like(rates), np.zeros_like(used), used)
    findings, bridged = bridge_repeats(stream, DEFAULT.sample_event)
    repeated, notes = bridged.filled, list[str]()
    if findings.symptoms and repeated.any():
        follows = mark_consecutive_samples(recording, used)
        if findings.tests[0].expected == 0:  # no repeat comes by chance, not even at the largest reading
            repeated = repeated | (follows & np.append(False, (rates[1:] == rates[:-1]).all(axis=1)))
        share = float(repeated[used].mean())
        text = f"{int(repeated.sum())} of {int(used.sum())} samples repeat the one before on all axes and are left out; "
        if has_regular_rate(repeated, follows, share):
            recording = _keep_measurements(recording, used, follows, repeated, share)
            repeated = np.zeros(recording.gyro.t_s.size, dtype=bool)
            text += f"the gyro measures at a regular {1 / recording.gyro.sample_s:.6g} Hz, which is the rate used here"
        else:
            text += "they come at irregular times, as lost samples do, so that one measurement lasts one sample"
            if share > NEGLIGIBLE_SHARE:
                text += (
                    f"; if the gyro itself measures at {1 - share:.3g} of the rate, its angle random walk is "
                    f"{1 / np.sqrt(1 - share):.3g} times the one here; slow noise has averaging times that are up to "
                    f"{1 / (1 - share):.3g} times longer than shown"
                )
        notes.append(text)
    return MeasuredSamples(recording, ~repeated, (*notes, *describe_lattices(recording)))


def has_regular_rate(repeated: Mask, follows: Mask, share: float) -> bool:
    """Decide whether measured samples come at a regular rate, from which samples repeat the one before or directly follow."""
    size = int(np.ceil(WINDOW_VARIANCE / max(share * (1 - share), 1e-12)))
    changes = list[Array]()
    for low, high in find_mask_runs(follows):
        count = (high - low) // size
        windows = repeated[low : low + count * size].reshape(count, size).sum(axis=1)
        changes.append(np.diff(windows))
    every = np.concatenate([np.empty(0), *changes])
    return every.size >= FEWEST_WINDOWS - 1 and float(np.mean(every**2)) / 2 < MOST_REGULAR_VARIANCE


def _keep_measurements(recording: Recording, used: Mask, follows: Mask, repeated: Mask, share: float) -> Recording:
    """Keep what a slower gyro measured inside the intervals, with evenly spaced tags between holes."""
    t_s, length = recording.gyro.t_s, recording.gyro.sample_s / (1 - share)
    kept, tags = list[NDArray[np.intp]](), list[Array]()
    begins = used & ~follows
    for low, high in zip(np.flatnonzero(begins), [*np.flatnonzero(begins)[1:], t_s.size], strict=True):
        rows = np.arange(low, high)
        own = rows[used[rows] & ~repeated[rows]]
        kept.append(own)
        tags.append(t_s[own[0]] + np.arange(own.size) * length)
    # A tag beyond the begin of the next piece, by less than a sample, comes from the length's own rounding.
    rows, times = np.concatenate(kept), np.concatenate(tags)
    good = np.append(np.diff(times) > 0.5 * length, True)
    return replace(
        recording,
        gyro=replace(recording.gyro, t_s=times[good], rates=recording.gyro.rates[rows[good]], sample_s=length),
    )


def describe_lattices(recording: Recording) -> list[str]:
    """Describe number formats so coarse that the readings' noise is not that of the gyro, a sentence an axis."""
    used, rates, notes = mark_interval_samples(recording), recording.gyro.rates, []
    follows = mark_consecutive_samples(recording, used)[1:]
    for axis, name in enumerate(AXIS_NAMES):
        step = find_lattice_step(rates[used, axis])
        change = np.diff(rates[:, axis])[follows]
        # The trimmed variance of changes holds no slews; rounding adds step²/12 to each reading.
        change = change[np.abs(change) <= np.quantile(np.abs(change), 0.99)] if change.size else np.zeros(1)
        noise = np.sqrt(max(float(np.mean(change**2)) / 2 - step**2 / 12, 0.0))
        if step > DITHERED * noise:
            notes.append(
                f"{name}: all readings are multiples of {np.rad2deg(step):.4g} deg/s, which is more than {DITHERED:g} "
                "times their noise: the terms are those of the rounded readings"
            )
    return notes
