"""Recordings of several gyros made of the small ones of three."""

from dataclasses import replace

import numpy as np

from gyrocal import GyroParameters, GyroStream, Recording
from tests.builders import piecewise_recording

TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
SKEWED = np.array([[1, 0, 0], [0, 1, 0], [0.1, 0, 0.995], [0.6, 0.64, 0.48], [0.0, 0.8, -0.6]])  # of no symmetry
ERRORS = 1e-3 * np.random.default_rng(3).standard_normal((6, 4)) * [1, 1, 1, 1e-3]  # of K, and of c in rad/s
ITSELF = GyroParameters(np.eye(3), np.zeros(3))  # three gyros that read the rate of the body


def array_recording(axes=TETRAHEDRON, arw=0.0, rng=None, gyros=None, **options):
    """A recording of gyros along some axes, and the true K and c, which differ from the nominal ones.

    With rng, both noises are drawn. `gyros` names those that are on in each interval; of the others it then holds NaN.
    """
    bare = piecewise_recording(truth=ITSELF, **options)
    K, c = axes + ERRORS[: len(axes), :3], ERRORS[: len(axes), 3]
    raw = bare.gyro.rates @ K.T + c
    attitudes = bare.attitudes
    if rng is not None:
        raw = raw + rng.normal(size=raw.shape) * arw / np.sqrt(bare.gyro.sample_s)
        attitudes = piecewise_recording(truth=ITSELF, rng=rng, **options).attitudes
    names = tuple(str(k + 1) for k in range(len(axes)))
    intervals = bare.intervals
    if gyros is not None:
        intervals = tuple(replace(one, gyros=chosen) for one, chosen in zip(intervals, gyros, strict=True))
        for one in intervals:
            off = [one.gyros is not None and name not in one.gyros for name in names]
            inside = (bare.gyro.t_s >= one.start_s) & (bare.gyro.t_s < one.stop_s)
            raw[np.ix_(inside, off)] = np.nan
    stream = GyroStream(bare.gyro.t_s, raw, bare.gyro.sample_s, arw, np.linalg.pinv(axes), np.zeros(3), names)
    return Recording("array", bare.epoch, stream, attitudes, intervals), K, c
