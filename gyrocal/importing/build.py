"""A recording from streams: what is not stated is estimated, intervals are made, and all of it is written down.

Intervals are as long as the turn that errors of a percent in G still leave linear, hold a few hundred references at most, and
end at gaps of either side. Each begins at a reference of its own, so that residuals of different intervals do not correlate.
"""

from __future__ import annotations

from collections.abc import Mapping as Entries
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gyrocal.errors import InputError
from gyrocal.importing import noise
from gyrocal.importing.agreement import Motion, agreement, motion
from gyrocal.importing.mapping import DIRECTIONS, ORDERS, Mapping, scalar_first, spec
from gyrocal.importing.sensors import Together, together
from gyrocal.importing.streams import Sensor, Streams
from gyrocal.recording import Attitudes, GyroStream, Interval, Recording

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

TURN = np.deg2rad(720.0)  # of an interval, summed: one percent of G is then 7 deg
INTERVAL_S = (30.0, 1800.0)
REFERENCES = 150  # of an interval, at most
GAP = 1.5  # samples without a gyro reading
SPEED_S = 1.0
LATE = 6.0  # samples; a gyro whose filter or tag is later by less is taken as it is
HOLE = 5.0  # times the usual spacing without an attitude
FEWEST_PAIRS = 12
MOST_PAIRS = 600
LEAST_SIGMA = np.deg2rad(2e-9)


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
        said.append(f"the gyros' axes are turned to those of the attitudes by {_degrees(_angles(C))} deg (rotation vector)")
        if np.linalg.det(C) < 0:
            said.append("the tetrahedron is the mirror image of the one with the axes (1,1,1), (1,−1,−1), (−1,1,−1), (−1,−1,1)")
    rates = streams.raw @ G.T  # of the body, but for the bias
    windows = motion_of(streams, rates, joined)
    if windows is None:
        raise InputError("too few attitudes within the gyro's time to compare the two")
    said += _agree(windows, mapping, LATE * streams.sample_s if check else np.inf)
    still = noise.rests(rates, streams.sample_s, _speed(joined, streams.t_s))
    said.append(f"{len(still)} rest(s) found" if still else "no rest found")
    bias = _bias(mapping, rates, still, windows, said)
    arw = _walk(mapping, streams, rates, still, parity, said)
    gyro = GyroStream(streams.t_s, rates, streams.sample_s, arw, np.eye(3), bias)
    chosen = intervals(gyro, joined, mapping, said)
    if G.shape[1] == 3:  # as on file; more gyros than three are their least-squares body rates
        gyro = replace(gyro, rates=streams.raw, apriori_G=G)
    sigma = _sigma(gyro, joined, chosen, said)
    used = np.concatenate(chosen)
    recording = Recording(
        title=mapping.title or "imported",
        epoch=streams.epoch,
        time_scale=streams.time_scale,
        gyro=gyro,
        attitudes=Attitudes(joined.t_s[used], joined.q[used], np.tile(sigma, (used.size, 1))),
        intervals=tuple(_named(joined.t_s, rows, still, streams.t_s, k) for k, rows in enumerate(chosen, 1)),
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


def intervals(gyro: GyroStream, joined: Together, mapping: Mapping, said: list[str]) -> list[Indices]:
    """Rows of the attitudes of each interval.

    Raises
    ------
    InputError
        None has two.
    """
    t_ref, sample_s = joined.t_s, gyro.sample_s
    stop = np.append(gyro.t_s[1:], gyro.t_s[-1] + sample_s)
    gap = np.flatnonzero(stop - gyro.t_s > GAP * sample_s)
    # Stretches of the gyro without a gap: from the start of a sample to the end of the last before a gap.
    starts = np.concatenate([[gyro.t_s[0]], stop[gap]])
    stops = np.concatenate([gyro.t_s[gap] + sample_s, [stop[-1]]])
    if gap.size:
        said.append(f"{gap.size} gap(s) of the gyro longer than {GAP:g} samples end an interval")
    usual = float(np.median(np.diff(t_ref)))
    holes = np.diff(t_ref) > HOLE * usual
    turned = np.concatenate([[0.0], np.cumsum(np.linalg.norm(gyro.rates + gyro.apriori_bias, axis=1) * (stop - gyro.t_s))])
    turn_at = np.interp(t_ref, np.append(gyro.t_s, stop[-1]), turned)
    span = float(np.clip(stop[-1] - gyro.t_s[0], *INTERVAL_S))
    least = mapping.spacing_s or max(usual, min(span, _longest(mapping, turn_at, t_ref)) / REFERENCES)
    chosen: list[list[int]] = []
    stretch = np.searchsorted(starts, t_ref + 1e-9, side="right") - 1
    now: list[int] = []
    for row, time in enumerate(t_ref):
        k = stretch[row]
        if k < 0 or time > stops[k] + 1e-9:
            continue
        if now:
            apart = stretch[now[-1]] != k or bool(holes[now[-1] : row].any())
            long = time - t_ref[now[0]] > (mapping.interval_s or INTERVAL_S[1]) or (
                mapping.interval_s is None
                and turn_at[row] - turn_at[now[0]] > TURN
                and time - t_ref[now[0]] > min(INTERVAL_S[0], 0.25 * (t_ref[-1] - t_ref[0]))
            )
            if apart or long or len(now) >= 4 * REFERENCES:
                chosen.append(now)
                now = []
            elif time - t_ref[now[-1]] < (1 - 1e-6) * least:
                continue
        now.append(row)
    chosen = [rows for rows in [*chosen, now] if len(rows) >= 2]
    if not chosen:
        raise InputError("no interval has two attitudes within the gyro's time")
    said.append(f"references at least {least:.4g} s apart are used, of those {usual:.4g} s apart")
    said.append(f"{len(chosen)} interval(s) made, each with a first reference of its own")
    return [np.array(rows) for rows in chosen]


def _longest(mapping: Mapping, turn_at: Array, t_ref: Array) -> float:
    """Length of an interval by the turn allowed in it, s."""
    if mapping.interval_s is not None:
        return mapping.interval_s
    rate = (turn_at[-1] - turn_at[0]) / (t_ref[-1] - t_ref[0])
    return float(np.clip(TURN / max(rate, 1e-12), *INTERVAL_S))


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
            f"{name} is turned to {first}, the body, by {_degrees(_angles(joined.mounting[name]))} deg (rotation vector)"
        )
    for name, sigma in joined.sigma.items():
        said.append(f"1-sigma about the axes of {name or 'the attitudes'}: {_degrees(sigma)} deg")
    return said


