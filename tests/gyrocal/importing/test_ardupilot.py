"""DataFlash logs, written byte by byte: a format message for each kind, then records of header, type and fields."""

import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import gyrocal
from gyrocal import InputError
from gyrocal.importing import ardupilot
from studies.validation import mems_log
from tests.gyrocal.importing import mems

pytest.importorskip("pymavlink.DFReader", reason="the extra ardupilot is not installed")

CODES = {"Q": "Q", "B": "B", "f": "f", "c": "h", "C": "H", "n": "4s", "N": "16s", "Z": "64s"}
FORMATS = {  # type, format and fields
    "FMT": (0x80, "BBnNZ", "Type,Length,Name,Format,Columns"),
    "GYR": (0x81, "QBQfff", "TimeUS,I,SampleUS,GyrX,GyrY,GyrZ"),
    "IMU": (0x82, "QBffff", "TimeUS,I,GyrX,GyrY,GyrZ,T"),
    "ATT": (0x83, "QccC", "TimeUS,Roll,Pitch,Yaw"),
    "IMU2": (0x84, "Qfff", "TimeUS,GyrX,GyrY,GyrZ"),  # before messages had a field I
}
BOOT_US = 5_000_000
LATE_US = 700  # between a sample of GYR and its message
WORDS = {"attitude_time": "timestamp_ms:ms", "quat": "qw,qx,qy,qz:body-to-world"}
OPTIONS = ("--attitude-time", WORDS["attitude_time"], "--quat", WORDS["quat"])


def record(name, *values):
    kind, form, _ = FORMATS[name]
    return b"\xa3\x95" + bytes([kind]) + struct.pack("<" + "".join(CODES[code] for code in form), *values)


def write_bin(path, records):
    """A file of records (name, fields), each kind's format first."""
    out = b""
    for name in dict.fromkeys(["FMT", *(name for name, *_ in records)]):
        kind, form, fields = FORMATS[name]
        length = 3 + struct.calcsize("<" + "".join(CODES[code] for code in form))
        out += record("FMT", kind, length, name.encode(), form.encode(), fields.encode())
    path.write_bytes(out + b"".join(record(*one) for one in records))
    return path


@pytest.fixture(scope="module")
def log():
    return mems_log.log(np.random.default_rng(21), seconds=60.0)


@pytest.fixture
def attitude(log, tmp_path):
    log.attitude.to_csv(tmp_path / "mocap.csv", index=False)
    return tmp_path / "mocap.csv"


def read_rates(log):
    """(n, 3) rad/s and µs of the ends of the samples."""
    t = BOOT_US + 1000 * (log.gyro["timestamp_ms"].to_numpy() - mems_log.UNIX_MS) + 10_000
    return np.deg2rad(log.gyro[["gx", "gy", "gz"]].to_numpy()), t


def warm(t):
    return 30.0 + 1e-7 * (t - BOOT_US)  # °C


def gyr(w, t, instance=0):
    return [("GYR", int(at) + LATE_US, instance, int(at), *row) for at, row in zip(t, w, strict=True)]


def imu(w, t, instance=0):
    return [("IMU", int(at), instance, *row, warm(at)) for at, row in zip(t, w, strict=True)]


def att(q_scalar_first, t):
    angles = Rotation.from_quat(np.roll(q_scalar_first, -1, axis=1)).as_euler("ZYX", degrees=True)
    hundredths = np.round(100 * (angles % [360, 1e9, 1e9] * [1, 0, 0] + angles * [0, 1, 1])).astype(int)
    return [("ATT", int(at), roll, pitch, yaw % 36000) for at, (yaw, pitch, roll) in zip(t, hundredths, strict=True)]


def test_one_gyro_of_two_is_imported_and_calibrated(run_cli, log, attitude, tmp_path):
    w, t = read_rates(log)
    other = w + np.deg2rad([1.0, -2.0, 3.0])  # a second gyro with another bias
    mixed = [one for pair in zip(gyr(w, t), gyr(other, t, 1), strict=True) for one in pair]
    path = write_bin(tmp_path / "log.bin", [*imu(w[::4], t[::4]), *mixed])
    for number, bias in ((None, log.bias), (1, log.bias - log.G @ np.deg2rad([1.0, -2.0, 3.0]))):
        chosen = [] if number is None else ["--instance", str(number)]
        out = tmp_path / f"rec{number}"
        words = ["import", "ardupilot", str(path), str(attitude), str(out), *OPTIONS, *chosen, "--attitude-offset"]
        done = run_cli(*words, str((BOOT_US / 1e3 - mems_log.UNIX_MS) / 1e3))
        assert done.exit_code == 0, done.stderr
        recording = gyrocal.load(out)
        assert recording.gyro.t_s.size == len(w)
        result = gyrocal.calibrate(recording)
        error = result.parameters.vector - np.concatenate([log.G.ravel(), bias])
        assert np.abs(error / result.sigma).max() < 4
    # The temperature is that of IMU of the same instance, which the second gyro does not have.
    assert "housekeeping" not in recording.tables
    warmth = gyrocal.load(tmp_path / "recNone").tables["housekeeping"]
    np.testing.assert_allclose(warmth["t_s"].to_numpy()[0], BOOT_US / 1e6 + 0.01, atol=1e-9)
    inside = warmth["t_s"] * 1e6 <= t[::4][-1]
    np.testing.assert_allclose(warmth["gyro_temperature_c"][inside], warm(1e6 * warmth["t_s"])[inside], atol=1e-5)


