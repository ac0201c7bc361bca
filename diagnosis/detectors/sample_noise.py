"""Level and colour of the noise of the samples, and where they are quiet enough to show it.

Differences of order d of the samples leave little of a motion that is slow beside the sampling, the less the higher the order,
and of white noise of variance σ² the variance C(2d, d) σ². They correlate over d samples, so that the mean square of n of them
has the relative variance (2/n) C(4d, 2d)/C(2d, d)²: 3.9/n for d = 2, 6.3/n for d = 6. The second differences are taken where
they agree with the sixth, and the sixth elsewhere. The same differences of means over m samples have 1/m of it if the noise is
white. The ratio of the two, m times the second over the first, is the colour: one for white noise, 1/m
for angle white noise (readout noise, whose differences are the rates), more than one for noise that is correlated over several
samples. IEEE Std 952, annex C.

Where the body never rests, or where its samples in motion are so many more that they say clearly better what those at rest
say, the level is theirs (`diagnosis.detectors.noise_in_motion`). A body may sway within what seems quiet, which the means show
as slow noise, and then on two gyros or more; these arcs are taken as moving ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy.fft
import scipy.linalg
import scipy.ndimage
import scipy.stats
from numpy.typing import NDArray
from scipy.special import expit, logit

from diagnosis.detectors.differences import agree, autocorrelation_of, power_of
from diagnosis.detectors.noise_blocks import SHOWING, SLOW, blocks_of, outside_bands, powers_of
from diagnosis.detectors.noise_in_motion import FEWEST_BLOCKS, InMotion, Level, chance_of, level_in_motion, preciser
from diagnosis.detectors.number_format import NumberFormats
from diagnosis.detectors.readout_noise import AVERAGES, UNDECIDED, Readout, readout
from diagnosis.detectors.report import (
    AXES,
    IMPOSSIBLE,
    Findings,
    Line,
    SampleTest,
    Symptom,
    Tell,
    arcs,
    consecutive,
    silent,
)
from gyrocal.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

HALF = 20  # samples on either side of one in the test for quiet
MOVING = 20.0  # sigmas of the change of the mean that count as visible; a slew's are hundreds, those of a vibration a few
ORDERS = (2, 6)  # of the differences, the more efficient first
CLEARLY = 0.98  # probability from which on readout noise is no white noise
AVERAGED = 4  # samples in the means that show the colour
FEWEST = 200  # differences, below which nothing is said
TRIM = 5.0  # robust sigmas beyond which a difference does not count
WHITE = 0.2  # departure of the colour from one up to which noise is called white
SWAY = 3.0  # sigmas from one of a colour that two gyros show
RESOLVED = 0.34  # variance of the samples in squares of a lattice's step, below which it may be that of a few readings
OFF_ZERO = 5.0  # sigmas from zero, from which on cutting toward zero is rounding down
DITHERED = 1.5  # noise sigmas in a step, up to which rounding adds uniform noise, to 1e-3 of the variance (Widrow, 1956)
ELSEWHERE = 0.3  # share of too much power beside any one band of the spectrum, from which on it is noise of another level
LEAST_ERROR = 0.01  # of a noise factor that is compared with others
ONE_FACTOR = 14.0  # χ² of three noise factors with one mean, below which they are one: a chance of 1e-3
SLACK = 0.1  # departure of the noise factor that rounding to a few sigmas makes by itself


def local_noise(rates: Array, sigma: float, coarse: Mask, steps: Array, filled: Mask) -> Array:
    """(3,) robust noise of a sample that was measured, where enough were; what bridges the others has less."""
    order = ORDERS[-1]
    if len(rates) <= order:
        return np.full(3, sigma)
    measured = ~scipy.ndimage.binary_dilation(filled, iterations=order // 2)[order // 2 : filled.size - order // 2]
    if measured.sum() < FEWEST:
        measured[:] = True
    robust = np.median(np.abs(_differences(rates, order)[measured]), axis=0) / 0.6745 / np.sqrt(power_of(order))
    floor = np.where(coarse, np.sqrt(sigma**2 + steps**2 / 12), 0.0)
    return np.asarray(np.maximum(np.where(robust > 0, robust, sigma), floor))


def quiet(rates: Array, noise: Array, tell: Tell = silent) -> Mask:
    """Samples around which the mean rate does not visibly change on any axis."""
    moving = np.zeros(len(rates), dtype=bool)
    for axis, level in enumerate(noise):
        tell(f"quiet samples of gyro {AXES[axis]}", axis / 3)
        ahead = scipy.ndimage.uniform_filter1d(rates[:, axis], HALF, origin=-HALF // 2, mode="nearest")
        behind = scipy.ndimage.uniform_filter1d(rates[:, axis], HALF, origin=HALF // 2 - 1, mode="nearest")
        moving |= np.abs(ahead - behind) / (level * np.sqrt(2 / HALF)) > MOVING
    return ~scipy.ndimage.binary_dilation(moving, iterations=HALF)


def level(x: Array, usable: list[tuple[int, int]]) -> Level | None:
    """Level and colour of the noise of some runs of samples; None where there are too few."""
    parts = [x[low:high] for low, high in usable]
    fine, error, n = _variance(parts)
    if n < FEWEST:
        return None
    means = [part[: part.size - part.size % AVERAGED].reshape(-1, AVERAGED).mean(axis=1) for part in parts]
    coarse, coarse_error, count = _variance(means)
    if count < FEWEST / AVERAGED or fine <= 0 or coarse <= 0:
        return Level(fine, error, float("nan"), float("nan"))
    colour = AVERAGED * coarse / fine
    return Level(fine, error, colour, colour * float(np.hypot(error / fine, coarse_error / coarse)))


def readout_of(x: Array, usable: list[tuple[int, int]], expected: float) -> Readout | None:
    """Readout noise in some runs of samples, if that explains their noise better than white noise of another level."""
    powers: list[float] = []
    errors: list[float] = []
    averages: list[int] = []
    for m in AVERAGES:
        means = [x[low : high - (high - low) % m].reshape(-1, m).mean(axis=1) for low, high in usable]
        power, error, count = _mean_square(means, ORDERS[-1])
        if count >= FEWEST / AVERAGED and power > 0:
            powers.append(m * power)
            errors.append(m * error)
            averages.append(m)
    order = ORDERS[-1]
    share = math.comb(2 * order + 2, order + 1) / math.comb(2 * order, order) / np.array(averages, dtype=float)
    return readout(np.array(powers), np.array(errors), share, expected)


def _differences(x: Array, order: int) -> Array:
    """Differences along the first axis."""
    return np.diff(x, order, axis=0)


def _variance(parts: list[Array]) -> tuple[float, float, int]:
    """Variance of white noise that some runs of samples show, its standard error, and the number of differences."""
    found = [_mean_square(parts, order) for order in ORDERS]
    (low, _, n), (high, _, _) = found
    return found[0] if agree(low, high, ORDERS, n) else found[1]


def _mean_square(parts: list[Array], order: int) -> tuple[float, float, int]:
    d = np.concatenate([np.empty(0), *(_differences(part, order) for part in parts if part.size > order)])
    if d.size < FEWEST / AVERAGED:
        return 0.0, np.inf, d.size
    spread = float(np.median(np.abs(d))) / 0.6745
    kept = d[np.abs(d) < TRIM * spread] if spread > 0 else d
    variance = float(np.mean(kept**2)) / power_of(order)
    return variance, variance * float(np.sqrt(2 * autocorrelation_of(order) / kept.size)), int(kept.size)


def off_zero(x: Array, step: float, sigma: float) -> Mask:
    """Samples around which all readings are far from zero, where cutting toward zero is rounding down."""
    middle = scipy.ndimage.uniform_filter1d(x, HALF, mode="nearest")
    spread = np.sqrt(np.maximum(scipy.ndimage.uniform_filter1d((x - middle) ** 2, HALF, mode="nearest"), 0.0))
    near = np.abs(middle) < OFF_ZERO * np.maximum(spread, sigma) + 2 * step
    return np.asarray(~scipy.ndimage.binary_dilation(near, iterations=HALF))


@dataclass(frozen=True)
class SampleNoise:
    """Noise of the samples.

    Attributes
    ----------
    findings : tests and departures
    factor : (3,) of a sample, actual over stated noise
    density : (3,) of the noise density that integrates to the attitude, actual over stated
    """

    findings: Findings
    factor: Array
    density: Array


class _Noted:
    """Tests, departures and factors as they are found, gyro by gyro."""

    def __init__(self, event_p: float) -> None:
        self.event_p = event_p
        self.tests: list[SampleTest] = []
        self.symptoms: list[Symptom] = []
        self.factor, self.density = np.ones(3), np.ones(3)

    def freeze(self) -> SampleNoise:
        """Return what was found."""
        return SampleNoise(Findings(tuple(self.tests), tuple(self.symptoms)), self.factor, self.density)


def measure_noise(
    rates: Array,
    recording: Recording,
    quiet: Mask,
    used: Mask,
    replaced: Mask,
    formats: NumberFormats,
    lines: Sequence[Line],
    event_p: float,
    tell: Tell = silent,
) -> SampleNoise:
    """Measure level and colour of the noise of each axis, beside the lines of the spectrum.

    Parameters
    ----------
    rates : (n, 3) repaired readings, rad/s
    recording : as recorded
    quiet, used : (n,) samples at rest, and all that can be used
    replaced : (n,) samples that were not measured, or do not show the rate
    formats : of the readings
    lines : of the spectrum
    event_p : p-value below which noise is not as stated
    """
    noted, sigma = _Noted(event_p), recording.gyro.arw / np.sqrt(recording.gyro.sample_s)
    steps, coarse, cut = formats.steps, formats.coarse, formats.may_be_cut
    rough = coarse & (steps > DITHERED * sigma)
    measured = ~scipy.ndimage.binary_dilation(replaced, iterations=2)
    usable = arcs(quiet & consecutive(recording, quiet) & measured)
    moving = arcs(used & consecutive(recording, used) & measured)
    found: dict[int, Level] = {}
    readings: dict[int, Readout] = {}
    read_out: dict[int, Callable[[], None]] = {}
    streams = [rates[:, axis] - sum((one.waveform for one in lines if one.axis == axis), 0.0) for axis in range(3)]
    aways = [off_zero(x, steps[k], sigma) if cut[k] else np.ones(x.size, dtype=bool) for k, x in enumerate(streams)]
    still = [
        arcs(quiet & consecutive(recording, quiet) & measured & away) if cut[axis] else usable
        for axis, away in enumerate(aways)
    ]
    levels: list[Level | None] = []
    for axis, (x, rests) in enumerate(zip(streams, still, strict=True)):
        tell(f"noise level of gyro {AXES[axis]} at rest", axis / 6)
        levels.append(level(x, rests))
    sways = _sways([one for axis, one in enumerate(levels) if not rough[axis]])
    for axis, (x, away, rests) in enumerate(zip(streams, aways, still, strict=True)):
        tell(f"noise level of gyro {AXES[axis]} in motion", 0.5 + axis / 6)
        expected = sigma**2 + (steps[axis] ** 2 / 12 if coarse[axis] else 0.0)
        one = None if sways else levels[axis]
        rest = arcs(used & consecutive(recording, used) & measured & away) if cut[axis] else moving
        # A line is taken out of the quiet arcs alone.
        fast = [line for line in lines if line.axis == axis and line.frequency_hz * recording.gyro.sample_s > SLOW]
        beside = one is not None and bool(fast)
        in_motion = None if beside else level_in_motion(x, rest, expected)
        if one is None and in_motion is not None:
            one = in_motion.level
        elif one is not None and in_motion is not None and preciser(one, in_motion):
            one = replace(in_motion.level, colour=one.colour, colour_sigma=one.colour_sigma)
        else:
            in_motion = None
        if one is None or not one.variance > 0 or (coarse[axis] and one.variance < RESOLVED * steps[axis] ** 2):
            continue  # readings that stand still have no noise whose level could be told
        excess = (one.variance - expected) / sigma**2
        factor = float(np.sqrt(max(1 + excess, 1e-6)))
        p = max(in_motion.p_value if in_motion else chance_of(one, expected), IMPOSSIBLE)
        banded = p < noted.event_p and factor > 1 and in_one_band([x[low:high] for low, high in rests], in_motion, expected)
        if banded:
            p = 1.0
        # Rounding to a few noise sigmas is not uniform noise.
        if rough[axis] and abs(factor - 1) < SLACK:
            p = 1.0
        noted.tests.append(
            SampleTest(
                "noise_level", AXES[axis], factor, 1.0, p, "white_noise_level",
                f"the noise of the samples is {factor:.3f} times what is stated",
            )
        )  # fmt: skip
        p_colour = 1.0
        if np.isfinite(one.colour) and not rough[axis] and not banded:
            p_colour = max(float(2 * scipy.stats.norm.sf(abs(one.colour - 1) / one.colour_sigma)), IMPOSSIBLE)
            noted.tests.append(
                SampleTest(
                    "noise_colour", AXES[axis], one.colour, 1.0, p_colour, "noise_colour" if one.colour < 1 else "slow_noise",
                    f"means over {AVERAGED} samples have {one.colour:.3f} times the noise power of white noise",
                )
            )  # fmt: skip
        found[axis] = one
        if p < noted.event_p and factor > 1 and not rough[axis]:
            reading = in_motion.reading if in_motion else readout_of(x, rests, expected)
            if reading is None and p_colour < noted.event_p:
                # Where a body still rings, means of several samples hold its motion, and the calm blocks say it.
                calm = level_in_motion(x, rests, expected)
                reading = None if calm is None else calm.reading
            if reading is not None:
                readings[axis] = reading
                read_out[axis] = partial(
                    _read_out, noted, axis, reading, factor, min(p, p_colour), sigma, recording.gyro.sample_s, expected
                )
    undecided = _rather_white(readings, _alike(noted, found, sigma))
    readings = {axis: one for axis, one in readings.items() if axis not in undecided}
    for axis in readings:
        read_out[axis]()
    _name(noted, {axis: one for axis, one in found.items() if axis not in readings}, sigma, undecided)
    return noted.freeze()


def in_one_band(parts: list[Array], in_motion: InMotion | None, expected: float) -> bool:
    """Whether the power that runs of samples, or the blocks in motion, have too much of is in one band of the spectrum."""
    blocks = blocks_of(parts if in_motion is None else in_motion.parts)
    return len(blocks) >= FEWEST_BLOCKS and outside_bands(powers_of(blocks[:, :SHOWING]), expected) < ELSEWHERE


def _sways(levels: list[Level | None]) -> bool:
    """Whether slow noise shows on two gyros or more, so that it is the body's that sways within what seems quiet."""
    known = [one for one in levels if one is not None and np.isfinite(one.colour)]
    return sum(one.colour - 1 > max(WHITE, SWAY * one.colour_sigma) for one in known) > 1


