"""Plausible ranges of G and b from the gyro's grade.

A calibration compares what the data determine with how far a parameter may plausibly be off. That distance depends on the
gyro: 10 deg/h is large for a fibre-optic gyro in orbit and nothing for a MEMS gyro in a phone. The stated angle random walk
(ARW) gives the grade. If the body rests, the bias measured there can correct the grade: if it exceeds the range of the
grade, the next coarser grade is taken.

Grades by ARW follow Yazdi, Ayazi and Najafi, Micromachined Inertial Sensors, Proc. IEEE 86(8), 1998, Table 2: tactical grade
from 0.05 deg/sqrt(h), rate grade from 0.5. MEMS gyros have become better since; data sheets of consumer parts state 0.004 to
0.03 deg/s/sqrt(Hz), that is 0.24 to 1.8 deg/sqrt(h). An estimated ARW may be lower, since digital filters remove noise at
short times. The upper limit of the tactical grade here is therefore 0.1 deg/sqrt(h).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrocal import attitude
from gyrocal.arrays import Array
from gyrocal.calibration.observability import PLAUSIBLE_BIAS, PLAUSIBLE_G
from gyrocal.errors import InputError
from gyrocal.recording import Recording
from gyrocal.rests import compute_speed, find_rests

Grade = Literal["space", "tactical", "MEMS"]

RAD_S_PER_DEG_H = float(np.deg2rad(1 / 3600))  # rad/s
DEG_SQRT_H = float(np.deg2rad(1 / 60))  # rad/sqrt(s)
SPACE_ARW = 0.05  # deg/sqrt(h), largest of a space gyro: where the tactical grade of Yazdi et al. begins
TACTICAL_ARW = 0.1  # deg/sqrt(h), largest of a tactical gyro, see above
TACTICAL_G = 0.02  # scale factor errors of 0.1 % and a mounting by hand, about 1 deg
TACTICAL_BIAS = 360 * RAD_S_PER_DEG_H  # 0.1 deg/s from one switching-on to the next
MEMS_G = 0.1  # data sheets state sensitivities to 3 to 6 %, cross-axis 2 %; a mounting by hand, about 6 deg
MEMS_BIAS = 36000 * RAD_S_PER_DEG_H  # 10 deg/s, the zero-rate level of consumer data sheets
REST_BIAS_SIGMAS = 3.0  # by which the bias in a rest must exceed the range of a grade before the next one is taken
LONGEST_SPACING_S = 3.0  # between references, of which rests can be seen


@dataclass(frozen=True)
class RestRates:
    """Mean rates over the rests of a recording."""

    raw: Array  # (3,) of the gyros, ω_raw, rad/s
    reference: Array  # (3,) of the body by its reference attitudes, rad/s
    sigma: float  # 1-sigma of the latter, rad/s

    def bias(self, G: Array) -> Array:
        """Compute the b (3,), rad/s, that fits the rests with a G (3, 3)."""
        return np.asarray(self.reference - G @ self.raw)


@dataclass(frozen=True)
class PlausibleRanges:
    """Plausible ranges of the errors of G and b, with their reason."""

    grade: Grade  # of the gyro
    G: float  # of an element of G, dimensionless
    bias: float  # of an element of b, rad/s
    reason: str  # how they were chosen, a sentence
    rest: RestRates | None = None  # mean rates over the rests; None where no rest is seen

    @property
    def bias_deg_h(self) -> float:
        """Plausible range of an element of b, deg/h."""
        return self.bias / RAD_S_PER_DEG_H

    def vector(self, is_bias: NDArray[np.bool_]) -> Array:
        """List the range (p,) of each parameter; is_bias (p,) tells which are biases.

        An `InputError` if a range is not positive, or not finite.
        """
        if not all(np.isfinite(value) and value > 0 for value in (self.G, self.bias)):
            raise InputError("plausible_G and plausible_bias must be positive and finite")
        return np.where(is_bias, self.bias, self.G)

    def to_json(self) -> dict[str, object]:
        """Convert to plain values, b in deg/h."""
        return {
            "grade": self.grade,
            "G": self.G,
            "bias_deg_h": self.bias_deg_h,
            "reason": self.reason,
        }


class GradeRanges(NamedTuple):
    """Ranges of a grade."""

    grade: Grade
    arw: float  # the largest, deg/sqrt(h)
    G: float
    bias: float  # rad/s


RANGES = (
    GradeRanges("space", SPACE_ARW, PLAUSIBLE_G, PLAUSIBLE_BIAS),
    GradeRanges("tactical", TACTICAL_ARW, TACTICAL_G, TACTICAL_BIAS),
    GradeRanges("MEMS", np.inf, MEMS_G, MEMS_BIAS),
)


def estimate_plausible_ranges(
    recording: Recording,
    plausible_G: float | None = None,
    plausible_bias: float | None = None,
    *,
    use_rests: bool = True,
) -> PlausibleRanges:
    """Estimate the gyro's grade and with it the plausible ranges of G and b.

    recording: with its stated ARW
    plausible_G, plausible_bias: ranges that are stated in place of those of the grade; the latter in rad/s
    use_rests: whether rests may correct the grade; a prediction must not see later references
    """
    arw = recording.gyro.arw / DEG_SQRT_H
    grade_index = next(k for k, ranges in enumerate(RANGES) if arw <= ranges.arw)
    reason = f"the stated angle random walk of {arw:.2g} deg/sqrt(h)"
    rest = compute_rest_rates(recording) if use_rests else None
    if rest is not None:
        size = float(np.abs(rest.bias(recording.gyro.apriori_G)).max())
        # An error of G in a slow motion is no bias.
        uncertainty = REST_BIAS_SIGMAS * rest.sigma + RANGES[grade_index].G * float(np.linalg.norm(rest.reference))
        needed = next((k for k, ranges in enumerate(RANGES) if size - uncertainty <= ranges.bias), len(RANGES) - 1)
        if needed > grade_index:
            exceeded = RANGES[grade_index].grade
            reason = f"a bias of {np.rad2deg(size):.2g} deg/s in the rests, beyond the range of {exceeded} grade"
            grade_index = needed
    grade, _, G, bias = RANGES[grade_index]
    chosen = PlausibleRanges(grade, G, bias, f"{grade} grade, from {reason}", rest)
    if plausible_G is None and plausible_bias is None:
        return chosen
    G, bias = (estimated if given is None else given for given, estimated in ((plausible_G, G), (plausible_bias, bias)))
    stated = " and ".join(
        name for name, given in (("plausible_G", plausible_G), ("plausible_bias", plausible_bias)) if given is not None
    )
    return replace(chosen, G=G, bias=bias, reason=f"{stated} as stated; {chosen.reason}")


def compute_rest_rates(recording: Recording) -> RestRates | None:
    """Compute the mean rates over the rests; None without a rest."""
    gyro, references = recording.gyro, recording.attitudes
    t_ref = references.t_s
    if t_ref.size < 4:
        return None
    if np.median(np.diff(t_ref)) > LONGEST_SPACING_S or np.ptp(t_ref) < 2 * LONGEST_SPACING_S:
        return None
    A = attitude.matrix_from_quaternion(references.quaternions)
    raw, reference, seconds, variance = np.zeros(3), np.zeros(3), 0.0, 0.0
    for first, stop in find_rests(gyro.rates, gyro.sample_s, compute_speed(t_ref, references.quaternions, gyro.t_s)):
        rows = np.flatnonzero((t_ref >= gyro.t_s[first]) & (t_ref <= gyro.t_s[stop - 1]))
        if rows.size < 2 or not t_ref[rows[-1]] > t_ref[rows[0]]:
            continue
        elapsed = float(t_ref[rows[-1]] - t_ref[rows[0]])
        low, high = np.searchsorted(gyro.t_s, t_ref[rows[[0, -1]]])
        raw += gyro.rates[low:high].mean(axis=0) * elapsed
        reference -= attitude.residual(A[rows[-1]], A[rows[0]])  # dA/dt = −[ω×] A
        seconds += elapsed
        variance += 2 * float(np.max(references.sigma[rows[[0, -1]]])) ** 2
    return None if seconds == 0 else RestRates(raw / seconds, reference / seconds, float(np.sqrt(variance)) / seconds)
