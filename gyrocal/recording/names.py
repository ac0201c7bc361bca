"""Names of the tables and columns of a recording's files."""

from __future__ import annotations

from gyrocal.recording import sensor_tables

TRIAD = ("x", "y", "z")
RATE_COLUMNS = ("rate_x_deg_s", "rate_y_deg_s", "rate_z_deg_s")
QUATERNION_COLUMNS = ("q1", "q2", "q3", "q4")
SIGMA_COLUMNS = ("sigma_x_deg", "sigma_y_deg", "sigma_z_deg")
CORRELATION_COLUMNS = ("rho_xy", "rho_xz", "rho_yz")  # optional, of the errors of an attitude about two body axes
OPTIONAL_TABLES = ("housekeeping", *sensor_tables.SENSOR_TABLE_NAMES)
