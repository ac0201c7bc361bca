"""Test whether gyro rates and attitudes agree as read, and name the reading of the tables that fits if they do not.

The mean body rate between two attitudes follows from the attitudes, dA/dt = −[ω×] A, and from the gyro:

    w_ref = s C w_gyro(t + τ) + b + noise

with the gyro's bias b; if everything is read correctly, s = 1, C = I and τ = 0. A reading error changes s (unit of rate or of
time), C (order and sign of the axes, mounting), τ or the clock rate (time tags), or w_ref itself (order of the quaternion's
elements, its direction). The time tags are aligned once: neither C nor the reading of a quaternion changes the speeds, whose
correlation gives τ and the clock rate (`alignment`). Then, for one reading of the attitudes, with centred sums

    |w_ref − s C w − b|² = Σ|w_ref|² − 2 s tr(Cᵀ Σ w_ref wᵀ) + s² Σ|w|²

gives the misfit of any s and C at once. Each stage below is tried if the one before leaves a misfit, and has to halve it:

1. named readings: units, the 48 orders and signs of the axes, and an offset of the tags;
2. numbers: the rotation that maximises tr(Cᵀ Σ w_ref wᵀ), a free factor, and a clock rate;
3. a free 3×3 matrix in place of s C: the rows of its inverse are the gyros' axes and scale factors.

Among readings that fit nearly as well as the best, the one with the fewest changes is reported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Literal, NamedTuple

import numpy as np

from gyrocal.angle_units import RATE_UNITS
from gyrocal.arrays import Array
from gyrocal.calibration.gate import LargeResidualError
from gyrocal.importing.alignment import LEAST_FACTOR, SIGNIFICANT_IN_SIGMA, refine, search_starts
from gyrocal.importing.motion import Motion, build_motion, estimate_constant_bias, locate_misfit, rotate_onto
from gyrocal.importing.units import SECONDS_A_DAY, TIME_UNITS
from gyrocal.recording import Recording

FITTING_RESIDUAL = 0.1  # residual over motion up to which a reading fits: it has errors of G and noise
USABLE_RESIDUAL = 0.5  # residual over motion above which a mapping is refused
LARGEST_RESIDUAL_RATIO = 0.5  # times the residual before: an alternative must fit so much better
RESIDUAL_TIE_FACTOR = 1.25  # times the smallest residual: readings up to it fit equally well
FEWEST_RATE_WINDOWS = 3  # with rates of both sides
LEAST_WINDOWS = 6  # to estimate a rotation of three angles
LEAST_SKEW = np.deg2rad(5.0)  # of the angles between three gyros from 90 deg: a smaller one is a gyro's own misalignment
LARGEST_FACTOR = 2.0  # of rates: a larger one is another unit, not a gyro's scale
LARGE_DRIFT = np.deg2rad(10.0)  # by a bias over the longest interval
FACTOR = "--rate-factor"
ROTATION_COUNT = 4  # changes that a free rotation counts for: more than the exchange of three axes
ALTERNATIVE_RATE_UNITS = ("rad/s", "deg/s", "deg/h")  # units that are confused with each other
ALTERNATIVE_TIME_UNITS = ("ms", "s", "us", "ns")
DAY_UNIT = "86400s"  # a day, in which spreadsheets count
ALTERNATIVE_ORDERS = {  # by the order as read: other orders of the elements, in words
    "": {},
    "scalar-last": {
        (1, 2, 3, 0): "the quaternion's scalar part first (scalar-first)",
        (1, 0, 2, 3): "q1 and q2 exchanged",
        (2, 1, 0, 3): "q1 and q3 exchanged",
        (0, 2, 1, 3): "q2 and q3 exchanged",
    },
    "scalar-first": {(3, 0, 1, 2): "the quaternion's scalar part last (scalar-last)"},
}
CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])
DIRECTION_WORDS = {
    False: "the attitude from inertial to body (inertial-to-body)",
    True: "the attitude from body to inertial (body-to-inertial)",
}


@dataclass(frozen=True)
class Reading:
    """One way to read the tables."""

    # axes exchanged, rotated, with a free factor or clock rate, or in free directions
    kind: Literal["named", "rotation", "alignment", "axes"]
    changes: tuple[str, ...]  # changes of the mapping, in words
    count: int  # number of changes; each axis that another one replaces counts as one
    residual: float  # RMS of w_ref − s C w − b over that of the motion
    offset_s: float = 0.0  # τ, s; added to the attitudes' tags
    is_tied: bool = False  # whether another reading fits equally well with as many changes

    @property
    def sentence(self) -> str:
        """The changes, the misfit with them, and the option that finds them."""
        text = f"{100 * self.residual:.1f} % with {' and '.join(self.changes) or 'small changes of all'}"
        if self.is_tied:
            text += ", which the motion does not tell from another reading that changes as much"
        if self.kind == "alignment":
            return f"{text}; --align auto finds and applies this"
        return f"{text}; --align auto finds and applies the offset" if self.offset_s else text


class AttitudeReading(NamedTuple):
    """Attitudes under one reading of the table."""

    words: tuple[str, ...]  # changes of the mapping
    q: Array  # (m, 4) inertial to body, scalar last


class Tags(NamedTuple):
    """Windows after a change of the time tags."""

    windows: Motion
    offset_s: float = 0.0  # added to the attitudes' tags
    factor: float = 1.0  # of the gyro's tags about the first

    @property
    def words(self) -> tuple[str, ...]:
        """The change in words; empty without one."""
        clock = (f"the gyro's time tags times {self.factor:.7g} (--time-factor)",) if self.factor != 1 else ()
        late = (f"{self.offset_s:+.4g} s added to the attitudes' time tags",) if self.offset_s else ()
        return clock + late


class AxesChange(NamedTuple):
    """Order, sign or rotation of the gyro's axes."""

    words: str
    C: Array  # (3, 3)
    moved: int  # number of axes that another one replaces, or `ROTATION_COUNT`


