"""Real recordings beside the checkout are imported by one command, and the alignment is that of an independent fit."""

import re

import pytest

from tests import SHARED

REAL = SHARED / "real"
ADC = [
    *("--time", "ts:unix", "--gyro", "wx,wy,wz:counts", "--lsb", "0.9687 deg/s", "--align", "auto", "--matrix"),
    ",".join(f"r{k}" for k in range(9)) + ":body-to-world",
]
GRACE = [
    *("--time", "t:s", "--gyro", "angle:deg", "--gyro-by", "gyro", "--attitude-by", "cam"),
    *("--quat", "q0,q1,q2,q3:scalar-first:body-to-inertial"),
]
SENTINEL = [
    *("--time", "t_s:s", "--gyro", "raw_angle_counts:counts", "--lsb", "5e-9 rad", "--gyro-by", "gyro", "--attitude-by", "str"),
    *("--axes", "tetrahedron", "--mounting", "estimate", "--quat", "q1,q2,q3,q4:scalar-last:body-to-inertial"),
]
OFFSET = r"time offset by the rates: (\S+) ± (\S+) s"
# Files, options, a number that the import states and its range by the independent fits of the recordings' README.
COMMANDS = {
    "ADC": ("csv", ["adc/imu1.csv", "adc/vicon1.csv"], ADC, OFFSET, (-0.022, -0.021)),
    "GRACE-FO": ("csv", ["gracefo/imu_C.csv", "gracefo/sca_C.csv"], GRACE, "", ()),
    # No independent fit of BROAD's time offset is known; those of its eight trials and three units agree to 0.1 ms.
    "BROAD": ("broad", ["broad/07_undisturbed_fast_rotation_B.parquet"], [], OFFSET, (0.0058, 0.0061)),
    "Sentinel-2A": ("csv", ["sentinel2a/imu.csv", "sentinel2a/str.csv"], SENTINEL, "differ by (.*) % of the motion", (0, 5)),
}


@pytest.mark.skipif(not REAL.is_dir(), reason="the real recordings are not beside this checkout")
@pytest.mark.parametrize("name", COMMANDS)
def test_one_command_imports_a_real_recording(run_cli, tmp_path, name):
    kind, files, options, words, room = COMMANDS[name]
    done = run_cli("import", kind, *(str(REAL / file) for file in files), str(tmp_path / "out"), *options)
    assert done.exit_code == 0, done.stderr
    if not words:
        return
    said = re.search(words, " ".join(done.stdout.split()))
    assert said, done.stdout
    value, sigma = float(said[1]), float(said[2]) if said.lastindex > 1 else 0.0
    assert sigma < 0.03
    assert room[0] - 3 * sigma <= value <= room[1] + 3 * sigma
