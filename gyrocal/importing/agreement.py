"""Test whether gyro rates and attitudes agree as read, and find the wrong unit, order or sign if they do not.

The mean body rate between two attitudes follows from the attitudes, dA/dt = −[ω×] A, and from the gyro:

    w_ref = s Π w_gyro(t + τ) + b + noise

with the gyro's bias b; if everything is read correctly, s = 1, Π = I and τ = 0. A reading error changes s (unit of rate or of
time), Π (order and sign of the axes), τ (time tags) or w_ref itself (order of the quaternion's elements, its direction). All
combinations of these are tried. For one reading of the attitudes and one τ, with centred sums

    |w_ref − s Π w − b|² = Σ|w_ref|² − 2 s tr(Πᵀ Σ w_ref wᵀ) + s² Σ|w|²

gives all s and Π at once. τ maximises the correlation of the magnitudes of both rates, which does not depend on s, Π or the
direction of the attitude. A general rotation of the gyro's axes is tried last: the rotation that maximises tr(Πᵀ Σ w_ref wᵀ)
follows from a singular value decomposition. Skew axes: a free matrix takes the place of s Π; the rows of its inverse are the
gyros' directions. Among readings that fit nearly as well as the best, the one with the fewest changes is reported. If none
fits, an alignment with a free factor and clock rate is tried (`alignment`), then the cause of the misfit is sought (`misfit`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations, product
from typing import Literal, NamedTuple

import numpy as np

from gyrocal.arrays import Array
from gyrocal.calibration.gate import LargeResidualError
from gyrocal.importing.alignment import LEAST_FACTOR, estimate_alignment
from gyrocal.importing.misfit import explain_misfit, locate_misfit
from gyrocal.importing.motion import QUATERNION_INDICES, Motion, build_motion, rotate_onto
from gyrocal.importing.units import ANGLE_UNITS, PER_SAMPLE, RATE_UNITS, SECONDS_A_DAY, TIME_UNITS
from gyrocal.recording import Recording

FITS = 0.1  # residual over motion of rates that are read rightly: errors of G and noise
HOPELESS = 0.5
LARGEST_RESIDUAL_RATIO = 0.5  # times the residual as read: an alternative must fit so much better
RESIDUAL_TIE_FACTOR = 1.25  # times the best residual: as good
FEWEST_RATE_WINDOWS = 3  # in which both sides are known
LEAST_WINDOWS = 6  # from which a rotation of three angles is told
LEAST_SKEW = np.deg2rad(5.0)  # of the angles between three gyros from 90 deg: fewer are a gyro's own misalignment
SURE_IN_SIGMA = 3.0
LARGE_DRIFT = np.deg2rad(10.0)  # by a bias over the longest interval
LONGEST_LAG = 0.25  # of the recording
ALTERNATIVE_RATE_UNITS = ("rad/s", "deg/s", "deg/h")  # that one is taken for another of
ALTERNATIVE_TIME_UNITS = ("ms", "s", "us", "ns")
DAY_UNIT = "86400s"  # a day, in which spreadsheets count
RATE_FACTORS = {  # of rates on file, which have one unit: a prefix or a conversion that was forgotten or made twice
    f"the rates {words}": factor
    for number, factor in (("1000", 1e3), ("3600", 3600.0), ("57.296", 180 / np.pi), ("206265", 3600 * 180 / np.pi))
    for words, factor in ((f"divided by {number}", 1 / factor), (f"times {number}", factor))
}
GAINED = 0.7  # of 1 − correlation: an offset that leaves more has gained nothing
ALTERNATIVE_ORDERS = {  # in which they may be instead
    "": {},
    "scalar-last": {(1, 2, 3, 0): "the quaternion's scalar part first (scalar-first)"},
    "scalar-first": {(3, 0, 1, 2): "the quaternion's scalar part last (scalar-last)"},
}
EXCHANGED = {(1, 0, 2, 3): "q1 and q2 exchanged", (2, 1, 0, 3): "q1 and q3 exchanged", (0, 2, 1, 3): "q2 and q3 exchanged"}
DIRECTION_WORDS = {
    False: "the attitude from inertial to body (inertial-to-body)",
    True: "the attitude from body to inertial (body-to-inertial)",
}


@dataclass(frozen=True)
class Reading:
    """One way to read the tables."""

    kind: Literal["turn", "rotation", "alignment", "skew"]  # axes exchanged, rotated, with a free factor and clock, or skew
    changes: tuple[str, ...]  # what is to be changed, in words
    count: int  # how many things these are; each axis that another takes the place of is one
    residual: float  # RMS of w_ref − s Π w − b over that of the motion
    offset_s: float = 0.0  # τ, s; the attitudes' tags are too late by it
    is_tied: bool = False  # whether another fits as well and changes as much

    @property
    def sentence(self) -> str:
        """The changes, the misfit with them, and the option that finds them."""
        text = f"{100 * self.residual:.1f} % with {' and '.join(self.changes) or 'small changes of all'}"
        if self.is_tied:
            text += ", which the motion does not tell from another reading that changes as much"
        if self.kind == "alignment":
            return f"{text}; --align auto finds and applies this"
        return f"{text}; --align auto finds and applies the offset" if self.offset_s else text


class RatePair(NamedTuple):
    """Mean rates (n, 3) by attitudes and gyro less their means, with what the reading changes and the time offset of it."""

    words: tuple[str, ...]
    offset_s: float
    reference: Array
    gyro: Array


@dataclass(frozen=True)
class Agreement:
    """Agreement of the rates and attitudes of the tables."""

    residual: float  # as read, RMS over that of the motion
    best: Reading | None = None  # of those that fit much better, and as well as any of them, the one that changes least
    cause: str = ""  # of a misfit that no reading mends, and where in time it lies

    @property
    def fits(self) -> bool:
        """Whether the rates agree with the attitudes as read; a calibration finds what rotated or skew axes change."""
        return self.residual <= HOPELESS and (self.best is None or self.best.kind in ("rotation", "skew"))

    @property
    def sentence(self) -> str:
        """The misfit, and the reading that fits."""
        lead = f"rates and attitudes do not fit each other: they differ by {100 * self.residual:.0f} % of the motion"
        if self.best is not None:
            return f"{lead}; {self.best.sentence}"
        return (
            f"{lead}, and no other unit, order of elements, direction, order or sign of axes, factor, clock rate or time "
            f"offset fits{f'; {self.cause}' if self.cause else ''}; are they of the same body and time?"
        )

    @property
    def summary(self) -> str:
        """State the misfit as read; a large misfit is never called a fit."""
        share = f"they differ by {100 * self.residual:.2g} % of the motion"
        if self.residual <= FITS:
            return f"rates and attitudes fit each other: {share}"
        return f"rates and attitudes fit only roughly: {share}{f'; {self.cause}' if self.cause else ''}"


def evaluate_agreement(
    windows: Motion,
    unit: str = "",
    time_unit: str = "",
    order: str = "",
    reverse: bool = False,
    factors: Mapping[str, float] | None = None,
    others: Sequence[tuple[tuple[str, ...], Array]] = (),
    G: Array | None = None,
) -> Agreement:
    """Compare rates and attitudes, as read and under alternative mappings.

    Parameters
    ----------
    unit, time_unit, order : as which rates, times and quaternions are read; others are tried in their place, of "" none
    reverse : whether the quaternions on file have been conjugated to be inertial to body
    factors : of the rates that are tried beside those of units, with their words
    others : further attitudes (m, 4) that the table may mean, with what each changes
    G : (3, 3) that has turned the rates of three gyros into those of the windows; None does not ask for the gyros' directions
    """
    as_read = _evaluate_as_read(windows)
    if as_read <= FITS:
        return Agreement(as_read)
    ways = _list_readings(windows, order, reverse)
    for words, q in others:
        ways += [((*words, *more), mean) for more, mean in _list_readings(replace(windows, q=q), order, reverse)]
    units = list(_list_scales(unit, "").values())  # name what factors would only number
    numbered = {words: factor for words, factor in (factors or {}).items() if not np.isclose(factor, units).any()}
    scales = _list_scales(unit, time_unit) | numbered
    pairs, late = _pair_rates(windows, ways), list[RatePair]()
    tried = [one for pair in pairs for one in _fit_scales_and_axes(pair, scales)]
    if _find_least(tried) > FITS and pairs:
        tried += _list_axis_factors(pairs[0])
    if _find_least(tried) > FITS:
        for way in ways:
            late += _pair_rates(windows, [way], tau) if (tau := _estimate_offset(windows, way[1])) else []
        tried += [one for pair in late for one in _fit_scales_and_axes(pair, scales)]
    if unit in ANGLE_UNITS and _find_least(tried) > FITS:
        word = f"the gyro as increments in {unit}{PER_SAMPLE}, not {unit}"
        summed = _pair_rates(_sum_increments(windows), [((*words, word), reference) for words, reference in ways])
        tried += [one for pair in summed for one in _fit_scales_and_axes(pair, scales)]
    smallest = min(as_read, 2 * HOPELESS)
    best = _choose(tried, LARGEST_RESIDUAL_RATIO * smallest)
    if _find_least(tried) > FITS:
        smallest = min(smallest, _find_least(tried))
        for find in (partial(_list_rotations, pairs + late, scales), partial(_align, windows, unit in ANGLE_UNITS)):
            found = _choose(find(), LARGEST_RESIDUAL_RATIO * smallest)
            best, smallest = (best, smallest) if found is None else (found, found.residual)
        if G is not None and smallest > FITS:
            best = _choose(_list_skew_axes(windows, pairs + late, scales, G), LARGEST_RESIDUAL_RATIO * smallest) or best
    return Agreement(as_read, best, "" if best is not None and best.kind in ("turn", "alignment") else _describe_cause(windows))


def _find_least(readings: Sequence[Reading]) -> float:
    return min((one.residual for one in readings), default=np.inf)


def _choose(readings: Sequence[Reading], largest: float) -> Reading | None:
    """The one that changes least of those that fit as well as the best, if that leaves no more than the largest residual."""
    least = _find_least(readings)
    if least > largest:
        return None
    good = [one for one in readings if one.residual <= max(RESIDUAL_TIE_FACTOR * least, least + 0.02)]
    best = min(good, key=lambda one: (one.count, one.residual))
    return replace(best, is_tied=best.kind == "turn" and sum(one.count == best.count for one in good) > 1)


def _sum_increments(windows: Motion) -> Motion:
    """The same windows with the differences of an angle as what they differ to, but for a constant rate."""
    length = float(np.median(np.diff(windows.t_s)))
    rates = (windows.angle - windows.angle.mean(axis=0)) / length
    return replace(
        windows, angle=np.concatenate([np.zeros((1, 3)), np.cumsum(rates[1:] * np.diff(windows.t_s)[:, None], axis=0)])
    )


def _align(windows: Motion, accumulated: bool) -> list[Reading]:
    """The reading with a free factor and a free clock, if the motion shows one."""
    steps = np.diff(windows.t_s)
    rates = np.diff(windows.angle, axis=0) / steps[:, None]
    found = estimate_alignment(windows.t_s[:-1], rates, float(steps[-1]), windows.t_ref, windows.q, accumulated)
    return [] if found is None else [Reading("alignment", tuple(found.changes), len(found.changes), found.residual)]


def _describe_cause(windows: Motion) -> str:
    """Describe the cause of a misfit that no alternative mapping removes."""
    if windows.is_coarse:
        return "the attitudes are too far apart for the mean rates between them to be compared well"
    fault = explain_misfit(windows)
    where = locate_misfit(windows)
    # The misfit is stated without its mean, so that a constant bias is no cause of it.
    return where if fault is None or fault.bias is not None else f"most of this is explained by {fault.words}; {where}"


def _list_readings(windows: Motion, order: str, reverse: bool) -> list[tuple[tuple[str, ...], Array]]:
    """All readings of the attitudes: what each changes, and the mean rates by it."""
    out: list[tuple[tuple[str, ...], Array]] = []
    for places, word in {QUATERNION_INDICES: "", **ALTERNATIVE_ORDERS[order]}.items():
        for other in (False, True):
            words = tuple(filter(None, (word, DIRECTION_WORDS[reverse] if other else "")))
            out.append((words, windows.attitudes(places, other, reverse)))
    # An exchange with the other direction as well is a turn of the axes, and those are tried for every reading.
    for places, word in EXCHANGED.items() if order == "scalar-last" else ():
        out.append(((word,), windows.attitudes(places, False, reverse)))
    return out


def explain_refusal(error: LargeResidualError) -> str:
    """Give the text of an error with the reading of the tables that would fit, if there is one."""
    reason = "" if error.start is None else _explain_residuals(*error.start)
    return f"{error}; {reason}" if reason else str(error)


def _explain_residuals(recording: Recording, G: Array, bias: Array) -> str:
    """Explain large residuals of a recording with the parameters it starts from; empty without an explanation."""
    gyro, references = recording.gyro, recording.attitudes
    if not gyro.rates.any():
        return "all rates are zero"
    windows = build_motion(gyro.t_s, gyro.rates @ G.T + bias, gyro.sample_s, references.t_s, references.quaternions)
    if windows is None:
        return ""
    found = evaluate_agreement(windows, "deg/s", "s", "scalar-last", factors=RATE_FACTORS)
    if found.best is not None and found.fits:
        return f"rates and attitudes fit much better if imported anew: {found.best.sentence}"
    if found.best is not None:
        return f"{found.sentence}{', as an option of gyrocal import' if found.best.kind == 'alignment' else ''}"
    longest = max(one.stop_s - one.start_s for one in recording.intervals)
    fault = None if windows.is_coarse else explain_misfit(windows)
    if fault is None or fault.bias is None:
        return f"{found.summary}; {_describe_cause(windows)}" if not found.cause else found.summary
    if np.linalg.norm(fault.bias) * longest < LARGE_DRIFT:
        return ""
    values = ", ".join(f"{value:.4g}" for value in np.rad2deg(bias + fault.bias))
    return (
        f"rates and attitudes fit each other with a bias of {values} deg/s: give it as apriori_bias_deg_s, as the mean "
        f"of a rest would, or split the intervals, of which the longest has {longest:.6g} s"
    )


def _evaluate_as_read(windows: Motion) -> float:
    """Residual of the tables as they are read over that of the motion, less a constant bias if that is smaller."""
    gyro, inside = windows.gyro()
    reference = windows.attitudes()[inside]
    if len(reference) < FEWEST_RATE_WINDOWS:
        return np.inf
    left = reference - gyro[inside]
    centred = _compute_rms(left - left.mean(axis=0)) / _compute_rms(reference - reference.mean(axis=0))
    return min(_compute_rms(left) / _compute_rms(reference), centred)


def _pair_rates(windows: Motion, ways: Sequence[tuple[tuple[str, ...], Array]], offset_s: float = 0.0) -> list[RatePair]:
    """Mean rates by both sides of each reading of the attitudes, at one time offset."""
    gyro, inside = windows.gyro(offset_s)
    if inside.sum() < FEWEST_RATE_WINDOWS:
        return []
    late = (f"{offset_s:+.3g} s added to the attitudes' time tags",) if offset_s else ()
    g = gyro[inside] - gyro[inside].mean(axis=0)
    return [RatePair((*words, *late), offset_s, r[inside] - r[inside].mean(axis=0), g) for words, r in ways]


def _fit_scales_and_axes(pair: RatePair, scales: dict[str, float]) -> list[Reading]:
    """The best of all s and Π for one reading of the attitudes."""
    whole = float(np.sum(pair.reference**2))
    cross, own = pair.reference.T @ pair.gyro, float(np.sum(pair.gyro**2))
    direction = pair.words[: len(pair.words) - bool(pair.offset_s)]
    out = []
    for name, scale in scales.items():
        for words, Pi in TURNS:
            left = max(whole - 2 * scale * float(np.sum(Pi * cross)) + scale**2 * own, 0.0)
            if left < whole:
                changes = (*direction, *filter(None, (name, words)), *pair.words[len(direction) :])
                moved = int(np.sum(np.diag(Pi) != 1)) + bool(name) + len(pair.words)
                out.append(Reading("turn", changes, moved, float(np.sqrt(left / whole)), pair.offset_s))
    return sorted(out, key=lambda one: (one.residual, one.count))[:8]


def _list_axis_factors(pair: RatePair) -> list[Reading]:
    """All readings in which one axis of the gyro has another unit than the two others."""
    whole = float(np.sum(pair.reference**2))
    found = []
    for axis, (words, factor) in product(range(3), RATE_FACTORS.items()):
        left = float(np.sum((pair.reference - np.where(np.arange(3) == axis, factor, 1.0) * pair.gyro) ** 2))
        change = f"{words} about {'xyz'[axis]} alone: that column has another unit, convert it"
        found.append(Reading("turn", (change,), 1, float(np.sqrt(left / whole))))
    return found


def _list_rotations(pairs: list[RatePair], scales: dict[str, float]) -> list[Reading]:
    """All readings with the rotation of the gyro's axes that fits best."""
    found = []
    for pair in pairs:
        if len(pair.gyro) < LEAST_WINDOWS:
            continue
        r, g = pair.reference, pair.gyro
        C, common = rotate_onto(r, g)
        whole = max(float(np.sum(r * r)), np.finfo(float).tiny)
        angle = float(np.arccos(np.clip((np.trace(C) - 1) / 2, -1.0, 1.0)))
        words = f"--mounting estimate, which rotates the gyro's axes by {np.rad2deg(angle):.3g} deg"
        for name, scale in scales.items():
            left = whole - 2 * scale * common + scale**2 * float(np.sum(g * g))
            changes = (*pair.words, *filter(None, (name,)), words)
            found.append(Reading("rotation", changes, len(changes), float(np.sqrt(max(left, 0.0) / whole))))
    return found


