"""Penetration angles that refer to another nadir than the model's: part of the Earth's flattening is missing in them.

The model of M0 takes the oblate horizon. Where the angles come from a source that has taken the oblateness out already, or from
a processing for a sphere, geocentric nadir and not the near geodetic one is what they point to: the sensor seems to see an
ellipsoid of flattening f (1 − size). A size of 1 is a sphere of the equatorial radius, of −1 twice the flattening.

What that adds is found here by another way than that of `simulator.sensors.horizon`. The lines of sight e that touch an
ellipsoid |D x| = 1 from r form the cone eᵀ C e = 0, C = (D² r)(D² r)ᵀ − (rᵀ D² r − 1) D². In the scan plane of a quadrant,
spanned by the body's z and s, e = z cos η + s sin η, so that with α = zᵀ C z, β = sᵀ C z, γ = sᵀ C s

    (α + γ) + (α − γ) cos 2η + 2 β sin 2η = 0,    2η = ψ ± arccos(−(α + γ)/ρ),    ρ e^{iψ} = (α − γ) + 2 i β

of which the limb is the root nearest to the nominal angle.
"""

from dataclasses import dataclass, replace

import numpy as np

from gyrocal.arrays import Array
from simulator.effects.base import Parameters, Setting
from simulator.effects.sensor.base import EARTH_SENSOR, SensorEffect, Sightings
from simulator.sensors.horizon import AZIMUTHS, Horizon
from simulator.sensors.suite import SensorSuite


@dataclass(frozen=True)
class FlattenedHorizon(Horizon):
    """A horizon with another flattening."""

    missing: float = 0.0  # part of the flattening that is missing

    @property
    def semi_axes(self) -> tuple[float, float]:
        """Equatorial and polar semi-axis, m."""
        a, c = super().semi_axes
        return a, c + self.missing * (a - c)


class _EsaNadir(SensorEffect):
    def fitted(self, suite: SensorSuite, setting: Setting) -> SensorSuite:
        original = suite.earth.horizon
        horizon = FlattenedHorizon(co2_height=original.co2_height, altitude=original.altitude, missing=setting.size)
        return replace(suite, earth=replace(suite.earth, horizon=horizon))

    def error(self, sightings: Sightings, axis: str | None, amplitudes: Array, parameters: Parameters) -> tuple[Array, Array]:
        sun, _ = sightings.nothing
        original = Horizon()
        changed = FlattenedHorizon(missing=float(amplitudes[0]))
        return sun, _compute_limbs(sightings, *changed.semi_axes, original.nominal) - _compute_limbs(
            sightings, *original.semi_axes, original.nominal
        )


def _compute_limbs(sightings: Sightings, a: float, c: float, nominal: float) -> Array:
    """Compute η (m, 4) of the quadrants' limbs, rad."""
    squares = 1 / np.array([a, a, c]) ** 2
    scaled = sightings.position * squares
    beyond = (sightings.position * scaled).sum(axis=1) - 1
    cone = scaled[:, :, None] * scaled[:, None, :] - beyond[:, None, None] * np.diag(squares)
    in_body = sightings.A @ cone @ np.swapaxes(sightings.A, 1, 2)
    sides = np.stack([np.cos(AZIMUTHS), np.sin(AZIMUTHS), np.zeros(4)])
    alpha, beta = in_body[:, 2, 2, None], in_body[:, 2] @ sides
    gamma = np.einsum("iq,mij,jq->mq", sides, in_body, sides)
    middle = np.arctan2(2 * beta, alpha - gamma)
    half = np.arccos(-(alpha + gamma) / np.hypot(alpha - gamma, 2 * beta))
    roots = np.stack([(middle + half) / 2, (middle - half) / 2])
    roots = nominal + (roots - nominal + np.pi / 2) % np.pi - np.pi / 2  # lines, not rays
    return np.asarray(np.where(np.abs(roots[0] - nominal) < np.abs(roots[1] - nominal), *roots))


EFFECT = _EsaNadir(
    name="esa_nadir",
    summary="part of the Earth's flattening is missing in the penetration angles",
    says="the Earth sensor takes the Earth for rounder than it is, by {number} of its flattening",
    unit="flattenings",
    stage="sensor",
    prior=(0.01, 2.0),
    bounds=(-5.0, 5.0),
    axes=(),
    acts_on=EARTH_SENSOR,
    meaning="The penetration angles miss part of the Earth's flattening, as if they pointed to geocentric nadir.",
)
