"""Mission Mode closed: what R requires when calibrated, R's symptoms when not, each with a control."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulator.mission_mode.calendar import compute_sun_angle
from simulator.mission_mode.config import (
    PRELAUNCH_G,
    R9_BIAS,
    R9_G,
    Controller,
    MissionConfig,
    OnBoardTables,
    TrueGyro,
    YawManeuver,
    build_period_tables,
)
from simulator.mission_mode.flight import ROTATION_NAMES, build_flight_schedule, simulate_mission
from simulator.mission_mode.mounting import BORESIGHTS, R3_M, build_mounted_sensors
from simulator.sensors.earth import TrueEarthSensor
from simulator.sensors.sun import (
    build_trmm_sensors,
)
from simulator.truth.orbit import compute_lvlh_rate

DAY = 86400.0
PERIODS = build_period_tables()
SETTLED = 4  # yaw updates until the cycle has settled
ORBIT_S = MissionConfig().orbit.period
KNOWLEDGE, POINTING, JITTER = 0.2, 0.4, 0.1  # deg; R Table 1, the first two 3-sigma


def config(period="postcalibration", **changes):
    return replace(MissionConfig(), **{"tables": PERIODS[period], **changes})


def at_sun_angle(degrees, **changes):
    """Calibrated, with the node at which the Sun stands at this angle at the epoch, forward so that it is on −Y."""
    base = config(**changes)
    nodes = np.deg2rad(np.arange(0.0, 360.0, 0.25))
    angles = np.array([compute_sun_angle(base.epoch, replace(base.orbit, node=n), np.zeros(1))[0] for n in nodes])
    node = nodes[np.argmin(np.abs(np.rad2deg(np.abs(angles)) - degrees))]
    orbit = replace(base.orbit, node=float(node))
    return replace(base, orbit=orbit, forward="+x" if compute_sun_angle(base.epoch, orbit, np.zeros(1))[0] > 0 else "-x")


def quiet(mounting_or_sensors, tables):
    """No noise at all."""
    sensors = build_mounted_sensors(mounting_or_sensors) if isinstance(mounting_or_sensors, str) else mounting_or_sensors
    return replace(
        config(),
        tables=tables,
        sun_sensors=tuple(replace(sensor, noise=0.0) for sensor in sensors),
        earth_sensor=TrueEarthSensor(sigma=0.0, sigma_s=0.0, swing=0.0),
        gyro=TrueGyro(arw=0.0),
        magnetometer_sigma=0.0,
    )


@pytest.fixture(scope="module")
def runs():
    return {name: simulate_mission(config(name), days=1.0, seed=11) for name in PERIODS}


def mean_update(run):
    return run.updates["update_deg"][SETTLED:].abs().mean()


def test_calibrated_meets_the_requirements_and_uncalibrated_yaw_misses_them(runs):
    orbits = runs["postcalibration"].orbits[2:]
    for axis in ROTATION_NAMES:
        assert 3 * orbits[f"rms_knowledge_{axis}_deg"].max() < KNOWLEDGE
        assert 3 * orbits[f"rms_error_{axis}_deg"].max() < POINTING
        assert orbits[f"largest_error_{axis}_deg"].max() < POINTING
        assert orbits[f"jitter_{axis}_deg"].max() < JITTER
    assert 3 * runs["precalibration"].orbits[2:]["rms_knowledge_yaw_deg"].mean() > KNOWLEDGE  # R: did not meet them


def test_yaw_updates_by_period(runs):
    """Before any upload twice what R (3) is about body z at raised boresights, 2 |cos E m_x − sin E m_z|; near none after."""
    turn = np.rad2deg(Rotation.from_matrix(R3_M).as_rotvec())
    expected = 2 * abs(np.cos(BORESIGHTS[1]) * turn[0] - np.sin(BORESIGHTS[1]) * turn[2])
    assert mean_update(runs["precalibration"]) == pytest.approx(expected, abs=0.02)
    assert mean_update(runs["calibration1"]) < 0.05
    assert mean_update(runs["postcalibration"]) < 0.05


@pytest.mark.parametrize("difference_deg", [0.1, 0.0])
def test_cycle_is_twice_the_difference(difference_deg):
    """Without noise and gyro errors, two sensors that differ by d in yaw give d and then 2 d for ever; alike they give none."""
    plain = build_trmm_sensors(BORESIGHTS[0], heads=(np.zeros(3), np.zeros(3)), elevation=BORESIGHTS[1])
    c, s = np.cos(np.deg2rad(difference_deg)), np.sin(np.deg2rad(difference_deg))
    turned = replace(plain[1], alignment=np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ plain[1].alignment)
    run = simulate_mission(quiet((plain[0], turned), OnBoardTables(G=R9_G, bias=R9_BIAS)), seconds=6 * ORBIT_S)
    sizes = run.updates["update_deg"].to_numpy()
    first = np.flatnonzero(np.abs(sizes) > 0.5 * difference_deg)[0] if difference_deg else 0
    # A count is 0.0083°, three readings make an update, and the quasi-geodetic nadir of roll gives a little more.
    assert np.abs(sizes[first]) == pytest.approx(difference_deg, abs=0.02)
    assert np.abs(sizes[SETTLED:]) == pytest.approx(2 * difference_deg, abs=0.03)


@pytest.mark.parametrize("forward", ["+x", "-x"])
def test_apparent_bias_is_that_of_the_orientation(forward):
    """R (8): ω − G ω_raw at ±1 RPO. The gyro's white noise over an orbit has ARW/√T; taken over 7 orbits, at 4 sigma."""
    tables = PERIODS["precalibration"]
    run = simulate_mission(replace(at_sun_angle(20.0, tables=tables), forward=forward), seconds=8 * ORBIT_S, seed=4)
    G = tables.G
    rate = compute_lvlh_rate(MissionConfig().orbit, np.zeros(1))[0] * (1 if forward == "+x" else -1) * np.array([0.0, 1.0, 0.0])
    expected = np.rad2deg(rate - G @ np.linalg.solve(R9_G, rate - R9_BIAS)) * 3600
    found = [run.orbits[f"apparent_bias_{axis}_deg_h"][1:].mean() for axis in ROTATION_NAMES]
    assert found == pytest.approx(expected, abs=4 * 2.6e-4 * 3600 / np.sqrt(7 * ORBIT_S))


