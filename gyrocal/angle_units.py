"""Units of angle and of angular rate by name, in rad and rad/s."""

import math

DEGREE = math.radians(1.0)
ANGLE_UNITS = {"rad": 1.0, "deg": DEGREE, "arcsec": DEGREE / 3600}
RATE_UNITS = {
    "rad/s": 1.0,
    "deg/s": DEGREE,
    "deg/h": DEGREE / 3600,
    "mrad/s": 1e-3,
    "mdeg/s": 1e-3 * DEGREE,
    "arcsec/s": DEGREE / 3600,
}
