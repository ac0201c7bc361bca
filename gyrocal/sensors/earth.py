"""Static Earth sensor as an estimator sees it: expected penetration angles and their derivatives.

Expected angle
    The CO₂ horizon is an ellipsoid with the semi-axes of WGS 84 plus the height of the layer. With D = diag(1/a, 1/a, 1/c) and
    k = |D r|² − 1 the lines of sight d from r that touch it form the cone dᵀ C d = 0, C = D (D r rᵀ D − k I) D. In the body
    it is C_b = A C Aᵀ. At the azimuth ζ about +z, from +x toward +y, the line of sight at the angle η from +z is
    e = (sin η cos ζ, sin η sin ζ, cos η), and with s = (cos ζ, sin ζ, 0)

        α cos²η + 2 β sin η cos η + γ sin²η = 0,    α = C_b,zz,  β = sᵀ C_b e_z,  γ = sᵀ C_b s
        η = atan2(β + √(β² − αγ), −γ)

    is the limb on the side of ζ. The penetration angle is y = η − asin(a/r₀) + bias, r₀ the nominal distance.
Derivative
    A → exp([θ×]) A turns the cone: eᵀ C_b e changes by −2 θ·(e × C_b e), and with η by 2 e'·C_b e, e' = ∂e/∂η. The sum stays
    zero, hence

        ∂y/∂θ = (e × C_b e)/(e'·C_b e)

    For a sphere of angular radius η₀ and +z to nadir this is (−sin ζ, cos ζ, 0).
Biases
    Four biases are therefore equal to a misalignment in roll and pitch (differences of opposite quadrants, as R says; yaw has
    none), a change of altitude or CO₂ height (their sum; 0.027 deg/km and 0.028 deg/km), and one more: y₁ + y₃ against
    y₂ + y₄. That one is an elongated horizon. The oblate Earth has such a part, known from the model, and no attitude and no
    height looks like it: it is the only combination that one sample of all four quadrants determines by itself.
Quadrants
    Flying +x forward, +x is east and +y south, so that the azimuths 45°, 135°, 225°, 315° are SE, SW, NW, NE; flying −x
    forward NW, NE, SE, SW. R does not say how it numbers them, see `TRMM_BIASES`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gyrocal.arrays import Array, Indices
from gyrocal.errors import InputError

EQUATORIAL_RADIUS, POLAR_RADIUS = 6378137.0, 6356752.314245  # m, WGS 84
# s of each quadrant
QUADRANT_DIRECTIONS = np.sqrt(0.5) * np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]])

#: b_ESA that R found with M_DSS-1 = I, in the order printed there, rad. R lists the quadrants as NE, NW, SE, SW in the text
#: but does not say that the biases are in that order, nor their sign. With the sign and the flight direction (+x forward)
#: of this module, the order NE, NW, SE, SW makes them a roll of -0.013 and a pitch of 0.086 deg, the order NE, SE, SW, NW
#: (clockwise from above) a roll of 0.058 and a pitch of -0.013 deg. In any order h = -0.065 deg, 2.4 km higher.
TRMM_BIASES = np.deg2rad([-0.1574, 0.04635, -0.09414, -0.05382])


@dataclass(frozen=True)
class EarthSensor:
    """An Earth sensor with four quadrants; an `InputError` if it has not four finite biases and a positive sigma.

    Attributes
    ----------
    biases : (4,) penetration-angle biases, added to the true angles, rad
    co2_height : height of the CO₂ layer's edge above WGS 84, m
    altitude : nominal altitude above the equatorial radius, at which a sphere's horizon has the angle zero, m
    sigma : noise of an angle, 1-sigma, rad
    name : of the sensor
    """

    biases: Array
    co2_height: float = 40e3
    altitude: float = 350e3
    sigma: float = float(np.deg2rad(0.02))
    name: str = "ESA"

    def __post_init__(self) -> None:
        object.__setattr__(self, "biases", np.asarray(self.biases, dtype=float))
        if self.biases.shape != (4,) or not np.isfinite(self.biases).all():
            raise InputError(f"{self.name}: the penetration biases must be four finite numbers")
        if not self.sigma > 0:
            raise InputError(f"{self.name}: sigma must be positive, not {self.sigma}")

    @property
    def nominal(self) -> float:
        """Angle of the horizon from nadir at which a penetration angle is zero, rad."""
        return float(np.arcsin((EQUATORIAL_RADIUS + self.co2_height) / (EQUATORIAL_RADIUS + self.altitude)))

    def cone(self, position: Array) -> Array:
        """Compute the cone C of the lines of sight that touch the horizon, inertial; (n, 3) m → (n, 3, 3)."""
        a, c = EQUATORIAL_RADIUS + self.co2_height, POLAR_RADIUS + self.co2_height
        D = 1 / np.array([a, a, c])
        p = position * D
        k = (p * p).sum(axis=-1) - 1
        return np.asarray((p * D)[..., :, None] * (p * D)[..., None, :] - k[..., None, None] * np.diag(D * D))


@dataclass(frozen=True)
class EarthModel:
    """`gyrocal.sensors.series.SensorModel` of four penetration angles, rad; parameters are their biases.

    Attributes
    ----------
    sensor : the sensor
    position : (n, 3) inertial position at each measurement, m
    """

    sensor: EarthSensor
    position: Array
    size = 4
    parameters = ("bias_1", "bias_2", "bias_3", "bias_4")

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", np.asarray(self.position, dtype=float))
        if self.position.ndim != 2 or self.position.shape[1] != 3:
            raise InputError(f"{self.sensor.name}: positions must be (n, 3), not {self.position.shape}")

    @property
    def name(self) -> str:
        """Name of the sensor."""
        return self.sensor.name

    def predict(self, A: Array, rows: Indices) -> Array:
        """Predict penetration angles at attitudes (n, 3, 3); (n, 4), NaN where a scan plane misses the Earth."""
        return np.asarray(_compute_limb(self._compute_cone(A, rows)) - self.sensor.nominal + self.sensor.biases)

    def jacobian(self, A: Array, rows: Indices) -> Array:
        """Compute ∂y/∂θ for A → exp([θ×]) A; (n, 4, 3)."""
        C = self._compute_cone(A, rows)
        eta = _compute_limb(C)[..., None]
        pole = np.array([0.0, 0.0, 1.0])
        e = np.sin(eta) * QUADRANT_DIRECTIONS + np.cos(eta) * pole
        along = np.cos(eta) * QUADRANT_DIRECTIONS - np.sin(eta) * pole
        normal = e @ C  # C is symmetric
        return np.asarray(_compute_cross(e, normal) / (along * normal).sum(axis=-1, keepdims=True))

    def partials(self, A: Array, rows: Indices) -> Array:
        """Return ∂y/∂bias: unit matrices, (n, 4, 4)."""
        return np.tile(np.eye(4), (len(rows), 1, 1))

    def corrected(self, change: Array) -> EarthModel:
        """Return the model with its biases moved by change (4,), rad."""
        return replace(self, sensor=replace(self.sensor, biases=self.sensor.biases + change))

    def _compute_cone(self, A: Array, rows: Indices) -> Array:
        C = self.sensor.cone(self.position[rows])
        return np.asarray(A @ C @ np.swapaxes(A, -1, -2))


def _compute_cross(a: Array, b: Array) -> Array:
    """Compute a × b of two (..., 3); for a few vectors several times faster than `np.cross`."""
    x, y, z, u, v, w = *np.moveaxis(a, -1, 0), *np.moveaxis(b, -1, 0)
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


def _compute_limb(C: Array) -> Array:
    """Compute η of the four quadrants from the cone in the body; (n, 3, 3) → (n, 4)."""
    alpha = C[..., 2, 2][..., None]
    beta = C[..., 2, :] @ QUADRANT_DIRECTIONS.T
    gamma = np.einsum("qi,...ij,qj->...q", QUADRANT_DIRECTIONS, C, QUADRANT_DIRECTIONS)
    square = beta**2 - alpha * gamma
    root = np.sqrt(np.where(square < 0, np.nan, square))
    return np.asarray(np.arctan2(beta + root, -gamma))
