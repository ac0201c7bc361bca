"""Signatures: what each effect does to the whitened and projected observations, per unit of its size.

x is the whitened column of the effect with G, b and the start attitudes projected out (`diagnosis.model.recording`),
linearised at the scenario's true G and b. A random effect is a covariance instead, X Xᵀ. Columns and options are those that the
diagnosis itself tries (`diagnosis.model.groups`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from diagnosis.model.groups import Group, plain_group, process_groups
from diagnosis.model.linearise import linearised
from diagnosis.model.recording import RecordingModel
from diagnosis.model.steps import step_times, switched_columns
from simulator.effects import EFFECTS, Effect, Trial
from simulator.scenario import Scenario
from simulator.simulate import simulate, with_gyro_temperature

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
StepTimes = tuple[Array, Array, Array, Indices]

GONE = 1e-6  # share of a signature that is left, below which it acts like the calibration itself


@dataclass(frozen=True)
class Signature:
    """What an effect does to the whitened and projected observations, per unit of its size.

    Attributes
    ----------
    effect, axis, label : the label also tells what else is fixed in a switched effect, as in "effect:z<y"
    X : (N, o, k) columns of each option (time of a step), k amplitudes (sine and cosine)
    share : (o,) what the projection leaves of each option, 1 for all
    weights : (o,) prior of the options, sum one
    parameters : of each option
    """

    effect: str
    axis: str | None
    label: str
    X: Array
    share: Array
    weights: Array
    parameters: tuple[dict[str, float | str], ...]

    @property
    def norms(self) -> Array:
        """(o,) ‖x‖ per unit size, root mean square over the phase."""
        return np.asarray(np.sqrt(np.sum(self.X**2, axis=(0, 2)) / self.X.shape[2]))

    @property
    def extremes(self) -> tuple[float, float]:
        """Smallest and largest ‖x‖ per unit size over options and phases."""
        values = np.linalg.svd(self.X.transpose(1, 0, 2), compute_uv=False)
        return float(values[:, -1].min()), float(values[:, 0].max())

    def typical(self) -> Array:
        """(N,) signature at the time of the median ‖x‖, and the phase of the mean ‖x‖²."""
        return np.asarray(self.X[:, self.middle] @ self.amplitudes)

    @property
    def middle(self) -> int:
        """The option with the median ‖x‖."""
        return median_index(self.norms, self.weights)

    @property
    def amplitudes(self) -> Array:
        """(k,) amplitudes of the typical signature: half way between the strongest and the weakest phase."""
        X = self.X[:, self.middle]
        return np.asarray(np.linalg.eigh(X.T @ X)[1].sum(axis=1) / np.sqrt(X.shape[1]))


def noise_free(scenario: Scenario) -> RecordingModel:
    """The model about the true G and b, without noise, and with the simulator's gyro temperature as housekeeping."""
    recording = with_gyro_temperature(simulate(scenario, noise=False))
    return linearised(recording, np.array(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s))


def signatures(model: RecordingModel, names: Sequence[str], at: StepTimes | None = None) -> list[Signature]:
    """Signatures of the effects that are sums of columns.

    Parameters
    ----------
    model : the noise-free recording
    names : effects
    at : times of steps as `step_times` returns them; those that the diagnosis tries by default
    """
    out: list[Signature] = []
    steps = step_times(model) if at is None else at
    for name in names:
        effect = EFFECTS[name]
        if not effect.has_columns or effect.missing(model.around) is not None:
            continue
        for axis in effect.axes or (None,):
            out += _switched(model, effect, axis, steps) if effect.switched else [_plain(model, effect, axis)]
    return out


def _plain(model: RecordingModel, effect: Effect, axis: str | None) -> Signature:
    """Signature of an effect that is there throughout, with the sets of parameters that are tried as its options."""
    group = plain_group(model, effect, axis, model.around)
    return _signature(
        model, effect, axis, _label(effect, axis), np.stack(group.columns, axis=1), group.weights, group.parameters
    )


def _switched(model: RecordingModel, effect: Effect, axis: str | None, steps: StepTimes) -> list[Signature]:
    """A signature for each set of parameters of an effect that is switched on, with the times of the step as its options."""
    times, _, weights, firsts = steps
    out = []
    trials = effect.trials(model.around)
    for trial in trials:
        label = _label(effect, axis) + (_words(trial) if len(trials) > 1 else "")
        W = switched_columns(model, effect, axis, trial.parameters, firsts)[:, :, None]
        known = [{**trial.parameters, "time_s": float(t)} for t in times]
        out.append(_signature(model, effect, axis, label, W, weights, known))
    return out


def _label(effect: Effect, axis: str | None) -> str:
    return effect.name if axis is None else f"{effect.name}:{axis}"


def _words(trial: Trial) -> str:
    return "".join(f"<{value}" for value in trial.parameters.values())


def _signature(
    model: RecordingModel,
    effect: Effect,
    axis: str | None,
    label: str,
    W: Array,
    weights: Array,
    parameters: Sequence[dict[str, float | str]],
) -> Signature:
    X = model.projected(W.reshape(model.size, -1)).reshape(W.shape)
    share = np.linalg.norm(X, axis=(0, 2)) / np.maximum(np.linalg.norm(W, axis=(0, 2)), 1e-300)
    return Signature(effect.name, axis, label, X, share, weights / weights.sum(), tuple(parameters))


@dataclass(frozen=True)
class RandomColumns:
    """A random effect: y = a X z with z ~ N(0, I).

    Attributes
    ----------
    effect, axis : which
    X : (N, r) projected columns of unit amplitude, of the usual option
    parameters : of that option
    """

    effect: str
    axis: str | None
    X: Array
    parameters: Mapping[str, float | str] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Effect and axis."""
        return self.effect if self.axis is None else f"{self.effect}:{self.axis}"

    @property
    def strength(self) -> float:
        """(tr K²)^¼ with K = X Xᵀ: the inverse goes with the smallest visible size."""
        return float(np.sum((self.X.T @ self.X) ** 2) ** 0.25)


def random_columns(model: RecordingModel, names: Sequence[str]) -> list[RandomColumns]:
    """The random effects among some, with the option of each that is nearest to the usual one."""
    out: list[RandomColumns] = []
    for name in names:
        effect = EFFECTS[name]
        if effect.has_columns or not effect.is_process or effect.missing(model.around) is not None:
            continue
        usual = {one.name: one.default for one in effect.parameters}
        out += [_nearest(model, group, usual) for group in process_groups(model, effect, model.around)]
    return out


def _nearest(model: RecordingModel, group: Group, usual: Mapping[str, float | str | None]) -> RandomColumns:
    chosen = min(range(len(group.columns)), key=lambda k: _unusual(group.parameters[k], usual))
    return RandomColumns(group.effect, group.axis, model.projected(group.columns[chosen]), group.parameters[chosen])


def _unusual(parameters: Mapping[str, float | str], usual: Mapping[str, float | str | None]) -> float:
    """How far an option is from the defaults of its effect."""
    away = 0.0
    for name, value in parameters.items():
        default = usual[name]
        if isinstance(value, float) and isinstance(default, float):
            away += abs(float(np.log(value / default)))
        else:
            away += value != default
    return away


def median_index(values: Array, weights: Array) -> int:
    """Index of the weighted median."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return int(order[min(np.searchsorted(total, 0.5 * total[-1]), order.size - 1)])
