"""Does an import lead to a right calibration without an edit, and is a wrong mapping named?

Each case draws the log of a MEMS gyro beside motion capture (`studies.validation.mems_log`): two tables, deg/s, milliseconds of
unix time, quaternions with the scalar part first. They are imported by the mapping that is right, which tells nothing of bias,
noise or intervals, and calibrated as they are. Then ten mappings that are wrong in one thing each are tried on the same tables:
each must be refused with an error that names that thing, and nothing else, as what would fit.
"""

from __future__ import annotations

import re
from collections.abc import Mapping as Entries
from typing import Any

import numpy as np
import pandas as pd

from gyrocal import NAMES, InputError, calibrate
from gyrocal.importing import validate_mapping
from gyrocal.importing.build import build
from gyrocal.importing.streams import read_streams
from studies.montecarlo.statistics import check_mean_nees, compute_binomial_interval, tabulate_accuracy
from studies.montecarlo.study import Row, Streams, Study, StudyConfig
from studies.report.checks import Check, bound_above, bound_below
from studies.report.entry import Entry, Report
from studies.report.tables import Table
from studies.report.units import PPM_DEG_H, PPM_DEG_H_NAMES, name_columns
from studies.validation.mems_log import SECONDS, MemsLog, log

CORRECT_MAPPING: dict[str, Any] = {
    "time": "timestamp_ms:ms",
    "gyro": "gx,gy,gz:deg/s",
    "quat": "qw,qx,qy,qz:body-to-inertial",
}
OFFSET_S = 0.35
NEAR_S = 0.02  # how near a named time offset must come
# What is wrong, how, and what must be named; {} stands for a time offset.
WRONG_MAPPINGS: Entries[str, tuple[dict[str, Any], str]] = {
    "rad/s for deg/s": ({"gyro": "gx,gy,gz:rad/s"}, "the gyro in deg/s, not rad/s"),
    "deg/h for deg/s": ({"gyro": "gx,gy,gz:deg/h"}, "the gyro in deg/s, not deg/h"),
    "scalar last for first": (
        {"quat": "qw,qx,qy,qz:body-to-inertial:scalar-last"},
        "the quaternion's scalar part first (scalar-first)",
    ),
    "conjugate": ({"quat": "qw,qx,qy,qz:inertial-to-body"}, "the attitude from body to inertial (body-to-inertial)"),
    "axes swapped": ({"gyro": "gy,gx,gz:deg/s"}, "the gyro's axes as y,x,z"),
    "sign of an axis": ({"gyro": "gx,-gy,gz:deg/s"}, "the gyro's axes as x,-y,z"),
    "axes in a cycle": ({"gyro": "gy,gz,gx:deg/s"}, "the gyro's axes as z,x,y"),
    "s for ms": ({"time": "timestamp_ms:s"}, "times in ms, not s"),
    "us for ms": ({"time": "timestamp_ms:us"}, "times in ms, not us"),
    "time offset": ({"attitude_offset_s": OFFSET_S}, "{} s added to the attitudes' time tags"),
}
ERROR_BOUND_SIGMAS = 4.0  # sigma


class ImportConfig(StudyConfig):
    """What the study runs.

    Attributes
    ----------
    cases : logs
    seconds : length of each
    """

    cases: int = 100
    seconds: float = SECONDS


def find_refusal(data: MemsLog, changes: dict[str, Any]) -> str:
    """The error that a mapping with changes ends in; empty if it is taken."""
    mapping = validate_mapping(CORRECT_MAPPING | changes, "mapping")
    try:
        build(read_streams(data.gyro, data.attitude, mapping), mapping)
    except InputError as error:
        return str(error)
    return ""


def is_mapping_named(message: str, wanted: str) -> bool:
    """Whether a refusal names what is wanted as the only way that fits."""
    found = re.search(r" % with (.*?)(; --align auto finds and applies the offset)?$", message)
    if found is None or "{}" not in wanted:
        return found is not None and found.group(1) == wanted
    number = re.fullmatch(re.escape(wanted).replace(r"\{\}", r"([-+][\d.e-]+)"), found.group(1))
    return number is not None and abs(float(number.group(1)) + OFFSET_S) < NEAR_S


