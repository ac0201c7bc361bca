"""Signatures: what each effect does to the whitened and projected observations, per unit of its size.

x is the whitened column of the effect with G, b and the start attitudes projected out (`diagnosis.model.recording`),
linearised at the scenario's true G and b. A random effect is a covariance instead, X Xᵀ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from diagnosis.model import processes as random_effects
from diagnosis.model.candidates import AXES, available, columns_of, step_times
from diagnosis.model.recording import RecordingModel, linearised
from simulator.effects import EFFECTS, Effect
from simulator.scenario import Scenario
from simulator.simulate import simulate, with_gyro_temperature

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

GONE = 1e-6  # share of a signature that is left, below which it acts like the calibration itself


@dataclass(frozen=True)
class Signature:
    """What an effect does to the whitened and projected observations, per unit of its size.

    Attributes
    ----------
    effect, axis, label : label has the picked-up axis too, "g_matrix_step:z<y"
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


def linear_model(scenario: Scenario) -> RecordingModel:
    """The model about the true G and b, without noise, and with the simulator's gyro temperature as housekeeping."""
    recording = with_gyro_temperature(simulate(scenario, noise=False))
    return linearised(recording, np.array(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s))


def signatures(model: RecordingModel, names: Sequence[str], at: tuple[Array, Array, Indices] | None = None) -> list[Signature]:
    """Signatures of the effects that are sums of columns.

    Parameters
    ----------
    model : the linear model
    names : effects
    at : times of steps, their weights, and the steps of the stream they begin with; those the diagnosis tries by default
    """
    out = []
    times, weights, firsts = step_times(model) if at is None else at
    for name in names:
        effect = EFFECTS[name]
        if not effect.has_columns or not available(model, effect):
            continue
        asked = {parameter.name for parameter in effect.parameters}
        for axis in effect.axes or (None,):
            label = name if axis is None else f"{name}:{axis}"
            if "time_s" not in asked:
                out.append(
                    _signature(model, effect, axis, label, columns_of(model, effect, axis, {})[:, None, :], np.ones(1), [{}])
                )
                continue
            for toward in AXES if "toward" in asked else [""]:
                fixed: dict[str, float | str] = {"toward": toward} if toward else {}
                on = effect.columns(model.stream, axis, {**fixed, "time_s": float(model.t_s[0]) - 1.0})[:, :, 0]
                W = model.whitened(model.reading_steps(on, firsts))[:, :, None]
                known = [{**fixed, "time_s": float(t)} for t in times]
                out.append(_signature(model, effect, axis, f"{label}<{toward}" if toward else label, W, weights, known))
    return out


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
    axis: str
    X: Array
    parameters: Mapping[str, float | str] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Effect and axis."""
        return f"{self.effect}:{self.axis}"

    @property
    def strength(self) -> float:
        """(tr K²)^¼ with K = X Xᵀ: the inverse goes with the smallest visible size."""
        return float(np.sum((self.X.T @ self.X) ** 2) ** 0.25)


def random_columns(model: RecordingModel, names: Sequence[str]) -> list[RandomColumns]:
    """The random effects among some, with the option of each that is nearest to the usual one."""
    out: list[RandomColumns] = []
    if not any(EFFECTS[name].is_process for name in names):
        return out
    for process in random_effects.processes(model, rivals=False):
        if process.name in names:
            usual = {one.name: one.default for one in EFFECTS[process.name].parameters}
            nearest = min(range(len(process.columns)), key=lambda k: _unusual(process.parameters[k], usual))
            out.append(
                RandomColumns(
                    process.name, process.axis, model.projected(process.columns[nearest]), process.parameters[nearest]
                )
            )
    return out


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
