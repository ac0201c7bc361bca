"""The ground's batch over flown telemetry against closed forms, the ladder's arithmetic, the geometry, and a planted cause."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from simulator.mission_mode.config import R9_BIAS, R9_G, MissionConfig, OnBoardTables
from simulator.mission_mode.flight import simulate_mission
from simulator.mission_mode.mounting import BORESIGHTS, ELEVATION, R3_M
from simulator.sensors.earth import TrueEarthSensor
from simulator.sensors.sun import build_trmm_sensors
from studies.robertson import diagnosis, geometry, ladder
from studies.robertson.calendar import PERIODS
from studies.robertson.ground import DEG_H_PER_RAD_S, align_one_orbit, solve_ground_attitude
from studies.robertson.ladder import (
    ANGLE_STATISTICS,
    WINDOW_NUMBERS,
    compute_rms_factor,
    compute_simulated_numbers,
    read_published_numbers,
)

SQUARE = (np.zeros(3), np.zeros(3))
ORBIT_S = MissionConfig().orbit.period


def perfect(misalignments=None, **changes):
    """No noise, square heads, the gyro's parameters known."""
    sensors = build_trmm_sensors(BORESIGHTS[0], misalignments, SQUARE, BORESIGHTS[1])
    base = MissionConfig(
        sun_sensors=tuple(replace(sensor, noise=0.0) for sensor in sensors),
        earth_sensor=TrueEarthSensor(sigma=1e-7, sigma_s=0.0, swing=0.0, s_filter="off"),
        tables=OnBoardTables(G=R9_G, bias=R9_BIAS, s_filter="off"),
        magnetometer_sigma=0.0,
    )
    return replace(base, gyro=replace(base.gyro, arw=1e-12), **changes)


def solved(config, **changes):
    run = simulate_mission(config, seconds=2 * ORBIT_S, telemetry_every=1)
    rows = run.telemetry[run.telemetry["t_s"] >= ORBIT_S]
    return solve_ground_attitude(config, rows, replace(config.tables, **changes), np.random.default_rng(0))


def test_without_errors_the_ground_has_the_truth_and_its_own_alignment_is_near_r3():
    """Counts of 0.0083° are left; on board minus ground is then on board minus true."""
    found = solved(perfect())
    assert np.rad2deg(np.abs(found.ground_minus_true)).max() < 0.003
    assert found.bias * DEG_H_PER_RAD_S == pytest.approx(R9_BIAS * DEG_H_PER_RAD_S, abs=0.01)
    difference = found.onboard_minus_ground - found.onboard_minus_true
    assert difference == pytest.approx(-found.ground_minus_true, abs=1e-7)
    # The mounting was solved by a fit of its own; R's first algorithm on flown telemetry at 10° comes to R (3) too.
    found = align_one_orbit(MissionConfig(), 10.0, 1998, 0)
    angles = [Rotation.from_matrix(M).as_rotvec(degrees=True) for M in (found.misalignment["DSS-2"], R3_M)]
    assert angles[0] == pytest.approx(angles[1], abs=0.04)


def test_a_turned_yaw_reference_is_a_bias_about_x():
    """Both sensors turned by ψ about body z: the ground's attitude is, and b_x is off by −n ψ, the rate about y being −n."""
    psi = np.deg2rad(1.0)
    turn = Rotation.from_rotvec([0.0, 0.0, psi]).as_matrix()
    # A noiseless Earth sensor would see yaw by the oblate Earth and outvote the sun sensors.
    base = perfect(forward="-x", earth_sensor=TrueEarthSensor(s_filter="off"))
    turned = tuple(replace(sun_sensor, alignment=turn @ sun_sensor.alignment) for sun_sensor in base.sun_sensors)
    plain, found = solved(base), solved(replace(base, sun_sensors=turned))
    shift = (found.bias - plain.bias)[0]
    yaw = np.mean(found.ground_minus_true[:, 2])
    assert abs(yaw) == pytest.approx(psi, rel=0.1)
    assert shift == pytest.approx(-base.orbit.mean_motion * yaw, rel=0.1)