def _list_skew_axes(windows: Motion, pairs: list[RatePair], scales: dict[str, float], G: Array) -> list[Reading]:
    """All readings with three gyros in the directions that fit best, if these are skew.

    With w_ref = M w + b and w = G w_raw, gyro i measures the rate along row i of (M G)⁻¹, in the axes of the attitudes.
    """
    found = []
    overlap = len(windows.rows) * float(np.median(windows.stop_s - windows.start_s)) / np.ptp(windows.start_s)
    for pair in pairs:
        if len(pair.gyro) < LEAST_WINDOWS:
            continue
        r, g = pair.reference, pair.gyro
        least = np.linalg.svd(g, compute_uv=False)[-1]
        M = np.linalg.lstsq(g, r, rcond=None)[0].T
        if not least > 0 or not abs(np.linalg.det(M)) > 0:
            continue
        left = r - g @ M.T
        K = np.linalg.inv(M @ G)
        size = np.linalg.norm(K, axis=1, keepdims=True)
        axes = K / size
        cosines = axes[[0, 0, 1]] * axes[[1, 2, 2]]
        angles = np.arccos(np.clip(cosines.sum(axis=1), -1.0, 1.0))
        skew = float(np.abs(angles - np.pi / 2).max())
        # δK = −K δM G K, largest about the direction in which the motion is smallest; overlapping windows share their errors.
        sigma = _compute_rms(left) * np.sqrt(max(overlap, 1.0) / 3) / least * float(size.max())
        if skew < max(LEAST_SKEW, SURE_IN_SIGMA * sigma):
            continue
        factor = 1 / float(np.cbrt(np.prod(size)))
        near = [name for name, scale in scales.items() if abs(factor / scale - 1) < LEAST_FACTOR]
        rows = ";".join(",".join(f"{value:.3f}" for value in row) for row in axes)
        words = f"gyros that are {', '.join(f'{one:.0f}' for one in np.rad2deg(angles))} deg apart, not 90: --axes '{rows}'"
        changes = (*pair.words, *filter(None, near[:1] if near else (f"the rates times {factor:.4g} (--rate-factor)",)), words)
        found.append(Reading("skew", changes, len(changes), _compute_rms(left) / _compute_rms(r)))
    return found


