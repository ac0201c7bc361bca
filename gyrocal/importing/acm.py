"""CCSDS Attitude Comprehensive Messages (504.0-B-2, section 5) in KVN and XML: attitudes, a gyro's bias, and their variances.

Times are seconds from EPOCH_TZERO. A line of COV is the diagonal of a covariance: variances in deg² about the axes of
COV_REF_FRAME, then, with ANGLE_GYROBIAS, those of the gyro's bias in (deg/s)². SIGMA_V of AD, in deg/√s, is the angle
random walk.

GYRO_BIAS is defined in annex B4 as the "correction to gyro estimated angular velocity", and in no other place. What is written
is what has to be added, b of ω = G ω_raw + b, and a comment says so. Its name, and the SIGMA_U and SIGMA_V of the same message,
are those of Farrenkopf's model ω_measured = ω + bias + noise, whose bias is taken off: other writers may mean that. So no sign
is taken for granted on reading; what is read is returned with the sign that it has on file, and no recording starts from it.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal.errors import InputError
from gyrocal.importing import ccsds
from gyrocal.importing.aem import Aem
from gyrocal.recording import Recording, find_reference_rows

Array = NDArray[np.float64]

ACM_REQUIRED_KEYS = ("TIME_SYSTEM", "EPOCH_TZERO")
ATT_NEEDED = ("REF_FRAME_A", "REF_FRAME_B", "ATT_TYPE")
ATT_KNOWN = (*ATT_NEEDED, "ATT_ID", "ATT_PREV_ID", "ATT_BASIS", "ATT_BASIS_ID", "NUMBER_STATES", "RATE_TYPE", "EULER_ROT_SEQ")
GYRO_BIAS_STATE = "ANGLE_GYROBIAS"
SIGN = "GYRO_BIAS is the correction to be added about the body axes: w = G w_raw + GYRO_BIAS"


@dataclass(frozen=True)
class Acm:
    """What a message says of attitude and gyro; None where it says nothing.

    Attributes
    ----------
    attitudes : of all its attitude blocks, one after another
    sigma : (3,) root mean square 1-sigma about the body's axes, rad
    gyro_bias : (m, 3) rad/s at the attitudes, of the sign that it has on file
    gyro_bias_sigma : (3,) 1-sigma of its last line, rad/s
    arw : angle random walk, rad/sqrt(s)
    """

    attitudes: Aem
    sigma: Array | None
    gyro_bias: Array | None
    gyro_bias_sigma: Array | None
    arw: float | None


def read_acm(path: str | os.PathLike[str]) -> Acm:
    """Read a message.

    Raises
    ------
    InputError
        It is no ACM of version 2, or has no attitudes that a recording can hold.
    """
    path = Path(path)
    _, blocks = ccsds.read(path, "ACM")
    meta = next((block.entries for block in blocks if block.kind == "META"), {})
    ccsds.check_keywords(meta, ACM_REQUIRED_KEYS, path)
    system = meta["TIME_SYSTEM"]
    scale = ccsds.read_scale(system, path)
    try:
        zero = ccsds.parse_time(meta["EPOCH_TZERO"], system)
    except ValueError as fault:
        raise InputError(f"{path}: EPOCH_TZERO: {fault}") from None
    times: list[tuple[int, float]] = []
    rows: list[Array] = []
    biases: list[Array] = []
    ends = set()
    for block in blocks:
        if block.kind != "ATT":
            continue
        ccsds.check_keywords(block.entries, ATT_NEEDED, path, ATT_KNOWN)
        if block.entries["ATT_TYPE"].upper() != "QUATERNION":
            raise InputError(f"{path}: attitude type {block.entries['ATT_TYPE']} is not read; read is QUATERNION")
        ends.add(ccsds.identify_frames(block.entries, path))
        biased = block.entries.get("RATE_TYPE", "").upper() == "GYRO_BIAS"
        for where, words in block.lines:
            numbers = ccsds.parse_numbers(words[1:], 7 if biased else 4, path, where)
            times.append(_parse_message_time(words[0], zero, system, path, where))
            rows.append(numbers[:4])
            biases += [np.deg2rad(numbers[4:7])] if biased else []
    if len(ends) > 1:
        raise InputError(f"{path}: its attitude blocks have different frames; give one message for each")
    inertial, body, conjugate = ends.pop() if ends else ("", "", False)
    clock, q = ccsds.build_attitudes(times, rows, scale, conjugate, path)
    angles, bias_variance = _read_variances([block for block in blocks if block.kind == "COV"], path)
    return Acm(
        attitudes=Aem(clock, q, meta.get("OBJECT_NAME", path.stem), (inertial, body)),
        sigma=None if angles is None else np.sqrt(np.mean(angles, axis=0)),
        gyro_bias=np.array(biases) if len(biases) == len(rows) else None,
        gyro_bias_sigma=None if bias_variance is None else np.sqrt(bias_variance),
        arw=_read_walk([block for block in blocks if block.kind == "AD"], path),
    )


def extract_noise(message: Acm) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Entries of a mapping with the noise that a message states, and what is said of it."""
    entries: dict[str, Any] = {}
    said = []
    if message.sigma is not None and (message.sigma > 0).all():
        entries["sigma_deg"] = np.rad2deg(message.sigma).tolist()
        said.append("sigma of the references is the root mean square of the message's; errors that they share are not told")
    if message.arw:
        entries["arw_deg_per_sqrt_s"] = float(np.rad2deg(message.arw))
        said.append("the angle random walk is the message's SIGMA_V")
    if message.gyro_bias is not None:
        values = ", ".join(f"{value:.4g}" for value in np.rad2deg(message.gyro_bias[0]))
        said.append(f"the message's GYRO_BIAS of {values} deg/s is not used: its sign is not told")
    return entries, tuple(said)


