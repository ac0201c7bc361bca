"""A recording from streams: what is not stated is estimated, intervals are made, and all of it is written down."""

from __future__ import annotations

import logging
from collections.abc import Mapping as Entries
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gyrocal.errors import InputError
from gyrocal.importing.agreement import agreement
from gyrocal.importing.estimates import degrees, reference_sigma, start_bias, walk
from gyrocal.importing.intervals import intervals, named
from gyrocal.importing.mapping import DIRECTIONS, ORDERS, Mapping, scalar_first, spec
from gyrocal.importing.motion import Motion, motion
from gyrocal.importing.rests import rests, speed
from gyrocal.importing.sensors import Together, together
from gyrocal.importing.streams import Sensor, Streams
from gyrocal.recording import Attitudes, GyroStream, Recording

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)

LATE = 6.0  # samples; a gyro whose filter or tag is later by less is taken as it is


@dataclass(frozen=True)
class Imported:
    """A recording and how it came about.

    Attributes
    ----------
    recording : the recording
    mapping : as which the tables were read
    assumed : what was taken for granted or estimated, a sentence each
    mounting, sigma : of each attitude sensor, see `gyrocal.importing.sensors.Together`
    apart : differences between the attitude sensors, see there
    parity : (n, k − 3) rad/s: what k gyros say without any attitude; no columns for three
    """

    recording: Recording
    mapping: Mapping
    assumed: tuple[str, ...]
    mounting: Entries[str, Array]
    sigma: Entries[str, Array]
    apart: Entries[str, Array]
    parity: Array

    def summary(self) -> pd.DataFrame:
        """What was made, a row a quantity, in degrees."""
        recording = self.recording
        lengths = [one.stop_s - one.start_s for one in recording.intervals]
        rows = [
            ("gyro samples", f"{recording.gyro.t_s.size} at {1 / recording.gyro.sample_s:.6g} Hz"),
            ("reference attitudes", str(recording.attitudes.t_s.size)),
            ("intervals", f"{len(lengths)} of {min(lengths):.6g} to {max(lengths):.6g} s"),
            ("epoch", f"{recording.epoch} ({recording.time_scale})"),
        ]
        return pd.DataFrame([*rows, *(("assumed", text) for text in self.assumed)], columns=["what", "value"])


def build(streams: Streams, mapping: Mapping, check: bool = True) -> Imported:
    """A recording of the streams.

    Parameters
    ----------
    streams : of both tables
    mapping : what is known beyond the columns
    check : whether rates and attitudes that do not fit each other are refused

    Raises
    ------
    InputError
        The tables do not overlap, do not fit each other, or are too short.
    """
    said = list(streams.assumed)
    joined = together(streams.sensors, _stated(mapping, streams.sensors), mapping.spacing_s or 0.0)
    G = mapping.directions(streams.raw.shape[1])
    said += _mounted(joined)
    parity = streams.raw @ _null_space(G).T
    _check_overlap(streams, joined)
    if mapping.mounting == "estimate":
        C = estimated_mounting(motion_of(streams, streams.raw @ G.T, joined, 12), mirrored=mapping.axes == "tetrahedron")
        G = C @ G
        said.append(f"the gyros' axes are turned to those of the attitudes by {degrees(_angles(C))} deg (rotation vector)")
        if np.linalg.det(C) < 0:
            said.append("the tetrahedron is the mirror image of the one with the axes (1,1,1), (1,−1,−1), (−1,1,−1), (−1,−1,1)")
    rates = streams.raw @ G.T  # of the body, but for the bias
    windows = motion_of(streams, rates, joined)
    if windows is None:
        raise InputError("too few attitudes within the gyro's time to compare the two")
    said += _agree(windows, mapping, LATE * streams.sample_s if check else np.inf)
    still = rests(rates, streams.sample_s, speed(joined.t_s, joined.q, streams.t_s))
    said.append(f"{len(still)} rest(s) found" if still else "no rest found")
    bias = start_bias(mapping, rates, still, windows, said)
    arw = walk(mapping, streams, rates, still, parity, said)
    gyro = GyroStream(streams.t_s, rates, streams.sample_s, arw, np.eye(3), bias)
    chosen = intervals(gyro, joined, mapping, said)
    if G.shape[1] == 3:  # as on file; more gyros than three are their least-squares body rates
        gyro = replace(gyro, rates=streams.raw, apriori_G=G)
    sigma = reference_sigma(gyro, joined, chosen, said)
    for text in said:
        logger.info("%s", text)
    used = np.concatenate(chosen)
    recording = Recording(
        title=mapping.title or "imported",
        epoch=streams.epoch,
        time_scale=streams.time_scale,
        gyro=gyro,
        attitudes=Attitudes(joined.t_s[used], joined.q[used], np.tile(sigma, (used.size, 1))),
        intervals=tuple(named(joined.t_s, rows, still, streams.t_s, k) for k, rows in enumerate(chosen, 1)),
        tables=_tables(streams, parity),
    )
    return Imported(recording, mapping, tuple(said), joined.mounting, joined.sigma, joined.apart, parity)


def motion_of(streams: Streams, rates: Array, joined: Together, windows: int | None = None) -> Motion | None:
    """Mean rates by gyro and attitudes over windows."""
    options = {} if windows is None else {"count": windows}
    return motion(streams.t_s, rates, streams.sample_s, joined.t_s, joined.q, **options)


