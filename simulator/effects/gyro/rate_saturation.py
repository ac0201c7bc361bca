"""Output clipped: samples beyond ±size read ±size. The range of the rebalance loop, the converter or the telemetry word."""

import numpy as np

from simulator.effects.base import AXIS_NAMES, Array, Effect, SampleTests, Setting, Smallest, Stream, Surroundings, Value
from simulator.effects.common import DEG, index


class RateSaturation(Effect):
    """See the module."""

    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        """Clipped at ±size."""
        axis, limit = index(setting.axis), setting.size * DEG
        out = samples.copy()
        out[:, axis] = np.clip(samples[:, axis], -limit, limit)
        return out

    def draw(self, rng: np.random.Generator, around: Surroundings) -> tuple[str | None, dict[str, Value]]:
        """The axis of the fastest turns."""
        return AXIS_NAMES[int(np.abs(around.stream.raw).max(axis=0).argmax())], {}

    def draw_size(self, rng: np.random.Generator, around: Surroundings, axis: str | None) -> float:
        """A limit that the fastest turns exceed."""
        fastest = float(np.rad2deg(np.abs(around.stream.raw[:, index(axis)]).max()))
        return fastest * float(rng.uniform(0.6, 0.95))

    def smallest(self, around: Surroundings, tests: SampleTests) -> list[Smallest]:
        """A limit that enough samples exceed."""
        largest = np.sort(np.abs(around.stream.raw), axis=0)[-tests.fewest_clipped]
        return [
            Smallest(axis, float(np.rad2deg(limit)), "limits up to this are seen")
            for axis, limit in zip(AXIS_NAMES, largest, strict=True)
        ]


EFFECT = RateSaturation(
    name="rate_saturation",
    summary="output clipped",
    says="{gyro} cuts off rates above {size}",
    unit="deg/s",
    stage="range",
    prior=(1e-2, 3e3),
    bounds=(1e-9, 1e5),
    meaning="Rates larger than this are cut off.",
    symptom="plateau",
)
