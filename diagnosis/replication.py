"""Replication: the size of an effect in separate parts of a recording, and whether the sizes agree.

A listed effect has one size. Its amplitude is estimated in each part, with all other effects in the model. The sizes a_k with
sigmas s_k agree if Q = Σ (a_k − ā)²/s_k² is χ² distributed (Cochran, Biometrics 10, 1954). Their scatter beyond the sigmas is
the variance τ² of DerSimonian and Laird (Controlled Clinical Trials 7, 1986), and the mean over the parts, with the weights
1/(s_k² + τ²), has a sigma that holds even where they do not agree. A cause whose size differs between parts is a cause all
the same: mean and scatter τ are stated, and a straight line over time where one is significant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.special
from numpy.typing import NDArray

from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.model.processes import TAGS_WANDER
from diagnosis.model.recording_model import RecordingModel
from gyrocal.arrays import Array

DELAYS = ("time_offset", "rate_lag")
CLOCKS = (*DELAYS, "clock_drift", "clock_slip", TAGS_WANDER)
PARTS = 6  # of a recording at least; intervals are divided until there are as many
WIDEST = 4.0  # sigma of a part beyond which it shows nothing, in sigmas of the best part
PRIOR = 1e3  # sigma of an amplitude in one part, in units of the prior of the whole
SIGNIFICANT = 0.01  # p-value of the slope over time below which sizes by part follow a ramp
FEWEST_IN_RAMP = 4  # parts that a ramp is fitted to


@dataclass(frozen=True)
class PartSize:
    """Size of an effect in one part of the recording: `part` is its name, size and sigma are in the effect's unit."""

    part: str
    size: float
    sigma: float


@dataclass(frozen=True)
class Replication:
    """Sizes of an effect by part."""

    parts: tuple[PartSize, ...]  # size in each part that shows the effect
    heterogeneity_p: float  # p-value of Q; 1 where fewer than two parts show the effect
    mean: float  # mean, sigma: random-effects mean over the parts, and its sigma
    sigma: float
    spread: float = 0.0  # τ, scatter of the sizes between parts beyond their sigmas
    ramp: tuple[float, float] | None = None  # sizes in the first and the last part by a line over time; None without one


def name_parts(model: RecordingModel) -> NDArray[np.str_]:
    """Name the part of the recording that each observation (r,) belongs to: its interval, or a piece of it."""
    pieces = max(1, -(-PARTS // len(model.blocks)))
    names = []
    for block in model.blocks:
        interval = model.recording.intervals[block.interval].name
        count = block.groups.size
        number = np.arange(count) * pieces // max(count, 1)
        names += [interval if pieces == 1 else f"{interval}, {k + 1} of {pieces}" for k in number]
    return np.array(names)


def estimate_by_part(
    model: RecordingModel, effects: Sequence[FittedEffect], unnamed: Sequence[FittedEffect], number: int
) -> Replication:
    """Estimate the size of one effect in each part of the recording, the others and the remainder held in the model.

    Parameters
    ----------
    model : the recording
    effects, unnamed : causes, and members of the remainder
    number : which of the effects
    """
    effect = effects[number]
    if effect.process:  # its size is a standard deviation; a part of it has none of its own
        return Replication((), 1.0, effect.size, effect.sigma)
    shape = effect.contribution
    names = np.repeat(name_parts(model), 3)
    parts = list(dict.fromkeys(names.tolist()))
    by_part = np.column_stack([np.where(names == name, shape, 0.0) for name in parts])
    others = [rival for k, rival in enumerate(effects) if k != number] + list(unnamed)
    if effect.effect in DELAYS:  # whose sizes by part are the delays there, whatever else the clocks do
        others = [rival for rival in others if rival.effect not in CLOCKS]
    scaled = [rival.columns * rival.prior_sigma for rival in others]
    observed = model.y - sum((model.project_out_nuisance(rival.shift) for rival in others), np.zeros(model.size))
    columns = model.project_out_nuisance(np.hstack([by_part, *scaled]))
    prior = np.concatenate([np.full(len(parts), PRIOR**-2), np.ones(columns.shape[1] - len(parts))])
    covariance = np.linalg.inv(columns.T @ columns + np.diag(prior))
    estimate = covariance @ (columns.T @ observed)
    sizes = estimate[: len(parts)] * effect.size
    spread = covariance[: len(parts), : len(parts)] * effect.size**2
    times = np.array([np.repeat(model.observation_t_s, 3)[names == name].mean() for name in parts])
    return combine_parts(parts, np.asarray(sizes), np.asarray(spread), times)


def combine_parts(names: Sequence[str], sizes: Array, covariance: Array, t_s: Array) -> Replication:
    """Combine sizes (k,) of an effect by part, with covariance (k, k) and times (k,), to a random-effects mean and a ramp."""
    sigmas = np.sqrt(np.diag(covariance))
    used = sigmas <= WIDEST * sigmas.min()
    size, sigma = sizes[used], sigmas[used]
    shown = zip(np.array(names)[used].tolist(), size.tolist(), sigma.tolist(), strict=True)
    parts = tuple(PartSize(*values) for values in shown)
    if size.size < 2:
        return Replication(parts, 1.0, float(size[0]), float(sigma[0]))
    weights = sigma**-2
    mean = float(weights @ size / weights.sum())
    Q = float(weights @ (size - mean) ** 2)
    between = max(0.0, (Q - (size.size - 1)) / float(weights.sum() - (weights**2).sum() / weights.sum()))
    weights = 1.0 / (sigma**2 + between)
    mean = float(weights @ size / weights.sum())
    p = float(scipy.special.chdtrc(size.size - 1, Q))
    ramp = _fit_ramp(size, sigma, t_s[used])
    return Replication(parts, p, mean, float(weights.sum() ** -0.5), float(np.sqrt(between)), ramp)


def _fit_ramp(sizes: Array, sigmas: Array, t_s: Array) -> tuple[float, float] | None:
    """Fit a line over time; its values at the first and the last time, or None unless its slope is significant.

    The sigma of the slope holds where sizes scatter about the line beyond their sigmas.
    """
    if sizes.size < FEWEST_IN_RAMP or not np.ptp(t_s) > 0:
        return None
    X = np.column_stack([np.ones(sizes.size), (t_s - t_s.min()) / np.ptp(t_s)]) / sigmas[:, None]
    line = np.linalg.lstsq(X, sizes / sigmas, rcond=None)[0]
    dof = sizes.size - 2
    scatter = max(1.0, float(np.sum((sizes / sigmas - X @ line) ** 2)) / dof)
    t = line[1] / np.sqrt(scatter * np.linalg.inv(X.T @ X)[1, 1])
    if 2 * scipy.special.stdtr(dof, -abs(t)) > SIGNIFICANT:
        return None
    return float(line[0]), float(line[0] + line[1])
