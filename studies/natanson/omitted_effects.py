"""What N's scenario leaves out, each flown beside it: J2 and geodetic nadir, packets of accumulated angles, a bias that drifts.

None of them is in "trmm" itself, whose gap to the flight they hardly change; the tables say by how much.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from gyrocal import CalibrationResult, calibrate
from gyrocal.calibration.parameters import AXIS_NAMES
from gyrocal.importing import validate_mapping
from gyrocal.importing.streams import read_streams
from gyrocal.recording import Recording
from simulator.effects.recording_view import TIME_TOLERANCE, compute_durations
from simulator.scenario import Scenario, override
from simulator.simulate import motion, simulate
from simulator.streams import generator
from studies.natanson import flight, flight_gap
from studies.natanson.drift import SCATTER_FRACTIONS, build_drift_table
from studies.reproduction import Reproduction

ARCSEC_IN_RAD = float(np.deg2rad(1 / 3600))
LSBS_ARCSEC = (0.05, 0.8, 3.2)
WRAP = 2**16  # counts
ORBIT_VARIANTS: Mapping[str, Mapping[str, object]] = {
    "as flown here": {},
    "J2": {"orbit.j2": True},
    "geodetic nadir": {"orbit.nadir": "geodetic"},
    "both": {"orbit.j2": True, "orbit.nadir": "geodetic"},
}
ORBIT_NOTE = (
    "omega_x: the largest of interval 5, N Figure 3. interval_5_yaw: predicted, less that without. `gyrocal reproduce --paper "
    "natanson --set orbit.j2=true --set 'orbit.nadir=\"geodetic\"'` makes all tables so."
)
PACKET_NOTE = (
    f"One simulated flight; registers of {WRAP} counts. rounding_over_noise: q/√6 over the white noise of a sample's "
    "angle. The changes are against the calibration of the same samples as rates. Neither N nor R gives the size of a count. "
    "`gyrocal import csv` reads such packets."
)
DRIFT_NOTE = (
    "Medians over 40 seeds, RMS in deg. six: all six calibrated together, as N did; december: intervals 1 to 4 alone, whose "
    "twelve numbers give twelve parameters, so that January's are missed by much without any drift; new_bias: b solved for "
    "again in January. scatter_of_R: walks of so many times the size that gives R Table 3's bias scatter after calibration "
    "(0.067, 0.058, 0.021 deg/h). share_below_flight: of the seeds, that leave as little in January as the flight. `gyrocal "
    "simulate trmm_drift OUT` flies it."
)


def add_omitted_effects(scenario: Scenario, made: Reproduction, entropy: int) -> None:
    """The three tables, and what of them the summary holds."""
    orbits = made.add("orbits", "Clean gap with J2 and geodetic nadir", build_orbit_table(scenario), note=ORBIT_NOTE)
    told = build_packet_table(scenario, entropy)
    made.add("packets", "Calibrated from packets of accumulated angles", told, note=PACKET_NOTE)
    drift = build_drift_table(entropy, jobs=made.jobs)
    made.add("drift", "A bias that drifts from December to January (deg RMS)", drift, note=DRIFT_NOTE)
    by_scale = drift.set_index("scatter_of_R").rename(
        index={SCATTER_FRACTIONS[0]: "none", SCATTER_FRACTIONS[-1]: "scatter_of_R"}
    )
    kept = ["six_january_deg", "december_january_deg", "share_below_flight"]
    made.summary |= {
        "orbit_clean_gap_rms_deg": orbits.set_index("orbit")["clean_gap_rms_deg"].to_dict(),
        "packets_largest_change_sigma": told.set_index(told["lsb_arcsec"].map("{:g}".format))["largest_change_sigma"].to_dict(),
        "drift": by_scale.loc[["none", "scatter_of_R"], kept].to_dict("index"),
    }


def build_orbit_table(scenario: Scenario) -> pd.DataFrame:
    """Prediction and N Figure 3's ω_x by how the orbit and nadir are modelled, a row each."""
    rows: list[dict[str, Any]] = []
    plain, hold = flight_gap.predict_residuals(scenario), flight_gap.HOLD
    for name, changes in ORBIT_VARIANTS.items():
        changed = override(scenario, changes)
        predicted, truth = flight_gap.predict_residuals(changed), motion(changed)
        rates = np.rad2deg(truth.rates[truth.intervals[hold]])
        rows.append(
            {
                "orbit": name,
                "clean_gap_rms_deg": flight_gap.compute_clean_gap_rms(predicted),
                "gap_rms_deg": flight_gap.compute_gap_rms(predicted),
                "omega_x_deg_s": round(float(np.abs(rates[:, 0]).max()), 9),  # what is left of zero is the integration's
                "interval_5_yaw_deg": float(predicted[hold, 2] - plain[hold, 2]),
            }
        )
    return pd.DataFrame(rows)


