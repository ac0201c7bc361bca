"""Reference error that swings with a period of its own: e = size · sin(2π t/P + φ) about one body axis, t since the epoch.

Such as a sensor that bends as its heater switches, or an error that repeats as a star field or a scan does. It is carried by
the reference attitudes and not by the rates. What swings with the orbit is `reference_orbital` and `reference_horizon`.
"""

from simulator.effects.base import Array, Parameters, References
from simulator.effects.common import DEG, harmonic, number, put_on_axis
from simulator.effects.periodic import Periodic


class ReferencePeriodic(Periodic):
    """See the module."""

    def reference_columns(self, references: References, axis: str | None, parameters: Parameters) -> Array:
        """Sine and cosine, as degrees."""
        return put_on_axis(harmonic(references.t_s, number(parameters, "period_s")) * DEG, axis)


EFFECT = ReferencePeriodic(
    name="reference_periodic",
    summary="reference error swings with a period of its own",
    says="the reference attitude swings by ±{size} about {axis} with a period of its own",
    unit="deg",
    stage="reference",
    prior=(1e-5, 10.0),
    bounds=(-90.0, 90.0),
    meaning="The reference attitude errs sinusoidally, with a steady period that is not the orbit's.",
)