def _angles(C: Array) -> Array:
    """Rotation vector of the rotation, or of its mirror image."""
    return np.asarray(Rotation.from_matrix(C * np.sign(np.linalg.det(C))).as_rotvec())


def _degrees(values: Array) -> str:
    return ", ".join(f"{value:.4g}" for value in np.rad2deg(values))


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


def _speed(joined: Together, t_s: Array) -> Array:
    """(n,) speed by the attitudes over `SPEED_S` about the gyro's tags, rad/s: so long that their noise does not count."""
    later = np.minimum(np.searchsorted(joined.t_s, joined.t_s + SPEED_S), joined.t_s.size - 1)
    rows = np.flatnonzero(later > np.arange(later.size))
    turned = Rotation.from_quat(joined.q)
    elapsed = joined.t_s[later[rows]] - joined.t_s[rows]
    speed = (turned[rows].inv() * turned[later[rows]]).magnitude() / elapsed
    return np.interp(t_s, joined.t_s[rows] + 0.5 * elapsed, speed)


def _bias(mapping: Mapping, rates: Array, still: list[tuple[int, int]], windows: Motion, said: list[str]) -> Array:
    """b of ω = ω_raw + b to start from."""
    if mapping.bias_deg_s is not None:
        return np.deg2rad(mapping.bias_deg_s)
    if still:
        first, stop = still[0]
        bias = -rates[first:stop].mean(axis=0)
        said.append(f"bias to start from, b = {_degrees(bias)} deg/s, is minus the mean of the first rest")
        return np.asarray(bias)
    gyro, inside = windows.gyro()
    difference = windows.attitudes()[inside] - gyro[inside]
    bias = difference.mean(axis=0)
    # Without a rest the mean difference holds errors of G too: it is used only where it is larger than they may be.
    if np.linalg.norm(bias) < 0.02 * np.linalg.norm(gyro[inside], axis=1).mean():
        said.append("bias to start from is zero")
        return np.zeros(3)
    said.append(f"bias to start from, b = {_degrees(bias)} deg/s, is the mean difference of attitudes' and gyro's rates")
    return np.asarray(bias)