class RatePair(NamedTuple):
    """Mean rates by attitudes and gyro under one reading of attitudes and tags."""

    words: tuple[str, ...]  # of the attitudes
    tags: Tags
    # reference, gyro: (n, 3) rad/s less their means
    reference: Array
    gyro: Array


@dataclass(frozen=True)
class Agreement:
    """Agreement of the rates and attitudes of the tables."""

    residual: float  # as read, RMS over that of the motion
    best: Reading | None = None  # of the readings that fit best, much better than as read, the one with the fewest changes
    where: str = ""  # place in time of a misfit that no reading removes

    @property
    def fits(self) -> bool:
        """Whether the rates agree with the attitudes as read; a calibration estimates rotated or skew axes."""
        return self.residual <= USABLE_RESIDUAL and (self.best is None or self.best.kind in ("rotation", "axes"))

    @property
    def sentence(self) -> str:
        """The misfit as read, and the reading that fits."""
        lead = f"rates and attitudes do not fit each other: they differ by {100 * self.residual:.0f} % of the motion"
        if self.best is not None:
            return f"{lead}; {self.best.sentence}"
        return (
            f"{lead}, and no other unit, order of elements, direction, order or sign of axes, factor, clock rate or time "
            f"offset fits{f'; {self.where}' if self.where else ''}; are they of the same body and time? With --unchecked they "
            "are imported all the same, and gyrocal diagnose names causes if the calibration is possible"
        )

    @property
    def summary(self) -> str:
        """The misfit as read; a large misfit is never called a fit."""
        share = f"they differ by {100 * self.residual:.2g} % of the motion"
        if self.residual <= FITTING_RESIDUAL:
            return f"rates and attitudes fit each other: {share}"
        return f"rates and attitudes fit only roughly: {share}{f'; {self.where}' if self.where else ''}"


