"""Names of gyros, and of the tables and columns of a recording's files."""

from __future__ import annotations

import re
from collections.abc import Sequence

from gyrocal.recording import sensor_tables

TRIAD = ("x", "y", "z")  # names of the three gyros of format 1
GYRO_NAME = re.compile(r"[A-Za-z_]*[0-9]+")  # of any other; ends with a digit, so that no body axis looks like it
MOST_GYROS = 24
RATE_COLUMNS = ("rate_x_deg_s", "rate_y_deg_s", "rate_z_deg_s")
QUATERNION_COLUMNS = ("q1", "q2", "q3", "q4")
SIGMA_COLUMNS = ("sigma_x_deg", "sigma_y_deg", "sigma_z_deg")
CORRELATION_COLUMNS = ("rho_xy", "rho_xz", "rho_yz")  # optional, of the errors of an attitude about two body axes
OPTIONAL_TABLES = ("housekeeping", *sensor_tables.SENSOR_TABLE_NAMES)


def list_rate_columns(names: Sequence[str]) -> tuple[str, ...]:
    """Columns of the gyros' rates on file."""
    return tuple(f"rate_{name}_deg_s" for name in names)


def check_names(names: tuple[str, ...]) -> None:
    """Raise a `ValueError` for names that are neither x, y and z nor those of other gyros."""
    if names == TRIAD:
        return
    wrong = [name for name in names if not GYRO_NAME.fullmatch(name)]
    if wrong or len(set(names)) < len(names):
        raise ValueError(f"must be x, y and z, or different names of letters with digits at the end, such as g1; not {names}")
