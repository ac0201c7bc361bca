"""BROAD trials as recordings: on a trial written here in the same format, and on the real ones beside the checkout."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from gyrocal import GyroParameters, attitude, calibrate, load, residual_table
from studies.cli.main import main
from studies.validation import broad
from tests import SHARED

FOLDER = SHARED / "real" / "broad"
REAL = sorted(FOLDER.glob("*.parquet"))
VIBRATING = "27_"
real = pytest.mark.skipif(not REAL, reason="the BROAD trials are not beside this checkout; their licence keeps them out of it")

SAMPLE_S = 7 / 2000
G = np.eye(3) + 1e-3 * np.array([[4, 2, -3], [-1, -2, 2], [3, 1, 2]])
BIAS = np.deg2rad([-0.2, 0.1, 0.3])
ARW = np.deg2rad(0.005)
SIGMA = np.deg2rad([0.04, 0.03, 0.02])


def trial_frame(phases=((12, 30), (40, 58), (68, 86)), length_s=100.0, seed=3):
    """A trial whose body turns about changing axes in the motion phases; sensor vectors to ENU, scalar first."""
    rng = np.random.default_rng(seed)
    count = round(length_s / SAMPLE_S)
    t = np.arange(count) * SAMPLE_S
    middle = t + SAMPLE_S / 2
    rates = np.zeros((count, 3))
    moving = np.zeros(count, dtype=bool)
    for number, (start, stop) in enumerate(phases):
        inside = (t >= start) & (t < stop)
        window = np.sin(np.pi * (middle[inside] - start) / (stop - start)) ** 2
        for axis in range(3):
            frequency = 0.2 + 0.11 * axis + 0.07 * number
            rates[inside, axis] = window * np.sin(2 * np.pi * frequency * (middle[inside] - start) + axis + number)
        rates[inside] *= np.deg2rad([120, 90, 100])
        rates[inside, number % 3] += np.deg2rad(40) * window
        moving |= inside
    # Sensor to ENU: each sample turns about the sensor's own axes, on the right.
    steps = Rotation.from_rotvec(rates * SAMPLE_S).as_matrix()
    all_C = np.empty((count, 3, 3))
    all_C[0] = Rotation.from_euler("zyx", [40, 10, -20], degrees=True).as_matrix()
    for k in range(count - 1):
        all_C[k + 1] = all_C[k] @ steps[k]
    force = np.einsum("kji,j->ki", all_C, [0, 0, 9.81])
    quaternions = Rotation.from_matrix(all_C)
    raw = np.linalg.solve(G, (rates - BIAS).T).T + rng.normal(size=rates.shape) * ARW / np.sqrt(SAMPLE_S)
    quaternions = quaternions * Rotation.from_rotvec(rng.normal(size=raw.shape) * SIGMA)
    q = quaternions.as_quat()[:, [3, 0, 1, 2]]
    q[: round(2 / SAMPLE_S)] = np.nan
    q[round(20 / SAMPLE_S) : round(20.1 / SAMPLE_S)] = np.nan
    columns = {
        **dict(zip(broad.IMU_RATE_COLUMNS, raw.T, strict=True)),
        **dict(zip(broad.FORCE_COLUMNS, force.T, strict=True)),
        **dict(zip([f"opt_quat_{axis}" for axis in "wxyz"], q.T, strict=True)),
        "movement": moving,
    }
    return pd.DataFrame(columns)


def write(frame, path, rate=b"285.7142857142857"):
    metadata = {} if rate is None else {broad.RATE_KEY: rate}
    pq.write_table(pa.Table.from_pandas(frame, preserve_index=False).replace_schema_metadata(metadata), path)
    return path


@pytest.fixture(scope="module")
def frame():
    return trial_frame()


@pytest.fixture(scope="module")
def trial_file(frame, tmp_path_factory):
    return write(frame, tmp_path_factory.mktemp("broad") / "99_synthetic.parquet")


@pytest.fixture(scope="module")
def trial(trial_file):
    return broad.read(trial_file)


@pytest.fixture
def run_import():
    return lambda *arguments: CliRunner().invoke(main, ["import", *map(str, arguments)])


def test_truth_is_recovered_from_a_file_in_the_projects_conventions(trial, frame):
    assert trial.sample_s == pytest.approx(SAMPLE_S, rel=1e-12)
    k = 10_000
    row = frame.loc[k]
    sensor_to_enu = Rotation.from_quat(row[[f"opt_quat_{axis}" for axis in "xyzw"]].to_numpy(dtype=float)).as_matrix()
    np.testing.assert_allclose(attitude.matrix_from_quaternion(trial.quaternions[k]), sensor_to_enu.T, atol=1e-12)
    np.testing.assert_array_equal(trial.rates[k], row[list(broad.IMU_RATE_COLUMNS)].to_numpy(dtype=float))
    assert not trial.tracked[0]
    assert len(trial.phases) == 3
    result = calibrate(broad.build_recording(trial).recording, plausible_bias=0.1)
    error = result.parameters.vector - np.concatenate([G.ravel(), BIAS])
    assert np.abs(error / result.sigma).max() < 4
    assert 0.7 < result.chi2 / result.dof < 1.3


def as_trial(frame):
    rates, force, q = (
        frame[list(names)].to_numpy()
        for names in (broad.IMU_RATE_COLUMNS, broad.FORCE_COLUMNS, broad.OPTICAL_QUATERNION_COLUMNS)
    )
    return broad.Trial("synthetic", SAMPLE_S, rates, force, q, frame["movement"].to_numpy())


def test_long_motion_is_cut_in_pieces_that_touch_and_the_rests_are_kept():
    trial = as_trial(trial_frame(phases=((12, 88),)))
    names = [cut[0] for cut in broad.cut_trial(trial)]
    assert names == ["rest before motion 1", *(f"motion 1 part {k}" for k in (1, 2, 3)), "rest after motion 1"]
    edges = np.array([cut[2:] for cut in broad.cut_trial(trial)])
    np.testing.assert_array_equal(edges[1:, 0], edges[:-1, 1])
    assert len(broad.build_recording(trial).recording.intervals) == 5
    assert len(broad.build_recording(trial, "whole").recording.intervals) == 1
    assert len(broad.build_recording(trial, 25.0).recording.intervals) == 4


def test_a_time_offset_is_stated_and_undone(trial):
    late = replace(trial, quaternions=np.roll(trial.quaternions, 5, axis=0))
    (text,) = broad.describe_time_offset(late)
    found = re.search(r": (\S+) ± (\S+) s .* differs from zero", text)
    assert float(found[1]) == pytest.approx(-5 * SAMPLE_S, abs=4 * float(found[2]))
    assert "does not differ from zero" in broad.describe_time_offset(late, -5 * SAMPLE_S)[0]
    moved = broad.build_recording(late, attitude_offset_s=-5 * SAMPLE_S).recording
    assert moved.gyro.t_s[0] == pytest.approx(5 * SAMPLE_S)


def test_command_writes_a_recording_that_calibrates(run_import, trial_file, tmp_path):
    result = run_import("broad", trial_file, tmp_path / "rec")
    assert result.exit_code == 0, result.output
    assert "CC-BY-4.0" in result.stdout
    recording = load(tmp_path / "rec")
    assert "CC-BY-4.0" in recording.title
    assert list(recording.tables["housekeeping"].columns)[1] == "specific_force_x_m_s2"
    assert "--force" in run_import("broad", trial_file, tmp_path / "rec").stderr


def test_bad_trials_files_and_options_are_one_line(run_import, frame, trial_file, tmp_path):
    (tmp_path / "text").write_text("hello")
    untracked = write(frame.assign(opt_quat_x=np.nan), tmp_path / "untracked")
    for file, options, word in (
        (write(frame.drop(columns="imu_gyr_y"), tmp_path / "column"), (), "imu_gyr_y"),
        (write(frame.assign(imu_gyr_x=frame["imu_gyr_x"].mask(frame.index == 7)), tmp_path / "hole"), (), "row 7"),
        (untracked, (), "nowhere tracked"),
        (write(frame, tmp_path / "rate", b"0"), (), "ampling"),
        (tmp_path / "text", (), "cannot be read as Parquet"),
        (trial_file, ["--intervals=sideways"], "sideways"),
    ):
        result = run_import("broad", file, tmp_path / "rec", *options)
        assert (result.exit_code, result.stderr.count("\n"), word in result.stderr) == (2, 1, True), result.stderr
    assert not (tmp_path / "rec").exists()


@real
def test_a_trial_beside_a_vibrating_phone_has_the_sigma_of_shorter_turns():
    """Over a second the motor's vibration adds more to the gyro's noise than the references scatter, over half of it less."""
    trial = broad.read(next(path for path in REAL if path.name.startswith(VIBRATING)))
    imported = broad.build_recording(trial)
    nearer = broad.build_recording(trial, spacing_s=0.5)
    np.testing.assert_allclose(imported.sigma_motion, nearer.sigma_motion, rtol=0.5)
    assert len(imported.recording.attitudes.t_s) < 0.6 * len(nearer.recording.attitudes.t_s)
    assert calibrate(imported.recording, plausible_bias=0.1).converged


@real
def test_real_trial_is_imported_and_calibrated():
    """The residual of the raw gyro is some degrees, and a calibration takes most of it: the conversion's sign and units."""
    imported = broad.build_recording(broad.read(next(path for path in REAL if not path.name.startswith(VIBRATING))))
    recording = imported.recording
    assert len(recording.intervals) >= 4
    assert (np.rad2deg(imported.sigma_motion) < 0.3).all()
    np.testing.assert_allclose(np.rad2deg(imported.arw), 0.006, rtol=0.3)
    result = calibrate(recording, plausible_bias=0.1)
    assert result.converged
    assert np.abs(result.G - np.eye(3)).max() < 0.03
    columns = [f"{when}_{axis}_deg" for when in ("before", "after") for axis in ("roll", "pitch", "yaw")]
    ends = residual_table(recording, GyroParameters(np.eye(3), np.zeros(3))).groupby("interval").tail(1)
    raw = np.sqrt(np.square(ends[columns[:3]].to_numpy()).sum(axis=1).mean())
    left = result.residuals.groupby("interval").tail(1)[columns[3:]].to_numpy()
    assert 5 < raw < 16
    assert np.sqrt(np.square(left).sum(axis=1).mean()) < 0.65 * raw
