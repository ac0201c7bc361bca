"""Columns of effects that are not linear enough in their size: late gyro tags, and errors that follow the rate.

*Late tags.* With tags late by s, the attitude as propagated, A_prop(t), is the true one of s before, A_true(t − s), but for a
constant turn. So E_k = A_true,kᵀ A_prop,k at the references is A_prop(t_k + s)ᵀ A_prop(t_k) but for a constant turn about
inertial axes, which the start attitude takes. To first order that is −s Aᵀω, the integral of the column −dω_raw/dt; where the
rate changes much during s, it is not. With E_obs,k of the recording and z_k as the model has it, the observation of exactly
that delay is z_k + log(E_k E_obs,kᵀ): the residual then is the noise. Per second it is a column c(s). The
column at the delay of least squares, searched around the one at which a fit of c(s) gives s back, is a further option.

*True rates.* The columns of an effect are made at the rates that M0 shows. Those hold the effect itself: of raw = ω + s c(ω)
they are about ω + s c(ω) − δ, with δ the part of it in G and b, and c at them is off by s c'(ω) times that. A scale factor that
grows by some percent up to the fastest turn is then estimated as smaller by about as much of itself. Beside it, G and b differ
from those of M0 by δG and δb. With these and s by least squares, the true rate is

    ω = ω_M0 + δG ω_raw + δb − s (G + δG) c(ω),

whose last term is the effect's column. At the new ω all is estimated anew, until the columns stay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from diagnosis.model.linear import LinearModel, Member
from diagnosis.model.recording import SETTINGS as RECORDING
from diagnosis.model.recording import RecordingModel, parameter_errors
from gyrocal.calibration.propagation import Arcs, propagate
from simulator.effects.base import Effect

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NonlinearSettings:
    """Constants of `diagnosis.model.nonlinear`."""

    nonlinear: float = 0.3  # sigmas of all observations together, by which columns must differ from those of a small effect
    delay_rounds: int = 10  # in which a delay settles
    delay_settled: float = 0.01  # relative change, at which it has
    # factor to either side of that delay, and delays that are tried
    widest: float = 4.0
    tried: int = 17
    rate_rounds: int = 6  # of the true rates, at most
    rate_settled: float = 0.03  # sigmas of all observations together, by which the effect's error still changes


SETTINGS = NonlinearSettings()
TINY = 1e-300


# ---- late tags -----------------------------------------------------------------------------------------------------------


def build_delay_column(model: RecordingModel, small: Array, prior: tuple[float, float]) -> Array | None:
    """Build the (N, 1) whitened column per second at the delay that fits best; None where that of a short delay is enough.

    Parameters
    ----------
    model : the recording
    small : (N, 1) whitened columns of a short delay
    prior : shortest and longest delay that is plausible, s
    """
    path = _Path(model)

    def left(delay: float) -> float:
        return float(np.sum((model.y - delay * model.projected(path.column(delay))[:, 0]) ** 2))

    column, delay = small, 0.0
    for _ in range(SETTINGS.delay_rounds):
        before, delay = delay, float(np.clip(_fit_amplitude(model, column), -prior[1], prior[1]))
        if abs(delay) < prior[0]:
            return None
        column = path.column(delay)
        if abs(delay - before) < SETTINGS.delay_settled * abs(delay):
            break
    if abs(delay) * float(np.linalg.norm(model.projected(column - small))) < SETTINGS.nonlinear:
        return None
    factors = np.geomspace(1 / SETTINGS.widest, SETTINGS.widest, SETTINGS.tried)
    nearest = min((delay * float(factor) for factor in factors if abs(delay * factor) <= prior[1]), key=left)
    step = SETTINGS.widest ** (2 / (SETTINGS.tried - 1))
    low, high = sorted((nearest / step, nearest * step))
    best = minimize_scalar(left, bounds=(low, high), method="bounded", options={"xatol": 1e-3 * abs(delay)})
    return path.column(float(best.x))


class _Path:
    """The propagated attitude of a recording at any time."""

    def __init__(self, model: RecordingModel) -> None:
        self.model = model
        count = model.t_s.size
        block = np.repeat(np.arange(len(model.blocks)), [one.steps.stop - one.steps.start for one in model.blocks])
        places = np.arange(count)
        turned = propagate(Arcs(model.rates, model.dt, places, places, places + 1, block), np.eye(3), np.zeros(3)).R
        quaternions = model.recording.attitudes.quaternions
        self.begin = [np.append(0.0, np.cumsum(model.dt[one.steps])) for one in model.blocks]
        self.to_inertial = []
        for one in model.blocks:
            start = Rotation.from_quat(quaternions[one.references[np.argmin(one.elapsed_s)]]).inv()
            relative = Rotation.from_matrix(turned[one.steps])
            self.to_inertial.append(start.inv() * Rotation.concatenate([Rotation.identity(), relative]).inv())

    def column(self, delay: float) -> Array:
        """(N, 1) whitened observations of a delay, per second of it."""
        start, parts = 0, []
        for number, block in enumerate(self.model.blocks):
            own = slice(start, start + block.references.size)
            first = self._at(number, np.array([delay])) * self._at(number, np.zeros(1)).inv()
            E = first.inv() * self._at(number, block.elapsed_s + delay) * self._at(number, block.elapsed_s).inv()
            off = (E * Rotation.from_rotvec(self.model.off[own]).inv()).as_rotvec()
            parts.append(block.observed(self.model.residuals[own] + off).ravel())
            start = own.stop
        return self.model.whitened(np.concatenate(parts)[:, None] / delay)

    def _at(self, number: int, t: Array) -> Rotation:
        """Aᵀ at times from a block's start; beyond its ends at constant rate."""
        edges, rates = self.begin[number], self.model.rates[self.model.blocks[number].steps]
        k = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, len(rates) - 1)
        return self.to_inertial[number][k] * Rotation.from_rotvec(rates[k] * (t - edges[k])[:, None])


