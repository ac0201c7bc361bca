"""A gyro that dies: from time_s on it reads size, whatever the motion, and has no noise.

Its own samples show it: they are all the same to the end of the recording, while those of the other gyros differ. Three gyros
do not tell it from a dead zone in which the last samples lie; more than three leave no motion for it to hide in.
"""

from collections.abc import Sequence

import numpy as np

from simulator.effects.base import Array, Detection, Effect, SampleView, Setting, Stream
from simulator.effects.common import DEG, TIME_PARAMETER, number, select_axes

FEWEST_DEAD_SAMPLES = 30  # equal samples at the end; a coarse converter makes some


class GyroDead(Effect):
    """See the module."""

    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        """The reading of samples that begin at or after time_s."""
        late = stream.t_s - 0.5 * stream.duration_s >= number(setting.parameters, "time_s")
        out = samples.copy()
        for column in select_axes(setting.axis):
            out[late, column] = setting.size * DEG
        return out

    def detect(self, view: SampleView) -> Sequence[Detection]:
        """Gyros of more than three whose last samples are all the same, while half of those of every other gyro differ."""
        rates = view.rates[view.inside]
        if rates.shape[1] <= 3 or len(rates) < FEWEST_DEAD_SAMPLES:
            return ()
        last = np.array([_count_equal_at_end(x) for x in rates.T])
        out = []
        for column in np.flatnonzero(last >= FEWEST_DEAD_SAMPLES):
            others = [np.unique(x[-last[column] :]).size for k, x in enumerate(rates.T) if last[k] < FEWEST_DEAD_SAMPLES]
            if not others or min(others) < 0.5 * last[column]:
                continue
            time_s = float(view.t_s[view.inside][-last[column]] - 0.5 * view.sample_s)
            reading = float(np.rad2deg(rates[-1, column]))
            text = (
                f"gyro {view.gyros[column]} reads {reading:.4g} deg/s from {time_s:.1f} s to the end, whatever the others read"
            )
            out.append(
                Detection(self.name, view.gyros[column], reading, self.unit, 0.0, {"time_s": time_s}, 30.0, 1e-300, text)
            )
        return out


def _count_equal_at_end(x: Array) -> int:
    """Number of equal samples at the end."""
    differs = np.flatnonzero(x != x[-1])
    return int(x.size if not differs.size else x.size - 1 - differs[-1])


EFFECT = GyroDead(
    name="gyro_dead",
    summary="one of several gyros reads the same from one time on",
    says="{whose} readings stop at {size}",
    unit="deg/s",
    stage="telemetry",
    prior=(1e-6, 1.0),
    bounds=(-1e5, 1e5),
    parameters=(TIME_PARAMETER,),
    meaning="One gyro stops to follow the motion at one time and reads the same ever after.",
    of_arrays=True,
)
