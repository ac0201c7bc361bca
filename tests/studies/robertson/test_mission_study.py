"""The tables beside the flight's: each statistic on made-up runs with known answers, formulas against the loop itself."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from simulator.mission_mode.config import (
    DAY,
    PRELAUNCH_BIAS,
    PRELAUNCH_G,
    R9_BIAS,
    R9_G,
    MissionConfig,
    TrueGyro,
    YawManeuver,
    build_period_tables,
)
from simulator.mission_mode.flight import MissionRun, simulate_mission
from simulator.mission_mode.mounting import BORESIGHTS, R3_M
from simulator.sensors.earth import TrueEarthSensor
from simulator.sensors.sun import SIMULATED_BETA_COEFFICIENTS, build_trmm_sensors
from studies.robertson import ground, performance, published_tables
from studies.robertson.calendar import (
    FIRST_DAYS,
    YAW_MANEUVER_TIMES,
    build_slew_config,
    convert_to_mission_day,
)
from studies.robertson.runs import SLEW_TABLES

BASE = MissionConfig()
AXES = published_tables.ROTATION_NAMES
EMPTY = pd.DataFrame()


def middle(period):
    """A moment in the middle of a period, s."""
    start, stop = (convert_to_mission_day(moment, BASE) * DAY for moment in FIRST_DAYS[period])
    return 0.5 * (start + stop)


def orbit(period, forward="+x", samples=1000.0, lost=0.0, **values):
    """A row of an orbit table; every number not given is zero."""
    names = ("rms_knowledge", "rms_error", "jitter")
    numbers = {f"{name}_{axis}_deg": 0.0 for name in names for axis in AXES}
    numbers |= {f"apparent_bias_{axis}_deg_h": 0.0 for axis in AXES}
    return {"t_s": middle(period), "forward": forward, "samples": samples, "lost": lost, **numbers, **values}


def run_of(orbits=(), updates=()):
    """A run with these orbits and (period, forward, update in deg)."""
    rows = [{"t_s": middle(period), "forward": forward, "update_deg": size} for period, forward, size in updates]
    table = pd.DataFrame(rows, columns=["t_s", "forward", "update_deg"])
    frame = pd.DataFrame(list(orbits), columns=list(orbit("precalibration")))
    return MissionRun(EMPTY, table, EMPTY, frame)


def test_statistics_of_a_period_are_those_of_its_full_orbits_and_updates():
    """Means over full orbits, the mean size of updates, the largest jitter; orientations apart."""
    rows = [orbit("calibration1", rms_knowledge_yaw_deg=k, jitter_yaw_deg=4 * k) for k in (0.02, 0.04)]
    slew = orbit("calibration1", lost=300.0, rms_knowledge_yaw_deg=9.0)
    other = orbit("precalibration", rms_knowledge_yaw_deg=9.0)
    updates = [("calibration1", "+x", -0.4), ("calibration1", "-x", 0.1), ("postcalibration", "+x", 5.0)]
    run = run_of([*rows, slew, other], updates)
    assert performance.compute_attitude_accuracy(run, "calibration1", "yaw") == pytest.approx(0.03)
    # Negative control: counted as normal pointing, the orbit with the maneuver would show.
    assert performance.compute_attitude_accuracy(run_of([*rows, {**slew, "lost": 0.0}]), "calibration1", "yaw") > 1.0
    assert performance.compute_mean_update(run, "calibration1") == pytest.approx(0.25)
    sizes = performance.compare_orientations([run]).set_index(["period", "forward"])["yaw_update_deg"]
    assert [sizes["calibration1", forward] for forward in ("+x", "-x")] == pytest.approx([0.4, 0.1])
    row = (
        performance.build_requirements_table([run])
        .set_index(["period", "requirement", "axis"])
        .loc["calibration1", "stability", "yaw"]
    )
    assert row["simulated_deg"] == pytest.approx(0.16)
    assert not row["met"]


@pytest.mark.parametrize(("knowledge", "met"), [(0.066, True), (0.067, False)])
def test_requirements_are_three_sigma(knowledge, met):
    """Weighted by samples: 3 σ of 0.198 or 0.201°, whatever a short orbit adds."""
    rows = [orbit("postcalibration", rms_knowledge_roll_deg=knowledge), orbit("postcalibration", samples=0.0)]
    table = performance.build_requirements_table([run_of(rows)]).set_index(["period", "requirement", "axis"])
    row = table.loc[("postcalibration", "knowledge", "roll")]
    assert row["simulated_deg"] == pytest.approx(3 * knowledge)
    assert row["met"] == met
    mixed = [orbit("postcalibration", rms_error_yaw_deg=0.1), orbit("postcalibration", samples=3000.0, rms_error_yaw_deg=0.2)]
    table = performance.build_requirements_table([run_of(mixed)]).set_index(["period", "requirement", "axis"])
    row = table.loc[("postcalibration", "pointing", "yaw")]
    assert row["simulated_deg"] == pytest.approx(3 * np.sqrt((0.1**2 + 3 * 0.2**2) / 4))


def test_maneuvers_are_on_the_flights_days():
    table = performance.compare_maneuver_dates(154.2)
    assert len(table) == 7
    near = table[table["flight"] != ""]
    assert near["flight_utc"].tolist() == ["1997-12-13", "1998-01-14", "1998-03-21"]
    assert near["simulated_minus_flight_days"].abs().max() < 0.6
    published = published_tables.read_maneuver_dates()["forward_after"]
    assert near["forward_after"].tolist()[:2] == published.tolist()[:2]


def test_solved_bias_is_r8():
    """R (8) is written for G = I: b' = b + (G − I) ω_raw. With the true G the bias is b in either orientation."""
    for forward, sign in (("+x", -1.0), ("-x", 1.0)):
        rate = BASE.orbit.mean_motion + BASE.orbit.nodal_rate * np.cos(BASE.orbit.inclination)
        raw = np.linalg.solve(R9_G, np.array([0.0, sign * rate, 0.0]) - R9_BIAS)
        assert performance.compute_solved_bias(np.eye(3), forward) == pytest.approx(
            R9_BIAS + (R9_G - np.eye(3)) @ raw, abs=1e-18
        )
        assert performance.compute_solved_bias(R9_G, forward) == pytest.approx(R9_BIAS, abs=1e-17)
    apart = performance.compute_solved_bias(PRELAUNCH_G, "-x") - performance.compute_solved_bias(PRELAUNCH_G, "+x")
    # 2 n (G_pre − G)[z, y], negative control of the independence.
    expected = -2 * rate * (PRELAUNCH_G - R9_G)[2, 1]
    assert apart[2] == pytest.approx(expected, rel=0.01)
    assert apart[2] * ground.DEG_H_PER_RAD_S == pytest.approx(0.546, abs=0.001)


