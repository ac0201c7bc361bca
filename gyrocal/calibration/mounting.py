"""Mounting of the gyro in the body from G, by polar decomposition.

G = R S: S is symmetric and holds scale factors and non-orthogonality about the gyro's own axes, R rotates the gyro's axes to
those of the body that the references describe. A fixed rotation of the references' body axes multiplies G from the left, so
that it goes into R alone: no data of gyro and references separate it from a rotation of the gyro. A fixed rotation of the
inertial axes acts on every attitude alike and goes into no parameter.

To first order δG = [δφ×] R S + R δS. With M = Rᵀ δG and [ω×] = Rᵀ [δφ×] R,

    M − Mᵀ = [ω×] S + S [ω×] = [((tr S) I − S) ω ×],    δS = M − [ω×] S.

Source: Higham, Computing the Polar Decomposition, SIAM J. Sci. Stat. Comput. 7, 1986.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array
from gyrocal.attitude import cross_matrix
from gyrocal.calibration.parameters import AXIS_NAMES


@dataclass(frozen=True)
class Mounting:
    """G = R S with uncertainties."""

    R: Array  # (3, 3) from the gyro's axes to those of the body; orthogonal
    S: Array  # (3, 3) symmetric, dimensionless
    sigma_rotation: Array  # (3,) 1-sigma of a small rotation about each axis of the body, rad
    sigma_S: Array  # (3, 3) 1-sigma of S
    change: float  # rad, rotation from the mounting that the a-priori G states
    # axes of the body about which the motion does not determine the rotation to within the plausible range
    undetermined: tuple[str, ...]

    @property
    def is_mirrored(self) -> bool:
        """Whether R is a reflection: the gyro's axes are left-handed in the body."""
        return bool(np.linalg.det(self.R) < 0)

    @property
    def rotation(self) -> Array:
        """(3,) rotation vector of R, or of −R where it is a reflection, rad."""
        return np.asarray(Rotation.from_matrix(-self.R if self.is_mirrored else self.R).as_rotvec())

    @property
    def angle(self) -> float:
        """Angle of that rotation, rad."""
        return float(np.linalg.norm(self.rotation))

    def format_sentences(self) -> list[str]:
        """Describe the decomposition and its limits."""
        vector = ", ".join(f"{value:.4g}" for value in np.rad2deg(self.rotation))
        sigma = ", ".join(f"{value:.2g}" for value in np.rad2deg(self.sigma_rotation))
        scale = ", ".join(f"{self.S[i, i]:.5f} ± {self.sigma_S[i, i]:.1g}" for i in range(3))
        skew = ", ".join(
            f"{AXIS_NAMES[i]}{AXIS_NAMES[j]} {np.rad2deg(self.S[i, j]):.3g} ± {np.rad2deg(self.sigma_S[i, j]):.1g}"
            for i, j in ((0, 1), (0, 2), (1, 2))
        )
        lines = [
            f"Mounting, from G = R S: R rotates the gyro's axes to those of the body by {np.rad2deg(self.angle):.3g} deg "
            f"(rotation vector {vector} deg, 1-sigma {sigma} deg about the axes x, y, z of the body).",
            f"S holds the scale factors {scale} and the non-orthogonality {skew} deg. It does not depend on the mounting.",
            "A rotation between the references' body axes and the body cannot be separated from a rotation of the gyro: both "
            "act as G and are in R.",
        ]
        if self.undetermined:
            lines.append(f"The motion does not determine the rotation about {', '.join(self.undetermined)}.")
        if self.is_mirrored:
            lines.append("The gyro's axes are left-handed in the body: one of them has the other sign.")
        return lines

    def to_json(self) -> dict[str, object]:
        """Convert to plain values, angles in degrees."""
        return {
            "rotation_vector_deg": np.rad2deg(self.rotation).tolist(),
            "sigma_rotation_deg": np.rad2deg(self.sigma_rotation).tolist(),
            "angle_deg": float(np.rad2deg(self.angle)),
            "change_from_apriori_deg": float(np.rad2deg(self.change)),
            "R": self.R.tolist(),
            "S": self.S.tolist(),
            "sigma_S": self.sigma_S.tolist(),
            "mirrored": self.is_mirrored,
            "undetermined_axes": list(self.undetermined),
            "sentences": self.format_sentences(),
        }


def compute_mounting(G: Array, covariance: Array, apriori_G: Array, plausible_G: float) -> Mounting:
    """Decompose G into mounting and scale.

    G: (3, 3) calibrated, not singular
    covariance: (9, 9) of G by rows
    apriori_G: (3, 3) that the calibration started from
    plausible_G: plausible range of an element of G; a rotation with a sigma beyond its 1/sqrt(2) is not determined, since
        its prior then has as much weight as the data
    """
    R, S = scipy.linalg.polar(G)
    to_rotation, to_S = _compute_jacobians(R, S)
    sigma = np.sqrt(np.diag(to_rotation @ covariance @ to_rotation.T))
    sigma_S = np.sqrt(np.diag(to_S @ covariance @ to_S.T)).reshape(3, 3)
    rotation = R @ scipy.linalg.polar(apriori_G)[0].T
    change = float(np.linalg.norm(Rotation.from_matrix(rotation).as_rotvec())) if np.linalg.det(rotation) > 0 else float(np.pi)
    undetermined = tuple(axis for axis, value in zip(AXIS_NAMES, sigma, strict=True) if value > plausible_G / np.sqrt(2))
    return Mounting(R, S, sigma, sigma_S, change, undetermined)


def _compute_jacobians(R: Array, S: Array) -> tuple[Array, Array]:
    """Compute ∂δφ/∂G (3, 9), about the axes of the body, and ∂S/∂G (9, 9), G and S by rows."""
    inverse = np.linalg.inv(np.trace(S) * np.eye(3) - S)
    sign = np.sign(np.linalg.det(R))  # R [ω×] Rᵀ = det(R) [(R ω)×]: R of a left-handed triad of gyros is improper
    rotation, scale = np.zeros((3, 9)), np.zeros((9, 9))
    for k in range(9):
        change = np.zeros(9)
        change[k] = 1.0
        M = R.T @ change.reshape(3, 3)
        skew = M - M.T
        omega = inverse @ np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
        rotation[:, k] = sign * R @ omega
        scale[:, k] = (M - cross_matrix(omega) @ S).ravel()
    return rotation, scale
