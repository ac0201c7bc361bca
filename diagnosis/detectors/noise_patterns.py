r"""Whether the noise of the samples depends on anything at all: a general question, of no known fault.

Under M0 the noise is white, normal, and independent of everything. Short blocks of samples x split into ê = Bᵀ B x, with B the
rows that whiten their upper spectrum (`diagnosis.detectors.noise_blocks`, B Bᵀ = 1), and the rest x − ê, which has the motion
in it. The two have independent noise: whatever is made of the rest and of the time is given beforehand, and ê is
N(0, σ² Bᵀ B). Only calm blocks count, in which no motion is left in ê, and none that come from zero: a dead zone, which is no
pattern, jumps there. What is asked of them is in `diagnosis.detectors.noise_questions`; whether single samples stand out, also
near zero, in `diagnosis.detectors.noise_tails`. Blocks begin every 37 samples, which is prime to all cycles that are asked for;
where there are more than show what matters, stretches all over the recording are taken. Of two gyros with calm blocks at the
same times, the noise must not correlate; with N cosines of both, the coefficient has the variance 1/N.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import scipy.ndimage
import scipy.stats
from numpy.typing import NDArray

from diagnosis.detectors.noise_blocks import (
    BACK,
    BLOCK,
    MEDIAN_SQUARE,
    ORDER,
    SHOWING,
    SLOW,
    WHITE,
    by_calm,
    fitted,
    is_near_zero,
    passes_zero,
    powers_of,
)
from diagnosis.detectors.noise_questions import (
    FAR,
    HIGHEST,
    Blocks,
    cycles_of_mean,
    cycles_of_power,
    levels,
    step,
    uneven,
    waves_of_level,
)
from diagnosis.detectors.noise_tails import tails
from diagnosis.detectors.report import (
    AXES,
    IMPOSSIBLE,
    SampleReport,
    SampleTest,
    Symptom,
    Tell,
    arcs,
    consecutive,
    inside,
    silent,
)
from gyrocal.recording import Recording
from simulator.effects.recorded import interval_slices

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

STRIDE = 37  # samples from block to block
FEWEST = 150  # blocks, below which nothing is said
MOST = 15_000  # blocks that are asked: a cycle of a hundredth of the noise then has T² = 39
TOGETHER = 50  # blocks that follow one another, which are chosen or left out together
SHARES = (1.0, 0.75, 0.5, 0.35, 0.25)  # of the blocks, the calmest, of which the first is taken in which no motion shows
FORMAT = 0.02  # noise sigmas in a step of the readings, from which on it matters at zero whether they are cut
NOTABLE = 0.01  # of the noise of a sample, or of its power, that matters
KINDS = 7  # of questions
IN_COMMON = 0.05  # correlation of the noise of two gyros that matters


def patterns(report: SampleReport, recording: Recording, used: NDArray[np.bool_], steps: Array, tell: Tell = silent) -> None:
    """Noise that depends on something, of gyros in which nothing else was found that would make it.

    Parameters
    ----------
    report, recording : what the samples showed so far
    used : (n,) samples that may be looked at
    steps : (3,) of the lattices that readings lie on, rad/s, zero if on none
    tell : called with what is looked at and the share done
    """
    good = used & inside(recording)
    good &= ~scipy.ndimage.binary_dilation(report.filled | report.clipped, iterations=2)
    size = BLOCK + ORDER
    runs = arcs(good & consecutive(recording, good))
    places = np.concatenate([np.empty(0, dtype=np.intp), *(np.arange(low, high - size, STRIDE) for low, high in runs)])
    if len(places) > MOST:
        groups = np.array_split(places, len(places) // TOGETHER)
        places = np.concatenate([groups[k] for k in np.linspace(0, len(groups) - 1, MOST // TOGETHER).astype(np.intp)])
    fast = {one.axis for one in report.lines if one.frequency_hz * recording.gyro.sample_s > SLOW}
    spoiled = fast | set(report.zones)
    falsified = any(one.kind in ("outliers", "repeats", "filled_samples", "plateau") for one in report.symptoms)
    calms: dict[int, Blocks] = {}
    for axis in range(3):
        tell(f"patterns of the noise of gyro {AXES[axis]}", axis / len(AXES))
        calm = (
            None
            if axis in spoiled or len(places) < FEWEST
            else _calm(report.rates, recording, places, axis, float(steps[axis]))
        )
        if calm is None:
            continue
        calms[axis] = calm
        found = [cycles_of_mean(calm), cycles_of_power(calm), step(calm), levels(calm), waves_of_level(calm)]
        if not falsified:
            found += [uneven(calm), tails(_everywhere(report.rates[:, axis], runs))]
        best = min(found, key=lambda one: one.p_value)
        p = min(1.0, max(KINDS * best.p_value, IMPOSSIBLE))
        text = f"the noise of gyro {AXES[axis]} is not independent of all else: {best.text}"
        report.tests.append(SampleTest("noise_pattern", AXES[axis], best.size, 0.0, p, "noise_pattern", text))
        _behaves(report, AXES[axis], p)
        if p < report.event_p and best.size > NOTABLE:
            error = best.size / float(scipy.stats.norm.isf(0.5 * p))
            report.symptoms.append(Symptom("noise_pattern", AXES[axis], best.size, "of the noise", error, {}, p, text))
    _in_common(report, calms)


def _in_common(report: SampleReport, calms: dict[int, Blocks]) -> None:
    """Noise that two gyros have in common, in the blocks that are calm on both; of a motion, the highest would have none."""
    for i, j in combinations(sorted(calms), 2):
        a, b = calms[i], calms[j]
        _, mine, others = np.intersect1d(a.start[:, 0], b.start[:, 0], return_indices=True)
        if mine.size < FEWEST:
            continue
        x, y = (np.clip(one, -FAR, FAR) for one in (a.cosines[mine], b.cosines[others]))
        coefficient, highest = (
            float(np.mean(x[:, :k] * y[:, :k]) / np.sqrt(np.mean(x[:, :k] ** 2) * np.mean(y[:, :k] ** 2)))
            for k in (SHOWING, HIGHEST)
        )
        p = max(float(2 * scipy.stats.norm.sf(abs(coefficient) * np.sqrt(x.size))), IMPOSSIBLE)
        pair = AXES[i] + AXES[j]
        text = f"the noise of gyros {AXES[i]} and {AXES[j]} in calm moments correlates by {coefficient:.3f}"
        report.tests.append(SampleTest("calm_noise_correlation", pair, coefficient, 0.0, p, "noise_correlation", text))
        known = any(one.kind == "noise_correlation" for one in report.symptoms)
        if p < report.event_p and min(abs(coefficient), highest * np.sign(coefficient)) > IN_COMMON and not known:
            error = float(1 / np.sqrt(x.size))
            report.symptoms.append(
                Symptom("noise_correlation", None, coefficient, "of the noise", error, {"gyros": pair}, p, text)
            )


def _behaves(report: SampleReport, axis: str, p: float) -> None:
    """Noise of another level or colour is that only where it depends on nothing."""
    for k, one in enumerate(report.symptoms):
        if one.kind in ("white_noise_level", "readout_noise") and one.axis in (None, axis):
            own = p if one.axis else min(1.0, len(AXES) * p)
            report.symptoms[k] = replace(one, likeness=min(one.likeness, own))


def _everywhere(x: Array, runs: list[tuple[int, int]]) -> Array:
    """(b, SHOWING) cosines of unit power of blocks that hold each sample once in their inner part, as `_calm` takes them.

    Those that come from zero count as well: the jump of a dead zone is a step.
    """
    size, inner = BLOCK + ORDER, BLOCK - ORDER
    windows = [np.lib.stride_tricks.sliding_window_view(x[low:high], size)[::inner] for low, high in runs if high - low >= size]
    cosines = np.concatenate([np.diff(one, ORDER, axis=1) @ WHITE.T for one in windows])
    found = _without_motion(cosines, by_calm(cosines))
    return cosines[found[0], :SHOWING] / np.sqrt(found[1]) if found else np.empty((0, SHOWING))


def _without_motion(cosines: Array, order: Indices) -> tuple[Indices, Array] | None:
    """The largest share of blocks in an order in which no motion shows, and their powers; None where it does in all."""
    for share in SHARES:
        chosen = np.sort(order[: int(share * order.size)])
        if chosen.size < FEWEST:
            return None
        powers = powers_of(cosines[chosen, :SHOWING])
        if powers.all() and fitted(powers / powers.mean(), chosen.size).still:
            return chosen, powers
    return None


def _calm(rates: Array, recording: Recording, places: Indices, axis: int, step: float) -> Blocks | None:
    """The largest share of the calmest blocks in which no motion shows; None where it does in all."""
    if len(places) < FEWEST:
        return None
    window = places[:, None] + np.arange(BLOCK + ORDER)
    x = rates[window, axis]
    cosines = np.diff(x, ORDER, axis=1) @ WHITE.T
    sigma = float(np.sqrt(np.median(cosines[:, :HIGHEST] ** 2) / MEDIAN_SQUARE))
    order = by_calm(cosines)
    at_zero = is_near_zero(x, sigma) if step > FORMAT * sigma else passes_zero(x, sigma)
    order = order[~at_zero[order]]
    found = _without_motion(cosines, order)
    if found is None:
        return None
    chosen, powers = found
    sigma, window = float(np.sqrt(powers.mean())), window[chosen]
    shown = cosines[chosen, :SHOWING] / sigma
    noise = shown @ BACK
    rest = x[chosen] - sigma * noise
    first = np.array([part.start for part in interval_slices(recording)])
    begin = first[np.searchsorted(first, places[chosen], side="right") - 1]
    ticks = np.round((recording.gyro.t_s - recording.gyro.t_s[0]) / recording.gyro.sample_s).astype(np.intp)
    start = np.column_stack([ticks[places[chosen]], ticks[places[chosen]] - ticks[begin]])
    axes = [axis, (axis + 1) % 3, (axis + 2) % 3]
    means = [rates[window, other].mean(axis=1) for other in axes]
    middle = places[chosen] + (BLOCK + ORDER) // 2
    angles = np.cumsum(rates[:, axes], axis=0) * recording.gyro.sample_s
    turned = angles[middle] - angles[begin]
    change = rest[:, -ORDER:].mean(axis=1) - rest[:, :ORDER].mean(axis=1)
    return Blocks(shown, noise, rest, start, np.column_stack(means), change, turned)
