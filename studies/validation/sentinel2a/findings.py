"""What the first 65 s tell.

Drift: with e(t) what an attitude of the trackers differs by from the one that the gyro carries along from a single start, the
drift over τ is e(t + τ) − R e(t), R the turn between the two: what the gyro alone would be wrong by after τ, with the noise of
both attitudes in it. All pairs of 10 Hz attitudes τ apart are taken; the number is the RMS over them and the three axes. *Held
out* is a third of the time at once: parameters come from the other two, and pairs with an end or both in that third count.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import periodogram

from gyrocal import Attitudes, Interval, attitude, calibrate, calibrate_gyros, propagate, triad
from gyrocal.calibration.sampling import prepare_measurements
from gyrocal.estimation.predict import condition_on_references, list_step_times, predict
from gyrocal.importing.build import ImportResult
from gyrocal.recording.gyros import compute_nominal_gyros, compute_parity_basis
from studies.calibration.shared_truth import compute_rms
from studies.report.prediction_page import tabulate_prediction as prediction_rows
from studies.validation.sentinel2a.flight_data import ARCSEC_PER_RAD, LSB_RAD, WINDOW_END_S, build_body_prior, build_gyro_prior

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

DRIFTS_S = (10.0, 30.0, 60.0)
THIRDS = 3
CHECK_FROM_S = (22.0, 33.0, 43.0)
BLOCK_S = 7.0
SLOW_HZ = 4.0  # tones are looked for below
STEP_S = 0.1  # of the forecast

MODELS: dict[str, dict[str, bool] | None] = {
    "nominal count, as imported": None,
    "mounting": {"scale": False, "bias": False},
    "mounting and scale factor": {"bias": False},
    "mounting, scale factor, shape and bias": {},
}


def propagate_from_start(flown: ImportResult, used: Mask, prior: Array | None) -> Array:
    """e (m, 3), rad, of all attitudes of both trackers together about the gyro alone from the first one on, their times (m, 1)
    and the turns since then (m, 9); the gyro's parameters are fitted to the references used."""
    recording, joined = triad(flown.recording), flown.joined
    # The prediction's times do not matter here: its parameters do.
    times = np.unique(recording.attitudes.t_s)[1:]
    fit = condition_on_references(recording, used, times, build_body_prior(False, False, False) if prior is None else prior)
    inside = joined.t_s >= recording.gyro.t_s[0]
    t_s, q = joined.t_s[inside], joined.q[inside]
    whole = replace(
        recording,
        attitudes=Attitudes(t_s, q, np.full((t_s.size, 3), 1e-5)),
        intervals=(Interval("all", "", float(t_s[0]), float(t_s[-1])),),
    )
    run = propagate(prepare_measurements(whole).arcs, fit.parameters.G, fit.parameters.bias)
    A = attitude.matrix_from_quaternion(q)
    R = np.concatenate([np.eye(3)[None], run.R])
    return np.concatenate([attitude.residual(A, R @ A[0]), t_s[:, None], R.reshape(-1, 9)], axis=1)


def compute_drift(path: Array, over_s: float, within: tuple[float, float] = (-np.inf, np.inf)) -> Array:
    """(n, 3) drifts over a time, rad, of the pairs with an end within some times."""
    e, t, R = path[:, :3], path[:, 3], path[:, 4:].reshape(-1, 3, 3)
    later = np.searchsorted(t, t + over_s - 0.05)
    first = np.flatnonzero(later < t.size)
    later = later[first]
    inside = (t >= within[0]) & (t <= within[1])
    chosen = inside[first] | inside[later]
    first, later = first[chosen], later[chosen]
    turn = R[later] @ R[first].transpose(0, 2, 1)
    return np.asarray(e[later] - np.einsum("nij,nj->ni", turn, e[first]))


def build_drift_rows(flown: ImportResult) -> list[dict[str, Any]]:
    """Drift over each time by each model, fitted to all and held out."""
    t_ref = flown.recording.attitudes.t_s
    edges = np.linspace(t_ref[0], t_ref[-1], THIRDS + 1)
    rows = []
    for model, options in MODELS.items():
        prior = None if options is None else build_body_prior(**options)
        whole = propagate_from_start(flown, np.ones(t_ref.size, dtype=bool), prior)
        held: dict[float, list[Array]] = {over: [] for over in DRIFTS_S}
        for third in pairwise(edges.tolist()):
            path = propagate_from_start(flown, (t_ref < third[0]) | (t_ref > third[1]), prior)
            for over in DRIFTS_S:
                held[over].append(compute_drift(path, over, third))
        for over in DRIFTS_S:
            row = {"kind": "drift", "what": model, "over_s": over}
            row |= {
                "fitted_arcsec": compute_rms(compute_drift(whole, over)) * ARCSEC_PER_RAD,
                "held_out_arcsec": compute_rms(np.concatenate(held[over])) * ARCSEC_PER_RAD,
            }
            rows.append(row)
    return rows


