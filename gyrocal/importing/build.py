"""A recording from streams: what is not stated is estimated, intervals are made, and all of it is written down."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array
from gyrocal.errors import InputError
from gyrocal.importing.agreement import (
    FITS,
    HOPELESS,
    LARGEST_FACTOR,
    Agreement,
    AttitudeReading,
    describe_mean_rates,
    evaluate_agreement,
)
from gyrocal.importing.alignment import Alignment, estimate_alignment, refine
from gyrocal.importing.column_mapping import (
    ATTITUDE_DIRECTIONS,
    QUATERNION_ORDERS,
    Mapping,
    convert_attitude,
    is_scalar_first,
    parse_spec,
)
from gyrocal.importing.estimates import compute_largest_miss, estimate_bias, estimate_walk
from gyrocal.importing.intervals import choose_intervals, name_interval
from gyrocal.importing.motion import Motion, build_motion, rotate_onto
from gyrocal.importing.reference_join import JoinedReferences
from gyrocal.importing.sensors import build_references, join_sensors, read_stated_sigma
from gyrocal.importing.streams import BodyAttitudes, Sensor, Streams
from gyrocal.importing.units import format_degrees
from gyrocal.masking import DataMask, find_mask
from gyrocal.masking.mask import TABLE
from gyrocal.recording import Attitudes, GyroStream, Interval, Recording
from gyrocal.rests import compare_rests, compute_speed, find_rests

logger = logging.getLogger(__name__)

TEMPERATURE = ["t_s", "gyro_temperature_c"]
SMALLEST_SIGMA = 1e-9  # rad, and rad/√s, of noise that is not yet estimated: the scatter of the innovations takes its place
LATE = 6.0  # samples; a gyro whose filter or tag is later by less is taken as it is
LARGEST_START_BIAS_SHARE = 0.3  # of the RMS rate: by so much a bias in motion may be off that of the rests
EULER_SEQUENCES = tuple(
    made
    for letters in ("XYZ", "xyz")
    for made in (*map("".join, permutations(letters)), *(a + b + a for a, b in permutations(letters, 2)))
)
ARRIVES = np.deg2rad(10.0)  # a turn at random is as small as this once in 4000 times


@dataclass(frozen=True)
class ImportResult:
    """A recording and how it came about."""

    recording: Recording  # the recording
    mapping: Mapping  # as which the tables were read
    assumed: tuple[str, ...]  # what was taken for granted or estimated, a sentence each
    sensors: tuple[Sensor, ...]  # the attitudes of each sensor as they were read
    joined: JoinedReferences | None  # those of several sensors joined, with their mountings; None of a single one
    warnings: tuple[str, ...] = ()  # what is implausible, a sentence each

    def summary(self) -> pd.DataFrame:
        """Table of the recording made, a row a quantity, in degrees."""
        recording = self.recording
        lengths = [interval.stop_s - interval.start_s for interval in recording.intervals]
        rows = [
            ("gyro samples", f"{recording.gyro.t_s.size} at {1 / recording.gyro.sample_s:.6g} Hz"),
            ("reference attitudes", str(recording.attitudes.t_s.size)),
            ("intervals", f"{len(lengths)} of {min(lengths):.6g} to {max(lengths):.6g} s"),
            ("epoch", f"{recording.epoch} ({recording.time_scale})"),
        ]
        return pd.DataFrame([*rows, *(("assumed", text) for text in self.assumed)], columns=["what", "value"])


def import_streams(streams: Streams, mapping: Mapping, said: Sequence[str] = ()) -> ImportResult:
    """Build a recording of the streams of both tables; `said` is what was taken for granted before.

    An `InputError` if the tables do not overlap, do not fit each other, or are too short.
    """
    said = [*said, *streams.assumed]
    if not streams.raw.any():
        raise InputError("gyro: all rates are zero; is the gyro switched on, and are these its columns or its topic?")
    is_aligned = mapping.align == "auto"
    if is_aligned:
        streams, mapping = _align(streams, mapping, said)
    stated = read_stated_sigma(mapping, streams.sensors)
    body = join_sensors(streams.sensors, stated, mapping)
    _check_overlap(streams, body)
    G = _mount(streams, mapping, body, said)
    rates = streams.raw @ G.T  # of the body, but for the bias
    if streams.gyros is not None:  # about no gyro's axis, and so about the body's
        streams, G = replace(streams, raw=rates), np.eye(3)
    windows = build_motion(streams.t_s, rates, streams.sample_s, body.t_s, body.q)
    if windows is None:
        raise InputError("too few attitudes within the gyro's time to compare the two")
    mask = _find_mask(streams, mapping, G, body)
    if not body.sensors:
        kept = ~mask.mark_false_references(body.t_s)
        body = BodyAttitudes(body.t_s[kept], body.q[kept])
    found = _evaluate(windows, mapping, streams.sensors[0], G if streams.gyros is None else None)
    _check_agreement(found, streams, mapping, rates, body, windows, said)
    near = refine(windows, reverse=False, with_clock=False)
    if near is not None and near.residual <= HOPELESS and not windows.is_coarse and not is_aligned:
        said.append(near.describe_offset())
    gyro, still, chosen = _estimate_gyro(streams, mapping, rates, body, windows, said)
    warnings = []
    if streams.gyros is not None:
        noise = gyro.arw / streams.gyros.gain / np.sqrt(gyro.sample_s)
        said += streams.gyros.describe(noise)
        warnings.append(streams.gyros.find_disagreement(noise))
    references, joined = build_references(streams, body, chosen, mapping, stated, gyro, said)
    tables = {} if streams.temperature is None else {"housekeeping": pd.DataFrame(streams.temperature, columns=TEMPERATURE)}
    recording = Recording(
        title=mapping.title or "imported",
        epoch=streams.epoch,
        time_scale=streams.time_scale,
        gyro=replace(gyro, rates=streams.raw, apriori_G=G),
        attitudes=references,
        intervals=tuple(name_interval(body.t_s, rows, still, streams.t_s, k) for k, rows in enumerate(chosen, 1))
        if mapping.interval is None
        else tuple(one.interval for one in mapping.interval),
        tables=tables | ({TABLE: mask.to_frame()} if mask else {}),
    )
    said += mask.describe(recording)
    for text in said:
        logger.info("%s", text)
    warnings += _list_warnings(found, mapping, near, gyro, bool(still))
    if mapping.bias_deg_s is None:
        warnings.append(describe_mean_rates(windows))
    return ImportResult(mask.apply(recording), mapping, tuple(said), streams.sensors, joined, tuple(filter(None, warnings)))


def _mount(streams: Streams, mapping: Mapping, body: BodyAttitudes, said: list[str]) -> Array:
    """G (3, 3) of the rates about the axes of the attitudes."""
    G = streams.G
    if isinstance(mapping.mounting, list):
        return np.asarray(Rotation.from_rotvec(mapping.mounting, degrees=True).as_matrix() @ G)
    if mapping.mounting == "as given":
        return G
    few = build_motion(streams.t_s, streams.raw @ G.T, streams.sample_s, body.t_s, body.q, 12)
    if few is None:
        raise InputError("mounting: too few attitudes within the gyro's time to estimate it")
    gyro, inside = few.gyro()
    C, _ = rotate_onto(few.attitudes()[inside], gyro[inside], mirrored=mapping.axes == "tetrahedron")
    sign = np.sign(np.linalg.det(C))
    turn = format_degrees(Rotation.from_matrix(C * sign).as_rotvec())
    said.append(f"the gyros' axes are turned to those of the attitudes by {turn} deg (rotation vector)")
    if sign < 0:
        said.append("the tetrahedron is the mirror image of the one with the axes (1,1,1), (1,−1,−1), (−1,1,−1), (−1,−1,1)")
    return np.asarray(C @ G)


def _find_mask(streams: Streams, mapping: Mapping, G: Array, body: BodyAttitudes) -> DataMask:
    """Find what was not measured, with all attitudes as they were given; only what is left out by hand of several sensors."""
    gyro = GyroStream(streams.t_s, streams.raw, streams.sample_s, SMALLEST_SIGMA, G)
    inside = np.flatnonzero((body.t_s >= streams.t_s[0]) & (body.t_s <= streams.t_s[-1] + streams.sample_s))
    t_s = body.t_s[inside]
    attitudes = Attitudes(t_s, body.q[inside], np.full((t_s.size, 3), SMALLEST_SIGMA))
    whole = Recording("", "", gyro, attitudes, (Interval("whole", "", float(t_s[0]), float(t_s[-1])),))
    spans = [(first, stop) for first, stop in mapping.exclude or ()]
    return DataMask().exclude(whole, spans) if body.sensors else find_mask(whole, spans)


def _estimate_gyro(
    streams: Streams, mapping: Mapping, rates: Array, body: BodyAttitudes, windows: Motion, said: list[str]
) -> tuple[GyroStream, list[tuple[int, int]], list[NDArray[np.intp]]]:
    """Body rates with their bias and noise, rests, and the rows of the attitudes of each interval."""
    still = find_rests(rates, streams.sample_s, compute_speed(body.t_s, body.q, streams.t_s))
    said.append(f"{len(still)} rest(s) found" if still else "no rest found")
    said += [text for text in [compare_rests(streams.t_s, rates, still)[0]] if text]
    bias = estimate_bias(mapping, rates, still, windows, body, streams, said)
    arw, degrees = estimate_walk(mapping, streams, rates, still, said)
    estimated = mapping.arw_deg_per_sqrt_s is None
    gyro = GyroStream(streams.t_s, rates, streams.sample_s, arw, np.eye(3), bias, estimated, degrees)
    return gyro, still, choose_intervals(gyro, body, mapping, said)


def _check_overlap(streams: Streams, body: BodyAttitudes) -> None:
    stop = streams.t_s[-1] + streams.sample_s
    inside = (body.t_s >= streams.t_s[0]) & (body.t_s <= stop)
    if inside.sum() >= 4:
        return
    gyro_s, attitude_s = stop - streams.t_s[0], body.t_s[-1] - body.t_s[0]
    hint = ""
    for times in (1e3, 1e6, 1e9):
        if 0.5 < attitude_s / gyro_s / times < 2:
            hint = f"; both would last as long with the attitudes' time unit {times:g} times finer, see attitude_time"
        if 0.5 < gyro_s / attitude_s / times < 2:
            hint = f"; both would last as long with the gyro's time unit {times:g} times finer, see time"
    raise InputError(
        f"the gyro runs from {streams.t_s[0]:.9g} to {stop:.9g} s and the attitudes from {body.t_s[0]:.9g} to "
        f"{body.t_s[-1]:.9g} s: {int(inside.sum())} attitudes are within"
        f"{hint or '; is one of the time tags offset? --align auto finds an offset of any size; a unit may be 100us'}"
    )


def _evaluate(windows: Motion, mapping: Mapping, sensor: Sensor, G: Array | None) -> Agreement:
    """Compare rates and attitudes under the mapping and its alternatives."""
    _, (time_unit, *_) = parse_spec(mapping.time, "time")
    order = ""
    names, words = parse_spec(str(getattr(mapping, mapping.attitude)), mapping.attitude)
    if mapping.attitude == "quat":
        order = QUATERNION_ORDERS[0] if is_scalar_first(names, words) else QUATERNION_ORDERS[1]
    reverse = any(ATTITUDE_DIRECTIONS.get(word, False) for word in words)
    others = _list_euler_readings(names, words, sensor) if windows.q.shape == sensor.q.shape else []
    time_unit = {"unix": "s"}.get(time_unit, time_unit)
    accumulated = mapping.gyro_factor[1]
    return evaluate_agreement(windows, mapping.gyro_unit, time_unit, order, reverse, others, G, accumulated)


def _list_euler_readings(names: list[str], words: list[str], sensor: Sensor) -> list[AttitudeReading]:
    """Attitudes of Euler angles in each other sequence and unit, with what they change."""
    if sensor.angles is None:
        return []
    unit = "deg" if "deg" in words else "rad"
    direction = next(word for word in words if word in ATTITUDE_DIRECTIONS)
    stated = next(word for word in words if word.lower().strip("xyz") == "")
    out = []
    for sequence, used in product(EULER_SEQUENCES, ("deg", "rad")):
        changes = (
            *([f"the Euler angles as {sequence}, not {stated}"] if sequence != stated else []),
            *([f"the Euler angles in {used}, not {unit}"] if used != unit else []),
        )
        if changes:
            text = f"{','.join(names)}:{used}:{sequence}:{direction}"
            out.append(AttitudeReading(changes, convert_attitude("euler", text, sensor.angles)))
    return out


def _check_agreement(
    found: Agreement, streams: Streams, mapping: Mapping, rates: Array, body: BodyAttitudes, windows: Motion, said: list[str]
) -> None:
    """Refuse what does not fit; otherwise say what is left of the motion.

    A small time offset is taken, and said: a gyro's own delay is for a diagnosis to find. Where attitudes are so far apart that
    the body turns over between them, their mean rates say nothing: then it counts that the gyro, as read, leads from each to
    the next, which no wrong reading does several times by chance.
    """
    best = found.best
    kind = "" if best is None else best.kind
    if found.fits:
        said.append(found.summary)
        if best is not None:
            said.append(f"the calibration may start nearer: {best.sentence}")
        return
    late_s = LATE * streams.sample_s
    if best is not None and kind == "named" and best.count == 1 and 0 < abs(best.offset_s) <= late_s and not mapping.unchecked:
        said.append(f"{found.sentence}; an offset as small as this is not undone")
        return
    if kind != "named" and (kind != "alignment" or windows.is_coarse):
        try:
            gyro, _, chosen = _estimate_gyro(streams, mapping, rates, body, windows, [])
            missed = compute_largest_miss(gyro, body, chosen)
        except InputError:
            missed = np.inf
        if missed < ARRIVES:
            said.append(f"the gyro leads from each attitude used to the next within {np.rad2deg(missed):.2g} deg")
            return
    if not mapping.unchecked:
        raise InputError(found.sentence)
    said.append(f"imported unchecked although {found.sentence}")


def _align(streams: Streams, mapping: Mapping, said: list[str]) -> tuple[Streams, Mapping]:
    """Streams and mapping with the alignment that the rates of both sides show, and all of it in words."""
    accumulated = mapping.gyro_factor[1]
    if mapping.mountings is not None:
        raise InputError("align: goes with no mountings of attitude sensors; give the sensors one by one")
    first = streams.sensors[0]
    found = estimate_alignment(streams.t_s, streams.raw @ streams.G.T, streams.sample_s, first.t_s, first.q, accumulated)
    if found is None or found.residual > HOPELESS:
        share = "" if found is None else f"; the best leaves {100 * found.residual:.0f} % of the motion"
        raise InputError(
            f"align: no time offset, clock rate, direction, mounting and factor make rates and attitudes fit{share}"
        )
    said += found.describe()
    factor = found.time_factor if found.is_clock_off else 1.0
    scale = found.factor if found.is_scaled else 1.0
    t_s = streams.t_s[0] + factor * (streams.t_s - streams.t_s[0])
    raw = streams.raw * scale / (factor if accumulated else 1.0)
    sensors = tuple(
        replace(
            sensor,
            t_s=sensor.t_s + found.offset_s,
            q=np.asarray(Rotation.from_quat(sensor.q).inv().as_quat()) if found.reverse else sensor.q,
        )
        for sensor in streams.sensors
    )
    entries: dict[str, Any] = {
        "align": "as given",
        "common_start": True,
        "attitude_offset_s": mapping.attitude_offset_s + found.offset_s,
        "time_factor": mapping.time_factor * factor,
        "rate_factor": mapping.rate_factor * scale,
    }
    if found.reverse:
        entries[mapping.attitude] = _exchange_direction(str(getattr(mapping, mapping.attitude)))
    if found.is_turned and mapping.mounting != "estimate":
        entries["mounting"] = np.rad2deg(found.turn).tolist()
    gyros, temperature = streams.gyros, streams.temperature
    if gyros is not None:
        gyros = replace(gyros, residuals=gyros.residuals * scale / (factor if accumulated else 1.0))
    if temperature is not None:
        start = np.array([streams.t_s[0], 0.0])
        temperature = start + np.array([factor, 1.0]) * (temperature - start)
    sample_s = factor * streams.sample_s
    aligned = replace(streams, t_s=t_s, raw=raw, sample_s=sample_s, sensors=sensors, gyros=gyros, temperature=temperature)
    return aligned, mapping.model_copy(update=entries)


def _exchange_direction(text: str) -> str:
    """The text of a mapping with the other direction."""
    words = [word.strip() if word.strip() in ATTITUDE_DIRECTIONS else word for word in text.split(":")]
    return ":".join("-to-".join(word.split("-to-")[::-1]) if word in ATTITUDE_DIRECTIONS else word for word in words)


def _list_warnings(found: Agreement, mapping: Mapping, near: Alignment | None, gyro: GyroStream, has_rest: bool) -> list[str]:
    """List implausible values, which are shown first."""
    out = []
    if found.residual > FITS:
        out.append(f"rates and attitudes differ by {100 * found.residual:.0f} % of the motion")
    if not 1 / LARGEST_FACTOR <= mapping.rate_factor <= LARGEST_FACTOR:
        out.append(
            f"the rates are multiplied by {mapping.rate_factor:.4g}: is their unit, range or size of a count another one?"
        )
    if has_rest and near is not None and mapping.bias_deg_s is None:
        off = float(np.linalg.norm(near.bias - gyro.apriori_bias))
        speed = float(np.sqrt(np.mean(np.sum(np.square(gyro.rates + gyro.apriori_bias), axis=1))))
        if off > LARGEST_START_BIAS_SHARE * speed:
            out.append(
                f"the bias in motion is {np.rad2deg(off):.3g} deg/s off that of the rests, the RMS rate {np.rad2deg(speed):.3g}"
            )
    return out
