"""One gyro that reads the same twice while the others go on: readings that were not made anew.

The difference of two readings that follow each other has a density that is smooth at zero, be it of noise or of motion. Numbers
of a format with the step q then show no difference as often as they show one of +q, or one of −q. Repeats n₀ beyond that third
of the n₀ + n₁ differences of at most q,

    P(n₀ or more) ≤ P(Binomial(n₀ + n₁, 1/3) ≥ n₀),

were not read. Of numbers without a step in sight, q is the smallest difference there is. The step of floating-point numbers
doubles where readings do, so that differences are gathered by the octave of the reading, and up to 2.5 of the smallest step are
counted there, which makes the bound wider.

Repeats on all axes are stale samples. Many zeros are a finding of their own, and the largest and smallest readings may
be those of a clipped gyro. Readings on a lattice coarser than their noise repeat by chance. None of these counts here.
"""

from __future__ import annotations

import numpy as np
import scipy.special
from numpy.typing import NDArray

from diagnosis.detectors.number_format import NumberFormats
from diagnosis.detectors.sample_report import AXES, IMPOSSIBLE, Findings, SampleTest, Stream, Symptom, mark_consecutive_samples

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEPS = 2.5  # of an octave's smallest difference, up to which differences are compared with none
FEWEST = 10  # repeats, below which nothing is said
WORTH = 1e-9  # of a reading: smaller differences are rounding


def find_own_repeats(stream: Stream, formats: NumberFormats, at_zero: Mask, event_p: float) -> Findings:
    """Find gyros whose readings repeat while those of the others change.

    Parameters
    ----------
    stream : samples inside the intervals
    formats : gyros that read on a coarse lattice are left out
    at_zero : (3,) gyros that read zero more often than noise allows
    event_p : p-value below which repeats are a departure
    """
    recording, used = stream.recording, stream.used
    rates, tests, symptoms = recording.gyro.rates, [], []
    follows = mark_consecutive_samples(recording, used)[1:]
    change = np.diff(rates, axis=0)
    together = (change == 0.0).all(axis=1)
    for axis in np.flatnonzero(~formats.coarse):
        x = rates[1:, axis]
        ends = (
            ((x == 0.0) & at_zero[axis])
            | (x == rates[used, axis].max(initial=-np.inf))
            | (x == rates[used, axis].min(initial=np.inf))
        )
        own = follows & ~together & ~ends
        repeats, p = compute_chance(x[own], change[own, axis])
        share = repeats / max(int(own.sum()), 1)
        text = f"gyro {AXES[axis]} reads {repeats} times the same as before while the others change"
        tests.append(SampleTest("own_repeats", AXES[axis], repeats, 0.0, p, "own_repeats", text))
        if p < event_p:
            symptoms.append(Symptom("own_repeats", AXES[axis], share, "of the samples", 0.0, {}, p, text))
    return Findings(tuple(tests), tuple(symptoms))


def compute_chance(x: Array, change: Array) -> tuple[int, float]:
    """Count readings x (n,) without a change from the one before, and compute the p-value that the format makes so many."""
    repeats = int(np.sum(change == 0.0))
    if repeats < FEWEST:
        return repeats, 1.0
    octave = np.frexp(np.abs(x) + np.abs(change))[1]
    size = np.where(np.abs(change) > WORTH * np.abs(x), np.abs(change), np.inf)
    near = 0
    for one in np.unique(octave[change == 0.0]):
        own = size[octave == one]
        near += int(np.sum(own <= STEPS * own.min())) if np.isfinite(own.min()) else 0
    return repeats, max(float(scipy.special.bdtrc(repeats - 1, repeats + near, 1 / 3)), IMPOSSIBLE)
