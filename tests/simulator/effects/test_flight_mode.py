"""Which axis flies forward, from how the body turns and never from the name of an activity."""

from dataclasses import replace

import numpy as np
import pytest

import simulator
from simulator.effects import find_flight_directions, parse
from simulator.effects.base import References, Surroundings
from simulator.effects.reference.reference_mode_offset import EFFECT as MODE_OFFSET
from simulator.truth.rotation import separation

SERIES = simulator.load("trmm_series")
RECORDING = simulator.simulate(SERIES, seed=2)


def forward_axes(recording):
    return find_flight_directions(recording)[0]


def runs_of(recording, number):
    """The axes flown in an interval, each run of references once."""
    interval, t_s = recording.intervals[number], recording.attitudes.t_s
    axes = forward_axes(recording)[(t_s >= interval.start_s) & (t_s <= interval.stop_s)]
    return [str(axis) for k, axis in enumerate(axes) if k == 0 or axis != axes[k - 1]]


FLOWN = [["+x"], ["+x", "-x"], ["-x"], ["-x", "-y", "-x"], ["-x", "", "-x"], ["-x", "+x"]]


def test_modes_of_the_six_maneuvers():
    assert [runs_of(RECORDING, number) for number in range(6)] == FLOWN
    # The names of activities are not read.
    silent = replace(RECORDING, intervals=tuple(replace(interval, activity="+y forward") for interval in RECORDING.intervals))
    np.testing.assert_array_equal(forward_axes(silent), forward_axes(RECORDING))


def test_a_reference_in_a_slew_belongs_to_the_nearer_mode():
    slew = {"axis": [0.0, 0.0, 1.0], "angle_deg": 180.0, "start_s": 100.0, "duration_s": 800.0}
    interval = {"name": "a", "activity": "", "start_s": 0.0, "stop_s": 1000.0, "mode": "+x", "slew": [slew]}
    recording = simulator.simulate(simulator.override(SERIES, {"interval": [interval]}), seed=3)
    # References in the slew too, each 40 s, where the simulator's own are at constant rates only.
    t_s = np.arange(0.0, 1001.0, 40.0)
    attitudes = replace(
        recording.attitudes, t_s=t_s, quaternions=np.tile([0.0, 0, 0, 1], (26, 1)), sigma=np.full((26, 3), 1e-4)
    )
    axes, headings = find_flight_directions(replace(recording, attitudes=attitudes))
    np.testing.assert_array_equal(axes, np.where(t_s < 500, "+x", "-x"))
    # A yaw about +z, smooth at its ends, takes the velocity from +x over -y to -x.
    assert np.all(np.diff(headings[(t_s > 120) & (t_s < 880)]) < 0)
    # Each is known to a twentieth of a radian (`flight_mode.NOISE`).
    assert headings[t_s == 480.0][0] + headings[t_s == 520.0][0] == pytest.approx(-np.pi, abs=3 * 0.05 * np.sqrt(2))


def test_what_is_stated_goes_first():
    stated = [replace(one, forward=forward) for one, forward in zip(RECORDING.intervals, ("-y", "none", "+x"), strict=False)]
    recording = replace(RECORDING, orbit=None, intervals=(*stated, *RECORDING.intervals[3:]))
    assert [runs_of(recording, number) for number in range(4)] == [["-y"], [""], ["+x"], [""]]


def offset_of(text):
    """Where an offset acts, (m,) in deg about x."""
    plain = simulator.simulate(SERIES, noise=False)
    made = simulator.simulate(SERIES, noise=False, effects=[parse(text)])
    return -np.rad2deg(separation(made.attitudes.quaternions, plain.attitudes.quaternions))[:, 0]


def test_the_offset_acts_around_a_hold_and_in_it_if_asked_to():
    flown, t_s = forward_axes(RECORDING), RECORDING.attitudes.t_s
    np.testing.assert_allclose(offset_of("reference_mode_offset:x=0.1"), 0.1 * (flown == "-x"), atol=1e-10)
    hold = (t_s >= RECORDING.intervals[4].start_s) & (t_s <= RECORDING.intervals[4].stop_s)
    assert set(flown[hold]) == {"-x", ""}
    np.testing.assert_allclose(offset_of("reference_mode_offset:x=0.1,holds=on"), 0.1 * ((flown == "-x") | hold), atol=1e-10)


def test_a_head_takes_over_at_some_heading_of_a_turn():
    """At 20, 50, 70, 110 and 160 degrees from -x, of which each is reached from a heading of its own on."""
    heading = np.pi - np.deg2rad([180.0, 160.0, 110.0, -70.0, 50.0, 20.0, 0.0])
    nothing = np.zeros((7, 4))
    seen = References(np.arange(7.0), nothing, np.zeros(7, dtype=int), np.array(["+x"] * 3 + ["-x"] * 4), 5500.0, heading)
    trials = MODE_OFFSET.trials(Surroundings(None, seen, 1e-6, 0.5, np.ones((7, 3))))
    reached = {
        tuple(np.flatnonzero(MODE_OFFSET.reference_columns(seen, "z", dict(trial.parameters))[:, 2])) for trial in trials
    }
    assert reached == {(5, 6), (4, 5, 6), (3, 4, 5, 6), (2, 3, 4, 5, 6)}
    assert sum(one.weight for one in trials) == pytest.approx(1.0)
