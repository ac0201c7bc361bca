"""Reference errors that are sinusoidal in time: e = size · sin(2π t/P + φ) about one body axis, t since the epoch.

reference_orbital
    At orbit rate, from thermal bending between sensors and gyro or from the ephemeris.
reference_horizon
    At twice orbit rate: over an oblate Earth geodetic and geocentric nadir differ, and the radiance of the horizon depends on
    latitude.
reference_periodic
    With a period of its own, such as a sensor that bends as its heater switches, or an error that repeats as a star field or a
    scan does. It is carried by the reference attitudes and not by the rates.
"""

from simulator.effects.base import Array, Parameters, References
from simulator.effects.common import DEG, put_on_axis
from simulator.effects.periodic import Periodic, Sinusoid


class _ReferenceSinusoid(Sinusoid):
    def reference_columns(self, references: References, axis: str | None, parameters: Parameters) -> Array:
        return put_on_axis(self.build_waves(references.t_s, references.orbit_period_s, parameters) * DEG, axis)


class _ReferencePeriodic(Periodic, _ReferenceSinusoid):
    pass


EFFECTS = [
    _ReferenceSinusoid(
        name="reference_orbital",
        summary="reference error sinusoidal at orbit rate",
        says="the reference attitude swings by ±{size} about {axis} once an orbit",
        unit="deg",
        stage="reference",
        prior=(1e-5, 10.0),
        bounds=(-90.0, 90.0),
        meaning="The reference attitude errs sinusoidally once an orbit.",
    ),
    _ReferenceSinusoid(
        name="reference_horizon",
        summary="reference error at twice orbit rate",
        says="the reference attitude swings by ±{size} about {axis} twice an orbit",
        unit="deg",
        stage="reference",
        prior=(1e-5, 10.0),
        bounds=(-90.0, 90.0),
        order=2,
        meaning="The reference attitude errs sinusoidally twice an orbit, as Earth sensors do over an oblate Earth.",
    ),
    _ReferencePeriodic(
        name="reference_periodic",
        summary="reference error swings with a period of its own",
        says="the reference attitude swings by ±{size} about {axis} with a period of its own",
        unit="deg",
        stage="reference",
        prior=(1e-5, 10.0),
        bounds=(-90.0, 90.0),
        meaning="The reference attitude errs sinusoidally, with a steady period that is not the orbit's.",
    ),
]
