"""Effects of Mission Mode by name: each against its closed form, with the nominal run beside it; bad input in one line."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gyrocal.errors import InputError
from simulator.mission_mode.config import MissionConfig, build_period_tables
from simulator.mission_mode.effects import ALL_MISSION_EFFECTS, apply_mission_settings, parse
from simulator.mission_mode.flight import simulate_mission

NOMINAL = replace(MissionConfig(), tables=build_period_tables()["postcalibration"])


def flown(*effects, seconds=6000.0, every=1, base=NOMINAL):
    return simulate_mission(
        apply_mission_settings(base, [parse(effect) for effect in effects]), seconds=seconds, seed=3, telemetry_every=every
    )


def test_updates_settle_at_the_difference_over_one_less_half_the_gain():
    """Measurements alternate by ±d/2; with a bias of ±B in turn |u| = d + B T and 2 B T = g |u|, so |u| = d/(1 − g/2)."""
    gain, base = 1.3, replace(NOMINAL, tables=build_period_tables()["precalibration"])
    sizes = flown(f"bias_gain={gain:g}", base=base, seconds=40_000.0, every=120).updates["update_deg"].abs().to_numpy()[8:]
    one = flown("bias_gain=1", base=base, seconds=40_000.0, every=120).updates["update_deg"].abs().to_numpy()[8:]
    assert sizes.mean() == pytest.approx(one.mean() / 2 / (1 - gain / 2), rel=0.15)


def test_cross_track_leans_the_frame_on_board():
    """The computer's frame is off by δ/r in roll, which the Earth sensor does not see: the body leans the other way from it."""
    kilometres = 20.0
    with_it, nominal = flown(f"cross_track={kilometres:g}"), flown()
    change = (with_it.telemetry["error_roll_deg"] - nominal.telemetry["error_roll_deg"]).to_numpy()[2000:]
    assert np.abs(change).max() == pytest.approx(math.degrees(1e3 * kilometres / NOMINAL.orbit.radius), rel=0.15)


def test_bad_settings_are_refused():
    for text, message in (("horizon=1", "none of that name"), ("horizon_noise=-1", "not within"), ("gyro_walk:w=1", "an axis")):
        with pytest.raises(InputError, match=message):
            parse(text)


def test_every_effect_acts():
    for effect in ALL_MISSION_EFFECTS:
        size = 1.0 if effect.bounds[1] >= 1.0 and effect.name != "bias_gain" else 0.5 * effect.bounds[1]
        text = f"{effect.name}{':x' if effect.axes else ''}={size:g}"
        changed = apply_mission_settings(NOMINAL, [parse(text)])
        assert repr(changed) != repr(NOMINAL), effect.name
        assert parse(text).effect == effect.name
