"""ULog files, written byte by byte as the format is documented: header, definitions, data."""

import struct

import numpy as np
import pytest

import gyrocal
from gyrocal import InputError, attitude
from gyrocal.importing import ulog
from studies.validation import mems_log
from tests.gyrocal.importing import mems

pytest.importorskip("pyulog", reason="the extra px4 is not installed")

TYPES = {"uint64_t": "Q", "float": "f", "float[3]": "3f", "float[4]": "4f", "uint8_t": "B", "uint8_t[3]": "3B"}
SENSOR_GYRO = {
    "timestamp": "uint64_t",
    "timestamp_sample": "uint64_t",
    "x": "float",
    "y": "float",
    "z": "float",
    "temperature": "float",
    "clip_counter": "uint8_t[3]",
}
COMBINED = {"timestamp": "uint64_t", "gyro_rad": "float[3]", "gyro_calibration_count": "uint8_t"}
ODOMETRY = {"timestamp": "uint64_t", "timestamp_sample": "uint64_t", "q": "float[4]", "reset_counter": "uint8_t"}
ATTITUDE = {"timestamp": "uint64_t", "q": "float[4]"}
BOOT_US = 5_000_000
LATE_US = 700  # between a measurement and its message


def message(kind, data):
    return struct.pack("<HB", len(data), ord(kind)) + data


def write_ulog(path, topics, parameters=()):
    """A file of topics (name, instance, fields, rows), and of parameters of whole numbers."""
    out = b"\x55\x4c\x6f\x67\x01\x12\x35\x01" + struct.pack("<Q", BOOT_US)
    for name, fields in {name: fields for name, _, fields, _ in topics}.items():
        out += message("F", f"{name}:{''.join(f'{kind} {field};' for field, kind in fields.items())}".encode())
    for name, value in parameters:
        key = f"int32_t {name}".encode()
        out += message("P", bytes([len(key)]) + key + struct.pack("<i", value))
    for number, (name, instance, _, _) in enumerate(topics):
        out += message("A", struct.pack("<BH", instance, number) + name.encode())
    for number, (_, _, fields, rows) in enumerate(topics):
        form = struct.Struct("<" + "".join(TYPES[kind] for kind in fields.values()))
        out += b"".join(message("D", struct.pack("<H", number) + form.pack(*row)) for row in rows)
    path.write_bytes(out)
    return path


@pytest.fixture(scope="module")
def log():
    return mems_log.log(np.random.default_rng(21), seconds=60.0)


def rows(log):
    """Rates and attitudes of a simulated log with their µs; a rate is tagged at its sample's end."""
    w = np.deg2rad(log.gyro[["gx", "gy", "gz"]].to_numpy())
    q = log.attitude[["qw", "qx", "qy", "qz"]].to_numpy()
    t_w, t_q = (BOOT_US + 1000 * (one["timestamp_ms"].to_numpy() - mems_log.UNIX_MS) for one in (log.gyro, log.attitude))
    return [(int(t) + 10_000, *row) for t, row in zip(t_w, w, strict=True)], [
        (int(t), *row) for t, row in zip(t_q, q, strict=True)
    ]


def warm(t):
    return 30.0 + 1e-7 * (t - BOOT_US)  # °C


def sensor_gyro(rates, instance=0, clip=()):
    made = [(t + LATE_US, t, *w, warm(t), *((3, 0, 1) if k in clip else (0, 0, 0))) for k, (t, *w) in enumerate(rates)]
    return ("sensor_gyro", instance, SENSOR_GYRO, made)


