"""Clocks of gyro and references that run apart or slip: what the simulator does, and what a diagnosis says of it."""

import numpy as np
import pytest

import simulator
from simulator.effects import EFFECTS, parse
from simulator.effects.timing import compute_delay_columns
from tests.simulator.effects.test_effects import MOTION, PLAIN, SCENARIO, STREAM

AGILE = {
    "control_motion": {"amplitude_deg": [2.0, 3.0, 2.5], "period_s": [31.0, 43.0, 37.0]},
    "reference.every_s": 2.0,
    "reference.sigma_deg": [0.005] * 3,
    "interval": [{"name": "turns", "activity": "turns", "start_s": 0.0, "stop_s": 1500.0, "mode": "+x"}],
}


def shown(text):
    return simulator.simulate(SCENARIO, noise=False, effects=[parse(text)]).gyro.rates


def agile():
    """A body that swings by degrees in half a minute for 25 minutes, with a reference every two seconds."""
    return simulator.override(simulator.load("trmm_series"), AGILE)


def test_a_positive_drift_makes_late_tags_later():
    """By 200 ppm the tags are 0.47 s early at the start and 0.47 s late at the end, which is about a sample of 0.5 s."""
    drifting, late = shown("clock_drift=200"), shown("time_offset=0.4")
    last = MOTION.intervals[-1]
    mid = slice(last.start + 10, last.stop - 10)
    delay = 200e-6 * (STREAM.t_s[mid] - 2350.0)
    assert delay == pytest.approx(0.4, abs=0.08)
    change, expected = drifting[mid] - PLAIN.gyro.rates[mid], late[mid] - PLAIN.gyro.rates[mid]
    np.testing.assert_allclose(change, expected * (delay / 0.4)[:, None], atol=0.02 * np.abs(expected).max())
    first = slice(MOTION.intervals[0].start + 10, MOTION.intervals[0].stop - 10)
    early = shown("time_offset=-0.4")[first] - PLAIN.gyro.rates[first]
    assert np.sum((drifting[first] - PLAIN.gyro.rates[first]) * early) > 0


def test_a_slip_is_an_offset_from_its_time_on():
    """At the edge of a sample; inside of one, that sample shows both by their shares."""
    time = float(MOTION.t_s[MOTION.intervals[1].start + 200])
    slipped, late = shown(f"clock_slip=0.5,time_s={time}"), shown("time_offset=0.5")
    after = MOTION.t_s >= time - 1e-6
    np.testing.assert_array_equal(slipped[~after], PLAIN.gyro.rates[~after])
    np.testing.assert_allclose(slipped[after], late[after], atol=1e-15)
    inside = shown(f"clock_slip=0.5,time_s={time + 0.125}")
    place = int(np.flatnonzero(after)[0])
    np.testing.assert_allclose(inside[place], 0.25 * PLAIN.gyro.rates[place] + 0.75 * late[place], atol=1e-15)


RIVALS = (
    *("clock_drift", "clock_slip", "time_offset", "rate_lag"),
    *("reference_jump", "reference_correlated", "bias_step", "bias_drift"),
)


def test_a_wander_that_lasts_is_a_delay_of_its_size():
    """With a time constant far beyond the recording the delay is one draw, and its size is that of the draws."""
    column, span = compute_delay_columns(STREAM)[:, :, 0], float(np.ptp(STREAM.t_s))
    effect, draws = EFFECTS["clock_wander"], []
    wandered = 5 * 0.02 * np.sqrt(2 * span / 1e9)  # five sigmas of a change over the recording
    for seed in range(200):
        moved = effect.wander(np.random.default_rng(seed), STREAM, parse("clock_wander=0.02,time_constant_s=1e9"))
        draws.append(np.sum(moved * column) / np.sum(column**2))
        np.testing.assert_allclose(moved, draws[-1] * column, rtol=0, atol=wandered * np.abs(column).max())
    assert np.std(draws) == pytest.approx(0.02, rel=4 / np.sqrt(2 * len(draws)))
