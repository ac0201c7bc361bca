"""A recording from streams: quantities that are not stated are estimated, intervals are chosen, and both are noted."""

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
    FITTING_RESIDUAL,
    USABLE_RESIDUAL,
    Agreement,
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
from gyrocal.importing.intervals import build_interval, choose_intervals
from gyrocal.importing.motion import Motion, build_motion, rotate_onto
from gyrocal.importing.readings import LARGEST_FACTOR, AttitudeReading
from gyrocal.importing.reference_join import JoinedReferences
from gyrocal.importing.sensors import build_references, join_sensors, read_stated_sigma
from gyrocal.importing.streams import BodyAttitudes, Sensor, Streams
from gyrocal.importing.units import format_degrees
from gyrocal.masking import DataMask, find_mask
from gyrocal.masking.mask import TABLE
from gyrocal.recording import Attitudes, GyroStream, Interval, Recording
from gyrocal.rests import compare_rests, compute_speed, find_rests

logger = logging.getLogger(__name__)

TEMPERATURE_COLUMNS = ["t_s", "gyro_temperature_c"]
SMALLEST_SIGMA = 1e-9  # rad, and rad/√s, of noise that is not yet estimated: the scatter of the innovations takes its place
MOST_LATE_SAMPLES = 6.0  # delay of a gyro by its filter or tag, in samples, that is accepted and not corrected
LARGEST_START_BIAS_SHARE = 0.3  # of the RMS rate: largest plausible difference of the bias in motion from that of the rests
EULER_SEQUENCES = tuple(
    sequence
    for letters in ("XYZ", "xyz")
    for sequence in (*map("".join, permutations(letters)), *(a + b + a for a, b in permutations(letters, 2)))
)
LARGEST_ARRIVAL_MISS = np.deg2rad(10.0)  # a random rotation is smaller with a probability of 1/4000


@dataclass(frozen=True)
class ImportResult:
    """A recording with the mapping, assumptions and estimates of its import."""

    recording: Recording  # the recording
    mapping: Mapping  # by which the tables were read
    assumed: tuple[str, ...]  # assumptions and estimates, a sentence each
    sensors: tuple[Sensor, ...]  # the attitudes of each sensor as they were read
    joined: JoinedReferences | None  # attitudes of several sensors joined, with their mountings; None of a single one
    warnings: tuple[str, ...] = ()  # implausible values, a sentence each

    def summary(self) -> pd.DataFrame:
        """Build a table of the recording, a row for each quantity and assumption, in degrees."""
        recording = self.recording
        lengths = [interval.stop_s - interval.start_s for interval in recording.intervals]
        rows = [
            ("gyro samples", f"{recording.gyro.t_s.size} at {1 / recording.gyro.sample_s:.6g} Hz"),
            ("reference attitudes", str(recording.attitudes.t_s.size)),
            ("intervals", f"{len(lengths)} of {min(lengths):.6g} to {max(lengths):.6g} s"),
            ("epoch", f"{recording.epoch} ({recording.time_scale})"),
        ]
        return pd.DataFrame([*rows, *(("assumed", text) for text in self.assumed)], columns=["what", "value"])