def test_align_finds_the_offset_of_dates(log, attitude, tmp_path):
    w, t = read_rates(log)
    imported = ardupilot.import_ardupilot(write_bin(tmp_path / "log.bin", gyr(w, t)), attitude, align="auto", **WORDS)
    assert mems.largest_error(imported.recording, log) < 4


def test_the_faster_message_is_read_and_said(log, tmp_path):
    w, t = read_rates(log)
    path = write_bin(tmp_path / "a.bin", [*gyr(w[::4], t[::4]), *imu(w, t), *imu(w[::2], t[::2], 2)])
    gyro, filters, said, tag = ardupilot.read_ardupilot(path)
    np.testing.assert_allclose(gyro[["x", "y", "z"]], w, rtol=1e-6)
    np.testing.assert_array_equal(gyro["t"], t)
    assert (tag, filters) == ("middle", {})
    assert said == [
        "rates are those of IMU:0 at 100 Hz: ArduPilot has subtracted its own calibration's offsets and filtered them",
        "not taken: GYR:0 at 25 Hz (slower)",
        "not taken: IMU:2 at 50 Hz (--instance)",
    ]
    old = write_bin(tmp_path / "b.bin", [("IMU2", 7, 0.1, 0.2, 0.3), ("IMU2", 9, 0.1, 0.2, 0.3)])
    gyro, _, said, _ = ardupilot.read_ardupilot(old, 1)
    np.testing.assert_allclose(gyro.to_numpy(), [[0.1, 0.2, 0.3, 7], [0.1, 0.2, 0.3, 9]], rtol=1e-6)
    assert said[0].startswith("rates are those of IMU:1")


def test_the_filter_is_no_reference(log, attitude, tmp_path):
    w, t = read_rates(log)
    q, t_q = log.attitude[["qw", "qx", "qy", "qz"]].to_numpy(), BOOT_US + 100_000 * np.arange(len(log.attitude))
    copied = write_bin(tmp_path / "copied.bin", [*gyr(w, t), *att(q, t_q)])
    seconds = (BOOT_US / 1e3 - mems_log.UNIX_MS) / 1e3
    given = WORDS | {"attitude_offset_s": seconds}
    with pytest.raises(InputError, match=r"mocap.csv: the attitudes are those of ATT, ArduPilot's own estimate from this gyro"):
        ardupilot.import_ardupilot(copied, attitude, **given)
    imported = ardupilot.import_ardupilot(copied, attitude, unchecked=True, **given)
    assert "are those of ATT" in imported.assumed[0]
    # A filter that is right to the noise of the references is not the source of these.
    noise = Rotation.from_rotvec(np.deg2rad(0.1) * np.random.default_rng(5).normal(size=(len(q), 3)))
    near = np.roll((Rotation.from_quat(np.roll(q, -1, axis=1)) * noise).as_quat(), 1, axis=1)
    imported = ardupilot.import_ardupilot(write_bin(tmp_path / "own.bin", [*gyr(w, t), *att(near, t_q)]), attitude, **given)
    assert not any("ATT" in text for text in imported.assumed)


def test_bad_input_gives_one_line(run_cli, attitude, tmp_path):
    path = write_bin(tmp_path / "log.bin", gyr([[0.1, 0.2, 0.3]], [7]))
    (tmp_path / "empty.bin").write_bytes(b"")
    (tmp_path / "noise.bin").write_bytes(np.random.default_rng(3).bytes(4000))
    (tmp_path / "short.bin").write_bytes(b"\xa3\x95\x80\x81")
    (tmp_path / "format.bin").write_bytes(record("FMT", 0x81, 90, b"GYR", b"Q?", b"TimeUS,I"))
    for words, text in (
        ([path, attitude, *OPTIONS, "--instance", "1"], "no gyro of instance 1; --instance may be 0"),
        ([path, attitude], "what its columns mean is not stated; give time and attitude, e.g. --attitude-time"),
        ([path, tmp_path / "none.csv", *OPTIONS], "none.csv: no such file"),
        ([path, path, *OPTIONS], "log.bin: "),
        ([tmp_path / "none.bin", attitude, *OPTIONS], "none.bin: no such file"),
        ([tmp_path / "empty.bin", attitude, *OPTIONS], "cannot be read as DataFlash"),
        ([tmp_path / "noise.bin", attitude, *OPTIONS], "cannot be read as DataFlash: it does not begin with a message"),
        ([tmp_path / "short.bin", attitude, *OPTIONS], "no gyro: the log has neither IMU nor GYR"),
        ([tmp_path / "format.bin", attitude, *OPTIONS], "cannot be read as DataFlash: Unsupported format char"),
    ):
        done = run_cli("import", "ardupilot", *map(str, words), "--force", str(tmp_path / "rec"))
        assert (done.exit_code, done.stderr.count("\n")) == (2, 1), done.stderr
        assert text in done.stderr


def test_without_the_package_it_is_asked_for(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pymavlink.DFReader", None)
    with pytest.raises(InputError, match=r"pymavlink is needed to read it: pip install 'gyrocal\[ardupilot\]'"):
        ardupilot.read_ardupilot(tmp_path / "x.bin")
