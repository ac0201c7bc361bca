"""Noise for a filter: it is that of the simulated gyro, and covers turns that neither the calibration nor the fit has used."""

from dataclasses import replace

import numpy as np
import pytest

import gyrocal
from gyrocal.estimation.filter_noise import FILTER_TURNS_S, FilterNoise, fit_filter_noise, select_moving_turns
from gyrocal.estimation.held_out import gather_held_out_turns
from gyrocal.importing.kalibr import read_noise_density, read_yaml
from tests.builders import piecewise_recording

ARW = 1e-3  # rad/√s


def simulate(seed, stated):
    """Six intervals of two minutes, turned at ten deg/s about axes that change, of a gyro with a stated noise of its own."""
    rng = np.random.default_rng(seed)
    plan = [tuple((tuple(np.deg2rad(10) * rng.normal(size=3)), 30.0) for _ in range(4)) for _ in range(6)]
    made = piecewise_recording(plan, sample_s=0.1, series_s=1.0, sigma_deg=0.01, arw=ARW, rng=rng, gap_s=10.0)
    return replace(made, gyro=replace(made.gyro, arw=stated))


@pytest.fixture(scope="module")
def recording():
    return simulate(1, ARW / 3)


def build_turns(rng, density, walk, factor, sigma, cases):
    """Turns with errors drawn from the law itself."""
    turns = {}
    for length in FILTER_TURNS_S:
        count = round(cases / length)
        each = density**2 * length + walk**2 * length**3 / 3 + (factor * sigma) ** 2
        errors = np.linalg.norm(rng.normal(size=(count, 3)) * np.sqrt(each), axis=1)
        same = np.ones(count)
        turns[length] = np.column_stack(
            [length * same, errors, errors, errors, np.sqrt(3) * sigma * same, length * np.arange(count), same]
        )
    return turns


def test_the_law_gives_its_numbers_back():
    found = fit_filter_noise(build_turns(np.random.default_rng(1), 2e-3, 3e-4, 2.0, 3e-3, 120_000), 1e-3)
    assert found.is_walk_seen
    got = (found.noise_density, found.random_walk, found.reference_factor)
    assert got == pytest.approx((2e-3, 3e-4, 2.0), rel=0.03)  # 1-sigma below 1 %
    at_rest = fit_filter_noise(build_turns(np.random.default_rng(2), 1e-3, 0.0, 1.0, 3e-3, 120_000), 1e-3)
    assert 1e-3 <= at_rest.noise_density < 1.03e-3
    assert 1.0 <= at_rest.reference_factor < 1.03
    assert at_rest.random_walk**2 * 60.0**3 / 3 < 0.05 * 60.0 * 1e-6


def test_a_simulated_gyro_has_its_own_noise_and_the_stated_one_is_refuted(recording):
    turns = select_moving_turns(gather_held_out_turns(recording, FILTER_TURNS_S))
    found = fit_filter_noise(turns, ARW / 3)
    assert set(turns) == set(FILTER_TURNS_S)
    assert found.noise_density == pytest.approx(ARW, rel=0.08)  # 6 · 120 s · 3 axes: 1-sigma 1.5 % at 1 s, 5 % at 10 s
    others = gather_held_out_turns(simulate(2, ARW / 3), FILTER_TURNS_S)  # of neither
    for length in (1.0, 10.0, 60.0):
        assert 0.8 < np.sqrt(np.mean(np.square(found.normalise_errors(others[length])))) < 1.25
        stated = FilterNoise(ARW / 3, 0.0, False, 1.0).normalise_errors(others[length])
        assert np.sqrt(np.mean(np.square(stated))) > 2


def test_rests_do_not_dilute_the_noise_in_motion():
    turns = build_turns(np.random.default_rng(3), 2e-3, 0.0, 1.0, 1e-4, 6000)
    mixed = {}
    for length, rows in turns.items():
        still = rows.copy()
        still[:, 1] *= 0.01
        still[:, 6] = 0.01
        still[:, 5] += 1e5
        mixed[length] = np.concatenate([rows, still])
    assert fit_filter_noise(select_moving_turns(mixed), 1e-4) == fit_filter_noise(turns, 1e-4)


def test_calibrate_writes_it_for_kalibr(run_cli, recording, tmp_path):
    gyrocal.save(recording, tmp_path / "rec")
    path = tmp_path / "imu.yaml"
    done = run_cli("calibrate", str(tmp_path / "rec"), "--filter-noise", str(path))
    assert done.exit_code == 0, done.stderr
    found = fit_filter_noise(select_moving_turns(gather_held_out_turns(recording, FILTER_TURNS_S)), ARW / 3)
    assert f"Filter noise: gyroscope_noise_density {found.noise_density:.3g} rad/s/sqrt(Hz)" in done.stdout
    assert np.deg2rad(read_noise_density(path)) == pytest.approx(found.noise_density, rel=1e-9)
    written = read_yaml(path)
    assert set(written) == {"gyroscope_noise_density", "gyroscope_random_walk", "rostopic", "update_rate"}
    assert written["gyroscope_random_walk"] == pytest.approx(found.random_walk, rel=1e-9)
    assert written["update_rate"] == pytest.approx(10.0)


def test_a_recording_without_held_out_turns_is_refused(run_cli, tmp_path):
    gyrocal.save(piecewise_recording([(((0.1, 0.2, 0.3), 60.0),)], series_s=30.0, arw=ARW), tmp_path / "rec")
    done = run_cli("calibrate", str(tmp_path / "rec"), "--solve-for", "bias", "--filter-noise", str(tmp_path / "imu.yaml"))
    assert done.exit_code == 2
    assert "no held-out turns" in done.stderr
    assert not (tmp_path / "imu.yaml").exists()