def _fit_amplitude(model: RecordingModel, column: Array) -> float:
    """Least-squares amplitude of a column."""
    x = model.projected(column)[:, 0]
    return float(x @ model.y / max(float(x @ x), TINY))


# ---- true rates ----------------------------------------------------------------------------------------------------------


def with_true_rates(model: RecordingModel, linear: LinearModel, member: Member, effect: Effect) -> LinearModel:
    """The linear model with the columns of a member's option at the true rates, where those differ enough.

    Parameters
    ----------
    model : what the columns are made from
    linear : of it
    member : of an effect with columns that are not switched on
    effect : its effect
    """
    entry, option = linear.candidate(member), linear.option(member)
    if entry.process or effect.on_references or effect.switched or not effect.has_columns or effect.stage != "rate":
        return linear
    before = linear.X[:, option.columns]
    high, W, X = effect.columns(model.stream, entry.axis, option.parameters), linear.W[:, option.columns], before
    amplitudes = _fit_amplitudes(linear, member, X)
    for _ in range(SETTINGS.rate_rounds):
        change = _estimate_change(model, W @ amplitudes)
        G = model.G + change[:9].reshape(3, 3)
        rates = model.rates + parameter_errors(model.raw) @ change - (high @ amplitudes) @ G.T
        high, last = effect.columns(replace(model.stream, rates=rates), entry.axis, option.parameters), X @ amplitudes
        W = model.whitened(model.rate_error(-np.einsum("ij,njk->nik", G, high)))
        X = model.projected(W)
        amplitudes = _fit_amplitudes(linear, member, X)
        if np.linalg.norm(X @ amplitudes - last) < SETTINGS.rate_settled:
            break
    if np.linalg.norm((X - before) @ amplitudes) < SETTINGS.nonlinear:
        return linear
    options = list(entry.options)
    options[member.option] = replace(option, start=linear.X.shape[1])
    return linear.with_options(member.candidate, options, W, X)


def _fit_amplitudes(linear: LinearModel, member: Member, X: Array) -> Array:
    """(k,) amplitudes of columns (N, k) under the prior at which the member is held."""
    return np.asarray(np.linalg.solve(X.T @ X + np.eye(X.shape[1]) / linear.scale(member) ** 2, X.T @ linear.y))


def _estimate_change(model: RecordingModel, explained: Array) -> Array:
    """(12,) by how much G_xx, …, G_zz and b, rad/s, differ from M0's beside what an effect explains, (N,) whitened."""
    columns = np.hstack([model.calibration, model.attitude_nuisance])
    scale = 1 / np.maximum(np.linalg.norm(columns, axis=0), TINY)
    left = model.whitened(model.zeta) - explained
    return np.asarray((scale * np.linalg.lstsq(columns * scale, left, rcond=RECORDING.rank)[0])[:12])