def evaluate_agreement(
    windows: Motion,
    unit: str = "",
    time_unit: str = "",
    order: str = "",
    reverse: bool = False,
    alternatives: Sequence[AttitudeReading] = (),
    G: Array | None = None,
    accumulated: bool = False,
) -> Agreement:
    """Compare rates and attitudes, as read and under alternative mappings.

    Parameters
    ----------
    unit, time_unit, order : of rates, times and quaternions as read; the alternatives to each are tried, none to ""
    reverse : whether the quaternions on file have been conjugated to be inertial to body
    alternatives : further readings of the attitudes
    G : (3, 3) from the readings of three gyros to the rates of the windows; with None the gyros' axes are not estimated
    accumulated : whether the rates are differences of an accumulated angle, which a factor of time makes smaller
    """
    as_read = _evaluate_as_read(windows)
    if as_read <= FITTING_RESIDUAL:
        return Agreement(as_read)
    given = AttitudeReading((), windows.q), *alternatives
    attitudes = [attitude for reading in given for attitude in _list_attitudes(reading, order, reverse)]
    scales = _list_scales(unit, time_unit)
    pairs = _pair_rates(Tags(windows), attitudes)
    named = [reading for pair in pairs for reading in _list_readings(pair, scales, SIGNED_AXES)]
    if not any(reading.residual <= FITTING_RESIDUAL for reading in named):
        aligned = [pair for tags in _align_tags(windows, attitudes, accumulated) for pair in _pair_rates(tags, attitudes)]
        named += [reading for pair in aligned if pair.tags.factor == 1 for reading in _list_readings(pair, scales, SIGNED_AXES)]
        pairs += aligned
    best, smallest = _choose_reading(named, None, min(as_read, 2 * USABLE_RESIDUAL))
    if smallest > FITTING_RESIDUAL:
        numeric = [reading for pair in pairs for reading in _list_numeric_readings(pair, scales)]
        best, smallest = _choose_reading(numeric, best, smallest)
    if smallest > FITTING_RESIDUAL and G is not None:
        # Only with the tags of the best reading so far: a free matrix with other tags fits errors of both.
        offset_s = 0.0 if best is None else best.offset_s
        same_tags = [pair for pair in pairs if pair.tags.offset_s == offset_s and pair.tags.factor == 1]
        free_axes = [reading for pair in same_tags for reading in _list_free_axes(pair, scales, G)]
        best, _ = _choose_reading(free_axes, best, smallest)
    is_removed = best is not None and best.kind in ("named", "alignment")
    return Agreement(as_read, best, "" if is_removed else _describe_misfit(windows))


def explain_refusal(error: LargeResidualError) -> str:
    """Return the text of an error with the reading of the tables that would fit, if there is one."""
    reason = "" if error.start is None else _explain_residuals(*error.start)
    return f"{error}; {reason}" if reason else str(error)


def _explain_residuals(recording: Recording, G: Array, bias: Array) -> str:
    """Explain large residuals of a recording at its a-priori G and bias; empty without an explanation."""
    gyro, references = recording.gyro, recording.attitudes
    if not gyro.rates.any():
        return "all rates are zero"
    windows = build_motion(gyro.t_s, gyro.rates @ G.T + bias, gyro.sample_s, references.t_s, references.quaternions)
    if windows is None:
        return ""
    agreement = evaluate_agreement(windows, "deg/s", "s", "scalar-last")
    if agreement.best is not None and agreement.fits:
        return f"rates and attitudes fit much better if imported anew: {agreement.best.sentence}"
    if agreement.best is not None:
        return f"{agreement.sentence}{', as an option of gyrocal import' if agreement.best.kind == 'alignment' else ''}"
    bias_error = None if windows.is_coarse else estimate_constant_bias(windows)
    if bias_error is None:
        return f"{agreement.summary}; {_describe_misfit(windows)}" if not agreement.where else agreement.summary
    longest = max(interval.stop_s - interval.start_s for interval in recording.intervals)
    if np.linalg.norm(bias_error) * longest < LARGE_DRIFT:
        return ""
    values = ", ".join(f"{value:.4g}" for value in np.rad2deg(bias + bias_error))
    return (
        f"rates and attitudes fit each other with a bias of {values} deg/s: give it as apriori_bias_deg_s, as the mean "
        f"of a rest would, or split the intervals, of which the longest has {longest:.6g} s"
    )


