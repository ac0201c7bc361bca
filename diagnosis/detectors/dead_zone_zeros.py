"""A dead zone behind the noise: samples that read exactly zero, beside others that do not come near it.

Zeros beside readings that are as good as zero leave no zone, and a number format has zeros beside its first step. A gyro that
stops reads zero in one stretch, and a rate goes in and out of a zone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from diagnosis.detectors.number_format import NumberFormats
from diagnosis.detectors.sample_report import AXES, IMPOSSIBLE, Findings, SampleTest, Stream, Symptom
from gyrocal.mask_runs import find_mask_runs

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class DeadZoneZeroSettings:
    """Constants of `diagnosis.detectors.dead_zone_zeros`."""

    fewest_stretches: int = 3  # of zeros, in a dead zone
    first: float = 3.0  # steps of a number format, within which the smallest readings beside its zeros lie
    of_noise: float = 0.01  # noise sigmas, within which readings are as good as zero
    # readings that are not zero: the smallest show the edge, and the next ones how dense they are there
    smallest: int = 3
    next: int = 30
    beside: int = 10  # samples beside a zero that are left out of other tests


SETTINGS = DeadZoneZeroSettings()


def find_zeros(stream: Stream, formats: NumberFormats) -> tuple[Findings, Mask]:
    """Find samples that read exactly zero on no coarse lattice; also the samples (n,) beside those of a dead zone."""
    tests, symptoms, near = [], [], np.zeros(len(stream.rates), dtype=bool)
    for axis in np.flatnonzero(~formats.coarse):
        zero = (stream.recording.gyro.rates[:, axis] == 0.0) & stream.used
        sizes = np.sort(np.abs(stream.recording.gyro.rates[stream.used & ~zero, axis]))
        smallest = float(sizes[: SETTINGS.smallest].mean()) if sizes.size else 0.0
        is_away = smallest > max(SETTINGS.of_noise * stream.sigma, SETTINGS.first * float(formats.steps[axis]))
        zone = is_away and sizes.size > SETTINGS.next and len(find_mask_runs(zero)) >= SETTINGS.fewest_stretches
        p, text = IMPOSSIBLE if zone else 1.0, f"{int(zero.sum())} samples read exactly zero"
        tests.append(SampleTest("zero_samples", AXES[axis], int(zero.sum()), 0.0, p, "dead_zone", text))
        if zone:
            near |= scipy.ndimage.binary_dilation(zero, iterations=SETTINGS.beside)
            spacing = max(float(sizes[SETTINGS.smallest : SETTINGS.next].mean()) - smallest, 1e-3 * smallest)
            size, sigma = float(np.rad2deg(smallest)), float(np.rad2deg(spacing))
            symptoms.append(Symptom("dead_zone", AXES[axis], size, "deg/s", sigma, {}, IMPOSSIBLE))
    return Findings(tuple(tests), tuple(symptoms)), near
