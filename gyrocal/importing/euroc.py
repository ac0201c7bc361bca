"""Folders of the EuRoC form (ASL dataset format).

``mav0/imu0/data.csv`` holds nanoseconds of unix time and rates in rad/s about the IMU's axes S; ``imu0/sensor.yaml`` the gyro's
noise density, which is the angle random walk. A reference folder, such as ``vicon0`` or ``state_groundtruth_estimate0``, has
quaternions with the scalar part first that take the axes of its own sensor R to the world; ``T_BS`` of its ``sensor.yaml``
takes that sensor's axes to the body's, whose axes are the IMU's where ``T_BS`` of ``imu0`` is the identity.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array
from gyrocal.errors import InputError
from gyrocal.importing import import_tables, validate_mapping
from gyrocal.importing.build import ImportResult
from gyrocal.importing.streams import read_csv

REFERENCE_FOLDERS = ("vicon0", "state_groundtruth_estimate0", "mocap0")
RATES = tuple(f"w_RS_S_{axis}" for axis in "xyz")
EUROC_QUATERNION_COLUMNS = tuple(f"q_RS_{element}" for element in "wxyz")
ESTIMATED = "state_groundtruth_estimate0"


def import_euroc(
    folder: str | os.PathLike[str], reference: str | None = None, stated_noise: bool = True, **entries: Any
) -> ImportResult:
    """Import a folder of the EuRoC form as a recording.

    An `InputError` if a file or a column is missing, or rates and attitudes do not fit each other.

    Parameters
    ----------
    folder : with mav0 in it, or mav0 itself
    reference : the folder with the attitudes; the first of `REFERENCE_FOLDERS` that is there by default
    stated_noise : whether the noise density of ``imu0/sensor.yaml`` is used; otherwise it is estimated
    entries : of the mapping, beyond the columns
    """
    folder = Path(folder)
    root = folder / "mav0" if (folder / "mav0").is_dir() else folder
    existing = [name for name in REFERENCE_FOLDERS if (root / name / "data.csv").is_file()]
    if not (root / "imu0" / "data.csv").is_file() or not (existing or reference):
        raise InputError(
            f"{folder}: not a folder of the EuRoC form: mav0/imu0/data.csv and one of {', '.join(REFERENCE_FOLDERS)}"
        )
    reference_folder = reference or existing[0]
    gyro, attitude = read_csv(root / "imu0" / "data.csv"), read_csv(root / reference_folder / "data.csv")
    notes = [f"attitudes are those of {reference_folder}"]
    if reference_folder == ESTIMATED:
        notes.append(f"{ESTIMATED} was estimated with the gyro itself: what it says of the gyro is not independent of it")
    sheet = root / "imu0" / "sensor.yaml"
    if stated_noise and "arw_deg_per_sqrt_s" not in entries and sheet.is_file():
        entries["arw_deg_per_sqrt_s"] = _read_noise_density(sheet)
        notes.append("the angle random walk is the noise density of imu0/sensor.yaml")
    names = _find_columns(attitude, EUROC_QUATERNION_COLUMNS, reference_folder)
    rotation = _read_turn(root, reference_folder)
    if np.abs(rotation - np.eye(3)).max() > 1e-9:
        q = np.roll(attitude[names].to_numpy(dtype=float), -1, axis=1)
        # q takes the reference sensor's axes to the world, and T_BS those of the IMU to them.
        attitude[names] = np.roll((Rotation.from_quat(q) * Rotation.from_matrix(rotation)).as_quat(), 1, axis=1)
        notes.append("the attitudes are turned from the reference sensor's axes to the IMU's by the T_BS of both")
    rates = _find_columns(gyro, RATES, "imu0")
    gyro = gyro[[gyro.columns[0], *rates]]  # no other column can count samples or number gyros
    columns = {
        "time": f"{gyro.columns[0]}:ns",
        "attitude_time": f"{attitude.columns[0]}:ns",
        "gyro": f"{','.join(rates)}:rad/s",
        "quat": f"{','.join(names)}:scalar-first:body-to-world",
        "title": f"EuRoC form, {root.resolve().parent.name}",
    }
    return import_tables(gyro, attitude, validate_mapping(columns | entries, str(folder)), said=notes)


def _read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML file of keys and values; OpenCV's first line is skipped."""
    try:
        import yaml
    except ImportError:
        raise InputError(f"{path}: PyYAML is needed to read it: pip install 'gyrocal[formats]'") from None
    try:
        text = path.read_text(encoding="utf-8")
        values = yaml.safe_load("\n".join(line for line in text.splitlines() if not line.startswith("%")))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as fault:
        raise InputError(f"{path}: cannot be read as YAML: {' '.join(str(fault).split())}") from None
    if not isinstance(values, dict):
        raise InputError(f"{path}: not a file of keys and values")
    return values


def _read_noise_density(path: Path) -> float:
    """Read the angle random walk of a sensor.yaml, deg/sqrt(s): rad/s/sqrt(Hz) is rad/sqrt(s)."""
    value = _read_yaml(path).get("gyroscope_noise_density")
    if isinstance(value, str):  # YAML 1.1 takes 1e-3, without a point, for a text
        with suppress(ValueError):
            value = float(value)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1:
        raise InputError(f"{path}: gyroscope_noise_density must be a positive number of rad/s/sqrt(Hz)")
    return float(np.rad2deg(value))


def _find_columns(table: pd.DataFrame, wanted: tuple[str, ...], where: str) -> list[str]:
    """Find columns by the first word of their names, as in "w_RS_S_x [rad s^-1]"."""
    column_by_name = {str(name).split()[0]: str(name) for name in table.columns}
    missing = [name for name in wanted if name not in column_by_name]
    if missing:
        raise InputError(f"{where}/data.csv: no column {', '.join(missing)}; there are {', '.join(column_by_name)}")
    return [column_by_name[name] for name in wanted]


def _read_turn(root: Path, reference: str) -> Array:
    """Read the rotation (3, 3) from the IMU's axes to those of the reference sensor; the identity if no file states it."""
    rotations = []
    for name in (reference, "imu0"):
        path = root / name / "sensor.yaml"
        matrix = _read_yaml(path).get("T_BS") if path.is_file() else None
        data = np.array(matrix["data"], dtype=float) if isinstance(matrix, dict) and "data" in matrix else np.eye(4)
        R = data.reshape(4, 4)[:3, :3] if data.size == 16 else np.zeros((3, 3))
        if np.abs(R @ R.T - np.eye(3)).max() > 1e-3:
            raise InputError(f"{path}: T_BS is not a rigid motion of 4×4 numbers")
        rotations.append(np.asarray(Rotation.from_matrix(R).as_matrix()))
    # T_BS takes a sensor's axes to the body's.
    return np.asarray(rotations[0].T @ rotations[1])
