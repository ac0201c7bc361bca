"""Digital sun sensor as an estimator sees it: counts to angles to a direction in the body, and the sensitivities.

    α = atan[a₁ + a₂ N + a₃ sin(a₄ N + a₅) + a₆ sin(a₇ N + a₈)] + a₉                                   R (5), β likewise
    O = (tan α, tan β, 1) / sqrt(tan² α + tan² β + 1)                                                  R (4)
    O_body = N M O                                                                                     R (1)

N is the nominal alignment, sensor to body, and M takes the true sensor frame to the nominal one. A measurement is the pair
(α, β). With an attitude A and the Sun's inertial direction r,

    O = Mᵀ Nᵀ A r,    α = atan(O_x / O_z),    β = atan(O_y / O_z)

    dα = (O_z dO_x − O_x dO_z) / (O_x² + O_z²),    dβ = (O_z dO_y − O_y dO_z) / (O_y² + O_z²)

With A → exp([θ×]) A and M → exp([m×]) M,

    dO = Mᵀ Nᵀ (θ × A r) − Mᵀ (m × Nᵀ A r)

m are angles about the axes of the nominal sensor frame, so that M ≈ I + [m×] near the identity. A turn θ of the body and
m = Nᵀ θ of the sensor cancel: turning all sensors together cannot be separated from an attitude error.

Both heads are taken to be at right angles, as the software of the mission took them; see `gyrocal.sensors.head_compensation`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from gyrocal.arrays import Array, Indices, Mask
from gyrocal.attitude import cross_matrix, rotation_matrix
from gyrocal.errors import InputError
from gyrocal.sensors.series import SensorSeries

# R publishes the form of (5) and no coefficients. These are made up: 14-bit counts with the boresight at their middle,
# 0.0083° a count there, sines of 0.02° and 0.01°.
ALPHA_COEFFICIENTS = (-1.1918, 1.4549e-4, 3.5e-4, 1.5340e-3, 0.40, 1.7e-4, 6.1359e-3, 1.10, 2.6e-4)
BETA_COEFFICIENTS = (-1.1925, 1.4556e-4, 3.1e-4, 1.5340e-3, 2.30, 2.0e-4, 6.1359e-3, 0.20, -1.9e-4)
HEAD_HALF_FOV = float(np.deg2rad(48.0))  # R: 96° about a head's boresight
BORESIGHT_TILT = float(np.deg2rad(20.0))  # of the boresights, not published
SUN_ANGLE_SIGMA = float(np.deg2rad(0.0056))  # 0.005° of noise (not published) and 0.0083°/sqrt(12) of quantisation


@dataclass(frozen=True)
class SunSensor:
    """Digital sun sensor; an `InputError` if a matrix is no rotation, or a shape or number cannot be used.

    Attributes
    ----------
    name : of the sensor
    alignment : (3, 3) N, nominal sensor to body
    misalignment : (3, 3) M, true sensor frame to nominal
    coefficients_alpha, coefficients_beta : (9,) a and b of R (5), a₅, a₈, a₉ and their like in rad
    half_fov : largest angle of either head, rad
    sigma : 1-sigma of each angle, rad
    """

    name: str
    alignment: Array
    misalignment: Array = field(default_factory=lambda: np.eye(3))
    coefficients_alpha: Array = field(default_factory=lambda: np.array(ALPHA_COEFFICIENTS))
    coefficients_beta: Array = field(default_factory=lambda: np.array(BETA_COEFFICIENTS))
    half_fov: float = HEAD_HALF_FOV
    sigma: float = SUN_ANGLE_SIGMA

    def __post_init__(self) -> None:
        shapes = {"alignment": (3, 3), "misalignment": (3, 3), "coefficients_alpha": (9,), "coefficients_beta": (9,)}
        for name, shape in shapes.items():
            value = np.asarray(getattr(self, name), dtype=float)
            if value.shape != shape or not np.isfinite(value).all():
                raise InputError(f"{self.name}: {name} must be {shape} finite numbers")
            object.__setattr__(self, name, value)
        for name in ("alignment", "misalignment"):
            value = getattr(self, name)
            # A published matrix is rounded, R (3) to 1e-6.
            if np.abs(value @ value.T - np.eye(3)).max() > 1e-5 or np.linalg.det(value) < 0:
                raise InputError(f"{self.name}: {name} must be a rotation matrix")
        if not 0 < self.half_fov < np.pi / 2 or not 0 < self.sigma < np.inf:
            raise InputError(f"{self.name}: half_fov must be below a quarter turn, sigma positive and finite")

    def angles(self, counts: npt.ArrayLike) -> Array:
        """Convert counts (n, 2) to (α, β) by R (5), rad; (n, 2)."""
        N = np.asarray(counts, dtype=float)
        alpha, beta = self.coefficients_alpha, self.coefficients_beta
        return np.stack([_evaluate_transfer(N[..., 0], alpha), _evaluate_transfer(N[..., 1], beta)], axis=-1)

    def in_view(self, angles: Array) -> Mask:
        """Tell (n,) whether both angles (n, 2) are within the field of view."""
        return np.asarray((np.abs(angles) <= self.half_fov).all(axis=-1))

    def series(self, t: Array, counts: npt.ArrayLike, sun: Array, visible: Mask | None = None) -> SensorSeries:
        """Build the measurements that an estimator takes.

        Parameters
        ----------
        t : (n,) s, ascending
        counts : (n, 2)
        sun : (n, 3) unit vectors to the Sun, inertial
        visible : (n,) whether the counts mean anything; all by default
        """
        angles = self.angles(counts)
        usable = self.in_view(angles) if visible is None else self.in_view(angles) & visible
        sigma = np.where(usable[:, None], self.sigma, np.inf) * np.ones(2)
        return SensorSeries(SunModel(self, sun), t, angles, sigma)


def _evaluate_transfer(N: Array, k: Array) -> Array:
    bracket = k[0] + k[1] * N + k[2] * np.sin(k[3] * N + k[4]) + k[5] * np.sin(k[6] * N + k[7])
    return np.asarray(np.arctan(bracket) + k[8])


def compute_angles(observed: Array) -> Array:
    """Compute (α, β) (n, 2) rad of directions O (n, 3) in the sensor frame, O_z > 0; the inverse of R (4)."""
    x, y, z = observed[..., 0], observed[..., 1], observed[..., 2]
    return np.stack([np.arctan2(x, z), np.arctan2(y, z)], axis=-1)


@dataclass(frozen=True)
class SunModel:
    """`gyrocal.sensors.series.SensorModel` of a sun sensor: y = (α, β), parameters the angles m of its misalignment.

    Attributes
    ----------
    sensor : the sensor
    sun : (rows, 3) unit vectors to the Sun, inertial, a row for each measurement of the series
    """

    sensor: SunSensor
    sun: Array
    size = 2
    parameters = ("m_x", "m_y", "m_z")

    @property
    def name(self) -> str:
        """Name of the sensor."""
        return self.sensor.name

    def predict(self, A: Array, rows: Indices) -> Array:
        """Predict (α, β) at attitudes A (n, 3, 3), rad; (n, 2)."""
        return compute_angles(self._compute_nominal(A, rows) @ self.sensor.misalignment)

    def jacobian(self, A: Array, rows: Indices) -> Array:
        """Compute ∂(α, β)/∂θ; (n, 2, 3)."""
        to_sensor = (self.sensor.alignment @ self.sensor.misalignment).T
        body = np.einsum("nij,nj->ni", A, self.sun[rows])
        return self._compute_angle_rates(body @ to_sensor.T) @ (to_sensor @ -cross_matrix(body))

    def partials(self, A: Array, rows: Indices) -> Array:
        """Compute ∂(α, β)/∂m; (n, 2, 3)."""
        M, nominal = self.sensor.misalignment, self._compute_nominal(A, rows)
        return self._compute_angle_rates(nominal @ M) @ (M.T @ cross_matrix(nominal))

    def corrected(self, change: Array) -> SunModel:
        """Return the model with M → exp([m×]) M, change m (3,) rad."""
        return replace(self, sensor=replace(self.sensor, misalignment=rotation_matrix(change) @ self.sensor.misalignment))

    def _compute_nominal(self, A: Array, rows: Indices) -> Array:
        """Compute Nᵀ A r (n, 3), the Sun in the nominal sensor frame."""
        return np.asarray(np.einsum("nij,nj->ni", A, self.sun[rows]) @ self.sensor.alignment)

    @staticmethod
    def _compute_angle_rates(observed: Array) -> Array:
        """Compute ∂(α, β)/∂O; (n, 2, 3)."""
        x, y, z = observed.T
        out = np.zeros((len(observed), 2, 3))
        out[:, 0, 0], out[:, 0, 2] = z / (x * x + z * z), -x / (x * x + z * z)
        out[:, 1, 1], out[:, 1, 2] = z / (y * y + z * z), -y / (y * y + z * z)
        return out


def trmm_sun_sensors(tilt: float = BORESIGHT_TILT, elevation: float = 0.0) -> tuple[SunSensor, SunSensor]:
    """Build TRMM's two sensors without misalignment; sensor and body axes as follows.

    The boresight z lies in the body's XY plane, `tilt` rad from +X (DSS-1) or −X (DSS-2) toward −Y, where the Sun is kept. y
    lies in that plane too, toward −Y, and x along +Z (DSS-1) or −Z (DSS-2). So α = 0 when the Sun crosses the XY plane, the
    moment of the yaw update, and there β is yaw: ∂β/∂θ_z = −1 (DSS-1) or +1 (DSS-2). With an elevation of the boresight
    from the plane toward +Z, y stays and the Sun crosses at tan α = −tan(elevation) (DSS-1) or +tan(elevation) (DSS-2). R
    publishes neither angle.
    """
    sensors = []
    for name, sign in (("DSS-1", 1.0), ("DSS-2", -1.0)):
        forward, up = np.array([sign * np.cos(tilt), -np.sin(tilt), 0.0]), np.array([0.0, 0.0, 1.0])
        z = np.cos(elevation) * forward + np.sin(elevation) * up
        y = sign * np.cross(forward, up)
        sensors.append(SunSensor(name, np.column_stack([np.cross(y, z), y, z])))
    return sensors[0], sensors[1]
