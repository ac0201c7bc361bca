"""What stands behind the names of a reader's own files in the docs: one small log in every format, and coarse scenarios."""

import re
import shutil

import numpy as np
import pandas as pd
from click.testing import CliRunner

from studies.cli.main import main
from studies.validation.mems_log import log
from tests.docs.blocks import blocks
from tests.gyrocal.importing import mems

COARSE = "[gyro]\nsample_s = 5.0\n"
SERIES = f'base = "trmm_series"\n{COARSE}[reference]\nevery_s = 300.0\n'
NAMES = {"broad": "05_undisturbed_slow_rotation_with_breaks_B.parquet"}
MAPPING = 'time = "timestamp_ms:ms"\ngyro = "gx,gy,gz:deg/s"\nquat = "qw,qx,qy,qz:body-to-inertial"\n'
WORDS = ["--time", "timestamp_ms:ms", "--gyro", "gx,gy,gz:deg/s", "--quat", "qw,qx,qy,qz:body-to-inertial"]
HEADERS = "Time (s);Vicon Orientation;;;;IMU Gyroscope;;\n;W;X;Y;Z;X;Y;Z\n"


def _write_two_headers(tables, path):
    """Attitudes and rates in rad/s in one table, seconds from its start, with groups above elements."""
    both = tables.gyro.merge(tables.attitude, how="left", on="timestamp_ms")
    seconds = (both["timestamp_ms"] - both["timestamp_ms"][0]) / 1000
    rates = np.deg2rad(both[["gx", "gy", "gz"]])
    rows = pd.concat([seconds, both[["qw", "qx", "qy", "qz"]], rates], axis=1)
    path.write_text(HEADERS + rows.to_csv(sep=";", index=False, header=False))


def _write_flight_logs(tables, folder):
    rates = np.deg2rad(tables.gyro[["gx", "gy", "gz"]].to_numpy())
    us = 1000 * (tables.gyro["timestamp_ms"] - tables.gyro["timestamp_ms"][0]) + 10_000
    px4 = pd.DataFrame(rates, columns=list("xyz")).assign(timestamp_sample=us)
    px4.to_csv(folder / "flight_sensor_gyro_0.csv", index=False)
    px4.rename(columns={"x": "GyrX", "y": "GyrY", "z": "GyrZ", "timestamp_sample": "SampleUS"}).to_csv(
        folder / "flight_gyr.csv", index=False
    )
    mocap = tables.attitude.rename(columns={f"q{letter}": f"q[{k}]" for k, letter in enumerate("wxyz")})
    mocap["timestamp_sample"] = 1000 * (mocap.pop("timestamp_ms") - tables.gyro["timestamp_ms"][0])
    mocap.to_csv(folder / "flight_vehicle_mocap_odometry_0.csv", index=False)


def _write_redundant_sensors(tables, folder):
    """Rates about x, y, z and about the axes of a tetrahedron, attitudes of two trackers in turn, in s from the start."""
    start = tables.gyro["timestamp_ms"][0]
    axes = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    four = pd.DataFrame(tables.gyro[["gx", "gy", "gz"]].to_numpy() @ axes.T, columns=["g1", "g2", "g3", "g4"])
    tables.gyro.join(four).assign(t=lambda table: (table.pop("timestamp_ms") - start) / 1000).to_csv(
        folder / "rates.csv", index=False
    )
    names = np.where(np.arange(len(tables.attitude)) % 2, "B", "A")
    attitude = tables.attitude.assign(t=(tables.attitude["timestamp_ms"] - start) / 1000, tracker=names)
    attitude.to_csv(folder / "attitude.csv", index=False)


def make(folder):
    """Write a log in every format, and coarse scenarios in place of those that take long."""
    tables = log(np.random.default_rng(1), seconds=40.0)
    times = pd.to_datetime(tables.gyro["timestamp_ms"], unit="ms").dt.strftime("%Y-%m-%dT%H:%M:%S.%f")
    tables.gyro.assign(time=times).to_csv(folder / "gyro.csv", index=False)
    tables.attitude.to_csv(folder / "mocap.csv", index=False)
    _write_flight_logs(tables, folder)
    mems.write_aem(tables, folder / "attitude.aem")
    mems.write_ck(tables, folder / "attitude.bc", folder / "clock.tsc")
    tables.gyro.merge(tables.attitude, how="left", on="timestamp_ms").to_csv(folder / "log.csv", index=False)
    _write_two_headers(tables, folder / "stick.csv")
    _write_redundant_sensors(tables, folder)
    (folder / "mapping.toml").write_text(MAPPING)
    (folder / "series.toml").write_text(SERIES)
    for name in ("scenario.toml", "mine.toml"):
        (folder / name).write_text('base = "trmm"\n')
    (folder / "roll.toml").write_text(blocks("docs/plan.md", "toml")[0])
    (folder / "mystudy.py").write_text(blocks("docs/own_study.md", "python")[0])
    (folder / "mine.py").write_text(blocks("docs/extending.md", "python")[0])
    run = CliRunner().invoke
    for words in (
        ["import", "csv", folder / "gyro.csv", folder / "mocap.csv", folder / "RECORDING", *WORDS],
        ["calibrate", folder / "RECORDING", "--json", folder / "result.json"],
    ):
        done = run(main, [str(word) for word in words])
        assert done.exit_code == 0, done.output
    adopted = re.sub(r'sha256 = ".*?"', "", blocks("docs/compare.md", "toml")[0])
    (folder / "adopted.toml").write_text(adopted)
    for page, name in (("formats/euroc", "folder"), ("formats/ros", "path"), ("broad", "path")):
        found = {}
        exec(blocks(f"docs/{page}.md", "python")[0], found)
        shutil.move(found[name], folder / NAMES.get(page, found[name].name))