def describe_mean_rates(windows: Motion) -> str:
    """Describe the disagreement of the gyro's axes with the mean rates of a nearly constant motion; empty without one.

    A constant bias explains any difference of the two, so that no reading is refused for it. No mounting changes the size.
    """
    gyro, inside = windows.gyro()
    reference, gyro = windows.attitudes()[inside], gyro[inside]
    if len(gyro) < FEWEST_RATE_WINDOWS:
        return ""
    a, b = reference.mean(axis=0), gyro.mean(axis=0)
    by_attitudes, by_gyro = float(np.linalg.norm(a)), float(np.linalg.norm(b))
    if windows.is_coarse or _compute_rms(gyro - b) > FITS * by_gyro:
        return ""  # there the motion tells
    span = float(windows.stop_s[inside][-1] - windows.start_s[inside][0])
    count = max(span / float(np.median(windows.stop_s - windows.start_s)), 1.0)
    sigma = _compute_rms(reference - a) / np.sqrt(count)
    off = float(np.linalg.norm(a - b))
    if by_attitudes < SURE_IN_SIGMA * sigma or off <= max(FITS * by_attitudes, SURE_IN_SIGMA * sigma):
        return ""
    # Errors across the rate lengthen it by half their square over it.
    own = float(np.std((reference - a) @ a)) / by_attitudes / np.sqrt(count) + sigma**2 / (2 * by_attitudes)
    degrees = np.rad2deg([by_gyro, by_attitudes, own, off])
    sizes = f"the mean rate is {degrees[0]:.4g} deg/s by the gyro, {degrees[1]:.4g} ± {degrees[2]:.1g} deg/s by the attitudes"
    if abs(by_gyro - by_attitudes) <= max(FITS * by_attitudes, SURE_IN_SIGMA * own):
        return f"{sizes}, in another direction: a bias of {degrees[3]:.3g} deg/s, or a rotation (--mounting estimate)"
    return (
        f"{sizes}, which no rotation explains: a bias of {degrees[3]:.3g} deg/s, gyros that are not at right angles (--axes), "
        f"or a factor (--rate-factor {by_attitudes / by_gyro:.4g}); the motion does not tell them apart"
    )


