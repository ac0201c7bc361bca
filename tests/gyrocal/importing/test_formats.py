"""EuRoC folders."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import gyrocal
from gyrocal import InputError
from gyrocal.importing import euroc
from tests.gyrocal.importing import mems, mems_log


@pytest.fixture(scope="module")
def log():
    return mems_log.log(np.random.default_rng(11), seconds=60.0)


def euroc_folder(root, log, turn):
    """A folder of the EuRoC form; the reference sensor is turned against the IMU."""
    (root / "mav0" / "imu0").mkdir(parents=True)
    (root / "mav0" / "vicon0").mkdir()
    gyro = pd.DataFrame({"#timestamp [ns]": log.gyro["timestamp_ms"] * 1_000_000})
    for axis in "xyz":
        gyro[f"w_RS_S_{axis} [rad s^-1]"] = np.deg2rad(log.gyro[f"g{axis}"])
    gyro.to_csv(root / "mav0" / "imu0" / "data.csv", index=False)
    q = Rotation.from_quat(np.roll(log.attitude[["qw", "qx", "qy", "qz"]].to_numpy(), -1, axis=1))
    q = np.roll((q * turn).as_quat(), 1, axis=1)
    table = pd.DataFrame({"#timestamp [ns]": log.attitude["timestamp_ms"] * 1_000_000, " p_RS_R_x [m]": 0.0})
    for k, element in enumerate("wxyz"):
        table[f" q_RS_{element} []"] = q[:, k]
    table.to_csv(root / "mav0" / "vicon0" / "data.csv", index=False)
    density = np.deg2rad(mems_log.MEMS_ARW_DEG_PER_SQRT_S)
    sheet = f"#Default imu sensor yaml file\nsensor_type: imu\nrate_hz: 100\ngyroscope_noise_density: {density}\n"
    (root / "mav0" / "imu0" / "sensor.yaml").write_text(sheet)
    T = np.eye(4)
    T[:3, :3] = turn.as_matrix()  # the reference sensor's axes to the body's, which are the IMU's
    data = ", ".join(f"{value:.15g}" for value in T.ravel())
    (root / "mav0" / "vicon0" / "sensor.yaml").write_text(f"T_BS:\n  cols: 4\n  rows: 4\n  data: [{data}]\n")
    return root


def test_a_euroc_folder_is_calibrated(run_cli, log, tmp_path):
    root = euroc_folder(tmp_path / "V1_01_easy", log, Rotation.from_rotvec([0.3, -1.2, 0.5]))
    done = run_cli("import", "euroc", str(root), str(tmp_path / "rec"))
    assert done.exit_code == 0, done.stderr
    recording = gyrocal.load(tmp_path / "rec")
    assert np.rad2deg(recording.gyro.arw) == pytest.approx(mems_log.MEMS_ARW_DEG_PER_SQRT_S, rel=1e-12)
    assert recording.title == "EuRoC form, V1_01_easy"
    assert mems.largest_error(recording, log) < 4


def test_the_noise_density_of_a_sensor_sheet(tmp_path):
    path = tmp_path / "sensor.yaml"
    for text in ("%YAML:1.0\ngyroscope_noise_density: 0.001\n", "gyroscope_noise_density: 1e-3\n"):
        path.write_text(text)
        assert np.deg2rad(euroc._read_noise_density(path)) == pytest.approx(1e-3)
    for text in ("update_rate: 200.0\n", "gyroscope_noise_density: fast\n", "a: [\n"):
        path.write_text(text)
        with pytest.raises(InputError, match=r"sensor\.yaml: "):
            euroc._read_noise_density(path)
