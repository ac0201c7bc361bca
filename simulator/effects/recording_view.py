"""A recording as the effects see it: its samples and its references.

Sample tags, durations and intervals are those of the recording; a sample belongs to the interval that it starts in. The
noise-free rates are not known, the smoothed adjusted ones G ω_raw + b stand in for them.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gyrocal.recording import Recording, find_reference_rows
from gyrocal.smoothing import estimate_sample_sigma, smooth_run
from simulator.effects.base import Array, References
from simulator.effects.common import list_runs
from simulator.effects.flight_mode import find_flight_directions

SMOOTH_S = np.inf  # s, longest window of the smoothing: as long as the motion allows
TIME_TOLERANCE = 1e-6  # s
FILLER = 1e15  # housekeeping as large as this is no measurement


def find_interval_slices(recording: Recording) -> tuple[slice, ...]:
    """Find the samples that start in each interval."""
    t_s, half = recording.gyro.t_s, 0.5 * recording.gyro.sample_s
    edges = []
    for interval in recording.intervals:
        low, high = np.searchsorted(t_s, [interval.start_s - half, interval.stop_s - TIME_TOLERANCE])
        edges.append((int(low), int(high)))
    ordered = sorted(range(len(edges)), key=lambda k: recording.intervals[k].start_s)
    for first, second in pairwise(ordered):
        edges[second] = (max(edges[second][0], edges[first][1]), edges[second][1])
    return tuple(slice(low, max(low, high)) for low, high in edges)


def compute_durations(recording: Recording) -> Array:
    """Compute the duration of each sample, s: the stated one, cut where its interval stops; (n,)."""
    gyro = recording.gyro
    out = np.full(len(gyro.t_s), gyro.sample_s)
    for part, interval in zip(find_interval_slices(recording), recording.intervals, strict=True):
        out[part] = np.minimum(out[part], interval.stop_s - gyro.t_s[part])
    return out


def smooth_rates(recording: Recording, G: Array, bias: Array, smooth_s: float = SMOOTH_S) -> Array:
    """Smooth the adjusted rates G ω_raw + b of a recording, (n, 3) rad/s; unchanged outside the intervals."""
    gyro, duration = recording.gyro, compute_durations(recording)
    adjusted = gyro.rates @ G.T + bias
    sigma = gyro.arw / np.sqrt(gyro.sample_s)
    out = adjusted.copy()
    for part in list_runs(gyro.t_s + 0.5 * duration, duration, find_interval_slices(recording)):
        out[part] = smooth_run(adjusted[part], gyro.sample_s, smooth_s, estimate_sample_sigma(adjusted[part], sigma))
    return out


def extract_references(recording: Recording) -> References:
    """Extract the reference attitudes of a recording as an effect on them sees them, row by row."""
    attitudes, interval = recording.attitudes, _find_intervals(recording)
    forward, heading = find_flight_directions(recording)
    return References(attitudes.t_s, attitudes.quaternions, interval, forward, read_period(recording), heading)


def read_period(recording: Recording) -> float:
    """Read the orbit's period, s; NaN if it is not stated."""
    return float("nan") if recording.orbit is None else recording.orbit.period_s


def _find_intervals(recording: Recording) -> NDArray[np.intp]:
    """Find the interval of each reference; one that two intervals share belongs to the first."""
    out = np.full(len(recording.attitudes.t_s), -1, dtype=np.intp)
    for number, interval in enumerate(recording.intervals):
        rows = find_reference_rows(recording.attitudes.t_s, interval)
        out[rows[out[rows] < 0]] = number
    return out


def interpolate_housekeeping(recording: Recording, t_s: Array) -> dict[str, Array]:
    """Interpolate numeric housekeeping columns at some times, linearly between rows in order of time; (n,) each.

    Missing values, and fillers in their place, are left out.
    """
    out: dict[str, Array] = {}
    table = recording.tables.get("housekeeping")
    if table is None:
        return out
    tags = table["t_s"].to_numpy(dtype=float)
    order = np.argsort(tags, kind="stable")
    for name in table.columns:
        if name != "t_s" and table[name].dtype.kind in "biuf":
            values = table[name].to_numpy(dtype=float)[order]
            good = np.abs(values) < FILLER
            if good.any():
                out[str(name)] = np.interp(t_s, tags[order][good], values[good])
    return out
