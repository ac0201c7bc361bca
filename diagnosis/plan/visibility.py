"""Smallest visible size of each effect that shows in the attitude.

The diagnosis calls a gap when its statistic T, the evidence averaged over all candidates (`Search.compute_null_statistic`),
passes the point that M0 passes with the probability `DiagnosisSettings.false_alarm_rate`. T is a log of a sum of exponentials
of convex quadratics in the observations y, and even in y; so {T ≤ threshold} is a convex set symmetric about 0, and by
Anderson's theorem (Proc. AMS 6, 1955, 170–176) the probability to leave it never falls as y = a x + n moves out along a fixed
signature x, nor as a random x is scaled up. The size at which 90 % of draws leave it therefore exists and is unique. It is
found with T itself on common draws of n, so that the price of looking everywhere is in it: no chi-square is assumed.

Where an effect has a time, the size is that at the median one, and at the phase of mean power; `best` and `worst` are for the
largest and the smallest ‖x‖ among all, at the same a‖x‖, which hardly depends on them. A random effect is drawn from its
covariance.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from diagnosis.inference.null import draw_null_statistics
from diagnosis.inference.search import Search
from diagnosis.model.linear import LinearModel
from diagnosis.model.recording_model import RecordingModel
from diagnosis.plan.columns import Signature
from diagnosis.plan.result import SETTINGS, Verdict, Visible
from diagnosis.settings import DEFAULT, DiagnosisSettings
from gyrocal.arrays import Array
from simulator.effects import EFFECTS, Effect


class DetectionPower:
    """The statistic of the diagnosis on draws, of the linear model of a noise-free recording with all candidates.

    Above its `threshold` the diagnosis calls a gap.
    """

    def __init__(self, linear: LinearModel, seed: int = 0, settings: DiagnosisSettings = DEFAULT):
        self.linear = linear
        self.search = Search(linear, settings)
        self.rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(b"diagnosis_plan")))
        null = draw_null_statistics(self.search, seed, SETTINGS.null_draws)
        # Beyond ln(draws + 1) the diagnosis goes by the bound P(B ≥ c) ≤ 1/c.
        self.threshold = float(min(np.quantile(null, 1 - settings.false_alarm_rate), np.log(1 + settings.null_draws)))
        self._correlation = linear.X.T @ linear.projected(self.rng.standard_normal((linear.y.size, SETTINGS.power_draws)))

    def compute_excess(self, projection: Array, amplitude: float) -> float:
        """Compute the statistic that nine draws in ten exceed, less the threshold, for the projection Xᵀx, (p, 1) or (p, d)."""
        values = self.search.compute_null_statistic(self._correlation + amplitude * projection)
        return float(np.quantile(values, 1 - SETTINGS.power)) - self.threshold

    def size(self, x: Array, start: float) -> float:
        """Find the amplitude of a signature, (N, 1) or (N, d) for each draw, that nine draws of ten show; infinite if none is.

        A secant in log amplitude from `start`; the statistic grows about as the square of the amplitude.
        """
        projection = self.linear.X.T @ x
        amplitude, value = start, self.compute_excess(projection, start)
        low, high = 0.0, np.inf
        slope = 25.0
        for _ in range(SETTINGS.steps):
            if abs(value) < SETTINGS.near:
                return amplitude
            low, high = (max(low, amplitude), high) if value < 0 else (low, min(high, amplitude))
            next_amplitude = amplitude * float(np.exp(np.clip(-value / slope, -0.9, 0.9)))
            if not low < next_amplitude < high:
                next_amplitude = (
                    float(np.sqrt(low * high)) if np.isfinite(high) and low > 0 else (2 * low if low > 0 else 0.5 * high)
                )
            new = self.compute_excess(projection, next_amplitude)
            slope = max((new - value) / np.log(next_amplitude / amplitude), 1.0)
            amplitude, value = next_amplitude, new
        return amplitude if abs(value) < 1.0 else float("inf")


def find_visible_size(signature: Signature, power: DetectionPower) -> Visible:
    """Find the smallest visible size of an effect."""
    effect = EFFECTS[signature.effect]
    smallest, largest = signature.extremes
    reason = "acts like a change of G, b or start attitudes"
    row = replace(build_visibility_row(effect, "not identifiable", np.inf, reason, signature.axis), label=signature.label)
    if signature.share.max() < SETTINGS.gone:
        return row
    x = signature.draw(power.rng, SETTINGS.power_draws)
    if signature.process:
        size = best = worst = power.size(x, SETTINGS.random / float(signature.norms[0]))
        parameters = [
            f"{name} {value:.4g}" if isinstance(value, float) else value for name, value in signature.parameters[0].items()
        ]
        snr, text = float("nan"), ", ".join(parameters)
    else:
        norm = max(float(np.linalg.norm(x)), 1e-300)
        size = power.size(x, SETTINGS.snr / norm)
        snr, text = size * norm, ""
        best, worst = snr / largest, snr / smallest if smallest > SETTINGS.gone * largest else np.inf
    row = replace(row, size=size, best=best, worst=worst, snr=snr, verdict="visible", text=text)
    if best > effect.prior[1]:
        return replace(row, verdict="implausible", text=f"plausible only up to {effect.prior[1]:g} {effect.unit}")
    if size > effect.prior[1]:
        return replace(row, text="hidden at most times")
    return replace(row, text="hidden at worst") if worst > effect.prior[1] else row


def list_unavailable_effects(model: RecordingModel, effects: Sequence[Effect]) -> Iterator[Visible]:
    """List effects that this scenario cannot have, and those whose references are left out."""
    for effect in effects:
        reason = effect.missing(model.surroundings)
        if reason is None and effect.implements("replace_references"):
            reason = "the mask of a recording finds and leaves out such references; its smallest size is not predicted"
        if reason is not None and not effect.in_samples:
            yield build_visibility_row(effect, "not available", np.inf, reason)


def build_visibility_row(effect: Effect, verdict: Verdict, size: float, text: str, axis: str | None = None) -> Visible:
    """Build the row of an effect with one visible size for every time and phase."""
    label = effect.name if axis is None else f"{effect.name}:{axis}"
    nan = float("nan")
    return Visible(effect.name, axis, label, effect.unit, verdict, size, size, size, nan, effect.prior, text=text)
