"""One gyro that reads the same twice while the others go on: readings that were not made anew.

The difference of two readings that follow each other has a density that is smooth at zero, be it of noise or of motion. Numbers
of a format with the step q then show no difference as often as they show one of +q, or one of −q. Repeats n₀ beyond that third
of the n₀ + n₁ differences of at most q,

    P(n₀ or more) ≤ P(Binomial(n₀ + n₁, 1/3) ≥ n₀),

were not read. Of numbers without a step in sight, q is the smallest difference there is. The step of floating-point numbers
doubles where readings do, so that differences are gathered by the octave of the reading, and up to 2.5 of the smallest step are
counted there, which makes the bound wider.

Repeats on all axes are stale samples; those of zero and of the largest and smallest readings are a dead zone or a clipped gyro;
readings on a lattice coarser than their noise repeat by chance. None of these counts here.
"""

from __future__ import annotations

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from diagnosis.detectors.report import AXES, IMPOSSIBLE, SampleReport, SampleTest, Symptom, consecutive
from gyrocal.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEPS = 2.5  # of an octave's smallest difference, up to which differences are compared with none
FEWEST = 10  # repeats, below which nothing is said
WORTH = 1e-9  # of a reading: smaller differences are rounding


def own_repeats(report: SampleReport, recording: Recording, used: Mask, coarse: Mask) -> None:
    """Note gyros whose readings repeat while those of the others change."""
    rates = recording.gyro.rates
    follows = consecutive(recording, used)[1:]
    change = np.diff(rates, axis=0)
    together = (change == 0.0).all(axis=1)
    for axis in np.flatnonzero(~coarse):
        x = rates[1:, axis]
        ends = (x == 0.0) | (x == rates[used, axis].max(initial=-np.inf)) | (x == rates[used, axis].min(initial=np.inf))
        own = follows & ~together & ~ends
        repeats, p = chance(x[own], change[own, axis])
        share = repeats / max(int(own.sum()), 1)
        text = f"gyro {AXES[axis]} reads {repeats} times the same as before while the others change"
        report.tests.append(SampleTest("own_repeats", AXES[axis], repeats, 0.0, p, "own_repeats", text))
        if p < report.event_p:
            report.symptoms.append(Symptom("own_repeats", AXES[axis], share, "of the samples", 0.0, {}, p, text))


def chance(x: Array, change: Array) -> tuple[int, float]:
    """Number of readings x (n,) without a change from the one before, and the p-value that the format makes so many."""
    repeats = int(np.sum(change == 0.0))
    if repeats < FEWEST:
        return repeats, 1.0
    octave = np.frexp(np.abs(x) + np.abs(change))[1]
    size = np.where(np.abs(change) > WORTH * np.abs(x), np.abs(change), np.inf)
    near = 0
    for one in np.unique(octave[change == 0.0]):
        own = size[octave == one]
        near += int(np.sum(own <= STEPS * own.min())) if np.isfinite(own.min()) else 0
    return repeats, max(float(scipy.stats.binom.sf(repeats - 1, repeats + near, 1 / 3)), IMPOSSIBLE)