def build_packet_table(scenario: Scenario, seed: int) -> pd.DataFrame:
    """The same flight calibrated from packets with some sizes of a count, beside its rates."""
    recording = simulate(scenario, seed=seed)
    from_rates = calibrate(recording)
    noise = recording.gyro.arw * np.sqrt(recording.gyro.sample_s)
    rows: list[dict[str, Any]] = []
    for number, lsb in enumerate(LSBS_ARCSEC):
        back, wraps = convert_through_packets(recording, lsb, WRAP, generator(seed, number, "packets"))
        rows.append(
            {
                "lsb_arcsec": lsb,
                "wraps": wraps,
                "rounding_over_noise": float(lsb * ARCSEC_IN_RAD / np.sqrt(6) / noise),
                "rate_rms_deg_s": float(np.rad2deg(np.sqrt(np.mean((back.gyro.rates - recording.gyro.rates) ** 2)))),
                **_measure_calibration_change(calibrate(back), from_rates),
            }
        )
    return pd.DataFrame(rows)


def simulate_packets(recording: Recording, lsb: float, wrap: int, rng: np.random.Generator) -> pd.DataFrame:
    """Simulate packets that hold each gyro's register of accumulated angle, N(t) = ⌊φ(t)/q⌋ mod w.

    n samples that follow one another make n + 1 packets. The register goes on while nothing is recorded, so that each stretch
    of samples begins anywhere.

    Parameters
    ----------
    recording : with the rates as the gyros put them out, noise included
    lsb : q, rad
    wrap : w, counts
    rng : of the register's value at the start of a stretch

    Returns
    -------
    t_s, and count_NAME of each gyro, whole numbers from 0 to w − 1
    """
    gyro, lasts = recording.gyro, compute_durations(recording)
    angles = gyro.rates * lasts[:, None] / lsb  # counts
    starts = np.flatnonzero(np.diff(gyro.t_s, prepend=-np.inf) > np.append(0.0, lasts[:-1]) + TIME_TOLERANCE)
    parts = []
    for first, last in zip(starts, [*starts[1:], len(gyro.t_s)], strict=True):
        begin = wrap * rng.random(size=3)
        counts = np.floor(begin + np.vstack([np.zeros(len(begin)), np.cumsum(angles[first:last], axis=0)]))
        times = np.append(gyro.t_s[first:last], gyro.t_s[last - 1] + lasts[last - 1])
        parts.append(np.column_stack([times, np.mod(counts, wrap)]))
    names = [f"count_{name}" for name in AXIS_NAMES]
    return pd.DataFrame(np.concatenate(parts), columns=["t_s", *names]).astype(dict.fromkeys(names, np.int64))


def convert_through_packets(
    recording: Recording, lsb_arcsec: float, wrap: int, rng: np.random.Generator
) -> tuple[Recording, int]:
    """A recording whose rates went through packets and the reader of `gyrocal import csv`; and how often a register wrapped."""
    counts = simulate_packets(recording, lsb_arcsec * ARCSEC_IN_RAD, wrap, rng)
    names = [name for name in counts.columns if name != "t_s"]
    mapping = validate_mapping(
        {
            "time": "t_s:s",
            "gyro": f"{','.join(names)}:counts",
            "lsb": f"{lsb_arcsec:g} arcsec",
            "wrap": float(wrap),
            "quat": "q1,q2,q3,q4:scalar-last:body-to-inertial",
        },
        "packets",
    )
    read = read_streams(counts, recording.to_frame("attitude"), mapping)
    if not np.allclose(read.t_s, recording.gyro.t_s, rtol=0, atol=1e-6):
        raise ValueError("the packets do not give the samples that went into them")
    wraps = int((np.abs(np.diff(counts[names].to_numpy(), axis=0)) > wrap / 2).sum())
    return replace(recording, gyro=replace(recording.gyro, rates=read.raw)), wraps


def _measure_calibration_change(found: CalibrationResult, before: CalibrationResult) -> dict[str, float]:
    """Largest change of a parameter in sigmas, and of a residual after calibration in deg."""
    parameters = (found.parameters.vector - before.parameters.vector) / np.sqrt(np.diag(before.covariance))
    names = [f"after_{axis}_deg" for axis in flight.ROTATIONS]
    residuals = found.residuals[names].to_numpy() - before.residuals[names].to_numpy()
    return {"largest_change_sigma": float(np.abs(parameters).max()), "residual_change_deg": float(np.abs(residuals).max())}