def slewed(tables, **changes):
    """−x to +x, as on January 14, the Sun nearly in the orbit plane."""
    base = replace(config(), tables=tables, **changes)
    at = float(2.5 * ORBIT_S)
    return simulate_mission(replace(base, maneuvers=(YawManeuver(at),)), seconds=7 * ORBIT_S, seed=2, telemetry_every=4)


def test_yaw_maneuver_before_and_after_calibration():
    """R Table 2, roll 0.248° before and −0.006° after; R's sign is propagated minus true, the opposite of ours."""
    before, after = (slewed(PERIODS[name]) for name in ("precalibration", "postcalibration"))
    assert -before.slews["targeting_roll_deg"][0] == pytest.approx(0.248, abs=0.08)
    # The white noise of the gyro through 1000 s is 0.008°, the on-board yaw bias is good to 0.02 deg/h.
    for axis in ROTATION_NAMES:
        assert abs(after.slews[f"targeting_{axis}_deg"][0]) < 0.04
    assert after.orbits["forward"].tolist() == ["-x"] * 3 + ["+x"] * 4
    assert after.updates["bias_solved"].tolist().count(False) == 2  # the very first one, and the first after the maneuver
    # The slew was flown: the Sun is on the other side.
    assert (after.updates["sun_angle_deg"][after.updates["forward"] == "-x"] > 0).all()
    assert (after.updates["sun_angle_deg"][after.updates["forward"] == "+x"] < 0).all()


def test_uploads_take_effect_on_their_day():
    upload = (6 * ORBIT_S, PERIODS["postcalibration"])
    run = simulate_mission(config("precalibration", uploads=(upload,)), seconds=14 * ORBIT_S, seed=5)
    sizes, before = run.updates["update_deg"].abs(), run.updates["t_s"] < upload[0]
    assert sizes[before][SETTLED:].mean() > 0.12
    assert sizes[~before][3:].mean() < 0.06


def test_unloading_bounds_the_wheels():
    """With the torquers the momentum stays; without (negative control) air and residual moment fill the wheels."""
    with_it = simulate_mission(config(), days=1.5, seed=6).orbits["momentum_nms"].to_numpy()
    without = simulate_mission(config(controller=Controller(unloading=0.0)), days=1.5, seed=6).orbits["momentum_nms"].to_numpy()
    assert with_it.max() < 15.0
    assert without.max() > 5 * with_it.max()


def test_faulty_s_filter_shows_as_spikes():
    """R Figure 8: with the Sun through a quadrant the faulty restart tilts the spacecraft; filter off and correct do not."""
    worst = {}
    for s_filter in ("restarted", "correct", "off"):
        run = simulate_mission(
            at_sun_angle(42.0, tables=replace(PERIODS["postcalibration"], s_filter=s_filter)),
            seconds=4 * ORBIT_S,
            seed=7,
            telemetry_every=4,
        )
        assert run.orbits["three_quadrants"][0] > 0.005
        worst[s_filter] = run.telemetry[["error_roll_deg", "error_pitch_deg"]].abs().to_numpy().max()
    assert worst["restarted"] > 0.1
    assert max(worst["correct"], worst["off"]) < 0.5 * worst["restarted"]


def test_penetration_biases_show_as_roll_and_pitch(runs):
    """Roll ½ Σ b_i sin ζ_i, pitch −½ Σ b_i cos ζ_i: what the spacecraft leans by until the biases are on board."""
    b = np.deg2rad([-0.1574, 0.04635, -0.09414, -0.05382])
    zeta = np.deg2rad([45.0, 135.0, 225.0, 315.0])
    lean = np.rad2deg([-0.5 * b @ np.sin(zeta), 0.5 * b @ np.cos(zeta)])
    columns = ["error_roll_deg", "error_pitch_deg"]
    found = [runs[name].telemetry[columns][30:].mean().to_numpy() for name in ("precalibration", "calibration1")]
    assert found[0] - found[1] == pytest.approx(lean, abs=0.003)
    assert np.abs(found[1]).max() < 0.005


def test_flight_schedule():
    schedule = build_flight_schedule(MissionConfig(), 120.0)
    assert len(schedule.maneuvers) == 6
    first, second = schedule.uploads
    assert first[0] / DAY == pytest.approx(13.6, abs=0.1)  # December 11
    assert second[0] / DAY == pytest.approx(91.6, abs=0.1)  # February 27
    assert first[1].s_filter == "off"
    assert (first[1].G == PRELAUNCH_G).all()
    assert (second[1].G == R9_G).all()
    assert (second[1].misalignments == first[1].misalignments).all()
