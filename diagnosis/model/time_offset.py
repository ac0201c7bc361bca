"""Gyro tags that are late by seconds: the attitude errors of that, not to first order.

With tags late by s, the attitude as propagated, A_prop(t), is the true one of s before, A_true(t − s), but for a constant turn.
So E_k = A_true,kᵀ A_prop,k at the references is A_prop(t_k + s)ᵀ A_prop(t_k) but for a constant turn about inertial axes, which
the start attitude takes. To first order that is −s Aᵀω, the integral of the column −dω_raw/dt; where the rate changes much
during s, it is not.

With E_obs,k of the recording and z_k as the model has it, the observation of exactly that delay is z_k + log(E_k E_obs,kᵀ):
what is left of the recording then is the noise. Per second it is a column c(s). Delays on a grid around the one at which a fit
of c(s) gives s back are tried, and the one of least squares beside it. Each that fits is an option with an amplitude a of its
own; since the truth is at a = s, its prior share is the likelihood there over that at the best a.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from diagnosis.model.recording_model import RecordingModel
from gyrocal.arrays import Array
from gyrocal.calibration.propagation import Arcs, propagate

ROUNDS = 10  # in which a delay settles
SETTLED = 0.01  # relative change, at which it has
NONLINEAR = 0.3  # sigmas of all observations together, by which a column then differs from that of a short delay
# factor to either side of that delay, and delays that are tried
WIDEST = 4.0
TRIED = 17
FITTING = 12.0  # χ² above the least, up to which a delay is an option


def fit_delays(model: RecordingModel, small: Array, prior: tuple[float, float]) -> list[tuple[Array, float]]:
    """Fit columns (N, 1) at the delays that fit the data, with prior weights; none where the column of a short delay does.

    The prior is the shortest and the longest delay that is plausible, s.
    """
    path = _Path(model)

    def compute_left_chi2(delay: float) -> float:
        return float(np.sum((model.y - delay * model.project_out_nuisance(path.column(delay))[:, 0]) ** 2))

    column, delay = small, 0.0
    for _ in range(ROUNDS):
        previous, delay = delay, float(np.clip(_fit_amplitude(model, column), -prior[1], prior[1]))
        if abs(delay) < prior[0]:
            return []
        column = path.column(delay)
        if abs(delay - previous) < SETTLED * abs(delay):
            break
    if abs(delay) * float(np.linalg.norm(model.project_out_nuisance(column - small))) < NONLINEAR:
        return []
    factors = np.geomspace(1 / WIDEST, WIDEST, TRIED)
    tried = [delay * float(factor) for factor in factors if abs(delay * factor) <= prior[1]]
    nearest = min(tried, key=compute_left_chi2)
    step = WIDEST ** (2 / (TRIED - 1))
    low, high = sorted((nearest / step, nearest * step))
    tried.append(
        float(minimize_scalar(compute_left_chi2, bounds=(low, high), method="bounded", options={"xatol": 1e-3 * abs(delay)}).x)
    )
    values = [compute_left_chi2(delay_s) for delay_s in tried]
    fitting = [
        (delay_s, path.column(delay_s)) for delay_s, value in zip(tried, values, strict=True) if value < min(values) + FITTING
    ]
    # A fit of the amplitude gains (a − s)² |c|² over it.
    gains = [
        (_fit_amplitude(model, c) - delay_s) ** 2 * float(np.sum(model.project_out_nuisance(c) ** 2)) for delay_s, c in fitting
    ]
    return [(c, float(share)) for (_, c), share in zip(fitting, compute_delay_shares(np.array(gains)), strict=True)]


def compute_delay_shares(gains: Array) -> Array:
    """Compute the prior shares (d,) of delays from the χ² that a free amplitude gains beside each."""
    weights = np.exp(-0.5 * (gains - gains.min()))
    return np.asarray(weights / weights.sum())


class _Path:
    """The propagated attitude of a recording at any time."""

    def __init__(self, model: RecordingModel) -> None:
        self.model = model
        count = model.t_s.size
        block = np.repeat(
            np.arange(len(model.blocks)), [block_model.steps.stop - block_model.steps.start for block_model in model.blocks]
        )
        places = np.arange(count)
        turned = propagate(Arcs(model.rates, model.dt, places, places, places + 1, block), np.eye(3), np.zeros(3)).R
        quaternions = model.recording.attitudes.quaternions
        self.begin = [np.append(0.0, np.cumsum(model.dt[block_model.steps])) for block_model in model.blocks]
        self.to_inertial = []
        for block_model in model.blocks:
            start = Rotation.from_quat(quaternions[block_model.references[np.argmin(block_model.elapsed_s)]]).inv()
            relative = Rotation.from_matrix(turned[block_model.steps])
            self.to_inertial.append(start.inv() * Rotation.concatenate([Rotation.identity(), relative]).inv())

    def column(self, delay: float) -> Array:
        """Observe a delay as whitened observations (N, 1), per second of it."""
        parts = []
        for number, (block, references) in enumerate(zip(self.model.blocks, self.model.reference_slices, strict=True)):
            attitude, elapsed_s = partial(self._compute_attitude, number), block.elapsed_s
            first = attitude(np.array([delay])) * attitude(np.zeros(1)).inv()
            E = first.inv() * attitude(elapsed_s + delay) * attitude(elapsed_s).inv()
            errors = (E * Rotation.from_rotvec(self.model.off[references]).inv()).as_rotvec()
            parts.append(block.average_references(self.model.residuals[references] + errors).ravel())
        return self.model.whiten(np.concatenate(parts)[:, None] / delay)

    def _compute_attitude(self, number: int, t: Array) -> Rotation:
        """Compute Aᵀ at times from a block's start; beyond its ends at constant rate."""
        edges, rates = self.begin[number], self.model.rates[self.model.blocks[number].steps]
        k = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, len(rates) - 1)
        return self.to_inertial[number][k] * Rotation.from_rotvec(rates[k] * (t - edges[k])[:, None])


def _fit_amplitude(model: RecordingModel, column: Array) -> float:
    """Fit the amplitude of a column by least squares."""
    x = model.project_out_nuisance(column)[:, 0]
    return float(x @ model.y / max(float(x @ x), 1e-300))