def import_streams(streams: Streams, mapping: Mapping, notes: Sequence[str] = ()) -> ImportResult:
    """Build a recording of the streams of both tables.

    An `InputError` if the tables do not overlap, do not fit each other, or are too short.

    notes: assumptions made before, a sentence each
    """
    notes = [*notes, *streams.assumed]
    if not streams.raw.any():
        raise InputError("gyro: all rates are zero; is the gyro switched on, and are these its columns or its topic?")
    is_aligned = mapping.align == "auto"
    if is_aligned:
        streams, mapping = _align(streams, mapping, notes)
    stated = read_stated_sigma(mapping, streams.sensors)
    body = join_sensors(streams.sensors, stated, mapping)
    _check_overlap(streams, body)
    G = _estimate_body_G(streams, mapping, body, notes)
    rates = streams.raw @ G.T  # of the body, without the bias
    if streams.gyros is not None:  # joined rates belong to no gyro's axis: the recording has them about the body's
        streams, G = replace(streams, raw=rates), np.eye(3)
    windows = build_motion(streams.t_s, rates, streams.sample_s, body.t_s, body.q)
    if windows is None:
        raise InputError("too few attitudes within the gyro's time to compare the two")
    mask = _find_mask(streams, mapping, G, body)
    if not body.sensors:
        is_valid = ~mask.mark_false_references(body.t_s)
        body = BodyAttitudes(body.t_s[is_valid], body.q[is_valid])
    agreement = _evaluate_mapping(windows, mapping, streams.sensors[0], G if streams.gyros is None else None)
    _check_agreement(agreement, streams, mapping, rates, body, windows, notes)
    alignment = refine(windows, reverse=False, with_clock=False)
    if alignment is not None and alignment.residual <= USABLE_RESIDUAL and not windows.is_coarse and not is_aligned:
        notes.append(alignment.describe_offset())
    gyro, rests, interval_rows = _estimate_gyro(streams, mapping, rates, body, windows, notes)
    warnings = []
    if streams.gyros is not None:
        noise = gyro.arw / streams.gyros.gain / np.sqrt(gyro.sample_s)
        notes += streams.gyros.describe(noise)
        warnings.append(streams.gyros.find_disagreement(noise))
    references, joined = build_references(streams, body, interval_rows, mapping, stated, gyro, notes)
    tables = {TABLE: mask.to_frame()} if mask else {}
    if streams.temperature is not None:
        tables = {"housekeeping": pd.DataFrame(streams.temperature, columns=TEMPERATURE_COLUMNS), **tables}
    intervals = [build_interval(body.t_s, rows, rests, streams.t_s, k) for k, rows in enumerate(interval_rows, 1)]
    recording = Recording(
        title=mapping.title or "imported",
        epoch=streams.epoch,
        time_scale=streams.time_scale,
        gyro=replace(gyro, rates=streams.raw, apriori_G=G),
        attitudes=references,
        intervals=tuple(intervals if mapping.interval is None else (span.interval for span in mapping.interval)),
        tables=tables,
    )
    notes += mask.describe(recording)
    for text in notes:
        logger.info("%s", text)
    warnings += _list_warnings(agreement, mapping, alignment, gyro, bool(rests))
    if mapping.bias_deg_s is None:
        warnings.append(describe_mean_rates(windows))
    return ImportResult(mask.apply(recording), mapping, tuple(notes), streams.sensors, joined, tuple(filter(None, warnings)))


def _estimate_body_G(streams: Streams, mapping: Mapping, body: BodyAttitudes, notes: list[str]) -> Array:
    """Compute G (3, 3) from the gyros' readings to rates about the axes of the attitudes, by the mounting of the mapping."""
    G = streams.G
    if isinstance(mapping.mounting, list):
        return np.asarray(Rotation.from_rotvec(mapping.mounting, degrees=True).as_matrix() @ G)
    if mapping.mounting == "as given":
        return G
    windows = build_motion(streams.t_s, streams.raw @ G.T, streams.sample_s, body.t_s, body.q, 12)
    if windows is None:
        raise InputError("mounting: too few attitudes within the gyro's time to estimate it")
    gyro, inside = windows.compute_gyro_rates()
    C, _ = rotate_onto(windows.compute_attitude_rates()[inside], gyro[inside], mirrored=mapping.axes == "tetrahedron")
    sign = np.sign(np.linalg.det(C))
    turn = format_degrees(Rotation.from_matrix(C * sign).as_rotvec())
    notes.append(f"the gyros' axes are turned to those of the attitudes by {turn} deg (rotation vector)")
    if sign < 0:
        notes.append("the tetrahedron is the mirror image of the one with the axes (1,1,1), (1,−1,−1), (−1,1,−1), (−1,−1,1)")
    return np.asarray(C @ G)


def _find_mask(streams: Streams, mapping: Mapping, G: Array, body: BodyAttitudes) -> DataMask:
    """Find stretches that were not measured, with all attitudes as given; of several sensors only those excluded by hand."""
    gyro = GyroStream(streams.t_s, streams.raw, streams.sample_s, SMALLEST_SIGMA, G)
    inside = np.flatnonzero((body.t_s >= streams.t_s[0]) & (body.t_s <= streams.t_s[-1] + streams.sample_s))
    t_s = body.t_s[inside]
    attitudes = Attitudes(t_s, body.q[inside], np.full((t_s.size, 3), SMALLEST_SIGMA))
    recording = Recording("", "", gyro, attitudes, (Interval("whole", "", float(t_s[0]), float(t_s[-1])),))
    spans = [(first, stop) for first, stop in mapping.exclude or ()]
    return DataMask().exclude(recording, spans) if body.sensors else find_mask(recording, spans)


