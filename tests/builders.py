"""Small recordings with a truth known in closed form, made without the code under test."""

import numpy as np
import pytest
import scipy.stats
from scipy.spatial.transform import Rotation

from gyrocal import NAMES, Attitudes, GyroParameters, GyroStream, Interval, Recording, attitude

TRUE_G = np.array([[1.000443, -1.013e-3, 6.75235e-4], [7.63599e-4, 1.00053, -2.1629e-3], [9.41394e-4, 1.6831e-3, 1.00088]])
TRUE_BIAS = np.deg2rad([-1.549155e-4, 1.978161e-4, 7.820254e-5])
TRUTH = GyroParameters(TRUE_G, TRUE_BIAS)
PRELAUNCH = GyroParameters(
    np.eye(3) + np.deg2rad([[0, -0.036, 0.006], [0.059, 0, -0.033], [0.005, 0.03, 0]]), np.deg2rad([-1.41e-4, 1.58e-4, 0.86e-4])
)
RPO = np.deg2rad(0.0656)

# Body rates (rad/s) and durations (s) of each interval: turns about every axis, both signs of pitch, a hold.
PLAN = (
    (((0.0, -RPO, 0.0), 3000.0),),
    (((0.0, -RPO, 0.0), 60.0), ((-0.0006, 0.0, np.deg2rad(0.3)), 600.0), ((0.0, RPO, 0.0), 60.0)),
    (((0.0, RPO, 0.0), 2400.0),),
    (((0.0, RPO, 0.0), 60.0), ((0.0, 0.0, np.deg2rad(-0.2)), 450.0), ((-RPO, 0.0, 0.0), 1500.0)),
    (((0.0, RPO, 0.0), 60.0), ((0.0, 0.0, 0.0), 2000.0), ((np.deg2rad(0.05), RPO, 0.0), 100.0)),
    (((0.0, RPO, 0.0), 60.0), ((0.0, 0.0, np.deg2rad(-0.35)), 510.0), ((0.0, -RPO, 0.0), 60.0)),
)


def piecewise_recording(
    plan=PLAN, sample_s=0.5, truth=TRUTH, series_s=None, sigma_deg=0.005, arw=0.0, rng=None, gap_s=300.0, apriori=None
):
    """Piecewise-constant rates; attitudes as exact products of exponentials. With rng, both noises are drawn from it."""
    t_gyro, rates, t_ref, q_ref, intervals = [], [], [], [], []
    clock = 0.0
    A = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
    for number, stretches in enumerate(plan):
        start = clock
        times, attitudes = [start], [A]
        for rate, duration in stretches:
            count = round(duration / sample_s)
            t_gyro.append(clock + sample_s * np.arange(count))
            rates.append(np.tile(rate, (count, 1)))
            marks = np.arange(series_s, duration + 1e-9, series_s) if series_s else np.array([duration])
            for mark in marks:
                times.append(clock + mark)
                attitudes.append(Rotation.from_rotvec(-np.array(rate) * mark).as_matrix() @ A)
            A = Rotation.from_rotvec(-np.array(rate) * duration).as_matrix() @ A
            clock += duration
        keep = range(len(times)) if series_s else (0, len(times) - 1)
        t_ref += [times[k] for k in keep]
        q_ref += [attitudes[k] for k in keep]
        intervals.append(Interval(f"m{number + 1}", "test", start, clock))
        clock += gap_s
        A = Rotation.from_rotvec([0.1, 0.4 * number, -0.2]).as_matrix() @ A if gap_s else A
    rates = np.concatenate(rates)
    raw = np.linalg.solve(truth.G, (rates - truth.bias).T).T
    A_obs = np.array(q_ref)
    sigma = np.full((len(t_ref), 3), np.deg2rad(sigma_deg))
    t_ref, unique = np.unique(t_ref, return_index=True)  # touching intervals share one reference attitude
    A_obs, sigma = A_obs[unique], sigma[unique]
    if rng is not None:
        raw = raw + rng.normal(size=raw.shape) * arw / np.sqrt(sample_s)
        A_obs = Rotation.from_rotvec(rng.normal(size=sigma.shape) * sigma).as_matrix() @ A_obs
    quaternions = Rotation.from_matrix(A_obs.transpose(0, 2, 1)).as_quat()
    start = apriori or GyroParameters(np.eye(3), np.zeros(3))
    return Recording(
        title="piecewise",
        epoch="2000-01-01T00:00:00Z",
        gyro=GyroStream(np.concatenate(t_gyro), raw, sample_s, arw, start.G, start.bias),
        attitudes=Attitudes(np.asarray(t_ref), quaternions, sigma),
        intervals=tuple(intervals),
    )


def choose_case_numbers(few, many):
    """Values of a parameter: few cases for ``make test``, many, for the power of a study, for ``make long``."""
    return [few, pytest.param(many, marks=pytest.mark.long)]


def mean_bounds(size, cases, z=4.0):
    """Bounds of the mean of `cases` χ² values with `size` degrees of freedom."""
    return size - z * np.sqrt(2 * size / cases), size + z * np.sqrt(2 * size / cases)


def is_mean_of_chi2(values, dof, confidence=0.999):
    """Whether the mean of some values is that of χ² with so many degrees of freedom."""
    n = len(values)
    low, high = scipy.stats.chi2.ppf([(1 - confidence) / 2, (1 + confidence) / 2], n * dof) / n
    return low < np.mean(values) < high


def squared_error(error, covariance):
    """Normalised estimation error squared of one error (n,) with its covariance (n, n)."""
    return error @ np.linalg.solve(covariance, error)


def state_errors(A, x, names, A_true, truth):
    """(k, n) states s = (θ, Δx) that estimates A (k, 3, 3) and x (k, 12) have against the truth, A_true (k, 3, 3)."""
    columns = [NAMES.index(name) for name in names]
    return np.concatenate([attitude.residual(A_true, A), (np.asarray(x) - truth.vector)[..., columns]], axis=-1)
