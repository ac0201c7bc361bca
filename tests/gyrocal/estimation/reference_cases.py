"""Two flights whose reference attitudes come from batches: intervals that share nothing, and a chain that shares batches."""

from dataclasses import dataclass

import numpy as np

from gyrocal import GyroParameters, GyroStream, Interval, Recording
from gyrocal.estimation.batch import BatchResult, Weighting
from gyrocal.estimation.reference_covariance import reference_attitudes
from tests.gyrocal.estimation.attitude_cases import ATTITUDE_CASE_ARW, RPO, build_timeline_flight, run_star_batch
from tests.gyrocal.estimation.flights import Flight

Rate = tuple[float, float, float]
Span = tuple[float, float, tuple[float, ...]]  # measured from, measured to, attitudes wanted at

REFERENCE_CASE_EPOCH = "2000-01-01T00:00:00Z"
COMPONENT_SIGMA = 5e-4  # of each component a sensor sees
SLEW_RATE = float(np.deg2rad(0.3))  # rad/s
FORWARD, BACKWARD, SIDEWAYS, STILL = (0.0, -RPO, 0.0), (0.0, RPO, 0.0), (RPO, 0.0, 0.0), (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class ReferenceCase:
    """Flights, batches along them and intervals."""

    name: str
    motions: tuple[Flight, ...]
    spans: tuple[tuple[int, Span], ...]
    intervals: tuple[Interval, ...]

    @property
    def arw(self) -> float:
        """Of the gyro, rad/sqrt(s)."""
        return self.motions[0].arw

    def draw(self, rng: np.random.Generator, weighting: Weighting = "plain") -> tuple[Recording, list[BatchResult]]:
        """A recording with noise, its references by batches with these weights; and the batches."""
        gyros = [motion.gyro(rng) for motion in self.motions]
        batches = [
            run_star_batch(self.motions[k], gyros[k], low, high, times, rng, COMPONENT_SIGMA, weighting)
            for k, (low, high, times) in self.spans
        ]
        t, rates = (np.concatenate([getattr(gyro, field) for gyro in gyros]) for field in ("t_s", "rates"))
        stream = GyroStream(t, rates, gyros[0].sample_s, self.arw)
        return Recording(self.name, REFERENCE_CASE_EPOCH, stream, reference_attitudes(batches), self.intervals), batches


def build_chain_case(truth: GyroParameters, arw: float = 0.2 * ATTITUDE_CASE_ARW) -> ReferenceCase:
    """Intervals that share batches; arw in rad/sqrt(s), small, or the gyro's noise hides what is shared."""
    rates = (FORWARD, BACKWARD, FORWARD, SIDEWAYS, BACKWARD, STILL, FORWARD)
    slews = (
        (0.0, 0.0, SLEW_RATE),
        (0.0, 0.0, -SLEW_RATE),
        (SLEW_RATE, 0.0, 0.0),
        (0.0, SLEW_RATE, 0.0),
        (0.0, -SLEW_RATE, 0.0),
        (-SLEW_RATE, 0.0, 0.0),
    )
    parts: list[tuple[Rate, float]] = []
    intervals: list[Interval] = []
    spans: list[tuple[int, Span]] = []
    clock = 0.0
    for k, rate in enumerate(rates):
        spans.append((0, (clock, clock + 900.0, (clock, clock + 900.0))))
        following = [(f"slew {k}", slews[k], 600.0)] if k < len(slews) else []
        for name, turn, length in [(f"arc {k}", rate, 900.0), *following]:
            parts.append((turn, length))
            intervals.append(Interval(name, "", clock, clock + length))
            clock += length
    motion = build_timeline_flight(parts, truth.G, arw=arw, bias=truth.bias)
    return ReferenceCase("chain", (motion,), tuple(spans), tuple(intervals))