def odometry(attitudes, name="vehicle_mocap_odometry", resets=0):
    count = len(attitudes)
    return (name, 0, ODOMETRY, [(t + LATE_US, t, *q, k * (resets + 1) // count) for k, (t, *q) in enumerate(attitudes)])


def test_a_log_is_imported_and_calibrated(run_cli, log, tmp_path):
    rates, attitudes = rows(log)
    own = ("vehicle_attitude", 0, ATTITUDE, [(t, 1.0, 0.0, 0.0, 0.0) for t, *_ in attitudes])
    path = write_ulog(tmp_path / "log.ulg", [sensor_gyro(rates), odometry(attitudes), own])
    done = run_cli("import", "ulog", str(path), str(tmp_path / "rec"))
    assert done.exit_code == 0, done.stderr
    recording = gyrocal.load(tmp_path / "rec")
    assert mems.largest_error(recording, log) < 4
    # Times are those of the measurements, not of the later messages.
    warmth = recording.tables["housekeeping"]
    assert warmth.columns.tolist() == ["t_s", "gyro_temperature_c"]
    np.testing.assert_allclose(warmth["t_s"], BOOT_US / 1e6 + 0.01 * np.arange(1, 1 + len(rates)), atol=1e-9)
    np.testing.assert_allclose(warmth["gyro_temperature_c"], warm(1e6 * warmth["t_s"]), atol=1e-5)


def test_a_quarter_turn_by_hand(tmp_path):
    # The body is turned by +90 deg about z: its x axis is the world's y, and the world's x has there (0, −1, 0).
    half = np.sqrt(0.5)
    path = write_ulog(tmp_path / "hand.ulg", [sensor_gyro([(7, 0.1, 0.2, 0.3)]), odometry([(9, half, 0.0, 0.0, half)])])
    gyro, attitudes, said, tag = ulog.read_ulog(path)
    np.testing.assert_allclose(gyro.to_numpy(), [[0.1, 0.2, 0.3, 7, warm(7)]], rtol=1e-6)
    assert (attitudes["t"].tolist(), tag) == ([9], "end")
    q = attitudes[["qx", "qy", "qz", "qw"]].to_numpy()
    np.testing.assert_allclose(attitude.matrix_from_quaternion(q)[0] @ [1, 0, 0], [0, -1, 0], atol=1e-7)
    assert said == ["rates are those of sensor_gyro:0", "attitudes are those of vehicle_mocap_odometry:0"]


def test_the_filter_is_no_reference(log, tmp_path):
    rates, attitudes = rows(log)
    own = ("vehicle_attitude", 0, ATTITUDE, attitudes)
    path = write_ulog(tmp_path / "log.ulg", [sensor_gyro(rates), own])
    with pytest.raises(
        InputError, match="no attitudes independent of the gyro: vehicle_attitude is PX4's own estimate from this gyro"
    ):
        ulog.import_ulog(path)
    assert "is PX4's own estimate" in ulog.import_ulog(path, attitude_topic="vehicle_attitude").assumed[0]
    groundtruth = ("vehicle_attitude_groundtruth", 0, ATTITUDE, attitudes)
    *_, said, _ = ulog.read_ulog(write_ulog(tmp_path / "sitl.ulg", [sensor_gyro(rates), own, groundtruth, odometry(attitudes)]))
    assert said[1] == "attitudes are those of vehicle_attitude_groundtruth:0"


def test_a_slowly_logged_raw_gyro_gives_only_its_temperature(log, tmp_path):
    rates, attitudes = rows(log)
    combined = ("sensor_combined", 0, COMBINED, [(t, *w, k > 2000) for k, (t, *w) in enumerate(rates)])
    path = write_ulog(tmp_path / "log.ulg", [sensor_gyro(rates[::100]), combined, odometry(attitudes, resets=2)])
    gyro, _, said, _ = ulog.read_ulog(path)
    assert len(gyro) == len(rates)
    inside = slice(0, len(rates) - 99)
    np.testing.assert_allclose(gyro["temperature"][inside], warm(gyro["t"])[inside], atol=1e-5)
    text = " ".join(said)
    for words in (
        "sensor_combined:0: PX4 has subtracted its own calibration's offsets",
        "not taken: sensor_gyro:0 at 1 Hz",
        "gyro's calibration, and with it the bias, 1 time(s)",
        "were reset and may jump 2 time(s)",
    ):
        assert words in text
    assert len(ulog.read_ulog(path, gyro_topic="sensor_gyro")[0]) == len(rates) // 100


def test_what_the_log_counts_is_said(log, tmp_path):
    rates, attitudes = rows(log)
    topics = [sensor_gyro(rates, 0, clip=(3, 4)), sensor_gyro(rates, 1), odometry(attitudes, "vehicle_visual_odometry")]
    *_, said, _ = ulog.read_ulog(write_ulog(tmp_path / "log.ulg", topics, [("SENS_BOARD_ROT", 4)]))
    text = " ".join(said)
    for words in (
        "not taken: sensor_gyro:1 at 100 Hz",
        "4 clipped",
        "SENS_BOARD_ROT is 4",
        "if the visual odometry uses this gyro",
    ):
        assert words in text


def test_what_is_wrong_with_a_log_is_said(tmp_path):
    gyro, poses = sensor_gyro([(7, 0.1, 0.2, 0.3)]), odometry([(9, 1.0, 0.0, 0.0, 0.0)])
    path = write_ulog(tmp_path / "log.ulg", [gyro, poses])
    for call, words in (
        (lambda: ulog.read_ulog(path, "sensor_gyro:1"), "no topic sensor_gyro:1; --gyro-topic may be sensor_gyro:0"),
        (lambda: ulog.read_ulog(path, None, "mocap"), "--attitude-topic may be vehicle_mocap_odometry:0"),
        (lambda: ulog.read_ulog(tmp_path / "none.ulg"), "no such file"),
        (lambda: ulog.read_ulog(write_ulog(tmp_path / "b.ulg", [poses])), "no gyro: none of the topics"),
        (lambda: ulog.read_ulog(write_ulog(tmp_path / "c.ulg", [gyro])), "no attitudes independent of the gyro; log one of"),
    ):
        with pytest.raises(InputError, match=words):
            call()
    path.write_bytes(path.read_bytes()[:10])
    with pytest.raises(InputError, match="cannot be read as ULog"):
        ulog.read_ulog(path)


def test_without_the_package_it_is_asked_for(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyulog", None)
    with pytest.raises(InputError, match=r"pip install 'gyrocal\[px4\]'"):
        ulog.read_ulog(tmp_path / "x.ulg")