def build_noise_rows(flown: ImportResult) -> list[dict[str, Any]]:
    """Parity of the gyros, tracker against tracker, and each tracker's own noise."""
    gyro, attitudes = flown.recording.gyro, flown.recording.attitudes
    said = (
        gyro.rates
        @ compute_parity_basis(compute_nominal_gyros(gyro)[0], np.arange(len(gyro.names)))[:, 0]
        * ARCSEC_PER_RAD
        * gyro.sample_s
    )
    fresh = said - said.mean()
    values = {
        "parity of a gyro, mean": (abs(float(said.mean())), "arcsec/s"),
        "parity of a gyro, scatter of 1 s": (float(said.std(ddof=1)), "arcsec"),
        "parity, correlation of successive seconds": (float(fresh[1:] @ fresh[:-1] / (fresh @ fresh)), ""),
        "angle random walk of the body rates, at most": (triad(flown.recording).gyro.arw * ARCSEC_PER_RAD, "arcsec/sqrt(s)"),
    }
    ((name, apart),) = flown.joined.apart.items()
    first = flown.sensors[0].name
    apart = apart[np.isfinite(apart).all(axis=1)]
    turn = np.arccos(np.clip((np.trace(flown.joined.mounting[name]) - 1) / 2, -1, 1))
    values[f"angle of the turn from {name} to {first}"] = (float(np.rad2deg(turn)), "deg")
    size = round(BLOCK_S / float(np.median(np.diff(flown.joined.t_s))))
    blocks = apart[: len(apart) // size * size].reshape(-1, size, 3).mean(axis=1)
    for k, axis in enumerate("xyz"):
        values[f"{name} against {first} about {first} {axis}"] = (float(apart[:, k].std() * ARCSEC_PER_RAD), "arcsec")
        values[f"means of {BLOCK_S:g} s of {name} against {first} about {first} {axis}"] = (
            float(blocks[:, k].std() * ARCSEC_PER_RAD),
            "arcsec",
        )
        for number, one in enumerate(attitudes.sensors):
            sigma = attitudes.sigma[attitudes.sensor == number][0, k]
            values[f"1-sigma of {one.name} about its {axis}"] = (float(sigma * ARCSEC_PER_RAD), "arcsec")
    return [{"kind": "noise", "what": what, "value": value, "unit": unit} for what, (value, unit) in values.items()]


def build_parameter_rows(flown: ImportResult) -> list[dict[str, Any]]:
    """The size of a count, the tetrahedron and the mounting by the calibration of four gyros, and what of it cannot be told."""
    recording = flown.recording
    fit = calibrate_gyros(recording, prior_covariance=build_gyro_prior(flown))
    body = triad(recording).gyro
    omega = body.rates[body.t_s < WINDOW_END_S - 1]
    mean = omega.mean(axis=0)
    along = mean / np.linalg.norm(mean)
    # A common scale factor s, that of G K₀, and a bias b∥ along the mean rate turn the body by s |ω| + b∥.
    K0, _ = compute_nominal_gyros(recording.gyro)
    scale = np.concatenate([K0.T.ravel() / 3, np.zeros(3)])
    bias = np.concatenate([np.zeros(K0.size), along])
    both = scale * np.linalg.norm(mean) + bias
    vector, covariance = np.concatenate([fit.G.ravel(), fit.bias]), fit.gain_covariance
    sigma = {name: float(np.sqrt(v @ covariance @ v)) for name, v in (("s", scale), ("b", bias), ("sum", both))}
    correlation = float(scale @ covariance @ bias / (sigma["s"] * sigma["b"]))
    size = float(scale @ vector)
    deg_h = np.rad2deg(1.0) * 3600
    values = {
        "mean rate": (float(np.rad2deg(np.linalg.norm(mean))), 0.0, "deg/s"),
        "RMS of the rate about its mean": (float(np.rad2deg(omega.std(axis=0)).max()), 0.0, "deg/s"),
        "angle of a count": (LSB_RAD * size * 1e9, LSB_RAD * sigma["s"] * 1e9, "nrad"),
        "common scale factor": (1e6 * (size - 1), 1e6 * sigma["s"], "ppm"),
        "bias along the mean rate": (float(bias @ vector) * deg_h, sigma["b"] * deg_h, "deg/h"),
        "scale factor times mean rate plus bias along it": (
            float(both @ vector - np.linalg.norm(mean)) * deg_h,
            sigma["sum"] * deg_h,
            "deg/h",
        ),
        "correlation of the errors of scale factor and bias along": (correlation, 0.0, ""),
    }
    for line in fit.summary().to_dict("records"):
        values[f"scale factor of {line['gyro']}"] = (1e6 * (line["scale_factor"] - 1), 1e6 * line["sigma_scale_factor"], "ppm")
        values[f"bias of {line['gyro']}"] = (line["bias_deg_s"] * 3600, line["sigma_bias_deg_s"] * 3600, "deg/h")
    assert fit.mountings is not None
    for line in fit.mountings.summary().to_dict("records"):
        what = f"misalignment of {line['sensor']} about its {line['axis']} from the import's"
        values[what] = (line["misalignment_arcsec"], line["sigma_arcsec"], "arcsec")
    (compared,) = fit.differences
    values |= {
        "chi2 per degree of freedom": (fit.chi2 / fit.dof, 0.0, ""),
        "parity, chi2 per degree of freedom": (fit.parity_chi2 / fit.parity_dof, 0.0, ""),
        "tracker against tracker, chi2 per degree of freedom": (compared.chi2 / compared.dof, 0.0, ""),
    }
    rows = [
        {"kind": "parameter", "what": what, "value": value, "sigma": s, "unit": unit}
        for what, (value, s, unit) in values.items()
    ]
    free = calibrate(triad(recording), apriori_covariance=build_body_prior()).observability.unobservable
    return rows + [{"kind": "not identifiable", "what": text} for text in free]


def build_residual_rows(flown: ImportResult) -> list[dict[str, Any]]:
    """Build rows of the residuals, of both trackers and of each about its own axes: size, correlation, strongest tone.

    A tone that both trackers have may be motion that gyros read once a second do not show; one of a single tracker is its own.
    """
    recording, joined = flown.recording, flown.joined
    begin = recording.attitudes.t_s[0]
    every = np.ones(recording.attitudes.t_s.size, dtype=bool)
    later = joined.t_s > begin
    found = condition_on_references(recording, every, joined.t_s[later], build_body_prior())
    left = {"both, body": attitude.residual(attitude.matrix_from_quaternion(joined.q)[later], found.A)}
    for one in flown.sensors:
        own = one.t_s > begin
        shown = condition_on_references(recording, every, one.t_s[own], build_body_prior()).of_sensor(one.name)
        left[one.name] = attitude.residual(attitude.matrix_from_quaternion(one.q)[own], shown.A)
    rate = 1 / float(np.median(np.diff(joined.t_s)))
    lag = round(0.5 * rate)
    rows = []
    for name, values in left.items():
        for axis, x in zip("xyz", (values - values.mean(axis=0)).T * ARCSEC_PER_RAD, strict=True):
            f, power = periodogram(x, rate)
            below = (f > 0) & (f < SLOW_HZ)
            best = int(np.argmax(np.where(below, power, 0.0)))
            row = {"kind": "left", "what": f"{name} {axis}", "rms_arcsec": float(x.std())}
            row |= {"correlation_after_0.1_s": float(x[1:] @ x[:-1] / (x @ x))}
            row |= {"correlation_after_0.5_s": float(x[lag:] @ x[:-lag] / (x @ x)), "tone_hz": float(f[best])}
            row["tone_amplitude_arcsec"] = float(np.sqrt(2 * power[best] * (f[1] - f[0])))
            rows.append(row | {"tone_over_median_power": float(power[best] / np.median(power[below]))})
    return rows


def build_check_rows(flown: ImportResult) -> list[dict[str, Any]]:
    """Predictions inside the first 65 s against the trackers' own readings, in sigmas, and their mean error."""
    rows = []
    for start in CHECK_FROM_S:
        for one in flown.sensors:
            chosen = one.t_s > start
            shown = predict(flown.recording, start, one.t_s[chosen], build_body_prior()).of_sensor(one.name)
            error = attitude.residual(attitude.matrix_from_quaternion(one.q[chosen]), shown.A)
            for k, axis in enumerate("xyz"):
                sigma = shown.reading_sigma[:, k]
                row = {"kind": "check", "what": f"{one.name} {axis}", "from_s": start}
                row |= {
                    "rms_arcsec": compute_rms(error[:, k]) * ARCSEC_PER_RAD,
                    "sigma_arcsec": compute_rms(sigma) * ARCSEC_PER_RAD,
                }
                row |= {
                    "rms_in_sigma": compute_rms(error[:, k] / sigma),
                    "mean_arcsec": float(error[:, k].mean()) * ARCSEC_PER_RAD,
                }
                rows.append(row | {"attitude_sigma_arcsec": compute_rms(shown.sigma[:, k]) * ARCSEC_PER_RAD})
    return rows


def build_forecast_rows(flown: ImportResult) -> list[dict[str, Any]]:
    """Both trackers' attitudes from 65 s to 97 s, as ``gyrocal predict --from 65 --step 0.1`` writes them; a row a time.

    Times go on as the first tracker's did. A row's `sigma_…` is that of a reading of the tracker about its own axes: of the
    attitude by gyro, of the mounting, and of the tracker's noise, which is most of it. `attitude_sigma_…` is that of the
    attitude and the mounting alone. Quaternions are tracker to inertial, scalar last, as in the data, and go on in their sign.
    """
    last = float(flown.sensors[0].t_s[-1])
    table = prediction_rows(
        predict(flown.recording, WINDOW_END_S, list_step_times(flown.recording, last, STEP_S), build_body_prior())
    )
    for sensor in flown.sensors:
        names = [f"{sensor.name.lower()}_q{k}" for k in (1, 2, 3, 4)]
        q = table[names].to_numpy()
        table[names] = q * np.sign(q @ sensor.q[-1])[:, None]
    kept = ["t_s", *(name for name in table.columns if name.startswith(tuple(f"{one.name.lower()}_" for one in flown.sensors)))]
    return [
        {"kind": "prediction"} | {str(name): value for name, value in row.items()} for row in table[kept].to_dict("records")
    ]