def _walk(
    mapping: Mapping, streams: Streams, rates: Array, still: list[tuple[int, int]], parity: Array, said: list[str]
) -> float:
    """Angle random walk of the body rates, rad/sqrt(s)."""
    if mapping.arw_deg_per_sqrt_s is not None:
        return float(np.deg2rad(mapping.arw_deg_per_sqrt_s))
    if parity.shape[1]:
        # Parity rows are orthonormal: each has the noise of one gyro; the least-squares rate has that of G.
        walk = noise.allan_walk([parity], streams.sample_s)
        assert walk is not None
        gain = np.sqrt(np.mean(np.sum(np.square(mapping.directions(streams.raw.shape[1])), axis=1)))
        arw, how = float(np.sqrt(np.mean(np.square(walk))) * gain), "the parity of the gyros"
    else:
        walk = noise.allan_walk([rates[a:b] for a, b in still], streams.sample_s)
        how = f"the Allan deviation of the rests at {noise.ALLAN_S:g} s"
        if walk is None:
            walk, how = noise.third_differences(rates, streams.sample_s), "third differences in motion, an upper bound"
        arw = float(np.sqrt(np.mean(np.square(walk))))
    if not arw > 0:
        raise InputError("gyro: its noise cannot be told from these rates; give arw_deg_per_sqrt_s")
    said.append(f"angle random walk {np.rad2deg(arw):.4g} deg/sqrt(s), from {how}")
    return arw


def _sigma(gyro: GyroStream, joined: Together, chosen: list[Indices], said: list[str]) -> Array:
    """(3,) 1-sigma of the references about the body's axes, rad."""
    if joined.covariance is not None:
        return np.asarray(np.sqrt(np.diag(joined.covariance)))
    pairs = [pair for rows in chosen for pair in pairwise(rows.tolist())]
    pairs = pairs[:: -(-len(pairs) // MOST_PAIRS)]
    if len(pairs) < FEWEST_PAIRS:
        raise InputError(f"{len(pairs)} turns between references are too few to take their sigma from; give sigma_deg")
    left, R = _increments(gyro, joined, pairs)
    elapsed = float(np.median([joined.t_s[b] - joined.t_s[a] for a, b in pairs]))
    sigma = noise.axis_sigma(left, R, gyro.arw**2 * elapsed)
    if not (sigma > LEAST_SIGMA).all():
        raise InputError("the references scatter less than the gyro between two of them: give sigma_deg, or a shorter spacing")
    said.append(
        f"sigma of the references {_degrees(sigma)} deg, from the turns between them; errors that they share are not in it"
    )
    return sigma


def _increments(gyro: GyroStream, joined: Together, pairs: list[tuple[int, int]]) -> tuple[Array, Array]:
    used = np.unique(np.array(pairs))
    t_s = joined.t_s
    return noise.increment_residuals(
        Recording(
            title="increments",
            epoch="",
            gyro=gyro,
            attitudes=Attitudes(t_s[used], joined.q[used], np.full((used.size, 3), np.deg2rad(1.0))),
            intervals=tuple(Interval(str(k), "", float(t_s[a]), float(t_s[b])) for k, (a, b) in enumerate(pairs)),
        )
    )


def _named(t_ref: Array, rows: Indices, still: list[tuple[int, int]], t_s: Array, number: int) -> Interval:
    start, stop = float(t_ref[rows[0]]), float(t_ref[rows[-1]])
    resting = sum(max(min(stop, t_s[b - 1]) - max(start, t_s[a]), 0.0) for a, b in still)
    activity = "rest" if resting > 0.9 * (stop - start) else "motion and rest" if resting > 0 else "motion"
    return Interval(f"part {number}", activity, start, stop)


def _tables(streams: Streams, parity: Array) -> dict[str, pd.DataFrame]:
    """Housekeeping: each gyro's own rate and the parity, where there are more than three gyros."""
    if not parity.shape[1]:
        return {}
    columns = {"t_s": streams.t_s}
    columns |= {f"gyro_{name}_deg_s": np.rad2deg(x) for name, x in zip(streams.channels, streams.raw.T, strict=True)}
    columns |= {f"parity_{k}_deg_s": np.rad2deg(x) for k, x in enumerate(parity.T, 1)}
    return {"housekeeping": pd.DataFrame(columns)}
