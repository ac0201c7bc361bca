"""Number format of readings: the step of the lattice that all readings of a gyro lie on, and what it does to them.

The error of a rounded reading is spread evenly over a step q. Noise that spans a step or more makes it anew with each sample,
so that rounding adds noise of the variance q²/12 (Widrow, 1956). Without such noise the error stays as long as the reading
does, for a time T, and adds noise of the density q²/12 T.

A reading that is cut toward zero is, besides that, half a step too near to zero on average. At a rate x with the noise σ the
mean error is

    E[reading − x] = −½ q erf(x/(√2 σ))

Cutting differs from rounding about zero only; far from zero the half step looks like a bias that changes with the sign of the
rate. Both are one symptom here, and a model of the recording has the half step as a nuisance parameter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.special

from diagnosis.arrays import AXES
from diagnosis.detectors.sample_report import IMPOSSIBLE, Findings, SampleTest, Stream, Symptom, mark_consecutive_samples
from gyrocal.arrays import Array, Mask

WORTH = 3.0  # sigmas of the angle random walk over all samples, that half steps must turn by to matter
SAME = 0.01  # relative difference of the steps of one converter
COARSE = 0.2  # a lattice finer than this share of the noise is a number format: its rounding has 0.3 % of the power
EXACT = 0.02  # steps, by which a value may be off the lattice
PRINTED = 5e-5  # relative error of a number printed with five digits, by which it may be off as well
MOST_ALLOWED = 0.2  # steps, of this deviation, from which on a value says nothing of the lattice
FEWEST_INFORMATIVE = 50  # other values, by which the chance of a lattice is less than 1e-19


@dataclass(frozen=True)
class Lattices:
    """Lattices that the readings of three gyros lie on."""

    steps: Array  # (3,) step, rad/s; zero of readings on no lattice
    coarse: Mask  # (3,) whether rounding matters beside the noise of a sample
    may_bias: Mask  # (3,) whether half a step matters beside the noise of all samples

    def describe(self) -> Findings:
        """Describe the coarse lattice of each gyro; gyros on one lattice are one departure from M0."""
        steps_deg, tests = np.rad2deg(self.steps), []
        for axis, step, coarse in zip(AXES, steps_deg.tolist(), self.coarse, strict=True):
            text = _describe_step(step) if coarse else "readings lie on no lattice that matters beside the noise"
            p = IMPOSSIBLE if coarse else 1.0
            tests.append(SampleTest("lattice_step", axis, step, 0.0, p, "lattice", text))
        lattices: list[tuple[str | None, float]] = [(AXES[k], float(steps_deg[k])) for k in np.flatnonzero(self.coarse)]
        if self.coarse.all() and np.ptp(steps_deg) < SAME * steps_deg.mean():
            lattices = [(None, float(steps_deg.mean()))]
        symptoms = [
            Symptom("lattice", axis, step, "deg/s", 1e-6 * step, {}, IMPOSSIBLE, _describe_step(step))
            for axis, step in lattices
        ]
        return Findings(tuple(tests), tuple(symptoms))

    def add_noise(self, stream: Stream) -> Stream:
        """Add the noise of rounding to a stream whose lattices are coarse; the error stays while the reading does."""
        sample_s = stream.recording.gyro.sample_s
        follows = mark_consecutive_samples(stream.recording, stream.used)
        hold_s = sample_s * np.column_stack([measure_runs(x, follows) for x in stream.recording.gyro.rates.T])
        return replace(stream, density=stream.density + np.where(self.coarse, self.steps**2 / 12, 0.0) * hold_s)


def _describe_step(step: float) -> str:
    return f"all readings are multiples of {step:.4g} deg/s"


def find_lattices(rates: Array, sigma: float) -> Lattices:
    """Find the lattices that readings (n, 3), rad/s, with noise `sigma` lie on."""
    steps = np.array([find_lattice_step(x) for x in rates.T])
    return Lattices(steps, steps > COARSE * sigma, 0.5 * steps * np.sqrt(len(rates)) > WORTH * sigma)


def find_lattice_step(x: Array) -> float:
    """Find the step of the lattice that all values (n,) lie on; 0 if there is none."""
    values = np.unique(x)
    if values.size < 3:
        return 0.0
    gaps = np.diff(values)
    gaps = gaps[gaps > 1e-9 * max(float(np.abs(values).max()), 1e-30)]
    if not gaps.size:
        return 0.0
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    order = np.argsort(np.abs(values))
    for share in (0.01, 0.1, 1.0):
        chosen = values[order[: max(3, int(share * values.size))]]
        counts = np.round(chosen / step)
        if np.any(counts):
            step = float(counts @ chosen / (counts @ counts))
    deviation = np.abs(values / step - np.round(values / step))
    allowed = EXACT + PRINTED * np.abs(values / step)
    is_informative = allowed < MOST_ALLOWED
    is_printed = is_informative.sum() >= FEWEST_INFORMATIVE and bool((deviation < allowed)[is_informative].all())
    return step if deviation.max() < EXACT or is_printed else 0.0


def measure_runs(x: Array, follows: Mask) -> Array:
    """Measure the length (n,) in samples of the run of equal readings x (n,) that each belongs to; runs end with arcs."""
    begins = np.flatnonzero(np.append(True, (np.diff(x) != 0) | ~follows[1:]))
    lengths = np.diff(np.append(begins, x.size))
    return np.repeat(lengths, lengths)


def compute_cut_error(x: Array, step: float, sigma: float) -> Array:
    """Compute the mean error (n,) of readings that are cut toward zero to a step, at the rates x, in the unit of these.

    Without noise the error is −x up to one step about zero, which a σ of half a step approximates.
    """
    return np.asarray(-0.5 * step * scipy.special.erf(x / (np.sqrt(2) * max(sigma, 0.5 * step))))
