"""The tables beside the flight's: each statistic on made-up runs with known answers, formulas against the loop itself."""

import numpy as np
import pandas as pd
import pytest

from simulator.mission_mode.config import (
    DAY,
    PRELAUNCH_G,
    R9_BIAS,
    R9_G,
    MissionConfig,
)
from simulator.mission_mode.flight import MissionRun
from studies.robertson import ground, performance, published_tables
from studies.robertson.calendar import (
    FIRST_DAYS,
    convert_to_mission_day,
)

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
    assert performance.compute_performance(run, "calibration1")["attitude_accuracy_deg", "yaw"] == pytest.approx(0.03)
    # Negative control: counted as normal pointing, the orbit with the maneuver would show.
    wrong = performance.compute_performance(run_of([*rows, {**slew, "lost": 0.0}]), "calibration1")
    assert wrong["attitude_accuracy_deg", "yaw"] > 1.0
    assert performance.compute_performance(run, "calibration1")["yaw_update_deg", "yaw"] == pytest.approx(0.25)
    sizes = performance.compare_orientations([run]).set_index(["period", "forward"])["yaw_update_deg"]
    assert [sizes["calibration1", forward] for forward in ("+x", "-x")] == pytest.approx([0.4, 0.1])
    row = (
        performance.build_requirements_table([run])
        .set_index(["period", "requirement", "axis"])
        .loc["calibration1", "stability", "yaw"]
    )
    assert row["simulated_deg"] == pytest.approx(0.16)
    assert not row["met"]


def test_solved_bias_is_r8_and_targeting_has_rs_sign():
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
    slew = pd.DataFrame([{**{f"targeting_{a}_deg": 0.1 * (k + 1) for k, a in enumerate(AXES)}, "bias_yaw_deg_h": 0.3}])
    (row,) = performance.collect_slew_misses(
        {("slew", "+x to -x", "calibration1", "3"): MissionRun(EMPTY, EMPTY, slew, EMPTY)}
    ).itertuples()
    assert (row.roll_deg, row.pitch_deg, row.yaw_deg) == pytest.approx((-0.1, -0.2, -0.3))
    assert (row.maneuver, row.tables, row.seed) == ("+x to -x", "calibration1", 3)


def test_maneuvers_are_on_the_flights_days():
    table = performance.compare_maneuver_dates(154.2)
    near = table[table["flight"] != ""]
    assert (len(table), near["flight_utc"].tolist()) == (7, ["1997-12-13", "1998-01-14", "1998-03-21"])
    assert near["simulated_minus_flight_days"].abs().max() < 0.6
