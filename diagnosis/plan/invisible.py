"""Effects that a recording cannot show, since G, b and the start attitudes absorb them.

An error that follows the rate is an error of G where all rates of a kind are alike. Such an effect leaves no misfit,
and moves G and b instead: by the least-squares solution of its whitened column x in the calibration's columns C,

    δ = (CᵀC)⁻¹ Cᵀ x,    start attitudes projected out of both.

Each effect is taken at a plausible size: a tenth of what is plausible for the gyro's grade, as an error of the rate in
proportion to the fastest one, or as a bias; for references their stated sigma.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from diagnosis.model.linearise import linearise_recording
from diagnosis.model.periods import make_columns
from diagnosis.model.recording_model import RecordingModel
from diagnosis.plan.result import SETTINGS
from gyrocal.arrays import Array
from gyrocal.calibration.parameters import NAMES
from gyrocal.calibration.plausible_ranges import PlausibleRanges, estimate_plausible_ranges
from gyrocal.recording import Recording
from simulator.effects import EFFECTS
from simulator.effects.base import Effect, Value

PLAUSIBLE_SHARE = 0.1  # of the plausible range of G or b
LEAST_SIGMAS = 3.0  # of the calibration, by which an effect has to move a parameter to be listed
MOST_LISTED = 5
MANEUVERS = {  # what would show an effect that is absorbed
    "scale_asymmetry": "slews about {axis} at the same rate in both directions",
    "scale_quadratic": "slews about {axis} at half and at twice the rate",
    "bias_drift": "the same maneuvers again at a later date",
    "bias_orbital": "an inertial hold of a whole orbit with references throughout",
    "bias_temperature": "rests at other temperatures",
    "g_matrix_temperature": "the same slews at another temperature",
    "acceleration_sensitivity": "rests with each axis along the acceleration, up and down",
    "reference_mode_offset": "the same maneuvers with the other axis forward",
    "reference_orbital": "an inertial hold of a whole orbit with references throughout",
    "reference_horizon": "an inertial hold of a whole orbit with references throughout",
}


@dataclass(frozen=True)
class InvisibleEffect:
    """An effect that a recording cannot show, and how far it moves G and b at a plausible size."""

    label: str  # effect:axis
    size: float  # plausible, in its unit
    unit: str
    change: Array  # (12,) of G row by row, and of b, rad/s
    sigmas: Array  # (12,) the same in units of the calibration's sigma
    maneuver: str  # what would show it

    def describe(self) -> str:
        """Describe how far the effect moves the parameter that it moves most, and which motion would show it."""
        worst = int(np.argmax(np.abs(self.sigmas)))
        factor, unit = (np.rad2deg(3600), "deg/h") if worst >= 9 else (1e6, "ppm")
        size, moved, sigmas = (
            float(f"{value:.{digits}g}")  # without an exponent, however large
            for value, digits in ((self.size, 3), (factor * self.change[worst], 3), (abs(self.sigmas[worst]), 2))
        )
        return (
            f"{self.label} of {size:g} {self.unit} leaves no misfit and moves {NAMES[worst]} by {moved:+g} {unit}, "
            f"{sigmas:g} sigma; {self.maneuver} would show it"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the effect as documented."""
        return {
            "effect": self.label,
            "size": self.size,
            "unit": self.unit,
            "delta_G": self.change[:9].reshape(3, 3).tolist(),
            "delta_bias_deg_s": np.rad2deg(self.change[9:]).tolist(),
            "maneuver": self.maneuver,
        }


def find_invisible_effects(recording: Recording, G: Array, bias: Array, sigma: Array) -> tuple[InvisibleEffect, ...]:
    """Find the effects of the library that this recording cannot show and that move G and b most.

    G, b (rad/s) and their sigmas (12,), of G row by row, are those of the calibration.
    """
    model = linearise_recording(recording, G, bias)
    ranges = estimate_plausible_ranges(recording)
    Q = np.linalg.qr(model.starts)[0]
    scale = ranges.vector(np.arange(12) >= 9)
    C = (model.calibration - Q @ (Q.T @ model.calibration)) * scale
    solve = np.linalg.pinv(C.T @ C + 1e-2 * np.eye(12)) @ C.T  # the prior of ten ranges keeps what cannot be observed
    invisible = []
    for name in MANEUVERS:
        effect = EFFECTS[name]
        if effect.missing(model.surroundings) is None:
            for axis in effect.axes or (None,):
                invisible += list(_try_effect(model, effect, axis, ranges, scale[:, None] * solve, sigma))
    invisible = [effect_change for effect_change in invisible if np.abs(effect_change.sigmas).max() > LEAST_SIGMAS]
    return tuple(sorted(invisible, key=lambda effect_change: -float(np.abs(effect_change.sigmas).max()))[:MOST_LISTED])


def _try_effect(
    model: RecordingModel, effect: Effect, axis: str | None, ranges: PlausibleRanges, solve: Array, sigma: Array
) -> Iterator[InvisibleEffect]:
    """Try an effect at the parameters, among those at which it is hidden, at which it moves G and b most; empty if at none."""
    label = effect.name if axis is None else f"{effect.name}:{axis}"
    best: InvisibleEffect | None = None
    for trial in effect.trials(model.surroundings):
        size = _choose_size(model, effect, axis, trial.parameters, ranges)
        x = size * make_columns(model, effect, axis, trial.parameters)
        if np.linalg.norm(model.project_out_nuisance(x), axis=0).max() > SETTINGS.snr:
            continue
        for change in (solve @ x).T:
            candidate = InvisibleEffect(
                label, size, effect.unit, change, change / sigma, MANEUVERS[effect.name].format(axis=axis)
            )
            if best is None or np.abs(candidate.sigmas).max() > np.abs(best.sigmas).max():
                best = candidate
    if best is not None:
        yield best


def _choose_size(
    model: RecordingModel, effect: Effect, axis: str | None, parameters: Mapping[str, Value], ranges: PlausibleRanges
) -> float:
    """Choose a plausible size of an effect, in its unit."""
    if effect.on_references:
        largest = float(np.abs(effect.reference_columns(model.references, axis, parameters)).max())
        plausible = float(np.median(model.recording.attitudes.sigma))
    else:
        largest = float(np.abs(effect.columns(model.stream, axis, parameters)).max())
        fastest = float(np.abs(model.rates).max())
        plausible = PLAUSIBLE_SHARE * (ranges.G * fastest if effect.unit.startswith("ppm") else ranges.bias)
    return min(plausible / max(largest, np.finfo(float).tiny), effect.prior[1])
