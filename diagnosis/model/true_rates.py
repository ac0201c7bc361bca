"""Columns of an effect that is not linear in the rate, at the rates that the body has beside it.

The columns of an effect are made at the rates that M0 shows. Those hold the effect itself: of raw = ω + s c(ω) they are about
ω + s c(ω) − δ, with δ what G and b take of it, and c at them is off by s c'(ω) times that. A scale factor that grows by some
percent up to the fastest turn is then told as smaller by about as much of itself. Beside it, G and b differ from those of M0
by δG and δb. With these and s by least squares, the true rate is

    ω = ω_M0 + δG ω_raw + δb − s (G + δG) c(ω),

whose last term is the effect's column. At the new ω all is estimated anew, until the columns stay.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from diagnosis.arrays import LEAST_POSITIVE, Array
from diagnosis.model.linear import LinearModel, SelectedCandidate
from diagnosis.model.recording_model import RANK, RecordingModel, build_parameter_errors
from simulator.effects.base import Effect

ROUNDS = 6  # at most
SETTLED = 0.03  # sigmas of all observations together, by which what the effect does still changes
NONLINEAR = 0.3  # the same, from which on the columns are taken at the true rates


def use_true_rates(model: RecordingModel, linear: LinearModel, member: SelectedCandidate, effect: Effect) -> LinearModel:
    """The linear model with the columns of a member's option at the true rates, where those differ enough.

    Only effects with columns that are not switched on are changed.
    """
    entry, option = linear.candidate(member), linear.option(member)
    if entry.process or effect.on_references or effect.switched or not effect.has_columns or effect.stage != "rate":
        return linear
    before = linear.X[:, option.columns]
    high, W, X = effect.columns(model.stream, entry.axis, option.parameters), linear.W[:, option.columns], before
    if high.shape[2] != option.count:  # with the rounding of a covariate
        return linear
    amplitudes = _fit_amplitudes(linear, member, X)
    for _ in range(ROUNDS):
        change = _change(model, W @ amplitudes)
        G = model.G + change[:9].reshape(3, 3)
        rates = model.rates + build_parameter_errors(model.raw) @ change - (high @ amplitudes) @ G.T
        high, last = effect.columns(replace(model.stream, rates=rates), entry.axis, option.parameters), X @ amplitudes
        W = model.whiten(model.observe_rate_error(-np.einsum("ij,njk->nik", G, high)))
        X = model.project_out_nuisance(W)
        amplitudes = _fit_amplitudes(linear, member, X)
        if np.linalg.norm(X @ amplitudes - last) < SETTLED:
            break
    if np.linalg.norm((X - before) @ amplitudes) < NONLINEAR:
        return linear
    options = list(entry.options)
    options[member.option] = replace(option, start=linear.X.shape[1])
    return linear.replace_options(member.candidate, options, W, X)


def _fit_amplitudes(linear: LinearModel, member: SelectedCandidate, X: Array) -> Array:
    """(k,) amplitudes of columns (N, k) under the prior at which the member is held."""
    return np.asarray(np.linalg.solve(X.T @ X + np.eye(X.shape[1]) / linear.scale(member) ** 2, X.T @ linear.y))


def _change(model: RecordingModel, explained: Array) -> Array:
    """(12,) by how much G_xx, …, G_zz and b, rad/s, differ from M0's beside what an effect explains, (N,) whitened."""
    columns = np.hstack([model.calibration, model.starts])
    scale = 1 / np.maximum(np.linalg.norm(columns, axis=0), LEAST_POSITIVE)
    left = model.whiten(model.zeta) - explained
    return np.asarray((scale * np.linalg.lstsq(columns * scale, left, rcond=RANK)[0])[:12])
