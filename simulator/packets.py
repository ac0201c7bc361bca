"""Telemetry of accumulated angles: each gyro adds up what it turns, in counts, and packets hold the register at their time.

    N(t) = ⌊φ(t)/q⌋ mod w,    φ(t) = φ₀ + ∫ ω_raw dt

with the size of a count q, its least significant bit, and w counts after which the register wraps. n samples of a recording
that follow one another make n + 1 packets, one at each start and one at the last end. Differences of counts, wraps undone,
times q over the time between are mean rates again, as long as less than half a register is turned between two packets. A
difference is wrong by less than a count, and the errors do not add up: of an angle turned, the first and the last reading
alone are. The rate has the spectrum of `noise_angle_white` with q/√12, not that of `rate_quantization`.

Between stretches of samples nothing is recorded while the register goes on, so that each begins anywhere. Neither N nor R
says what TRMM's count and register were.
"""

import numpy as np
import pandas as pd

from gyrocal.errors import InputError
from gyrocal.recording import Recording
from simulator.effects.recording_view import TIME_TOLERANCE, compute_durations

MOST_COUNTS = 2**52  # what a register may hold for its counts to be exact as floating-point numbers


def simulate_packets(recording: Recording, lsb: float, wrap: int, rng: np.random.Generator) -> pd.DataFrame:
    """The packets of a recording.

    Parameters
    ----------
    recording : with the rates as the gyros put them out, noise included
    lsb : q, rad
    wrap : w, counts
    rng : of where the registers stand when a stretch begins

    Returns
    -------
    t_s, and count_NAME of each gyro, whole numbers from 0 to w − 1

    Raises
    ------
    InputError
        The size of a count or the register is none, or a gyro turns half a register between two packets.
    """
    if not (np.isfinite(lsb) and lsb > 0):
        raise InputError(f"packets: the size of a count must be positive, not {lsb:g} rad")
    if not 2 <= wrap <= MOST_COUNTS:
        raise InputError(f"packets: the register wraps after {wrap} counts; it must be 2 to 2^52")
    gyro, lasts = recording.gyro, compute_durations(recording)
    angles = gyro.rates * lasts[:, None] / lsb  # counts
    fastest = float(np.abs(angles).max())
    if not fastest + 1 < wrap / 2:
        raise InputError(
            f"packets: a gyro turns {fastest:.6g} counts between two packets, and less than half of {wrap} can be told from "
            "a wrap; take larger counts or a longer register"
        )
    starts = np.flatnonzero(np.diff(gyro.t_s, prepend=-np.inf) > np.append(0.0, lasts[:-1]) + TIME_TOLERANCE)
    parts = []
    for first, last in zip(starts, [*starts[1:], len(gyro.t_s)], strict=True):
        begin = wrap * rng.random(size=(len(gyro.names),))
        counts = np.floor(begin + np.vstack([np.zeros(len(begin)), np.cumsum(angles[first:last], axis=0)]))
        times = np.append(gyro.t_s[first:last], gyro.t_s[last - 1] + lasts[last - 1])
        parts.append(np.column_stack([times, np.mod(counts, wrap)]))
    names = [f"count_{name}" for name in gyro.names]
    return pd.DataFrame(np.concatenate(parts), columns=["t_s", *names]).astype(dict.fromkeys(names, np.int64))
