"""The command ``gyrocal allan`` and what it rests on."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from gyrocal import GyroParameters, InputError, save
from gyrocal.allan.terms import ANGLE_WHITE, FLICKER, RANDOM_WALK
from simulator import scenario
from simulator.effects import parse
from simulator.simulate import simulate
from studies.allan.analysis import convert_to_display_unit, estimate_noise_terms
from studies.allan.rates import compute_constant_rate_p
from studies.cli.main import main
from tests.builders import piecewise_recording
from tests.pages import checked

ARW = np.deg2rad(2.6e-4)
SWAY, SWAY_S = np.deg2rad(0.02), 900.0
IDEAL = GyroParameters(np.eye(3), np.zeros(3))


def rest(seed, *effects, sample_s=1.0):
    """A recording of TRMM's six intervals, of which m1 rests for 6000 s."""
    plan = scenario.override(scenario.load("trmm_series"), {"gyro.sample_s": sample_s})
    return simulate(plan, seed=seed, effects=[parse(text) for text in effects])


def swaying(seed, arw=ARW):
    """One interval of an hour in which the body swings about x, with references every minute."""
    rng = np.random.default_rng(seed)
    plan = ((((0.0, 0.0, 0.0), 3600.0),),) * 2
    plain = piecewise_recording(plan, truth=IDEAL, series_s=60.0, sigma_deg=0.002, arw=arw, rng=rng)
    turned, rates = [], plain.gyro.rates.copy()
    for interval in plain.intervals:
        own = (plain.gyro.t_s >= interval.start_s) & (plain.gyro.t_s < interval.stop_s)
        at = plain.gyro.t_s[own] - interval.start_s + 0.25
        rates[own, 0] += SWAY * np.sin(2 * np.pi * at / SWAY_S)
        since = plain.attitudes.t_s - interval.start_s
        angle = SWAY * SWAY_S / (2 * np.pi) * (1 - np.cos(2 * np.pi * since / SWAY_S))
        turned.append(np.where((since >= 0) & (since <= 3600), angle, 0.0))
    back = Rotation.from_rotvec(np.outer(np.sum(turned, axis=0), [1.0, 0.0, 0.0]))
    quaternions = (Rotation.from_quat(plain.attitudes.quaternions) * back).as_quat()
    moved = replace(plain.attitudes, quaternions=quaternions)
    return replace(plain, gyro=replace(plain.gyro, rates=rates), attitudes=moved)


def test_flicker_and_a_tone_are_found_on_their_axes():
    found = estimate_noise_terms(rest(2, "noise_flicker:z=1", "vibration:y=0.0005,apparent_hz=0.1"))
    x, y, z = found.axes
    assert not x.lines
    assert not x.fit.estimate(FLICKER).seen
    (line,) = y.lines
    assert line.frequency_hz == pytest.approx(0.1, rel=1e-3)
    assert abs(np.rad2deg(line.amplitude) - 0.0005) < 4 * np.rad2deg(line.sigma)
    estimate = convert_to_display_unit(z.fit.estimate(FLICKER))
    # The simulated 1/f ends an octave above the sampling rate, which adds to the white noise and takes from the flicker.
    assert estimate.seen
    assert abs(estimate.value - 1.0) < 4 * estimate.sigma + 0.05


def test_a_constant_rate_is_a_rest():
    rng = np.random.default_rng(4)
    t, rate = np.arange(0.0, 6000.0, 60.0), np.deg2rad([0.01, -0.0656, 0.002])
    sigma = np.full((t.size, 3), np.deg2rad(0.005))
    start = Rotation.from_rotvec([0.3, -0.2, 0.9])
    p = []
    for _ in range(40):
        errors = Rotation.from_rotvec(rng.standard_normal(sigma.shape) * sigma)
        attitudes = start * Rotation.from_rotvec(t[:, None] * rate) * errors
        p.append(compute_constant_rate_p(t, attitudes, sigma))
    assert 0.35 < np.mean(p) < 0.65  # uniform: 0.5 ± 0.046
    sway = Rotation.from_rotvec(np.outer(np.deg2rad(0.05) * np.sin(2 * np.pi * t / 900), [1.0, 0, 0]))
    assert compute_constant_rate_p(t, attitudes * sway, sigma) < 1e-20


def test_motion_that_the_references_show_is_no_noise():
    found = estimate_noise_terms(swaying(3))
    assert not any(one.rest for one in found.stretches)
    walk = found.axes[0].fit.estimate(RANDOM_WALK)
    assert abs(walk.value - ARW) < 4 * walk.sigma
    assert not any(one.seen for one in found.axes[0].fit.estimates if one.term not in (RANDOM_WALK, ANGLE_WHITE))
    # The errors of the references are of the size of angle white noise with their sigma, once an average spans several.
    last = found.axes[0].deviation.tau_s >= 240
    expected = 3 * np.deg2rad(0.002) ** 2 / found.axes[0].deviation.tau_s[last] ** 2
    assert np.allclose(found.axes[0].references[last], expected, rtol=0.5)


def test_the_command_writes_what_it_shows(tmp_path):
    save(rest(6, "noise_excess:x=2"), tmp_path / "rec")
    files = {name: tmp_path / f"allan.{name}" for name in ("json", "html", "svg")}
    options = ["--json", files["json"], "--report", files["html"], "--figure", files["svg"], "--interval", "m1"]
    result = CliRunner().invoke(main, ["allan", str(tmp_path / "rec"), *map(str, options)])
    assert result.exit_code == 0, result.output
    assert re.search(r"x: the angle random walk is (2|1\.9\d*|2\.0\d*) times the stated one", result.output)
    written = json.loads(files["json"].read_text())
    terms = written["axes"]["x"]["terms"]
    assert terms[RANDOM_WALK]["value"] == pytest.approx(2 * written["stated_angle_random_walk"]["value"], rel=0.03)
    assert not terms[FLICKER]["seen"]
    assert list(checked(files["html"].read_text()).figures) == ["allan"]
    assert files["svg"].read_text().startswith("<?xml")


def test_an_interval_that_is_all_motion_is_refused():
    recording = rest(7)
    shaken = recording.gyro.rates + np.sin(recording.gyro.t_s / 5)[:, None]
    with pytest.raises(InputError, match="no stretch of interval m2"):
        estimate_noise_terms(replace(recording, gyro=replace(recording.gyro, rates=shaken)), "m2")
