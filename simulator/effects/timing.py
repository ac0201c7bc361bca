"""The noise-free reading as a function of time, for effects on its timing.

Samples are means, so their sums are the exact cumulative angle Θ at the samples' edges. A cubic spline through Θ (not-a-knot)
is the reading between; before the first edge and after the last it goes on at constant rate (intervals start and end in
constant-rate modes). The derivative of a sample's mean is then that of the
spline's slope, [Θ'(t + Δ) − Θ'(t)]/Δ.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from simulator.effects.base import Array, Stream
from simulator.effects.common import list_runs

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

FEWEST_CUBIC_SAMPLES = 3  # samples that fix a cubic by themselves; with less, the first and the last mean rate are the slopes


def compute_edges(duration_s: Array) -> Array:
    """Compute the time of the samples' edges from the first, s; (n,) → (n + 1,)."""
    return np.append(0.0, np.cumsum(duration_s))


def build_angle_spline(rates: Array, duration_s: Array) -> CubicSpline:
    """Build Θ as a spline over `compute_edges`, of (n, 3) rad/s and (n,) s."""
    from scipy.interpolate import CubicSpline  # late: a calibration loads all effects and needs no spline

    angle = np.vstack([np.zeros(3), np.cumsum(rates * duration_s[:, None], axis=0)])
    is_short = len(rates) < FEWEST_CUBIC_SAMPLES
    return CubicSpline(compute_edges(duration_s), angle, bc_type=((1, rates[0]), (1, rates[-1])) if is_short else "not-a-knot")


def extend_spline(spline: CubicSpline, t: Array) -> Array:
    """Evaluate Θ(t) with constant rate outside of the spline's range; (n,) → (n, 3)."""
    inside = np.clip(t, spline.x[0], spline.x[-1])
    return np.asarray(spline(inside) + (t - inside)[:, None] * spline(inside, 1))


def delay_rates(raw: Array, stream: Stream, delay_s: Array) -> Array:
    """Read noise-free samples (n, 3), rad/s, at [t − delay, t − delay + Δ) in place of [t, t + Δ); delays (n,) in s."""
    out = raw.copy()
    for part in list_runs(stream.t_s, stream.duration_s, stream.intervals):
        duration, delay = stream.duration_s[part], delay_s[part]
        spline, tags = build_angle_spline(raw[part], duration), compute_edges(duration)
        angle = extend_spline(spline, tags[1:] - delay) - extend_spline(spline, tags[:-1] - delay)
        out[part] = angle / duration[:, None]
    return out


def compute_delay_columns(stream: Stream) -> Array:
    """Change of the raw reading per second of a short delay, −dω_raw/dt, on all axes; (n, 3, 1) rad/s per s."""
    out = np.zeros((len(stream.t_s), 3, 1))
    for part in list_runs(stream.t_s, stream.duration_s, stream.intervals):
        duration = stream.duration_s[part]
        slope = build_angle_spline(stream.raw[part], duration)(compute_edges(duration), 1)
        out[part, :, 0] = -np.diff(slope, axis=0) / duration[:, None]
    return out
