"""A late gyro diagnosed: the log of own_log.py, imported, diagnosed, and imported again with the attitudes' tags moved."""

import tempfile
from pathlib import Path

import numpy as np
import own_log

import gyrocal
from diagnosis.diagnose import diagnose
from gyrocal.calibration.verdict import format_p_value
from gyrocal.importing import import_csv
from studies.report.panels import BLUE, RED, Line, draw_panels, make_curves, save

rng, folder = np.random.default_rng(7), Path(tempfile.mkdtemp())
own_log.gyro(rng).to_csv(folder / "gyro.csv", index=False)
own_log.mocap(rng).to_csv(folder / "mocap.csv", index=False)
words = {"time": "time_ms:ms", "gyro": "gx,gy,gz:deg/s", "quat": "qw,qx,qy,qz:body-to-inertial"}


def calibrated(offset_s):
    """The recording with the attitudes' tags moved, and its calibration."""
    imported = import_csv(folder / "gyro.csv", folder / "mocap.csv", attitude_offset_s=offset_s, **words)
    return imported.recording, gyrocal.calibrate(imported.recording)


recording, first = calibrated(0.0)
cause = diagnose(recording).causes[0]
_, second = calibrated(float(f"{cause.size:.4f}"))
print(f"{' or '.join(cause.group)}: {cause.size:.4f} ± {cause.sigma:.4f} s")

results = (("as logged", first, RED, "."), ("attitudes 12 ms later", second, BLUE, "^"))
lines = [
    Line(one.residuals["t_s"], one.residuals["after_yaw_deg"], f"{name}: {format_p_value(one.p_value)}", colour, style, size=3)
    for name, one, colour, style in results
]
axes = {"title": "Yaw residuals after the calibration", "x": "s since the start", "y": "deg", "legend": "lower right"}
save(draw_panels(make_curves(lines, **axes), size=(6.5, 3.0)), Path("late_gyro.svg"))