def _describe_misfit(windows: Motion) -> str:
    """Describe where a misfit lies that no alternative mapping removes."""
    if windows.is_coarse:
        return "the attitudes are too far apart for the mean rates between them to be compared well"
    return locate_misfit(windows)


def _evaluate_as_read(windows: Motion) -> float:
    """Compute the RMS misfit of the tables as read over the RMS motion, with or without a constant bias, whichever is less."""
    gyro, inside = windows.compute_gyro_rates()
    reference = windows.compute_attitude_rates()[inside]
    if len(reference) < FEWEST_RATE_WINDOWS:
        return np.inf
    residual = reference - gyro[inside]
    centred = _compute_rms(residual - residual.mean(axis=0)) / _compute_rms(reference - reference.mean(axis=0))
    return min(_compute_rms(residual) / _compute_rms(reference), centred)


def _choose_reading(readings: Sequence[Reading], previous: Reading | None, residual: float) -> tuple[Reading | None, float]:
    """Choose the reading with the fewest changes among those that fit best; the previous one unless its residual halves."""
    smallest = min((reading.residual for reading in readings), default=np.inf)
    if smallest > LARGEST_RESIDUAL_RATIO * residual:
        return previous, residual
    good = [reading for reading in readings if reading.residual <= max(RESIDUAL_TIE_FACTOR * smallest, smallest + 0.02)]
    best = min(good, key=lambda candidate: (candidate.count, candidate.residual))
    is_tied = best.kind == "named" and sum(reading.count == best.count for reading in good) > 1
    return replace(best, is_tied=is_tied), best.residual


# ---- readings of attitudes and tags ----------------------------------------------------------------------------------------


def _list_attitudes(given: AttitudeReading, order: str, reverse: bool) -> list[AttitudeReading]:
    """List the readings of attitudes with each order of the elements on file and in both directions."""
    on_file = given.q * (CONJUGATE if reverse else 1.0)
    out = []
    for places, word in {(0, 1, 2, 3): "", **ALTERNATIVE_ORDERS[order]}.items():
        q = on_file[:, places] * (CONJUGATE if reverse else 1.0)
        words = (*given.words, *filter(None, (word,)))
        out.append(AttitudeReading(words, q))
        # An exchange together with the other direction is a change of the axes, which is tried for every reading.
        if "exchanged" not in word:
            out.append(AttitudeReading((*words, DIRECTION_WORDS[reverse]), q * CONJUGATE))
    return out


def _align_tags(windows: Motion, attitudes: Sequence[AttitudeReading], accumulated: bool) -> list[Tags]:
    """List the tags with an offset, and with an offset and a clock rate, if the reading that fits best shows them."""
    starts = search_starts(windows.t_s, windows.angle, windows.t_ref, windows.q)
    shifted = [Tags(aligned, *start) for start in starts if (aligned := windows.move_tags(*start, accumulated)) is not None]
    out = []
    for with_clock in (False, True):
        allowed = [tags for tags in shifted if with_clock or tags.factor == 1]
        candidates = [tags._replace(windows=replace(tags.windows, q=read.q)) for tags, read in product(allowed, attitudes)]
        nearest = min(candidates, key=lambda candidate: _compute_orthogonal_misfit(candidate.windows))
        fit = refine(nearest.windows, reverse=False, with_clock=with_clock, mirrored=True)
        if fit is None:
            continue
        offset, factor = nearest.offset_s + fit.offset_s, nearest.factor * fit.time_factor
        is_late = abs(offset) > SIGNIFICANT_IN_SIGMA * fit.offset_sigma
        is_clock_off = abs(factor - 1) > SIGNIFICANT_IN_SIGMA * fit.time_sigma
        aligned = windows.move_tags(offset * is_late, factor, accumulated)
        if aligned is not None and (is_clock_off if with_clock else is_late):
            out.append(Tags(aligned, offset * is_late, factor))
    return out