def _estimate_offset(windows: Motion, reference: Array) -> float:
    """τ at which the magnitudes of both rates correlate best, s; 0 if they do so no better than as they are."""
    span = windows.stop_s[-1] - windows.start_s[0]
    speed = np.linalg.norm(reference, axis=1)
    length = float(np.median(windows.stop_s - windows.start_s))
    steps = np.arange(-LONGEST_LAG * span, LONGEST_LAG * span, max(length, span / 2000))
    scores = np.array([_correlate_speeds(windows, speed, tau) for tau in steps])
    if not np.isfinite(scores).any():
        return 0.0
    best = float(steps[int(np.nanargmax(scores))])
    for fine in (length / 8, length / 40, length / 200):
        near = best + fine * np.arange(-6, 7)
        scores = np.array([_correlate_speeds(windows, speed, tau) for tau in near])
        best = float(near[int(np.nanargmax(scores))])
    at_zero, gained = _correlate_speeds(windows, speed, 0.0), _correlate_speeds(windows, speed, best)
    return best if np.isnan(at_zero) or 1 - gained < GAINED * (1 - at_zero) else 0.0


def _correlate_speeds(windows: Motion, speed: Array, tau: float) -> float:
    gyro, inside = windows.gyro(tau)
    if inside.sum() < max(FEWEST_RATE_WINDOWS, 0.5 * inside.size):
        return np.nan
    a, b = speed[inside], np.linalg.norm(gyro[inside], axis=1)
    a, b = a - a.mean(), b - b.mean()
    return float(np.sum(a * b) / max(np.sqrt(np.sum(a * a) * np.sum(b * b)), np.finfo(float).tiny))


