"""Readings of the tables of rates and attitudes: what a wrong unit, order, sign or tag changes, and the misfit that it leaves.

With the mean body rates w_ref by attitudes and w by gyro, both less their means, a factor s and an orthogonal matrix C,

    |w_ref − s C w|² = Σ|w_ref|² − 2 s tr(Cᵀ Σ w_ref wᵀ) + s² Σ|w|²

gives the misfit of any s and C at once. The time tags are aligned once (`align_tags`): neither C nor the reading of a
quaternion changes the speeds, whose correlation gives the time offset and the clock rate (`gyrocal.importing.alignment`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Literal, NamedTuple

import numpy as np

from gyrocal.angle_units import RATE_UNITS
from gyrocal.arrays import Array
from gyrocal.importing.alignment import LEAST_FACTOR, SIGNIFICANT_IN_SIGMA, refine, search_starts
from gyrocal.importing.motion import Motion, rotate_onto
from gyrocal.importing.units import SECONDS_A_DAY, TIME_UNITS

FEWEST_RATE_WINDOWS = 3  # with rates of both sides
LEAST_WINDOWS = 6  # to estimate a rotation of three angles
LEAST_SKEW = np.deg2rad(5.0)  # of the angles between three gyros from 90 deg: a smaller one is a gyro's own misalignment
LARGEST_FACTOR = 2.0  # of rates: a larger one is another unit, not a gyro's scale
ROTATION_COUNT = 4  # changes that a fitted rotation counts for: more than the exchange of three axes
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
    weight: int  # changes that it counts for: axes that another one replaces, or `ROTATION_COUNT`
    is_fitted: bool = False  # whether C is the rotation that fits best


class RatePair(NamedTuple):
    """Mean rates by attitudes and gyro under one reading of attitudes and tags."""

    words: tuple[str, ...]  # of the attitudes
    tags: Tags
    # reference, gyro: (n, 3) rad/s less their means
    reference: Array
    gyro: Array


# ---- readings of attitudes and tags ----------------------------------------------------------------------------------------


def list_attitudes(given: AttitudeReading, order: str, reverse: bool) -> list[AttitudeReading]:
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


def align_tags(windows: Motion, attitudes: Sequence[AttitudeReading], accumulated: bool) -> list[Tags]:
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
    for pair in pair_rates(Tags(windows), [AttitudeReading((), windows.q)]):
        _, common = rotate_onto(pair.reference, pair.gyro, mirrored=True)
        return 1 - common**2 / max(float(np.sum(pair.reference**2) * np.sum(pair.gyro**2)), np.finfo(float).tiny)
    return np.inf


def pair_rates(tags: Tags, attitudes: Sequence[AttitudeReading]) -> list[RatePair]:
    """Pair the gyro's mean rates with those of each reading of the attitudes; empty if there are too few windows."""
    gyro, inside = tags.windows.compute_gyro_rates()
    if inside.sum() < FEWEST_RATE_WINDOWS:
        return []
    g = gyro[inside] - gyro[inside].mean(axis=0)
    rates = [replace(tags.windows, q=attitude.q).compute_attitude_rates()[inside] for attitude in attitudes]
    return [RatePair(attitude.words, tags, r - r.mean(axis=0), g) for attitude, r in zip(attitudes, rates, strict=True)]


# ---- readings of the rates -------------------------------------------------------------------------------------------------


def list_readings(
    pair: RatePair, scales: Mapping[str, float], axes_changes: Sequence[AxesChange], is_factor_fitted: bool = False
) -> list[Reading]:
    """List the readings of one pair with each factor and each order, sign or rotation of the gyro's axes."""
    reference_square, gyro_square = float(np.sum(pair.reference**2)), float(np.sum(pair.gyro**2))
    cross = pair.reference.T @ pair.gyro
    out = []
    for (name, scale), axes in product(scales.items(), axes_changes):
        residual_square = max(reference_square - 2 * scale * float(np.sum(axes.C * cross)) + scale**2 * gyro_square, 0.0)
        if residual_square >= reference_square:
            continue
        kind: Literal["named", "rotation", "alignment"] = "rotation" if axes.is_fitted else "named"
        if is_factor_fitted or pair.tags.factor != 1:
            kind = "alignment"
        changes = (*pair.words, *filter(None, (name, axes.words)), *pair.tags.words)
        count = axes.weight + bool(name) + len(pair.words) + len(pair.tags.words)
        out.append(Reading(kind, changes, count, float(np.sqrt(residual_square / reference_square)), pair.tags.offset_s))
    return out


def list_numeric_readings(pair: RatePair, scales: Mapping[str, float]) -> list[Reading]:
    """List the readings of one pair with the rotation of the gyro's axes, and the factor of the rates, that fit best."""
    if len(pair.gyro) < LEAST_WINDOWS:
        return []
    rotation = rotate_onto(pair.reference, pair.gyro)[0]
    angle = np.rad2deg(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1.0, 1.0)))
    words = f"--mounting estimate, which rotates the gyro's axes by {angle:.3g} deg"
    gyro_square, cross, out = float(np.sum(pair.gyro**2)), pair.reference.T @ pair.gyro, []
    for axes in (*SIGNED_AXES, AxesChange(words, rotation, ROTATION_COUNT, is_fitted=True)):
        out += list_readings(pair, scales, [axes])
        factor = float(np.sum(axes.C * cross)) / gyro_square
        if factor > 0 and _find_scale(factor, scales) is None:
            fitted = {f"the rates times {factor:.6g} (--rate-factor)": factor}
            out += list_readings(pair, fitted, [axes], is_factor_fitted=True)
    return out


def list_free_axes(pair: RatePair, scales: Mapping[str, float], G: Array) -> list[Reading]:
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
    K, residual = np.linalg.inv(M), compute_rms(r - raw / size @ M.T)
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
    scaled = f"the rates times {factor:.4g} (--rate-factor)" if scale_name is None else scale_name
    changes = (*pair.words, *filter(None, (scaled,)), *words, *pair.tags.words)
    kind: Literal["named", "axes"] = "named" if odd_factor else "axes"
    return [Reading(kind, changes, len(changes), residual / compute_rms(r), pair.tags.offset_s)]


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


def list_scales(unit: str, time_unit: str) -> dict[str, float]:
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


def compute_rms(values: Array) -> float:
    """Compute the RMS length of vectors (n, 3), which is never zero."""
    return max(float(np.sqrt(np.mean(np.sum(np.square(values), axis=1)))), np.finfo(float).tiny)


SIGNED_AXES = _list_axes_changes()