MANEUVER_STEPS = 5000  # of the maneuver; leaves 1e-6 deg


def compute_noise_free_miss(maneuver, tables, solved=True):
    """The miss by G and b alone, propagated minus true, (3,) deg: a turn at constant orbital rate with the loop's yaw profile.

    With A_propagated = exp(−[ε×]) A the error grows as ε' = δω − ω × ε, δω the propagated rate minus the true one, so that at
    the end it is A ∫ Aᵀ δω dt. The orbital rate n in the body turns with the yaw κ: ω = (−n sin κ, −n cos κ, κ').

    Parameters
    ----------
    maneuver : "+x to -x", by +180°, or "-x to +x", by −180°
    tables : "calibration1" with the gyro's parameters of before launch, "postcalibration" with R (9)
    solved : whether the yaw bias is the one solved for before the maneuver, as on board, or the published one
    """
    G, b = (R9_G, R9_BIAS) if tables == "postcalibration" else (PRELAUNCH_G, PRELAUNCH_BIAS)
    start, sign = (0.0, 1.0) if maneuver == "+x to -x" else (np.pi, -1.0)
    if solved:
        b = np.array([b[0], b[1], performance.compute_solved_bias(G, maneuver[:2])[2]])
    shape = YawManeuver(0.0)
    t, dt, r = (np.arange(MANEUVER_STEPS) + 0.5) / MANEUVER_STEPS, shape.duration_s / MANEUVER_STEPS, shape.ramp_fraction
    rise, fall = np.clip(t / r, 0, 1), np.clip((t - 1 + r) / r, 0, 1)
    rate = sign * np.pi / shape.duration_s / (1 - r) * ((3 - 2 * rise) * rise**2 - (3 - 2 * fall) * fall**2)
    yaw = start + (np.cumsum(rate) - 0.5 * rate) * dt
    n = MissionConfig().orbit.mean_motion
    omega = np.stack([-n * np.sin(yaw), -n * np.cos(yaw), rate], axis=-1)
    wrong = (omega - R9_BIAS) @ np.linalg.inv(R9_G).T @ G.T + b - omega
    to_start = _rotate_pitch_yaw(yaw, -n * t * shape.duration_s).transpose(0, 2, 1)
    gathered = np.einsum("kij,kj->i", to_start, wrong) * dt
    end = _rotate_pitch_yaw(np.array([start + sign * np.pi]), np.array([-n * shape.duration_s]))[0]
    return np.asarray(np.round(np.rad2deg(end @ gathered), 9) + 0.0)