def _read_out(
    noted: _Noted, axis: int, found: Readout, factor: float, p: float, sigma: float, sample_s: float, expected: float
) -> None:
    """Readout noise is a symptom; it adds nothing to the noise of the angle turned. White noise beside it may be another."""
    size, error = (float(np.rad2deg(value) * 3600 * sample_s) for value in (found.reading, found.sigma))
    text = f"the noise of the samples rises with the frequency as that of readings of the angle of {size:.3g} arcsec"
    rivals = (("white_noise_level", 1 - found.probability),) if found.as_stated and found.probability < CLEARLY else ()
    likely = 1.0 if rivals else found.probability
    noted.symptoms.append(Symptom("readout_noise", AXES[axis], size, "arcsec", error, {}, p, text, likely, rivals))
    noted.factor[axis] = factor
    if found.as_stated:
        return
    white = float(np.sqrt(max(1 + (found.white - expected) / sigma**2, 1e-6)))
    error = 0.5 * found.white_sigma / sigma**2 / white
    p_white = max(float(2 * scipy.stats.norm.sf(abs(white - 1) / error)), IMPOSSIBLE)
    noted.density[axis] *= white**2
    if p_white < noted.event_p:
        text = f"beside readout noise, the white noise of the samples is {white:.3f} times what is stated"
        noted.symptoms.append(Symptom("white_noise_level", AXES[axis], white, "factor", error, {}, p_white, text))


