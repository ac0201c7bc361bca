"""Attitude sensors for an estimator: expected measurements, their sensitivities, and series of real ones.

An attitude error θ is that of the residual N (16): the true attitude is exp([θ×]) A, or (I + [θ×]) A to first order, for an
estimate A. A model predicts y = h(A, p) with p its calibration parameters, and gives ∂h/∂θ and ∂h/∂p, so that
to first order

    y − h(A, p) = (∂h/∂θ) θ + (∂h/∂p) Δp + noise,    Δp = p_true − p

For a sensor that sees a direction, with body components v = A r, the change is θ × v = −[v×] θ.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from gyrocal.arrays import Array, Indices, Mask
from gyrocal.errors import InputError


class SensorModel(Protocol):
    """Measurement model of one sensor over a series; what differs from row to row (a Sun vector, a position) it holds.

    `rows` are row numbers of the series, one for each of the attitudes given.
    """

    @property
    def name(self) -> str:
        """Name of the sensor."""

    @property
    def size(self) -> int:
        """Numbers per measurement, m."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the p calibration parameters, e.g. "m_x", "m_y", "m_z"; angles in rad."""

    def predict(self, A: Array, rows: Indices) -> Array:
        """Predict measurements at attitudes A (n, 3, 3); (n, m)."""

    def jacobian(self, A: Array, rows: Indices) -> Array:
        """Compute ∂h/∂θ for A → exp([θ×]) A; (n, m, 3)."""

    def partials(self, A: Array, rows: Indices) -> Array:
        """Compute ∂h/∂p; (n, m, p)."""

    def corrected(self, change: Array) -> SensorModel:
        """Return the model with its parameters moved by change (p,); rotations are composed, not added."""


@dataclass(frozen=True)
class SensorSeries:
    """Measurements of one sensor.

    An `InputError` if the arrays do not fit each other or the model, a time does not ascend, a sigma is not positive, or a
    number to be used is not finite.

    Attributes
    ----------
    model : their model, for which row k is the k-th measurement
    t : (n,) s, strictly ascending
    y : (n, m) measurements; any value, NaN too, where sigma is infinite
    sigma : (n, m) 1-sigma of the noise, in the unit of y; infinite where a number is not to be used (out of view, quadrant
        dropped)
    """

    model: SensorModel
    t: Array
    y: Array
    sigma: Array

    def __post_init__(self) -> None:
        for field in ("t", "y", "sigma"):
            object.__setattr__(self, field, np.asarray(getattr(self, field), dtype=float))
        name = self.model.name
        if self.t.ndim != 1 or not self.t.size:
            raise InputError(f"{name}: the times must be (n,) with n ≥ 1, not {self.t.shape}")
        expected = (self.t.size, self.model.size)
        for field, values in (("measurements", self.y), ("sigmas", self.sigma)):
            if values.shape != expected:
                raise InputError(f"{name}: the {field} must be {expected}, not {values.shape}")
        if not np.isfinite(self.t).all():
            raise InputError(f"{name}: row {_find_first(~np.isfinite(self.t))}: the time is not finite")
        backward = np.diff(self.t, prepend=-np.inf) <= 0
        if backward.any():
            k = _find_first(backward)
            raise InputError(f"{name}: row {k}: times must ascend, {self.t[k]:.9g} s follows {self.t[k - 1]:.9g} s")
        improper = ~(self.sigma > 0).all(axis=1)  # a NaN is improper too
        if improper.any():
            raise InputError(
                f"{name}: row {_find_first(improper)}: sigma must be positive, or infinite for a number not to be used"
            )
        missing = (~np.isfinite(self.y) & self.used).any(axis=1)
        if missing.any():
            raise InputError(f"{name}: row {_find_first(missing)}: a measurement is not finite but its sigma is")

    @property
    def used(self) -> Mask:
        """(n, m) numbers to be used."""
        return np.isfinite(self.sigma)


def _find_first(mask: npt.ArrayLike) -> int:
    return int(np.argmax(mask))