def _rotate_pitch_yaw(yaw, pitch):
    """Body axes turned by the pitch about y and then by the yaw about z, (k, 3, 3)."""
    return np.asarray(Rotation.from_euler("YZ", np.stack([pitch, yaw], axis=-1)).as_matrix().transpose(0, 2, 1))


def quiet(config):
    """The config without noise; the sun sensors' is left, it is 0.005° in yaw."""
    return replace(
        config,
        gyro=TrueGyro(arw=0.0),
        earth_sensor=TrueEarthSensor(sigma=0.0, sigma_s=0.0, swing=0.0),
        magnetometer_sigma=0.0,
    )


@pytest.mark.parametrize("maneuver", list(YAW_MANEUVER_TIMES))
@pytest.mark.parametrize("tables", SLEW_TABLES)
def test_noise_free_miss_is_that_of_the_loop(maneuver, tables):
    """The Earth's geodetic lean, 0.2° at most, is left; square heads, for an error of theirs would drift the solved bias."""
    square = build_trmm_sensors(BORESIGHTS[0], (np.eye(3), R3_M), (np.zeros(3), np.zeros(3)), BORESIGHTS[1])
    own = replace(
        build_period_tables()[tables], coefficients_beta=np.stack([SIMULATED_BETA_COEFFICIENTS, SIMULATED_BETA_COEFFICIENTS])
    )
    config = quiet(build_slew_config(replace(BASE, sun_sensors=square), own, maneuver))
    run = simulate_mission(config, seconds=config.maneuvers[0].start_s + 1010.0, telemetry_every=None)
    slew = run.slews.iloc[0]
    assert slew["forward"] == maneuver[-2:]
    miss = np.array([-slew[f"targeting_{axis}_deg"] for axis in AXES])
    published = compute_noise_free_miss(maneuver, tables, solved=False)
    solved = compute_noise_free_miss(maneuver, tables)
    if tables == "postcalibration":
        assert (solved == 0).all()
    else:
        assert np.abs(miss - solved).max() < 0.012
        assert np.abs(miss - published).max() > 0.03  # negative control: another yaw bias is another miss
    assert np.abs(miss[:2] - solved[:2]).max() < 0.012


def test_targeting_has_rs_sign():
    slew = pd.DataFrame([{**{f"targeting_{a}_deg": 0.1 * (k + 1) for k, a in enumerate(AXES)}, "bias_yaw_deg_h": 0.3}])
    (row,) = performance.collect_slew_misses(
        {("slew", "+x to -x", "calibration1", "3"): MissionRun(EMPTY, EMPTY, slew, EMPTY)}
    ).itertuples()
    assert (row.roll_deg, row.pitch_deg, row.yaw_deg) == pytest.approx((-0.1, -0.2, -0.3))
    assert (row.maneuver, row.tables, row.seed) == ("+x to -x", "calibration1", 3)
