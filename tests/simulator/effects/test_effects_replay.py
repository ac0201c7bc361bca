"""A recording simulated again: its motion, its noise, what a calibration makes of it; and the command line of both."""

import json
from dataclasses import replace

import numpy as np
import scipy.stats

import simulator
from gyrocal import calibrate, load, save
from gyrocal.smoothing import estimate_sample_sigma
from simulator.replay import reconstruct_motion, replay
from simulator.truth.rotation import separation

SERIES = simulator.load("trmm_series")
MOTION = simulator.motion(SERIES)
ORIGINAL = simulator.simulate(SERIES, seed=5)
FITTED = calibrate(ORIGINAL).parameters
FOUND = reconstruct_motion(ORIGINAL, FITTED.G, FITTED.bias)
SAMPLE_SIGMA = ORIGINAL.gyro.arw / np.sqrt(0.5)


def test_recovered_motion_is_near_the_truth():
    np.testing.assert_array_equal(FOUND.t_s, MOTION.t_s)
    np.testing.assert_array_equal(FOUND.reference_t_s, MOTION.reference_t_s)
    # The noise of a quadratic through 39 samples is 0.24 of one sample's.
    assert (FOUND.rates - MOTION.rates).std() < 0.3 * SAMPLE_SIGMA
    assert np.abs(FOUND.rates - MOTION.rates).max() < 5 * SAMPLE_SIGMA  # also in the slews
    sigma = np.deg2rad(0.005)
    assert separation(FOUND.quaternions, MOTION.quaternions).std() < 0.7 * sigma  # better than the references
    assert separation(FOUND.quaternions, ORIGINAL.attitudes.quaternions).std() < 1.1 * sigma


def test_replay_keeps_everything_but_the_draws():
    again = replay(ORIGINAL, FITTED.G, FITTED.bias, seed=1, motion=FOUND)
    np.testing.assert_array_equal(again.gyro.t_s, ORIGINAL.gyro.t_s)
    np.testing.assert_array_equal(again.attitudes.t_s, ORIGINAL.attitudes.t_s)
    np.testing.assert_array_equal(again.attitudes.sigma, ORIGINAL.attitudes.sigma)
    assert (again.title, again.intervals, again.orbit) == (ORIGINAL.title, ORIGINAL.intervals, ORIGINAL.orbit)
    # The noise is there once. The median of second differences has 1.4 times the relative error of a median of as many
    # independent values, 1.17/sqrt(n), since neighbours share samples; here are two of them, four sigma apart at most.
    room = 4 * np.sqrt(2) * 1.4 * 1.17 / np.sqrt(len(ORIGINAL.gyro.rates))
    np.testing.assert_allclose(
        estimate_sample_sigma(again.gyro.rates, 0), estimate_sample_sigma(ORIGINAL.gyro.rates, 0), rtol=room
    )
    clean = replay(ORIGINAL, FITTED.G, FITTED.bias, noise=False, motion=FOUND)
    np.testing.assert_array_equal(clean.attitudes.quaternions, FOUND.quaternions)
    np.testing.assert_allclose(clean.gyro.rates @ FITTED.G.T + FITTED.bias, FOUND.rates, atol=1e-17)


def test_replays_calibrate_to_their_truth_within_sigma():
    """Sum of 12 normalised squared errors over 10 seeds: χ² of 120."""
    nees = 0.0
    for seed in range(10):
        result = calibrate(replay(ORIGINAL, FITTED.G, FITTED.bias, seed=seed, motion=FOUND))
        error = result.parameters.vector - FITTED.vector
        nees += error @ np.linalg.solve(result.covariance, error)
    assert 0.001 < scipy.stats.chi2.sf(nees, 120) < 0.999


def test_holes_and_outliers_are_bridged():
    gyro = ORIGINAL.gyro
    kept = np.ones(gyro.t_s.size, dtype=bool)
    kept[5000:5020] = False  # ten seconds of m1
    rates = gyro.rates.copy()
    rates[[3000, 20000], 1] += np.deg2rad(1.0)
    broken = replace(ORIGINAL, gyro=replace(gyro, t_s=gyro.t_s[kept], rates=rates[kept]))
    found = reconstruct_motion(broken, FITTED.G, FITTED.bias)
    np.testing.assert_array_equal(found.t_s, gyro.t_s[kept])
    assert np.abs(found.rates - MOTION.rates[kept]).max() < 5 * SAMPLE_SIGMA
    assert separation(found.quaternions, MOTION.quaternions).std() < np.deg2rad(0.005)


def test_replay_on_the_command_line(run_cli, tmp_path):
    save(ORIGINAL, tmp_path / "rec")
    truth = tmp_path / "truth.json"
    done = run_cli(
        "simulate", str(tmp_path / "rec"), str(tmp_path / "again"), "--truth", str(truth), "--effect", "time_offset=1"
    )
    assert done.exit_code == 0, done.stderr
    again = load(tmp_path / "again")
    np.testing.assert_array_equal(again.gyro.t_s, ORIGINAL.gyro.t_s)
    document = json.loads(truth.read_text())
    np.testing.assert_allclose(document["G"], FITTED.G, atol=1e-12)
    assert document["effects"][0]["effect"] == "time_offset"
    assert calibrate(again).p_value < 0.01
    bad = run_cli("simulate", "trmm", str(tmp_path / "bad"), "--effect", "bias_step:z=1,time_s=1e9")
    assert (bad.exit_code, len(bad.stderr.strip().splitlines())) == (2, 1)
    assert not (tmp_path / "bad").exists()
