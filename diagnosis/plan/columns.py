"""Signatures: errors by each effect in the whitened and projected observations, per unit of its size.

Columns and options are the candidates of the diagnosis itself (`diagnosis.model.candidates`), with G, b and the start attitudes
projected out (`diagnosis.model.recording_model`), linearised at the scenario's true G and b. A random effect is a covariance X
Xᵀ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.model.candidates import list_effect_groups
from diagnosis.model.linear import CandidateColumns
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.recording_model import RecordingModel
from diagnosis.model.steps import StepTimes
from gyrocal.arrays import Array
from simulator.effects import EFFECTS
from simulator.scenario import Scenario
from simulator.simulate import add_gyro_temperature, simulate

OF_TIME = ("time_s", "time_sigma_s")  # parameters of an option that is one of several times


@dataclass(frozen=True)
class Signature:
    """Error by an effect in the whitened and projected observations, per unit of its size."""

    effect: str  # effect, axis, label: the label also tells what else is fixed in a switched effect, as in "effect:z<y"
    axis: str | None
    label: str
    # (N, o, k) columns of each option (time of a step), k amplitudes (sine and cosine); of a random effect y = a X z with z ~
    # N(0, I), in the usual option
    X: Array
    share: Array  # (o,) what the projection leaves of each option, 1 for all
    weights: Array  # (o,) prior of the options, sum one
    parameters: tuple[Mapping[str, float | str], ...]  # of each option
    process: bool = False  # whether the effect is random

    @property
    def norms(self) -> Array:
        """(o,) ‖x‖ per unit size, root mean square over the phase; of a random effect (tr K²)^¼ with K = X Xᵀ.

        The inverse goes with the smallest visible size.
        """
        if self.process:
            return np.array([np.sum((self.X[:, 0].T @ self.X[:, 0]) ** 2) ** 0.25])
        return np.asarray(np.sqrt(np.sum(self.X**2, axis=(0, 2)) / self.X.shape[2]))

    @property
    def extremes(self) -> tuple[float, float]:
        """Smallest and largest ‖x‖ per unit size over options and phases."""
        values = np.linalg.svd(self.X.transpose(1, 0, 2), compute_uv=False)
        return float(values[:, -1].min()), float(values[:, 0].max())

    @property
    def middle(self) -> int:
        """The option with the median ‖x‖."""
        return find_median_index(self.norms, self.weights)

    @property
    def amplitudes(self) -> Array:
        """(k,) amplitudes of the typical signature: half way between the strongest and the weakest phase."""
        X = self.X[:, self.middle]
        return np.asarray(np.linalg.eigh(X.T @ X)[1].sum(axis=1) / np.sqrt(X.shape[1]))

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Draw a random effect (N, count); else return the signature (N, 1) at the option of median ‖x‖ and a typical phase."""
        if self.process:
            return np.asarray(self.X[:, 0] @ rng.standard_normal((self.X.shape[2], count)))
        return np.asarray(self.X[:, self.middle] @ self.amplitudes)[:, None]


def linearise_noise_free(scenario: Scenario) -> RecordingModel:
    """Linearise a recording about the true G and b, without noise, with the simulator's gyro temperature as housekeeping."""
    recording = add_gyro_temperature(simulate(scenario, noise=False))
    return linearise_recording(recording, np.array(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s))


def build_signatures(model: RecordingModel, names: Sequence[str], steps: StepTimes | None = None) -> list[Signature]:
    """Build the signatures of some effects, the random ones last; steps are at the times of the diagnosis by default."""
    signatures = []
    for group in list_effect_groups(model, [EFFECTS[name] for name in names], None, steps):
        for label, options in _split(group).items():
            W = np.stack([group.columns[k] for k in options], axis=1)
            X = model.project_out_nuisance(W.reshape(model.size, -1)).reshape(W.shape)
            share = np.linalg.norm(X, axis=(0, 2)) / np.maximum(np.linalg.norm(W, axis=(0, 2)), 1e-300)
            weights, parameters = group.weights[options], tuple(group.parameters[k] for k in options)
            signatures.append(
                Signature(group.effect, group.axis, label, X, share, weights / weights.sum(), parameters, group.process)
            )
    return sorted(signatures, key=lambda signature: signature.process)


def _split(group: CandidateColumns) -> dict[str, list[int]]:
    """Split the options of a candidate into its signatures: one for each set of parameters of an effect that is switched on."""
    effect = EFFECTS[group.effect]
    label = group.effect if group.axis is None else f"{group.effect}:{group.axis}"
    if group.process:
        defaults = {parameter.name: parameter.default for parameter in effect.parameters}
        return {label: [min(range(len(group.columns)), key=lambda k: _measure_unusualness(group.parameters[k], defaults))]}
    if not effect.switched:
        return {label: list(range(len(group.columns)))}
    places_by_label: dict[str, list[int]] = {}
    for k, parameters in enumerate(group.parameters):
        words = "".join(f"<{value}" for name, value in parameters.items() if name not in OF_TIME)
        places_by_label.setdefault(label + words, []).append(k)
    return places_by_label


def _measure_unusualness(parameters: Mapping[str, float | str], defaults: Mapping[str, float | str | None]) -> float:
    """Measure the distance of an option from the defaults of its effect."""
    distance = 0.0
    for name, value in parameters.items():
        default = defaults[name]
        if isinstance(value, float) and isinstance(default, float):
            distance += abs(float(np.log(value / default)))
        else:
            distance += value != default
    return distance


def find_median_index(values: Array, weights: Array) -> int:
    """Find the index of the weighted median."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return int(order[min(np.searchsorted(total, 0.5 * total[-1]), order.size - 1)])
