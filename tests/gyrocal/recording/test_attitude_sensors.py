"""A folder with attitudes of several sensors (format 2) is joined when it is read, and what cannot be meant is said."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import gyrocal
import simulator
from gyrocal import InputError, attitude

MOUNTING = Rotation.from_rotvec([1.0, 0.3, -0.2])  # of st2, active: its axes in the body
SIGMA = np.deg2rad([[5e-4, 5e-4, 5e-3], [6e-4, 4e-4, 4e-3]])  # about each tracker's own axes
HEADER = """maps = "inertial to sensor"
quaternion = "scalar last"

[[attitude.sensor]]
name = "st1"
mounting = [0.0, 0.0, 0.0, 1.0]
estimated = false

[[attitude.sensor]]
name = "st2"
mounting = {}
estimated = true
"""


@pytest.fixture(scope="module")
def single():
    settings = {"gyro.sample_s": 2.0, "reference.every_s": 100.0}
    return simulator.simulate(simulator.override(simulator.load("trmm_series"), settings), noise=False)


def write_two(folder, single, seed=1, turn_deg=(0.01, -0.02, 0.03)):
    """Save a recording of two trackers, of which the second is mounted a little beside where it is stated."""
    rng, table = np.random.default_rng(seed), single.to_frame("attitude")
    body, parts = attitude.matrix_from_quaternion(single.attitudes.quaternions), []
    mounted = (np.eye(3), attitude.rotation_matrix(np.deg2rad(turn_deg)) @ MOUNTING.as_matrix().T)
    for name, M, sigma in zip(("st1", "st2"), mounted, SIGMA, strict=True):
        A = attitude.rotation_matrix(sigma * rng.normal(size=(len(body), 3))) @ M @ body
        part = table.assign(sensor=name)
        part[["q1", "q2", "q3", "q4"]] = attitude.quaternion_from_matrix(A)
        part[["sigma_x_deg", "sigma_y_deg", "sigma_z_deg"]] = np.rad2deg(sigma)
        parts.append(part)
    rows = pd.concat(parts).sort_values("t_s", kind="stable")
    gyrocal.save(single, folder)
    (folder / "attitude.parquet").unlink()
    rows.to_csv(folder / "attitude.csv", index=False)
    path = folder / "recording.toml"
    text = path.read_text().replace("format = 1", "format = 2")
    old = 'maps = "inertial to body"\nquaternion = "scalar last"\n'
    assert old in text
    path.write_text(text.replace(old, HEADER.format(MOUNTING.as_quat().tolist())))
    return rows


def test_two_sensors_on_disk_are_joined(tmp_path, single):
    write_two(tmp_path, single)
    read = gyrocal.load(tmp_path)
    np.testing.assert_array_equal(read.attitudes.t_s, single.attitudes.t_s)
    e = attitude.residual(
        attitude.matrix_from_quaternion(read.attitudes.quaternions),
        attitude.matrix_from_quaternion(single.attitudes.quaternions),
    )
    # Across both boresights; a turn of the body's axes is common to all, and no error of the rates.
    assert (read.attitudes.sigma < 7.5e-4 * np.pi / 180).all()
    P = read.attitudes.compute_covariance()
    e = e - e.mean(axis=0)
    nees = np.einsum("ki,ki->", e, np.linalg.solve(P, e[:, :, None])[:, :, 0]) / e.size
    assert nees == pytest.approx(1, abs=4 * np.sqrt(2 / e.size))
    gyrocal.save(read, tmp_path / "again")
    again = gyrocal.load(tmp_path / "again").attitudes
    np.testing.assert_allclose(again.compute_covariance(), P, rtol=1e-12, atol=1e-24)
    assert "format = 1" in (tmp_path / "again" / "recording.toml").read_text()
    assert {"rho_xy", "rho_xz", "rho_yz"} < set(read.to_frame("attitude").columns)


def test_calibrations_of_joined_recordings_agree_with_their_sigma(tmp_path, single):
    truth = gyrocal.calibrate(single).parameters.vector
    z, chi2, dof = [], 0.0, 0
    for seed in range(8):
        write_two(tmp_path / str(seed), single, seed)
        result = gyrocal.calibrate(gyrocal.load(tmp_path / str(seed)))
        off = result.parameters.vector - truth
        z.append(off @ np.linalg.solve(result.covariance, off))
        chi2, dof = chi2 + result.chi2, dof + result.dof
    # The rates have no noise here: the stated angle random walk only widens the sigmas.
    assert np.mean(z) < 12 + 4 * np.sqrt(24 / 8)
    assert chi2 < dof + 4 * np.sqrt(2 * dof)


def test_a_single_sensor_on_disk_is_the_recording_without_it(tmp_path, single):
    table = write_two(tmp_path, single)
    path = tmp_path / "recording.toml"
    head, first, second = path.read_text().split("[[attitude.sensor]]\n")
    path.write_text(f"{head}[[attitude.sensor]]\n{first}{second.partition('estimated = true')[2]}")
    table[table.sensor == "st1"].to_csv(tmp_path / "attitude.csv", index=False)
    read = gyrocal.load(tmp_path).attitudes
    assert read.correlation is None
    np.testing.assert_allclose(read.sigma, np.tile(SIGMA[0], (read.t_s.size, 1)), rtol=1e-14)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("format = 2", "format = 1", "needs format = 2"),
        ('name = "st2"', 'name = "st1"', "must differ"),
        ('name = "st2"', 'name = "st3"', r"no \[\[attitude.sensor\]\] st2"),
        ("estimated = false", "estimated = true", "defines the axes"),
        ("estimated = false", "mounting_sigma_deg = [0.1, 0.1, 0.1]", "estimated = true"),
        ("mounting = [0.0, 0.0, 0.0, 1.0]", "mounting = [0.0, 0.0, 0.0, 0.9]", "norm 1"),
        ("mounting = [0.0, 0.0, 0.0, 1.0]", "mounting = [0.0, 0.0, 1.0, 0.0]", "from where it is stated"),
    ],
)
def test_what_cannot_be_meant_is_said(tmp_path, single, old, new, message):
    write_two(tmp_path, single)
    path = tmp_path / "recording.toml"
    text = path.read_text().replace(old, new, 1)
    path.write_text(text.replace("estimated = true", "estimated = false") if "stated" in message else text)
    with pytest.raises(InputError, match=message):
        gyrocal.load(tmp_path)


def test_rows_must_name_their_sensor_and_be_quaternions(tmp_path, single):
    table = write_two(tmp_path, single)
    for frame, message in (
        (table.drop(columns="sensor"), "column sensor is missing"),
        (table.assign(sensor=None), r"no \[\[attitude.sensor\]\] \(empty\)"),
        (table.iloc[::-1], "attitude of st1: time goes backwards"),
        (table.assign(t_s=table.t_s + 1e6 * (table.sensor == "st2")), r"st2 has \d time.* in common"),
    ):
        frame.to_csv(tmp_path / "attitude.csv", index=False)
        with pytest.raises(InputError, match=message):
            gyrocal.load(tmp_path)


def test_sigmas_may_be_stated_once(tmp_path, single):
    table = write_two(tmp_path, single).drop(columns=["sigma_x_deg", "sigma_y_deg", "sigma_z_deg"])
    table.to_csv(tmp_path / "attitude.csv", index=False)
    path = tmp_path / "recording.toml"
    text = path.read_text()
    for own, estimated in zip(SIGMA, ("estimated = false", "estimated = true"), strict=True):
        text = text.replace(estimated, f"sigma_deg = {np.rad2deg(own).tolist()}\n{estimated}")
    path.write_text(text)
    assert (gyrocal.load(tmp_path).attitudes.sigma < 7.5e-4 * np.pi / 180).all()


def test_correlations_are_three_columns_of_a_covariance(tmp_path, single):
    gyrocal.save(single, tmp_path)
    (tmp_path / "attitude.parquet").unlink()
    table = single.to_frame("attitude").assign(rho_xy=0.9, rho_xz=0.9, rho_yz=0.9)
    for frame, message in (
        (table.drop(columns="rho_xz"), "rho_xy, rho_xz, rho_yz go together"),
        (table.assign(rho_yz=-0.9), "correlations in row 0"),
    ):
        frame.to_csv(tmp_path / "attitude.csv", index=False)
        with pytest.raises(InputError, match=message):
            gyrocal.load(tmp_path)
    table.to_csv(tmp_path / "attitude.csv", index=False)
    read = gyrocal.load(tmp_path).attitudes
    D, s = read.build_error_axes(), read.sigma
    np.testing.assert_allclose((D * s[:, None] ** 2) @ D.transpose(0, 2, 1), read.compute_covariance(), atol=1e-20)
