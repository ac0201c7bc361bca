"""First-order lag of the gyro's output: τ y' = x − y, with y the reading, x the noise-free rate and τ = size.

Between two edges of the samples x is a quadratic (`simulator.effects.timing`), for which the solution is exact:

    y = y_p + (y₀ − y_p(0)) e^{−u/τ},    y_p = x − τ x' + τ² x''

and since y = x − τ y', a sample shows mean(x) − τ [y(Δ) − y(0)]/Δ. Each interval starts with y = x. For small τ a lag
acts like a delay of τ, so that its column is −dω_raw/dt. The attitude alone cannot separate a lag from a delay.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Parameters, Setting, Stream
from simulator.effects.common import list_runs, recursion
from simulator.effects.timing import build_angle_spline, compute_delay_columns


def apply_lag(rates: Array, duration_s: Array, tau: float) -> Array:
    """Mean lagged rates of a run of samples, (n, 3) rad/s."""
    a, b, c, _ = build_angle_spline(rates, duration_s).c  # Θ = a u³ + b u² + c u + …
    u = duration_s[:, None]
    initial = c[0]
    particular_start = c - tau * 2 * b + tau**2 * 6 * a
    particular_end = 3 * a * u**2 + 2 * b * u + c - tau * (6 * a * u + 2 * b) + tau**2 * 6 * a
    decay = np.exp(-duration_s / tau)
    out = np.empty_like(rates)
    for axis in range(3):
        # The output at the edges obeys y_{k+1} = decay_k y_k + last_k − decay_k first_k.
        drive = np.append(initial[axis], particular_end[:, axis] - decay * particular_start[:, axis])
        y = recursion(np.append(0.0, decay), drive)
        out[:, axis] = rates[:, axis] - tau * np.diff(y) / duration_s
    return out


class _RateLag(Effect):
    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        return compute_delay_columns(stream)

    def retimed(self, raw: Array, stream: Stream, setting: Setting) -> Array:
        out = raw.copy()
        if setting.size > 0:
            for part in list_runs(stream.t_s, stream.duration_s, stream.intervals):
                out[part] = apply_lag(raw[part], stream.duration_s[part], setting.size)
        return out


EFFECT = _RateLag(
    name="rate_lag",
    summary="first-order lag of the gyro output",
    says="the gyro's readings trail the motion by {size}",
    unit="s",
    stage="filter",
    prior=(1e-4, 10.0),
    bounds=(0.0, 1e4),
    axes=(),
    meaning="The gyro's output trails the rate, as behind a low-pass filter with this time constant.",
    sign="positive",
)