def _parse_message_time(word: str, zero: tuple[int, float], system: str, path: Path, where: str) -> tuple[int, float]:
    """A time of its own, or seconds from another."""
    try:
        if "T" in word.upper():
            return ccsds.parse_time(word, system)
        since = float(word)
        floor = int(np.floor(since + zero[1]))
        return zero[0] + floor, since + zero[1] - floor
    except (ValueError, OverflowError) as fault:
        raise InputError(f"{path}: {where}: {fault}") from None


def _read_variances(blocks: list[ccsds.Block], path: Path) -> tuple[Array | None, Array | None]:
    """Variances of angles (k, 3) rad² about the body's axes, and of the gyro's bias (3,) (rad/s)²."""
    angles: list[Array] = []
    bias = None
    for block in blocks:
        kind, frame = block.entries.get("COV_TYPE", "").upper(), block.entries.get("COV_REF_FRAME", "")
        if not kind.startswith("ANGLE") or not frame.upper().startswith(ccsds.BODY_FRAMES):
            continue
        for where, words in block.lines:
            values = ccsds.parse_numbers(words[1:], 6 if kind == GYRO_BIAS_STATE else 3, path, where) * np.deg2rad(1.0) ** 2
            if (values < 0).any():
                raise InputError(f"{path}: {where}: a variance is negative")
            angles.append(values[:3])
            bias = values[3:6] if kind == GYRO_BIAS_STATE else bias
    return (np.array(angles) if angles else None), bias


def _read_walk(blocks: list[ccsds.Block], path: Path) -> float | None:
    text = next((block.entries["SIGMA_V"] for block in blocks if "SIGMA_V" in block.entries), None)
    if text is None:
        return None
    (value,) = ccsds.parse_numbers(text.partition("[")[0].split(), 1, path, "SIGMA_V")[:1]
    return float(np.deg2rad(value))