def _compute_orthogonal_misfit(windows: Motion) -> float:
    """Compute the share of the motion's square that the best rotation or reflection, factor and bias leave."""
    for pair in _pair_rates(Tags(windows), [AttitudeReading((), windows.q)]):
        _, common = rotate_onto(pair.reference, pair.gyro, mirrored=True)
        return 1 - common**2 / max(float(np.sum(pair.reference**2) * np.sum(pair.gyro**2)), np.finfo(float).tiny)
    return np.inf


def _pair_rates(tags: Tags, attitudes: Sequence[AttitudeReading]) -> list[RatePair]:
    """Pair the gyro's mean rates with those of each reading of the attitudes; empty if there are too few windows."""
    gyro, inside = tags.windows.compute_gyro_rates()
    if inside.sum() < FEWEST_RATE_WINDOWS:
        return []
    g = gyro[inside] - gyro[inside].mean(axis=0)
    rates = [replace(tags.windows, q=attitude.q).compute_attitude_rates()[inside] for attitude in attitudes]
    return [RatePair(attitude.words, tags, r - r.mean(axis=0), g) for attitude, r in zip(attitudes, rates, strict=True)]


# ---- readings of the rates -------------------------------------------------------------------------------------------------


def _list_readings(pair: RatePair, scales: Mapping[str, float], axes_changes: Sequence[AxesChange]) -> list[Reading]:
    """List the readings of one pair with each factor and each order, sign or rotation of the gyro's axes."""
    reference_square, gyro_square = float(np.sum(pair.reference**2)), float(np.sum(pair.gyro**2))
    cross = pair.reference.T @ pair.gyro
    out = []
    for (name, scale), axes in product(scales.items(), axes_changes):
        residual_square = max(reference_square - 2 * scale * float(np.sum(axes.C * cross)) + scale**2 * gyro_square, 0.0)
        if residual_square >= reference_square:
            continue
        kind: Literal["named", "rotation", "alignment"] = "rotation" if axes.moved == ROTATION_COUNT else "named"
        if FACTOR in name or pair.tags.factor != 1:
            kind = "alignment"
        changes = (*pair.words, *filter(None, (name, axes.words)), *pair.tags.words)
        count = axes.moved + bool(name) + len(pair.words) + len(pair.tags.words)
        out.append(Reading(kind, changes, count, float(np.sqrt(residual_square / reference_square)), pair.tags.offset_s))
    return out


def _list_numeric_readings(pair: RatePair, scales: Mapping[str, float]) -> list[Reading]:
    """List the readings of one pair with the rotation of the gyro's axes, and the factor of the rates, that fit best."""
    if len(pair.gyro) < LEAST_WINDOWS:
        return []
    rotation = rotate_onto(pair.reference, pair.gyro)[0]
    angle = np.rad2deg(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1.0, 1.0)))
    words = f"--mounting estimate, which rotates the gyro's axes by {angle:.3g} deg"
    gyro_square, cross, out = float(np.sum(pair.gyro**2)), pair.reference.T @ pair.gyro, []
    for axes in (*SIGNED_AXES, AxesChange(words, rotation, ROTATION_COUNT)):
        factor = float(np.sum(axes.C * cross)) / gyro_square
        is_free = factor > 0 and _find_scale(factor, scales) is None
        free = {f"the rates times {factor:.6g} ({FACTOR})": factor} if is_free else {}
        out += _list_readings(pair, {**scales, **free}, [axes])
    return out