def estimated_mounting(windows: Motion | None, mirrored: bool) -> Array:
    """Orthogonal C (3, 3) that takes the gyro's mean rates best to those of the attitudes, Σ|w_ref − C w|² least.

    Parameters
    ----------
    windows : of both
    mirrored : whether C may be a reflection

    Raises
    ------
    InputError
        There is too little to compare.
    """
    if windows is None:
        raise InputError("mounting: too few attitudes within the gyro's time to estimate it")
    gyro, inside = windows.gyro()
    U, _, Vt = np.linalg.svd(windows.attitudes()[inside].T @ gyro[inside])
    sign = np.linalg.det(U @ Vt)
    if mirrored:
        return np.asarray(U @ Vt)
    return np.asarray(U @ np.diag([1.0, 1.0, sign]) @ Vt)


def _stated(mapping: Mapping, sensors: tuple[Sensor, ...]) -> dict[str, Array] | None:
    if mapping.sigma_deg is None:
        return None
    if isinstance(mapping.sigma_deg, dict):
        return {name: np.deg2rad(values) for name, values in mapping.sigma_deg.items()}
    return {one.name: np.deg2rad(mapping.sigma_deg) for one in sensors}


def _null_space(G: Array) -> Array:
    """Rows (k − 3, k) that the readings of k gyros must give zero with: orthonormal, and at right angles to all motion."""
    return np.asarray(np.linalg.svd(np.linalg.pinv(G))[0][:, 3:].T)


def _mounted(joined: Together) -> list[str]:
    said = []
    first, *others = joined.mounting
    for name in others:
        said.append(
            f"{name} is turned to {first}, the body, by {degrees(_angles(joined.mounting[name]))} deg (rotation vector)"
        )
    for name, sigma in joined.sigma.items():
        said.append(f"1-sigma about the axes of {name or 'the attitudes'}: {degrees(sigma)} deg")
    return said


def _angles(C: Array) -> Array:
    """Rotation vector of the rotation, or of its mirror image."""
    return np.asarray(Rotation.from_matrix(C * np.sign(np.linalg.det(C))).as_rotvec())


def _check_overlap(streams: Streams, joined: Together) -> None:
    stop = streams.t_s[-1] + streams.sample_s
    inside = (joined.t_s >= streams.t_s[0]) & (joined.t_s <= stop)
    if inside.sum() >= 4:
        return
    gyro_s, attitude_s = stop - streams.t_s[0], joined.t_s[-1] - joined.t_s[0]
    hint = ""
    for times in (1e3, 1e6, 1e9):
        if 0.5 < attitude_s / gyro_s / times < 2:
            hint = f"; both would last as long with the attitudes' time unit {times:g} times finer, see attitude_time"
        if 0.5 < gyro_s / attitude_s / times < 2:
            hint = f"; both would last as long with the gyro's time unit {times:g} times finer, see time"
    raise InputError(
        f"the gyro runs from {streams.t_s[0]:.9g} to {stop:.9g} s and the attitudes from {joined.t_s[0]:.9g} to "
        f"{joined.t_s[-1]:.9g} s: {int(inside.sum())} attitudes are within{hint or '; is one of the time tags offset?'}"
    )


def _agree(windows: Motion, mapping: Mapping, late_s: float) -> list[str]:
    """Refuse what does not fit; what is left of the motion, in words.

    A time offset of up to late_s is taken, and said: a gyro's own delay is for a diagnosis to find. Infinite refuses nothing.
    """
    _, (unit, *_) = spec(mapping.gyro, "gyro")
    _, (time_unit, *_) = spec(mapping.time, "time")
    order, reverse = "", False
    names, words = spec(str(getattr(mapping, mapping.attitude)), mapping.attitude)
    if mapping.attitude == "quat":
        order = ORDERS[0] if scalar_first(names, words) else ORDERS[1]
    reverse = any(DIRECTIONS.get(word, False) for word in words)
    found = agreement(windows, unit, {"unix": "s"}.get(time_unit, time_unit), order, reverse)
    if not found.fits:
        offset_alone = found.better and all(one.count == 1 and 0 < abs(one.offset_s) <= late_s for one in found.better)
        if np.isfinite(late_s) and offset_alone:
            return [f"{found.sentence}; an offset as small as this is not undone"]
        if np.isfinite(late_s):
            raise InputError(found.sentence)
        return [f"imported unchecked although {found.sentence}"]
    return [f"rates and attitudes fit each other: {100 * found.as_read.residual:.2g} % of the motion is left"]


def _tables(streams: Streams, parity: Array) -> dict[str, pd.DataFrame]:
    """Housekeeping: each gyro's own rate and the parity, where there are more than three gyros."""
    if not parity.shape[1]:
        return {}
    columns = {"t_s": streams.t_s}
    columns |= {f"gyro_{name}_deg_s": np.rad2deg(x) for name, x in zip(streams.channels, streams.raw.T, strict=True)}
    columns |= {f"parity_{k}_deg_s": np.rad2deg(x) for k, x in enumerate(parity.T, 1)}
    return {"housekeeping": pd.DataFrame(columns)}
