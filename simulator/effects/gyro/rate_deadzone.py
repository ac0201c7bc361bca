"""Small rates read zero: the noise-free reading is 0 where its absolute value is below size.

Stiction of a pivot, or lock-in of a laser gyro without dither. Acts before the white noise, which comes from the electronics
behind it and goes on.
"""

import numpy as np

from simulator.effects.base import AXIS_NAMES, Array, Effect, Setting, Stream, Surroundings, Value
from simulator.effects.common import DEG, index


class RateDeadzone(Effect):
    """See the module."""

    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        """Zero inside the zone."""
        axis = index(setting.axis)
        out = samples.copy()
        out[np.abs(samples[:, axis]) < setting.size * DEG, axis] = 0.0
        return out

    def draw(self, rng: np.random.Generator, around: Surroundings) -> tuple[str | None, dict[str, Value]]:
        """An axis whose rate is small most of the time, which that of the orbital motion is not."""
        usual = _compute_usual_rates(around)
        slow = [axis for axis, rate in zip(AXIS_NAMES, usual, strict=True) if rate <= 0.5 * usual.max()]
        return str(rng.choice(slow or AXIS_NAMES)), {}

    def draw_size(self, rng: np.random.Generator, around: Surroundings, axis: str | None) -> float:
        """About as wide as the rate is most of the time."""
        return float(np.rad2deg(_compute_usual_rates(around)[index(axis)]) * rng.uniform(0.5, 2.0))


def _compute_usual_rates(around: Surroundings) -> Array:
    """(3,) median of the absolute raw rates, rad/s."""
    return np.asarray(np.median(np.abs(around.stream.raw), axis=0))


EFFECT = RateDeadzone(
    name="rate_deadzone",
    summary="small rates read zero",
    says="{gyro} does not feel rates below {size}",
    unit="deg/s",
    stage="threshold",
    prior=(1e-5, 1.0),
    bounds=(0.0, 1e5),
    meaning="Rates smaller than this read zero.",
    symptom="dead_zone",
)
