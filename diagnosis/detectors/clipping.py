"""Readings that stand at their largest: a gyro that is clipped, and not one that stops or a steady rate on a lattice.

A clipped gyro stands at the end of its range, on either side of its reading at rest, and its rate runs up to the end: the last
reading before a plateau is as near to it as readings are to one another. The level at which a gyro stops may be anywhere: other
readings lie farther from that at rest, or a jump leads to it. The probability is that of the gaps at both ends of all plateaus,
nearly all of which are small under clipping, and half of them under a stop.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf, expit

from diagnosis.detectors.number_format import NumberFormats
from diagnosis.detectors.sample_report import AXES, IMPOSSIBLE, Findings, SampleTest, Symptom
from gyrocal.mask_runs import find_mask_runs
from gyrocal.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FEWEST_CLIPPED = 5  # samples at the largest reading
FEWEST_PLATEAU = 20  # samples in a run of clipped ones on a lattice
OFTEN = 3  # times as often as any other reading, that the largest stands if it is clipped
PLATEAU_P = 1e-8  # chance of a steady rate to stand still that long
OUTSIDE = 5  # readings before and after a plateau, whose largest change is what a reading changes by there
REACHED = 2.0  # of those changes, up to which the rate runs up to the plateau
# share of the ends of plateaus at which it does, of a gyro that is clipped and of one that stops
CLOSE = (0.95, 0.5)


def find_clipping(recording: Recording, used: Mask, formats: NumberFormats, sigma: float) -> tuple[Findings, Mask]:
    """Find gyros whose largest reading stands still where no lattice makes it.

    Parameters
    ----------
    recording : what was recorded
    used : (n,) samples inside the intervals
    formats : of the readings
    sigma : of the noise of a sample, rad/s

    Returns
    -------
    Tests and departures, and (n,) samples at the largest reading of such a gyro
    """
    rates, steps = recording.gyro.rates, formats.steps
    tests, symptoms, all_clipped = [], [], np.zeros(len(rates), dtype=bool)
    # A largest reading that telemetry repeats stands still on all axes; of a clipped gyro the others go on.
    held = np.zeros(len(rates), dtype=bool)
    held[1:] = (rates[1:] == rates[:-1]).all(axis=1)
    at_rest = -np.linalg.solve(recording.gyro.apriori_G, recording.gyro.apriori_bias)
    for axis in range(3):
        x = rates[used, axis]
        largest = float(np.abs(x).max())
        at = np.abs(x) >= largest * (1 - 1e-12)
        count = int((at & ~held[used]).sum())
        # A gyro that reads zero throughout is dead, not clipped.
        found = largest > 0 and count >= FEWEST_CLIPPED
        if found and formats.coarse[axis]:
            found = _is_plateau(at, float(steps[axis]) / sigma if sigma else np.inf)
        elif found:
            found = count >= OFTEN * _count_most_frequent(x[~held[used]], at[~held[used]])
        clipped = used & (np.abs(rates[:, axis]) >= largest * (1 - 1e-12))
        probability = compute_probability_of_clipping(rates[:, axis] - at_rest[axis], used, clipped, sigma) if found else 0.0
        tests.append(
            SampleTest(
                "clipped_samples", AXES[axis], count, 1.0, IMPOSSIBLE if found else 1.0, "plateau",
                f"{count} samples read exactly the largest rate, {np.rad2deg(largest):.4g} deg/s",
            )
        )  # fmt: skip
        all_clipped |= clipped & found
        if probability < 0.5:
            continue
        rounded, cut = bool(formats.may_be_rounded[axis]), bool(formats.may_be_cut[axis])
        below, above = _bound_level(float(np.rad2deg(steps[axis])), rounded, cut)
        size = float(np.rad2deg(largest)) + 0.5 * (above - below)
        spread = max((above + below) / np.sqrt(12), 1e-6 * size)
        symptoms.append(Symptom("plateau", AXES[axis], size, "deg/s", spread, {}, IMPOSSIBLE, probability=probability))
    return Findings(tuple(tests), tuple(symptoms)), all_clipped


def compute_probability_of_clipping(x: Array, used: Mask, clipped: Mask, sigma: float) -> float:
    """Compute the probability that readings at their largest are clipped, against a gyro that stops.

    Parameters
    ----------
    x : (n,) readings less the one at rest, rad/s
    used : (n,) samples inside the intervals
    clipped : (n,) those at the largest reading
    sigma : noise of a sample, rad/s
    """
    level = float(np.abs(x[clipped]).max())
    if float(np.abs(x[used]).max()) > level + REACHED * sigma:
        return 0.0
    log_odds = 0.0
    for low, high in find_mask_runs(clipped):
        for outside in (x[max(low - OUTSIDE, 0) : low][::-1], x[high : high + OUTSIDE]):
            if outside.size == OUTSIDE:
                change = max(float(np.abs(np.diff(outside)).max()), sigma)
                close = abs(float(x[low] - outside[0])) <= REACHED * change
                log_odds += np.log(CLOSE[0] / CLOSE[1]) if close else np.log((1 - CLOSE[0]) / (1 - CLOSE[1]))
    return float(expit(log_odds)) if clipped.sum() < used.sum() else 1.0


def _bound_level(step: float, rounded: bool, cut: bool) -> tuple[float, float]:
    """Bound the level of clipping below and above its reading on a lattice of this step."""
    return 0.5 * step * rounded, step if cut else 0.5 * step * rounded


def _count_most_frequent(x: Array, at: Mask) -> int:
    """Count the most frequent reading other than zero and the largest: floats with few digits repeat, also the largest one."""
    others = np.abs(x[~at & (x != 0.0)])
    return int(np.unique(others, return_counts=True)[1].max()) if others.size and not at.all() else 0


def _is_plateau(at: Mask, step: float) -> bool:
    """Whether the largest values stand in one solid block, as a noisy reading on a lattice of so many sigmas cannot.

    A reading stays on its lattice point at best with the probability that noise is less than half a step.
    """
    longest = max(high - low for low, high in find_mask_runs(at))
    stays = float(erf(0.5 * step / np.sqrt(2)))
    chance = np.log(at.size) + longest * np.log(stays) if stays < 1 else 0.0
    return longest >= FEWEST_PLATEAU and chance < np.log(PLATEAU_P)