def _estimate_gyro(
    streams: Streams, mapping: Mapping, rates: Array, body: BodyAttitudes, windows: Motion, notes: list[str]
) -> tuple[GyroStream, list[tuple[int, int]], list[NDArray[np.intp]]]:
    """Estimate bias and noise of the body rates, find the rests, and choose the rows of the attitudes of each interval."""
    rests = find_rests(rates, streams.sample_s, compute_speed(body.t_s, body.q, streams.t_s))
    notes.append(f"{len(rests)} rest(s) found" if rests else "no rest found")
    notes += filter(None, [compare_rests(streams.t_s, rates, rests)[0]])
    bias = estimate_bias(mapping, rates, rests, windows, body, streams, notes)
    arw, degrees = estimate_walk(mapping, streams, rates, rests, notes)
    estimated = mapping.arw_deg_per_sqrt_s is None
    gyro = GyroStream(streams.t_s, rates, streams.sample_s, arw, np.eye(3), bias, estimated, degrees)
    return gyro, rests, choose_intervals(gyro, body, mapping, notes)


def _check_overlap(streams: Streams, body: BodyAttitudes) -> None:
    """Refuse tables with fewer than four attitudes within the gyro's time."""
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


def _evaluate_mapping(windows: Motion, mapping: Mapping, sensor: Sensor, G: Array | None) -> Agreement:
    """Compare rates and attitudes under the mapping and its alternatives."""
    _, (time_unit, *_) = parse_spec(mapping.time, "time")
    order = ""
    names, words = parse_spec(str(getattr(mapping, mapping.attitude)), mapping.attitude)
    if mapping.attitude == "quat":
        order = QUATERNION_ORDERS[0] if is_scalar_first(names, words) else QUATERNION_ORDERS[1]
    reverse = any(ATTITUDE_DIRECTIONS.get(word, False) for word in words)
    alternatives = _list_euler_readings(names, words, sensor) if windows.q.shape == sensor.q.shape else []
    time_unit = {"unix": "s"}.get(time_unit, time_unit)
    return evaluate_agreement(windows, mapping.gyro_unit, time_unit, order, reverse, alternatives, G, mapping.is_accumulated)


def _list_euler_readings(names: list[str], words: list[str], sensor: Sensor) -> list[AttitudeReading]:
    """List the attitudes of the Euler angles in each other sequence and unit, with the changes in words."""
    if sensor.angles is None:
        return []
    unit = "deg" if "deg" in words else "rad"
    direction = next(word for word in words if word in ATTITUDE_DIRECTIONS)
    stated = next(word for word in words if word.lower().strip("xyz") == "")
    out = []
    for sequence, unit_read in product(EULER_SEQUENCES, ("deg", "rad")):
        changes = (
            *([f"the Euler angles as {sequence}, not {stated}"] if sequence != stated else []),
            *([f"the Euler angles in {unit_read}, not {unit}"] if unit_read != unit else []),
        )
        if changes:
            text = f"{','.join(names)}:{unit_read}:{sequence}:{direction}"
            out.append(AttitudeReading(changes, convert_attitude("euler", text, sensor.angles)))
    return out


def _check_agreement(
    result: Agreement, streams: Streams, mapping: Mapping, rates: Array, body: BodyAttitudes, windows: Motion, notes: list[str]
) -> None:
    """Refuse rates and attitudes that do not fit each other; otherwise note the misfit.

    A small time offset is accepted and noted, since a diagnosis estimates a gyro's own delay. If the body turns far between two
    attitudes, their mean rates cannot be compared. Each attitude, propagated with the gyro as read, must then reach the next:
    a wrong reading does not do so several times by chance.
    """
    best = result.best
    kind = "" if best is None else best.kind
    if result.fits:
        notes.append(result.summary)
        if best is not None:
            notes.append(f"the calibration may start nearer: {best.sentence}")
        return
    late_s = MOST_LATE_SAMPLES * streams.sample_s
    if best is not None and kind == "named" and best.count == 1 and 0 < abs(best.offset_s) <= late_s and not mapping.unchecked:
        notes.append(f"{result.sentence}; an offset as small as this is not undone")
        return
    if kind != "named" and (kind != "alignment" or windows.is_coarse):
        try:
            gyro, _, interval_rows = _estimate_gyro(streams, mapping, rates, body, windows, [])
            miss = compute_largest_miss(gyro, body, interval_rows)
        except InputError:
            miss = np.inf
        if miss < LARGEST_ARRIVAL_MISS:
            notes.append(f"the gyro leads from each attitude used to the next within {np.rad2deg(miss):.2g} deg")
            return
    if not mapping.unchecked:
        raise InputError(result.sentence)
    notes.append(f"imported unchecked although {result.sentence}")


