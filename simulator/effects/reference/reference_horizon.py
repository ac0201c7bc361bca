"""Reference error about one body axis at twice orbit rate, as the horizon makes it.

Over an oblate Earth geodetic and geocentric nadir differ, and the radiance of the horizon depends on latitude.
"""

from simulator.effects.reference.harmonic import ReferenceHarmonic

EFFECT = ReferenceHarmonic(
    name="reference_horizon",
    summary="reference error at twice orbit rate",
    says="the reference attitude swings by ±{size} about {axis} twice an orbit",
    unit="deg",
    stage="reference",
    prior=(1e-5, 10.0),
    bounds=(-90.0, 90.0),
    order=2,
    meaning="The reference attitude errs sinusoidally twice an orbit, as Earth sensors do over an oblate Earth.",
)
