"""A simulated MEMS log beside motion capture, as the files that imports read."""

import numpy as np
import pandas as pd

import gyrocal
from studies.validation import mems_log

EPOCH = "2023-11-14T22:13:20.123Z"
OPTIONS = ("--time", "time:iso", "--gyro", "gx,gy,gz:deg/s")


def write_gyro(log, path):
    """The gyro's table with dates; `OPTIONS` read it."""
    time = pd.to_datetime(log.gyro["timestamp_ms"], unit="ms").dt.strftime("%Y-%m-%dT%H:%M:%S.%f")
    log.gyro.assign(time=time).to_csv(path, index=False)
    return str(path)


def references(log, **noise):
    """A recording of the attitudes alone, for an export."""
    q = np.roll(log.attitude[["qw", "qx", "qy", "qz"]].to_numpy(), -1, axis=1)
    t = (log.attitude["timestamp_ms"] - mems_log.UNIX_MS).to_numpy() / 1000
    given = {"sigma": 1e-3, "arw": 1e-6} | noise
    return gyrocal.Recording.from_arrays(t, np.zeros((t.size, 3)), t, q, epoch=EPOCH, time_scale="UTC", **given)


def largest_error(recording, log):
    """Of G and bias of a calibration, in its own sigmas."""
    result = gyrocal.calibrate(recording)
    error = result.parameters.vector - np.concatenate([log.G.ravel(), log.bias])
    return np.abs(error / result.sigma).max()