def _list_scales(unit: str, time_unit: str) -> dict[str, float]:
    """Factors of the gyro's rates with the units that they stand for, the one as read first."""
    out = {"": 1.0}
    if unit in ALTERNATIVE_RATE_UNITS:
        for true in ALTERNATIVE_RATE_UNITS:
            out |= {f"the gyro in {true}, not {unit}": RATE_UNITS[true] / RATE_UNITS[unit]} if true != unit else {}
    if time_unit in ALTERNATIVE_TIME_UNITS[:3]:
        # Times that are read too long make the attitudes' rates too small.
        read = TIME_UNITS[time_unit]
        for true in ALTERNATIVE_TIME_UNITS:
            out |= {f"times in {true}, not {time_unit}": 10.0 ** (read - TIME_UNITS[true])} if true != time_unit else {}
        out[f"times in {DAY_UNIT}, which are days, not {time_unit}"] = SECONDS_A_DAY * 10.0**read
    return out


def _list_turns() -> list[tuple[str, Array]]:
    """The 48 orders and signs of three axes, with words for those that are not as read."""
    out = []
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        Pi = np.zeros((3, 3))
        Pi[range(3), order] = signs
        names = ",".join(f"{'-' if sign < 0 else ''}{'xyz'[k]}" for sign, k in zip(signs, order, strict=True))
        out.append(("" if names == "x,y,z" else f"the gyro's axes as {names}", Pi))
    return sorted(out, key=lambda one: one[0] != "")


def _compute_rms(values: Array) -> float:
    return max(float(np.sqrt(np.mean(np.sum(np.square(values), axis=1)))), np.finfo(float).tiny)


TURNS = _list_turns()
