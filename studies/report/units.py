"""Units at the edge: of the twelve parameters in tables, and of a column by the end of its name."""

import re

import numpy as np

from gyrocal.arrays import Array
from gyrocal.calibration.parameters import NAMES

# Factors from G (dimensionless) and b (rad/s) to these units, (12,).
PPM_DEG_H: Array = np.array([1e6] * 9 + [np.rad2deg(1.0) * 3600] * 3)
ONE_DEG_S: Array = np.array([1.0] * 9 + [np.rad2deg(1.0)] * 3)
PPM_DEG_H_NAMES = ("ppm",) * 9 + ("deg/h",) * 3
ONE_DEG_S_NAMES = ("1",) * 9 + ("deg/s",) * 3

# Endings of column names, the longer before those they end with.
ENDINGS = {
    "deg_per_sqrt_s": "deg/√s",
    "deg_s": "deg/s",
    "deg_h": "deg/h",
    "mdeg": "mdeg",
    "deg": "deg",
    "arcsec": "arcsec",
    "ppm": "ppm",
    "bits": "bits",
    "ms": "ms",
    "s": "s",
}
WITH_UNIT = re.compile(rf"(?P<name>.+?)_(?P<ending>{'|'.join(ENDINGS)})(?P<statistic>(?:_max|_median)?)")
PARAMETER = re.compile(r"\b(G|b) ([xyz]{1,2})\b")


def name_columns(quantity: str) -> list[str]:
    """Name the columns of a quantity of the twelve parameters in ppm and deg/h, such as error_G_xx_ppm."""
    return [f"{quantity}_{name}_{unit.replace('/', '_')}" for name, unit in zip(NAMES, PPM_DEG_H_NAMES, strict=True)]


def format_heading(column: str) -> str:
    """Format a column's name for people: words in place of underscores, and its unit in brackets."""
    if match := WITH_UNIT.fullmatch(column):
        return f"{format_heading(match['name'] + match['statistic'])} ({ENDINGS[match['ending']]})"
    return PARAMETER.sub(r"\1_\2", column.replace("_", " "))
