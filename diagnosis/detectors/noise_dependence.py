"""Whether the level of a gyro's noise depends on the motion or on the time.

White noise of any level depends on nothing. Each short block (`diagnosis.detectors.noise_blocks`) has one estimate of the noise
power in which a motion with rough accelerations cancels: the squares of its cosines, weighted as the least squares of white
noise beside such a motion weigh them. Blocks in six classes of equal size, by a reading, its change or the time, have the same
mean then. An analysis of variance tests that, of each covariate; where classes are of equal size, it is robust against unequal
variances (Box, Annals of Mathematical Statistics 25, 1954). A body that shakes while it turns has it on several gyros, so
that a dependence of one gyro alone is reported.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.special
from numpy.typing import NDArray

from diagnosis.detectors.noise_blocks import (
    LEVEL_WEIGHTS,
    ORDER,
    SAMPLES,
    SHOWING,
    WHITE_COSINES,
    find_zero_crossings,
    rank_calm_blocks,
)
from diagnosis.detectors.sample_report import AXES, IMPOSSIBLE, Findings, SampleTest, Stream, Symptom

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FEWEST_BLOCKS = 150  # in six classes of 25, below which no test is made
CLASSES = 6  # of blocks
LARGEST = 6.0  # standard deviations of white noise above the mean, at which a block's power is cut off; by judgement
NOTABLE = 0.05  # standard deviation of the classes' means, as a share of the power, that matters; by judgement


def find_noise_dependence(stream: Stream, measured: Mask, tested: Mask, event_p: float) -> tuple[Findings, Array]:
    """Test whether the noise level of a gyro depends on readings, their change, or the time.

    Parameters
    ----------
    stream : repaired readings, without the tones of the spectrum
    measured : (n,) samples that were measured
    tested : (3,) gyros whose noise is that of M0 but for its level
    event_p : p-value below which a dependence is reported

    Returns
    -------
    Findings, and the p-value of each gyro (3,), 1 where it is not tested.
    """
    length = SAMPLES + ORDER
    begins = [np.arange(low, high - length + 1, SAMPLES) for low, high in stream.find_arcs(measured)]
    begin = np.concatenate([np.zeros(0, dtype=np.intp), *begins]).astype(np.intp)
    p_values, sizes, texts = np.ones(3), np.zeros(3), [""] * 3
    for axis in np.flatnonzero(tested):
        p_values[axis], sizes[axis], texts[axis] = _test_axis(stream, begin[:, None] + np.arange(length), int(axis))
    tests = tuple(
        SampleTest("noise_dependence", AXES[axis], float(sizes[axis]), 0.0, float(p_values[axis]), "noise_pattern", texts[axis])
        for axis in range(3)
        if texts[axis]
    )
    departing = (p_values < event_p) & (sizes > NOTABLE)
    if not departing.any():  # a dependence too small to matter is none
        return Findings(tests), np.where(sizes > NOTABLE, p_values, 1.0)
    if np.count_nonzero(departing) > 1:
        return Findings(tests), np.ones(3)
    one = int(np.argmax(departing))
    found = Symptom("noise_pattern", AXES[one], float(sizes[one]), "of its power", 0.0, {}, float(p_values[one]), texts[one])
    return Findings(tests, (found,)), np.where(departing, p_values, 1.0)


def lower_likeness(symptoms: tuple[Symptom, ...], p_values: Array) -> tuple[Symptom, ...]:
    """Lower the likeness of noise of another level where the level depends on something: that is white noise of no level."""
    out = []
    for one in symptoms:
        if one.kind in ("white_noise_level", "readout_noise"):
            p = min(1.0, 3 * float(p_values.min())) if one.axis is None else float(p_values[AXES.index(one.axis)])
            out.append(replace(one, likeness=min(one.likeness, p)))
        else:
            out.append(one)
    return tuple(out)


def _test_axis(stream: Stream, window: NDArray[np.intp], axis: int) -> tuple[float, float, str]:
    """Test one gyro: the smallest p-value times the number of covariates, its size and a sentence; no text if untested."""
    if len(window) < FEWEST_BLOCKS:
        return 1.0, 0.0, ""
    x = stream.rates[window, axis]
    cosines = np.diff(x, ORDER, axis=1) @ WHITE_COSINES.T
    calm = np.zeros(len(x), dtype=bool)
    calm[rank_calm_blocks(cosines)] = True
    calm &= ~find_zero_crossings(x, stream.sigma)
    if np.count_nonzero(calm) < FEWEST_BLOCKS:
        return 1.0, 0.0, ""
    window, power = window[calm], cosines[calm, :SHOWING] ** 2 @ LEVEL_WEIGHTS
    usual = float(np.median(power))
    if usual <= 0:
        return 1.0, 0.0, ""
    power = np.minimum(power / usual, 1 + LARGEST * np.sqrt(2 * np.sum(LEVEL_WEIGHTS**2)))
    found = []
    for name, values in _list_covariates(stream, window, axis):
        classes = np.array_split(np.argsort(values, kind="stable"), CLASSES)
        if values[classes[-1]].min() <= values[classes[0]].max():  # nearly all blocks have the same value
            continue
        found.append((*_compare_means([power[own] for own in classes]), name))
    if not found:
        return 1.0, 0.0, ""
    p, size, name = min(found)
    return max(min(1.0, len(found) * p), IMPOSSIBLE), size, f"the noise level of gyro {AXES[axis]} depends on {name}"


def _list_covariates(stream: Stream, window: NDArray[np.intp], axis: int) -> list[tuple[str, Array]]:
    """List what the level may depend on, with a value for each block."""
    gyro = stream.recording.gyro
    means = stream.rates[window].mean(axis=1)
    half, order = window.shape[1] // 2, ORDER
    own = stream.rates[window, axis]
    change = own[:, -order:].mean(axis=1) - own[:, :order].mean(axis=1)
    t_s = gyro.t_s[window[:, half]]
    begins = np.array([one.start_s for one in stream.recording.intervals])
    since = t_s - begins[np.maximum(np.searchsorted(begins, t_s, side="right") - 1, 0)]
    of_size = [("the size of its reading" if k == axis else f"the size of the reading of gyro {AXES[k]}", k) for k in range(3)]
    return [
        *((name, np.abs(means[:, k])) for name, k in of_size),
        ("its reading", means[:, axis]),
        ("the change of its reading", np.abs(change)),
        ("the time", t_s),
        ("the time since an interval's start", since),
    ]


def _compare_means(classes: list[Array]) -> tuple[float, float]:
    """Compare the means of classes by an analysis of variance: p-value, and standard deviation of the means in terms of all."""
    count, total = len(classes), sum(one.size for one in classes)
    everything = np.concatenate(classes)
    means = np.array([one.mean() for one in classes])
    between = sum(one.size * (mean - everything.mean()) ** 2 for one, mean in zip(classes, means, strict=True)) / (count - 1)
    within = sum(float(np.sum((one - mean) ** 2)) for one, mean in zip(classes, means, strict=True)) / (total - count)
    p = float(scipy.special.fdtrc(count - 1, total - count, between / max(within, 1e-300)))
    noise = within * count / total  # of a mean
    return p, float(np.sqrt(max(means.var(ddof=1) - noise, 0.0)) / max(everything.mean(), 1e-300))
