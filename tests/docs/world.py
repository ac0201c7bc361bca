"""What stands behind the names of a reader's own files in the docs: one small log in every format, and coarse scenarios."""

import contextlib
import re
import shutil

import numpy as np
import pandas as pd
from click.testing import CliRunner

from studies.cli.main import main
from tests.docs.blocks import blocks
from tests.gyrocal.importing import mems
from tests.gyrocal.importing.mems_log import log

COARSE = "[gyro]\nsample_s = 5.0\n"
SERIES = f'base = "trmm_series"\n{COARSE}[reference]\nevery_s = 300.0\n'
NAMES = {"broad": "05_undisturbed_slow_rotation_with_breaks_B.parquet"}
MAPPING = 'time = "timestamp_ms:ms"\ngyro = "gx,gy,gz:deg/s"\nquat = "qw,qx,qy,qz:body-to-inertial"\n'
WORDS = ["--time", "timestamp_ms:ms", "--gyro", "gx,gy,gz:deg/s", "--quat", "qw,qx,qy,qz:body-to-inertial"]
HEADERS = "Time (s);Vicon Orientation;;;;IMU Gyroscope;;\n;W;X;Y;Z;X;Y;Z\n"
AXES = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
Q = ["qw", "qx", "qy", "qz"]


def _write_tables(tables, folder):
    """Write the log as tables of several programs, with the rates of four gyros and attitudes of two trackers in turn."""
    start, rates = tables.gyro["timestamp_ms"][0], tables.gyro[["gx", "gy", "gz"]].to_numpy()
    gyro, attitude = (one.assign(t=(one["timestamp_ms"] - start) / 1000) for one in (tables.gyro, tables.attitude))
    gyro["time"] = pd.to_datetime(gyro["timestamp_ms"], unit="ms").dt.strftime("%Y-%m-%dT%H:%M:%S.%f")
    px4 = pd.DataFrame({"timestamp_sample": 1000 * (gyro["timestamp_ms"] - start) + 10_000}).join(
        pd.DataFrame(np.deg2rad(rates), columns=list("xyz"))
    )
    both = gyro.merge(attitude.drop(columns="t"), how="left", on="timestamp_ms")
    mocap = attitude[Q].set_axis([f"q[{k}]" for k in range(4)], axis=1)
    for name, table in {
        "gyro": gyro,
        "mocap": attitude,
        "log": both,
        "flight_sensor_gyro_0": px4,
        "flight_gyr": px4.set_axis(["SampleUS", "GyrX", "GyrY", "GyrZ"], axis=1),
        "flight_vehicle_mocap_odometry_0": mocap.assign(timestamp_sample=1000 * (attitude["timestamp_ms"] - start)),
        "rates": gyro.join(pd.DataFrame(rates @ AXES.T, columns=["g1", "g2", "g3", "g4"])),
        "attitude": attitude.assign(tracker=np.where(np.arange(len(attitude)) % 2, "B", "A")),
    }.items():
        table.to_csv(folder / f"{name}.csv", index=False)
    rows = pd.concat([both["t"], both[Q], np.deg2rad(both[["gx", "gy", "gz"]])], axis=1)
    (folder / "stick.csv").write_text(HEADERS + rows.to_csv(sep=";", index=False, header=False))


def make_log(folder):
    """Write a log as tables; returns them."""
    tables = log(np.random.default_rng(1), seconds=40.0)
    _write_tables(tables, folder)
    return tables


def make(folder):
    """Write a log in every format, and coarse scenarios in place of those that take long."""
    tables = make_log(folder)
    mems.write_aem(tables, folder / "attitude.aem")
    mems.write_ck(tables, folder / "attitude.bc", folder / "clock.tsc")
    (folder / "mapping.toml").write_text(MAPPING)
    (folder / "series.toml").write_text(SERIES)
    for name in ("scenario.toml", "mine.toml"):
        (folder / name).write_text('base = "trmm"\n')
    (folder / "roll.toml").write_text(blocks("docs/plan.md", "toml")[0])
    (folder / "mystudy.py").write_text(blocks("docs/studies.md", "python")[1])
    (folder / "baseline.toml").write_text(blocks("docs/ci.md", "toml")[0])
    (folder / "mine.py").write_text(blocks("docs/extending.md", "python")[0])
    names = [str(folder / name) for name in ("gyro.csv", "mocap.csv", "RECORDING")]
    done = CliRunner().invoke(main, ["import", "csv", *names, *WORDS])
    assert done.exit_code == 0, done.output
    (folder / "adopted.toml").write_text(re.sub(r'sha256 = ".*?"', "", blocks("docs/compare.md", "toml")[0]))
    for format_name, page, number, name in (
        ("euroc", "formats", 4, "folder"),
        ("ros", "formats", 3, "path"),
        ("broad", "validation", 0, "path"),
    ):
        found = {}
        with contextlib.chdir(folder):
            exec(blocks(f"docs/{page}.md", "python")[number], found)
        shutil.move(found[name], folder / NAMES.get(format_name, found[name].name))