def _list_free_axes(pair: RatePair, scales: Mapping[str, float], G: Array) -> list[Reading]:
    """List the reading of one pair with the directions and factors of three gyros that fit best; none if these are usual.

    With w_ref = M D u + b and the gyros' own readings D u, D diagonal and u of RMS one, the rows of M⁻¹ are the gyros'
    directions in the axes of the attitudes, and their lengths times D the inverses of the gyros' factors.
    """
    r, raw = pair.reference, pair.gyro @ np.linalg.inv(G).T
    if len(raw) < LEAST_WINDOWS or not raw.any(axis=0).all():
        return []
    size = np.sqrt(np.mean(np.square(raw), axis=0))
    smallest_motion = np.linalg.svd(raw / size, compute_uv=False)[-1]
    M = np.linalg.lstsq(raw / size, r, rcond=None)[0].T
    if not smallest_motion > 0 or not abs(np.linalg.det(M)) > 0:
        return []
    K, residual = np.linalg.inv(M), _compute_rms(r - raw / size @ M.T)
    length = np.linalg.norm(K, axis=1)
    # δK = −K δM K, largest about the direction in which the motion is smallest; overlapping windows share their errors.
    windows = pair.tags.windows
    overlap = len(windows.rows) * float(np.median(windows.stop_s - windows.start_s)) / np.ptp(windows.start_s)
    sigma = residual * np.sqrt(max(overlap, 1.0) / 3) / smallest_motion * float(length.max())
    odd_factor = _describe_odd_factor(1 / (size * length))
    words = _describe_axes(K / length[:, None], sigma) + odd_factor
    if not words:
        return []
    factor = float(np.median(1 / (size * length)))
    scale_name = _find_scale(factor, scales)
    scaled = f"the rates times {factor:.4g} ({FACTOR})" if scale_name is None else scale_name
    changes = (*pair.words, *filter(None, (scaled,)), *words, *pair.tags.words)
    kind: Literal["named", "axes"] = "named" if odd_factor else "axes"
    return [Reading(kind, changes, len(changes), residual / _compute_rms(r), pair.tags.offset_s)]


def _describe_axes(axes: Array, sigma: float) -> tuple[str, ...]:
    """Describe the directions (3, 3) of gyros that are not at right angles, or left-handed; empty for others."""
    cosines = (axes[[0, 0, 1]] * axes[[1, 2, 2]]).sum(axis=1)
    angles = np.arccos(np.clip(cosines, -1.0, 1.0))
    skew = float(np.abs(angles - np.pi / 2).max())
    if skew < max(LEAST_SKEW, SIGNIFICANT_IN_SIGMA * sigma) and np.linalg.det(axes) > 0:
        return ()
    rows = ";".join(",".join(f"{value:.3f}" for value in row) for row in axes)
    return (f"gyros that are {', '.join(f'{angle:.0f}' for angle in np.rad2deg(angles))} deg apart, not 90: --axes '{rows}'",)


def _describe_odd_factor(factors: Array) -> tuple[str, ...]:
    """Describe the gyro whose factor, of (3,), has another unit than the two others; empty without one."""
    ratios = factors / np.median(factors)
    odd = int(np.argmax(np.abs(np.log(ratios))))
    if 1 / LARGEST_FACTOR <= ratios[odd] <= LARGEST_FACTOR:
        return ()
    return (f"the rates of gyro {odd + 1} alone times {ratios[odd]:.4g}: its column has another unit, convert it",)


def _find_scale(factor: float, scales: Mapping[str, float]) -> str | None:
    """Find the name of the scale near a factor, within a gyro's own scale error; None without one."""
    return next((name for name, scale in scales.items() if abs(factor / scale - 1) < LEAST_FACTOR), None)


