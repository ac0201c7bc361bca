"""Reference error about one body axis at orbit rate, from thermal bending between sensors and gyro or from the ephemeris."""

from simulator.effects.reference.harmonic import ReferenceHarmonic

EFFECT = ReferenceHarmonic(
    name="reference_orbital",
    summary="reference error sinusoidal at orbit rate",
    says="the reference attitude swings by ±{size} about {axis} once an orbit",
    unit="deg",
    stage="reference",
    prior=(1e-5, 10.0),
    bounds=(-90.0, 90.0),
    meaning="The reference attitude errs sinusoidally once an orbit.",
)