def test_the_factor_is_that_of_the_logarithms():
    values = read_published_numbers()
    assert compute_rms_factor(values, WINDOW_NUMBERS) == pytest.approx(1.0)
    twice = {number: 2 * value for number, value in values.items()}
    half = {number: 0.5 * value for number, value in values.items()}
    assert compute_rms_factor(twice, WINDOW_NUMBERS) == pytest.approx(2.0)
    assert compute_rms_factor(half, WINDOW_NUMBERS[:5]) == pytest.approx(2.0)
    assert np.isnan(compute_rms_factor(values, ()))
    groups = ladder.group_numbers(WINDOW_NUMBERS[:3])
    assert [len(groups[name]) for name in ("factor_18", "factor_12", "factor_unfitted")] == [18, 12, 15]


def test_geometry_of_the_mounting_and_of_r6():
    """Availability rises up to the elevation at which the field's edge is the limb, and falls beyond."""
    angles = np.deg2rad([5.0, 20.0, 40.0])
    share = [geometry.compute_sun_availability(BORESIGHTS[0], up, angles).mean() for up in np.deg2rad([0.0, 20.0, 29.4, 40.0])]
    assert share[0] < share[1] < share[2] > share[3]
    assert np.rad2deg(-ELEVATION) == pytest.approx(29.4, abs=0.1)
    # With a zero slipped in c both numbers of DSS-1 stand for one |tan α|; as printed they do not (control).
    rows = geometry.compute_alpha_tangents().set_index(["sensor", "number"])
    c, d = (rows.loc[("DSS-1", number)] for number in ("c - 1", "d"))
    assert c["tan_alpha"] == pytest.approx(d["tan_alpha"], rel=0.02)
    assert abs(c["tan_alpha_as_printed"]) < 0.2 * abs(d["tan_alpha_as_printed"])
    assert (c["slip"], d["slip"]) == (10.0, 1.0)
    assert c["computed_1e6"] == pytest.approx(10 * c["published_1e6"], rel=0.1)


def windows_of(scale):
    """Made-up windows: numbers scattered by 5 % about a base, times a factor by parameter and axis."""
    rng, rows = np.random.default_rng(7), []
    for period in PERIODS:
        for k in range(12):
            row = {"period": period, "day": 10.0 + k, "yaw_update_deg": 0.1 * (1 + 0.05 * rng.standard_normal())}
            for axis in ("roll", "pitch", "yaw"):
                row[f"onboard_minus_ground_{axis}_deg"] = 0.02 * (1 + 0.05 * rng.standard_normal()) * scale.get(axis, 1.0)
            rows.append(row | {f"bias_{axis}_deg_h": 0.05 * rng.standard_normal() for axis in "xyz"})
    return pd.DataFrame(rows)


def test_a_planted_cause_is_named_and_an_unlisted_one_is_not(monkeypatch):
    base = windows_of({})
    trials = {one.setting: base for one in diagnosis.TRIED_EFFECTS if one.setting}
    trials[(ladder.HORIZON,)] = windows_of({"roll": 1.5, "pitch": 1.5})
    trials |= {ladder.NOMINAL: base}
    planted = compute_simulated_numbers(trials[(ladder.HORIZON,)])
    monkeypatch.setattr(diagnosis, "read_published_numbers", lambda: planted)
    found = diagnosis.diagnose_table3(trials)
    assert found.probabilities["horizon_noise"] > 0.9
    assert found.fitted[0].size == pytest.approx(0.0287, rel=0.1)
    # Control: a change that no effect makes is unknown.
    odd = compute_simulated_numbers(base) | {(ANGLE_STATISTICS[1], "yaw", PERIODS[0]): 0.5}
    monkeypatch.setattr(diagnosis, "read_published_numbers", lambda: odd)
    other = diagnosis.diagnose_table3(trials)
    assert other.attribution.unknown > 0.9