def _list_scales(unit: str, time_unit: str) -> dict[str, float]:
    """List the factors of the gyro's rates by the change of units that causes each; the first is as read."""
    out = {"": 1.0}
    if unit in ALTERNATIVE_RATE_UNITS:
        for true in ALTERNATIVE_RATE_UNITS:
            out |= {f"the gyro in {true}, not {unit}": RATE_UNITS[true] / RATE_UNITS[unit]} if true != unit else {}
    if time_unit in ALTERNATIVE_TIME_UNITS[:3]:
        # Times read in too large a unit make the attitudes' rates too small.
        read = TIME_UNITS[time_unit]
        for true in ALTERNATIVE_TIME_UNITS:
            out |= {f"times in {true}, not {time_unit}": 10.0 ** (read - TIME_UNITS[true])} if true != time_unit else {}
        out[f"times in {DAY_UNIT}, which are days, not {time_unit}"] = SECONDS_A_DAY * 10.0**read
    return out


def _list_axes_changes() -> list[AxesChange]:
    """List the 48 orders and signs of three axes, with words for all but the order as read."""
    out = []
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        C = np.zeros((3, 3))
        C[range(3), order] = signs
        names = ",".join(f"{'-' if sign < 0 else ''}{'xyz'[k]}" for sign, k in zip(signs, order, strict=True))
        words = "" if names == "x,y,z" else f"the gyro's axes as {names}"
        out.append(AxesChange(words, C, int(np.sum(np.diag(C) != 1))))
    return out


def _compute_rms(values: Array) -> float:
    """Compute the RMS length of vectors (n, 3), which is never zero."""
    return max(float(np.sqrt(np.mean(np.sum(np.square(values), axis=1)))), np.finfo(float).tiny)


SIGNED_AXES = _list_axes_changes()


# ---- a nearly constant motion ----------------------------------------------------------------------------------------------


def describe_mean_rates(windows: Motion) -> str:
    """Describe a difference between the mean rates of a nearly constant motion by gyro and attitudes; empty without one.

    A constant bias explains any difference of the two, so no reading is refused for it. No mounting changes the size.
    """
    gyro, inside = windows.compute_gyro_rates()
    reference, gyro = windows.compute_attitude_rates()[inside], gyro[inside]
    if len(gyro) < FEWEST_RATE_WINDOWS:
        return ""
    mean_ref, mean_gyro = reference.mean(axis=0), gyro.mean(axis=0)
    by_attitudes, by_gyro = float(np.linalg.norm(mean_ref)), float(np.linalg.norm(mean_gyro))
    if windows.is_coarse or _compute_rms(gyro - mean_gyro) > FITTING_RESIDUAL * by_gyro:
        return ""  # the motion decides
    span = float(windows.stop_s[inside][-1] - windows.start_s[inside][0])
    independent = max(span / float(np.median(windows.stop_s - windows.start_s)), 1.0)
    sigma = _compute_rms(reference - mean_ref) / np.sqrt(independent)
    difference = float(np.linalg.norm(mean_ref - mean_gyro))
    is_seen = by_attitudes >= SIGNIFICANT_IN_SIGMA * sigma
    if not is_seen or difference <= max(FITTING_RESIDUAL * by_attitudes, SIGNIFICANT_IN_SIGMA * sigma):
        return ""
    # Errors across the rate lengthen it by half their square over it.
    along = float(np.std((reference - mean_ref) @ mean_ref)) / by_attitudes / np.sqrt(independent)
    size_sigma = along + sigma**2 / (2 * by_attitudes)
    shown = np.rad2deg([by_gyro, by_attitudes, size_sigma, difference])
    sizes = f"the mean rate is {shown[0]:.4g} deg/s by the gyro, {shown[1]:.4g} ± {shown[2]:.1g} deg/s by the attitudes"
    if abs(by_gyro - by_attitudes) <= max(FITTING_RESIDUAL * by_attitudes, SIGNIFICANT_IN_SIGMA * size_sigma):
        return f"{sizes}, in another direction: a bias of {shown[3]:.3g} deg/s, or a rotation (--mounting estimate)"
    return (
        f"{sizes}, which no rotation explains: a bias of {shown[3]:.3g} deg/s, gyros that are not at right angles (--axes), "
        f"or a factor (--rate-factor {by_attitudes / by_gyro:.4g}); the motion does not tell them apart"
    )