def _alike(noted: _Noted, found: dict[int, Level], sigma: float) -> bool:
    """Whether all three gyros have too much noise, and by one factor."""
    tests = [test for test in noted.tests if test.statistic == "noise_level"]
    if len(tests) < 3 or any(test.p_value >= noted.event_p or test.value < 1 for test in tests):
        return False
    factors = np.array([test.value for test in tests])
    errors = np.array([0.5 * found[AXES.index(str(test.axis))].sigma / sigma**2 / test.value for test in tests])
    return _are_one(factors, errors)


def _are_one(factors: Array, errors: Array) -> bool:
    """Whether the noise factors of three gyros are one."""
    weights = 1 / errors**2
    mean = float(np.sum(factors * weights) / np.sum(weights))
    return float(np.sum(((factors - mean) / np.maximum(errors, LEAST_ERROR)) ** 2)) < ONE_FACTOR


def _rather_white(readings: dict[int, Readout], alike: bool) -> dict[int, float]:
    """Probability of readout noise of the axes on which white noise is likelier.

    Noise that all gyros have too much of by one factor is of one kind: each says its part of which, and one whose noise is
    clearly white as much as an undecided one can at most.
    """
    own = {axis: one.probability for axis, one in readings.items() if one.as_stated and one.probability < CLEARLY}
    white = 3 - len(readings)
    if alike and white and len(own) == len(readings):
        odds = sum(float(logit(p)) for p in own.values()) - 0.5 * UNDECIDED * white
        if odds < 0:
            return dict.fromkeys(own, float(expit(odds)))
    return {axis: p for axis, p in own.items() if p < 0.5}


