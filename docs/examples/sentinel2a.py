"""Sentinel-2A in flight: join four gyros and two star trackers, calibrate, and predict both trackers' attitudes after 65 s.

Contains modified Copernicus Sentinel data 2020. ``python docs/examples/sentinel2a.py`` writes sentinel2a/prediction.csv beside
itself, or another file that is given. docs/predict.md has the results.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

from gyrocal import attitude, calibrate
from gyrocal.estimation.predict import condition_on_references, list_step_times, predict, prior_covariance
from gyrocal.importing import load_mapping, validate_mapping
from gyrocal.importing.build import import_streams
from gyrocal.importing.streams import read_streams

FOLDER = Path(__file__).parent / "sentinel2a"
ARCSEC = np.rad2deg(1.0) * 3600  # a radian
LAST_REFERENCE_S, STEP_S = 65.0, 0.1
CHECKED_FROM_S = (22.0, 33.0, 43.0)
# Known before: each element of G to 1e-3, the mounting of the gyros to 0.3 rad (the rates hardly vary, so that the import finds
# it to some degrees about their mean), the angle of a count to 1 %, and the biases to 1 deg/h.
SHAPE, BIAS, MOUNTING, SCALE = 1e-3, np.deg2rad(1.0 / 3600), 0.3, 0.01


def import_flight(until_s=LAST_REFERENCE_S):
    """The gyros, and the attitudes of the trackers up to a time."""
    mapping = validate_mapping(load_mapping(FOLDER / "mapping.toml"), "mapping.toml")
    gyros, trackers = (pd.read_csv(FOLDER / name) for name in ("imu.csv", "str.csv"))
    return import_streams(read_streams(gyros, trackers[trackers["t_s"] <= until_s], mapping), mapping)


def build_prior(recording):
    """(12, 12) covariance of G and b as they are known before."""
    return prior_covariance(SHAPE, BIAS, MOUNTING, SCALE, recording.gyro.apriori_G)


def turn_to_tracker(body, tracker):
    """Attitudes (k, 3, 3) of a tracker and their covariance (k, 3, 3) about its axes, rad², from those of the body."""
    M = tracker.mounting
    mounting_sigma = np.zeros(3) if tracker.mounting_sigma is None else tracker.mounting_sigma
    return M @ body.A, M @ body.covariance @ M.T + np.diag(mounting_sigma**2)


def compute_errors(sensor, times, A):
    """Attitudes A (k, 3, 3) predicted for a tracker at times of its readings, against these, rad about its axes."""
    return attitude.residual(attitude.matrix_from_quaternion(sensor.q[np.isin(sensor.t_s, times)]), A)


def estimate_noise(flight):
    """1-sigma (3,) of a reading of each tracker, rad: RMS of its readings about the attitude by gyro and all references."""
    recording, noise = flight.recording, []
    every = np.ones(recording.attitudes.t_s.size, dtype=bool)
    for sensor, tracker in zip(flight.sensors, flight.joined.sensors, strict=True):
        times = sensor.t_s[sensor.t_s > recording.attitudes.t_s[0]]
        body = condition_on_references(recording, every, times, build_prior(recording))
        errors = compute_errors(sensor, times, turn_to_tracker(body, tracker)[0])
        noise.append(np.sqrt(np.mean(errors**2, axis=0)))
    return noise


def check_predictions(flight):
    """RMS errors of the readings after some times, as predicted from those before them alone."""
    rows = []
    for from_s in CHECKED_FROM_S:
        known = import_flight(from_s)
        for sensor, tracker, noise in zip(flight.sensors, known.joined.sensors, estimate_noise(known), strict=True):
            times = sensor.t_s[sensor.t_s > from_s]
            A, P = turn_to_tracker(predict(known.recording, from_s, times, build_prior(known.recording)), tracker)
            errors, variance = compute_errors(sensor, times, A), np.diagonal(P, axis1=1, axis2=2) + noise**2
            sizes = np.sqrt(np.mean(errors**2, axis=0)) * ARCSEC, np.sqrt(np.mean(errors**2 / variance, axis=0))
            rows += [(from_s, sensor.name, *row) for row in zip("xyz", *sizes, strict=True)]
    return pd.DataFrame(rows, columns=["from_s", "tracker", "axis", "rms_arcsec", "rms_in_sigma"])


def predict_trackers(flight):
    """Attitudes of both trackers every 0.1 s to the end of the gyros' data.

    ``sigma`` is that of a reading of the tracker about its own axes, ``attitude_sigma`` that of the attitude alone.
    """
    times = list_step_times(flight.recording, flight.sensors[0].t_s[-1], STEP_S)
    body = predict(flight.recording, LAST_REFERENCE_S, times, build_prior(flight.recording))
    columns = {"t_s": times}
    for sensor, tracker, noise in zip(flight.sensors, flight.joined.sensors, estimate_noise(flight), strict=True):
        A, P = turn_to_tracker(body, tracker)
        q, variance, name = attitude.quaternion_from_matrix(A), np.diagonal(P, axis1=1, axis2=2), sensor.name.lower()
        q = q * np.sign(q @ sensor.q[-1])[:, None]  # the sign goes on as in the data
        columns |= {f"{name}_q{k + 1}": q[:, k] for k in range(4)}
        for label, sigma in (("sigma", np.sqrt(variance + noise**2)), ("attitude_sigma", np.sqrt(variance))):
            columns |= {f"{name}_{label}_{axis}_arcsec": ARCSEC * sigma[:, k] for k, axis in enumerate("xyz")}
    return pd.DataFrame(columns)


def main(out):
    """Print what the import says, the calibration and the checks, and write the prediction."""
    flight = import_flight()
    print(*flight.assumed, sep="\n")
    result = calibrate(flight.recording, apriori_covariance=build_prior(flight.recording))
    print(f"chi2 {result.chi2:.0f} of {result.dof}; not determined: {'; '.join(result.observability.unobservable)}")
    print(check_predictions(flight).to_string(index=False, float_format="{:.2f}".format))
    predict_trackers(flight).to_csv(out, index=False, float_format="%.9g")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else FOLDER / "prediction.csv")