def write_acm(
    recording: Recording,
    path: str | os.PathLike[str],
    *,
    bias: ArrayLike | None = None,
    bias_sigma: ArrayLike | None = None,
    object_name: str = "UNKNOWN",
    object_id: str = "UNKNOWN",
    frame: str = "ICRF",
    form: ccsds.Form = "kvn",
) -> None:
    """Write the reference attitudes with their variances and, of a calibration, the gyro's bias with its.

    Parameters
    ----------
    recording : its time scale must be UTC or GPS
    path : file
    bias, bias_sigma : (3,) b of ω = G ω_raw + b and its 1-sigma, rad/s, as in a `CalibrationResult`; both or neither
    object_name, object_id : of the spacecraft
    frame : the inertial one, REF_FRAME_A
    form : "kvn" or "xml"

    Raises
    ------
    InputError
        The recording's times have no date, or a bias has no sigma.
    """
    scale, epoch = ccsds.require_dates(recording, "an ACM")
    rates, variances = _format_bias(bias, bias_sigma)
    kind = GYRO_BIAS_STATE if rates else "ANGLE"
    ends = {"REF_FRAME_A": frame, "REF_FRAME_B": ccsds.SPACECRAFT_BODY_FRAME}
    att_head = {"COMMENT": SIGN} if rates else {}
    att_head |= ends | {"NUMBER_STATES": str(4 + len(rates)), "ATT_TYPE": "QUATERNION"}
    att_head |= {"RATE_TYPE": "GYRO_BIAS"} if rates else {}
    cov_head = {"COV_BASIS": "DETERMINED_GND", "COV_REF_FRAME": ccsds.SPACECRAFT_BODY_FRAME, "COV_TYPE": kind}
    states, covariances = [], []
    for interval in recording.intervals:
        references = recording.attitudes
        chosen = find_reference_rows(references.t_s, interval)
        times = ccsds.format_numbers(references.t_s[chosen])
        att = [("", [t, *ccsds.format_numbers(q), *rates]) for t, q in zip(times, references.quaternions[chosen], strict=True)]
        squares = np.square(np.rad2deg(references.sigma[chosen]))
        cov = [("", [t, *ccsds.format_numbers(one), *variances]) for t, one in zip(times, squares, strict=True)]
        states.append(ccsds.Block("ATT", dict(att_head), att))
        covariances.append(ccsds.Block("COV", dict(cov_head), cov))
    determination = {"AD_METHOD": "BATCH", "ATTITUDE_SOURCE": "GND", "ATTITUDE_STATES": "QUATERNION", "COV_TYPE": kind}
    determination |= ends | {"RATE_STATES": "GYRO_BIAS", "SIGMA_V": ccsds.format_numbers([np.rad2deg(recording.gyro.arw)])[0]}
    blocks = [*states, *covariances, *([ccsds.Block("AD", determination)] if rates else [])]
    meta = {
        "OBJECT_NAME": object_name,
        "INTERNATIONAL_DESIGNATOR": object_id,
        "TIME_SYSTEM": scale,
        "EPOCH_TZERO": ccsds.format_time(epoch, 0.0),
        "ACM_DATA_ELEMENTS": ", ".join(block.kind for block in blocks),
    }
    blocks.insert(0, ccsds.Block("META", meta))
    ccsds.write(path, "ACM", blocks, recording.title, form)


def _format_bias(bias: ArrayLike | None, sigma: ArrayLike | None) -> tuple[list[str], list[str]]:
    """b in deg/s, and its variances in (deg/s)², as they are written; nothing without a bias."""
    if bias is None and sigma is None:
        return [], []
    b, s = np.asarray(bias, dtype=np.float64), np.asarray(sigma, dtype=np.float64)
    if b.shape != (3,) or s.shape != (3,) or not np.isfinite(b).all() or not (s > 0).all():
        raise InputError(
            "ACM: bias and bias_sigma are three numbers each, in rad/s; a held bias has no sigma and is not written"
        )
    return ccsds.format_numbers(np.rad2deg(b)), ccsds.format_numbers(np.square(np.rad2deg(s)))