def _name(noted: _Noted, found: dict[int, Level], sigma: float, undecided: dict[int, float]) -> None:
    """White noise of another level is one symptom, noise of another colour is another."""
    tests = {(test.statistic, test.axis): test for test in noted.tests}
    factors, errors = np.ones(3), np.full(3, np.inf)
    white = []
    for axis, one in found.items():
        test, colour = tests["noise_level", AXES[axis]], tests.get(("noise_colour", AXES[axis]))
        factors[axis] = test.value
        errors[axis] = 0.5 * one.sigma / sigma**2 / max(test.value, 1e-3)
        coloured = colour is not None and colour.p_value < noted.event_p and abs(one.colour - 1) > WHITE
        if colour is not None and coloured and one.colour < 1:
            # Averages over time have less of it: what integrates to the attitude is the slow part.
            noted.factor[axis] = test.value
            noted.density[axis] *= min(test.value**2, test.value**2 * one.colour)
            noted.symptoms.append(
                Symptom("noise_colour", AXES[axis], one.colour, "of white noise", one.colour_sigma, {}, colour.p_value)
            )
        elif colour is not None and coloured and test.p_value < noted.event_p:
            # More than white noise at lower frequencies: what that is, the attitude sees better.
            noted.factor[axis] = test.value
            noted.density[axis] *= test.value**2
            noted.symptoms.append(
                Symptom("slow_noise", AXES[axis], one.colour, "of white noise", one.colour_sigma, {}, colour.p_value)
            )
        elif test.p_value < noted.event_p:
            white.append(axis)
            noted.factor[axis] = test.value
            noted.density[axis] *= test.value**2
    if not white:
        return
    common = len(white) == 3 and _are_one(factors, errors)
    for name, axes in [(None, white)] if common else [(AXES[axis], [axis]) for axis in white]:
        size = float(np.mean(factors[axes]))
        error = float(np.sqrt(np.mean(errors[axes] ** 2) / len(axes)))
        p = min(tests["noise_level", AXES[axis]].p_value for axis in axes)
        # Noise that all axes have is of one kind: each axis says its part of which.
        odds = sum(float(logit(undecided[axis])) if axis in undecided else -np.inf for axis in axes)
        rivals = (("readout_noise", float(expit(odds))),) if odds > -0.5 * UNDECIDED else ()
        noted.symptoms.append(Symptom("white_noise_level", name, size, "factor", error, {}, p, rivals=rivals))