def run_case(config: ImportConfig, number: int, streams_of: Streams) -> list[Row]:
    """The calibration of an import, and a row for every wrong mapping."""
    data = log(streams_of.generator("log"), config.seconds)
    mapping = validate_mapping(CORRECT_MAPPING, "mapping")
    result = calibrate(build(read_streams(data.gyro, data.attitude, mapping), mapping).recording)
    error = result.parameters.vector - np.concatenate([data.G.ravel(), data.bias])
    row: dict[str, Any] = {"kind": "right", "named": True, "chi2_per_dof": result.chi2 / result.dof}
    row["nees"] = float(error @ np.linalg.solve(result.covariance, error))
    row |= dict(zip(name_columns("error"), (error * PPM_DEG_H).tolist(), strict=True))
    row |= dict(zip(name_columns("sigma"), (result.sigma * PPM_DEG_H).tolist(), strict=True))
    rows: list[Row] = [row]
    for kind, (changes, wanted) in WRONG_MAPPINGS.items():
        message = find_refusal(data, changes)
        rows.append({"kind": kind, "named": is_mapping_named(message, wanted), "message": message})
    return rows


STUDY = Study("studies.validation.imports:STUDY", ImportConfig, run_case)


def build_error_table(rows: pd.DataFrame) -> pd.DataFrame:
    """Errors of each parameter in its sigmas."""
    right = rows[rows["kind"] == "right"]
    errors, sigmas = right[name_columns("error")].to_numpy(float), right[name_columns("sigma")].to_numpy(float)
    z, accuracy = errors / sigmas, tabulate_accuracy(errors, sigmas, NAMES, PPM_DEG_H_NAMES)
    return pd.DataFrame(
        {
            "parameter": NAMES,
            "unit": PPM_DEG_H_NAMES,
            "sigma": sigmas.mean(axis=0),
            "rms_error": np.sqrt(np.mean(np.square(errors), axis=0)),
            "mean_in_standard_errors": accuracy["bias_in_standard_errors"],
            "largest_error_in_sigma": np.abs(z).max(axis=0),
            f"share_within_{ERROR_BOUND_SIGMAS:g}_sigma": np.mean(np.abs(z) <= ERROR_BOUND_SIGMAS, axis=0),
        }
    )


def count_named_mappings(rows: pd.DataFrame) -> pd.DataFrame:
    """Count how often each wrong mapping is named, with an interval of 95 %."""
    out = []
    for kind in WRONG_MAPPINGS:
        part = rows[rows["kind"] == kind]["named"].astype(bool)
        low, high = compute_binomial_interval(int(part.sum()), len(part))
        out.append({"wrong": kind, "trials": len(part), "named": int(part.sum()), "low": low, "high": high})
    return pd.DataFrame(out)


NEES = "The mean NEES of the twelve parameters; its bounds are those of a consistent covariance at 99 %."


def report(config: ImportConfig, rows: pd.DataFrame) -> Report:
    """Errors in sigmas, and how often a wrong mapping is named."""
    table, named = build_error_table(rows), count_named_mappings(rows)
    found = check_mean_nees(rows[rows["kind"] == "right"]["nees"], len(NAMES))
    checks = [
        Check(
            "largest error of a parameter",
            float(table["largest_error_in_sigma"].max()),
            bound_above(ERROR_BOUND_SIGMAS),
            "sigma",
        ),
        Check("mean NEES", found.value, (found.lower, found.upper), "", NEES),
    ]
    for line in named.to_dict("records"):
        checks.append(Check(f"named: {line['wrong']}", line["named"] / line["trials"], bound_below(0.95)))
    tables = {
        "parameters": Table("Calibration of an import, nothing edited", table),
        "named": Table("Wrong mappings, and how often the right one is named alone", named),
    }
    return Report(tables, {}, tuple(checks))


ENTRY = Entry(STUDY, "somebody's tables: is the calibration of an import right, and is a wrong mapping named?", report)