def _align(streams: Streams, mapping: Mapping, notes: list[str]) -> tuple[Streams, Mapping]:
    """Estimate the alignment from the rates of both sides; return streams and mapping with its significant parts applied."""
    accumulated = mapping.is_accumulated
    if mapping.mountings is not None:
        raise InputError("align: goes with no mountings of attitude sensors; give the sensors one by one")
    first = streams.sensors[0]
    alignment = estimate_alignment(streams.t_s, streams.raw @ streams.G.T, streams.sample_s, first.t_s, first.q, accumulated)
    if alignment is None or alignment.residual > USABLE_RESIDUAL:
        remainder = "" if alignment is None else f"; the best leaves {100 * alignment.residual:.0f} % of the motion"
        raise InputError(
            f"align: no time offset, clock rate, direction, mounting and factor make rates and attitudes fit{remainder}"
        )
    notes += alignment.describe()
    factor = alignment.time_factor if alignment.is_clock_off else 1.0
    scale = alignment.factor if alignment.is_scaled else 1.0
    t_s = streams.t_s[0] + factor * (streams.t_s - streams.t_s[0])
    raw = streams.raw * scale / (factor if accumulated else 1.0)
    sensors = tuple(
        replace(
            sensor,
            t_s=sensor.t_s + alignment.offset_s,
            q=np.asarray(Rotation.from_quat(sensor.q).inv().as_quat()) if alignment.reverse else sensor.q,
        )
        for sensor in streams.sensors
    )
    entries: dict[str, Any] = {
        "align": "as given",
        "common_start": True,
        "attitude_offset_s": mapping.attitude_offset_s + alignment.offset_s,
        "time_factor": mapping.time_factor * factor,
        "rate_factor": mapping.rate_factor * scale,
    }
    if alignment.reverse:
        entries[mapping.attitude] = _exchange_direction(str(getattr(mapping, mapping.attitude)))
    if alignment.is_turned and mapping.mounting != "estimate":
        entries["mounting"] = np.rad2deg(alignment.turn).tolist()
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
    """Replace the direction in the text of a mapping by the other one."""
    words = [word.strip() if word.strip() in ATTITUDE_DIRECTIONS else word for word in text.split(":")]
    return ":".join("-to-".join(word.split("-to-")[::-1]) if word in ATTITUDE_DIRECTIONS else word for word in words)


def _list_warnings(result: Agreement, mapping: Mapping, fit: Alignment | None, gyro: GyroStream, has_rest: bool) -> list[str]:
    """List implausible values, which are shown first."""
    out = []
    if result.residual > FITTING_RESIDUAL:
        out.append(f"rates and attitudes differ by {100 * result.residual:.0f} % of the motion")
    if not 1 / LARGEST_FACTOR <= mapping.rate_factor <= LARGEST_FACTOR:
        out.append(
            f"the rates are multiplied by {mapping.rate_factor:.4g}: is their unit, range or size of a count another one?"
        )
    if has_rest and fit is not None and mapping.bias_deg_s is None:
        bias_change = float(np.linalg.norm(fit.bias - gyro.apriori_bias))
        rms_rate = float(np.sqrt(np.mean(np.sum(np.square(gyro.rates + gyro.apriori_bias), axis=1))))
        if bias_change > LARGEST_START_BIAS_SHARE * rms_rate:
            off, rms = np.rad2deg([bias_change, rms_rate])
            out.append(f"the bias in motion is {off:.3g} deg/s off that of the rests, the RMS rate {rms:.3g}")
    return out
