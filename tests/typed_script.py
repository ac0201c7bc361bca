"""A user's script, which mypy checks as with --strict, and never runs: `make types`."""

import numpy as np

import gyrocal
from gyrocal.importing import import_csv
from gyrocal.importing.aem import read_aem
from gyrocal.importing.ck import read_ck
from gyrocal.importing.rosbag import import_bag


def bias_of(folder: str) -> list[float]:
    recording = gyrocal.load(folder)
    made = gyrocal.Recording.from_arrays(
        recording.gyro.t_s, recording.gyro.rates, recording.attitudes.t_s, recording.attitudes.quaternions, sigma=1e-4, arw=1e-7
    )
    result = gyrocal.calibrate(made, solve_for="bias", psi="full")
    values: list[float] = result.bias_deg_s.tolist()
    print(result.to_frame()["sigma"].sum(), made.to_frame("gyro").shape, gyrocal.__version__)
    result.plot_residuals(before=True).set_title("residuals")
    print(result.plot_parameters().get_xlabel(), result.parameters.bias_deg_s.sum())
    return values


def read_others(folder: str) -> float:
    recording = import_bag(folder, imu_topic="/imu0").recording
    return float(read_ck("a.bc", "a.tsc").q[0, 3] - read_aem("a.aem").q[0, 3]) * recording.gyro.sample_s


def imported(path: str) -> float:
    return import_csv(path, time="t:s", gyro="x,y,z:deg/s", quat="w,x,y,z:body-to-world").recording.gyro.arw


def misspelled(made: gyrocal.Recording) -> None:
    gyrocal.calibrate(made, psi="fully")  # type: ignore[arg-type]  # a comment without an error is an error


def shown() -> None:
    print(bias_of("/tmp"), read_others("bag"), np.rad2deg(imported("log.csv")))
