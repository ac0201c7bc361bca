"""Stretches that were not measured: found where they are and nowhere else, listed, and left out of the recording."""

from dataclasses import replace
from functools import cache
from itertools import accumulate

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import gyrocal
import simulator
from diagnosis.diagnose import list_clipped_gyros
from diagnosis.settings import DEFAULT
from gyrocal.masking import DataMask, MaskedStretch, find_mask
from gyrocal.masking.gyro_faults import is_reached
from gyrocal.recording import Recording
from simulator.effects import EFFECTS, parse
from simulator.truth.rotation import apply_rotation_errors
from tests.simulator.effects.test_clock import agile

SCENARIOS = {"agile": agile(), "trmm": simulator.load("trmm_series"), "ends": simulator.load("trmm")}
CLOCK_S, SAMPLE_S = np.arange(6000) * 0.01, 0.01  # a hand-held body at 100 Hz, with a reference at each sample


def made(scenario, *texts, seed=1):
    return simulator.simulate(SCENARIOS[scenario], seed=seed, effects=[parse(text) for text in texts])


@cache
def move(still):
    """Rates and attitudes of a swing, or of a rest."""
    rates = (0.0 if still else 1.7) * np.sin(np.outer(CLOCK_S + 0.5 * SAMPLE_S, [2.1, 3.3, 1.7]))
    turns = [Rotation.identity(), *Rotation.from_rotvec(rates[:-1] * SAMPLE_S)]
    return rates, Rotation.concatenate(list(accumulate(turns, lambda a, b: a * b))).as_quat()


def swing(*, clip=None, jump=0.0, flip=0.0, still=False, noise_deg=0.02, seed=0):
    """A swing of up to 100 deg/s: clipped at a level about x, deg/s, references that jump at 20 s and are false at 40 s."""
    rng, t, (rates, attitudes) = np.random.default_rng(seed), CLOCK_S, move(still)
    errors = np.deg2rad(noise_deg) * rng.standard_normal((t.size, 3))
    errors[t >= 20] += np.deg2rad([0, jump, 0])
    errors[(t >= 39.995) & (t < 40.015)] += np.deg2rad([flip, 0, 0])
    raw = rates.copy()
    if clip is not None:
        raw[:, 0] = raw[:, 0].clip(-np.deg2rad(clip), np.deg2rad(clip))
    raw += 1e-3 * rng.standard_normal(raw.shape)
    return Recording.from_arrays(t, raw, t, apply_rotation_errors(attitudes, errors), sigma=np.deg2rad(noise_deg), arw=1e-4)


@pytest.mark.parametrize(
    ("scenario", "text", "what", "axis", "size", "span"),
    [
        ("agile", "gyro_stop=0,begin_s=500,end_s=520", "stopped", None, 0.0, (500, 520)),
        ("agile", "gyro_stop:y=0.1,begin_s=500,end_s=520", "stopped", "y", 0.1, (500, 520)),
        ("trmm", "gyro_stop=0.01,begin_s=600,end_s=1000", "stopped", None, 0.01, (600, 1000)),
        ("agile", "reference_freeze=30,begin_s=600", "frozen", None, 0.0, (600, 630)),
    ],
)
def test_a_stop_and_a_freeze_are_found_with_level_and_times(scenario, text, what, axis, size, span):
    (found,) = find_mask(made(scenario, text)).stretches
    assert (found.what, found.axis, found.size) == (what, axis, pytest.approx(size, abs=1e-9))
    assert (found.from_s, found.to_s) == pytest.approx(span, abs=0.6)


def test_a_clipped_gyro_is_found_on_both_sides_of_its_range():
    recording = made("trmm", "rate_saturation:z=0.1")
    found = find_mask(recording)
    assert {(stretch.what, stretch.axis) for stretch in found.stretches} == {("clipped", "z")}
    assert {round(one.size, 9) for one in found.stretches} == {0.1, -0.1}
    left = found.apply(recording)
    t_s, at = recording.gyro.t_s, np.abs(recording.gyro.rates[:, 2]) >= np.deg2rad(0.1) * (1 - 1e-12)
    assert not any(((t_s[at] >= interval.start_s) & (t_s[at] < interval.stop_s)).any() for interval in left.intervals)


def test_clipped_readings_with_noise_are_found_by_the_references():
    """Nothing repeats: the readings crowd at 80 deg/s and the references turn beyond."""
    found = find_mask(swing(clip=80.0))
    assert {(stretch.what, stretch.axis) for stretch in found.stretches} == {("clipped", "x")}
    assert np.abs([one.size for one in found.stretches]) == pytest.approx(80.0, abs=0.5)


def test_jumps_of_the_references_are_found_with_time_axis_and_size():
    single, jump = sorted(find_mask(swing(jump=3.0, flip=4.0)).stretches, key=lambda stretch: -stretch.size)
    assert (single.axis, single.from_s, single.to_s) == ("x", pytest.approx(40.0), pytest.approx(40.02))
    assert (jump.axis, jump.from_s, jump.to_s) == ("y", pytest.approx(19.995), pytest.approx(19.995))
    assert (single.size, jump.size) == (pytest.approx(4.0, abs=0.15), pytest.approx(3.0, abs=0.15))
    recording = swing(jump=3.0, flip=4.0)
    left = find_mask(recording).apply(recording)
    assert [interval.stop_s for interval in left.intervals] == pytest.approx([19.99, 59.99])
    assert np.setdiff1d(recording.attitudes.t_s, left.attitudes.t_s) == pytest.approx([40.0, 40.01])


def test_single_false_references_are_found_where_references_are_sparse():
    plain, recording = made("agile"), made("agile", "reference_glitch=3,fraction=0.02")
    off = (plain.attitudes.quaternions != recording.attitudes.quaternions).any(axis=1)
    np.testing.assert_array_equal(find_mask(recording).mark_false_references(recording.attitudes.t_s), off)


@pytest.mark.parametrize(
    ("scenario", "text"),
    [
        ("agile", "reference_jump=0.5,begin_s=500,end_s=520"),
        ("agile", "reference_noise_excess=5"),
        ("agile", "stale_samples=8,fraction=0.1"),
        ("agile", "rate_quantization=0.2"),
        ("trmm", "bias_step:y=2000,time_s=1500"),
        ("trmm", "rate_deadzone:z=0.01"),
        ("ends", "rate_lag=5"),
    ],
)
def test_other_effects_are_left_to_the_diagnosis(scenario, text):
    assert not find_mask(made(scenario, text))


def test_a_clean_recording_has_an_empty_mask():
    """Of several grades and rates, moving and at rest."""
    clean = [made(name, seed=seed) for name in SCENARIOS for seed in range(4)]
    clean += [swing(still=seed % 2 == 1, noise_deg=10.0 ** -(seed % 3 + 1), seed=seed) for seed in range(6)]
    assert not any(find_mask(one) for one in clean)


@pytest.mark.parametrize(("level", "reached"), [(60.0, True), (90.0, False)])
def test_a_gyro_that_jumps_to_its_largest_reading_is_not_clipped(level, reached):
    x = 100 * np.sin(np.arange(5000) / 37.0) + np.random.default_rng(3).standard_normal(5000)
    assert is_reached(np.where(x > 60.0, level, x), x > 60.0, 1.0) == reached


def test_a_late_frame_and_a_jump_of_the_gyro_are_no_jumps_of_the_references():
    recording = swing()
    q, rates = recording.attitudes.quaternions.copy(), recording.gyro.rates.copy()
    q[3000] = q[2999]
    assert not find_mask(replace(recording, attitudes=replace(recording.attitudes, quaternions=q)))
    rates[3000, 1] += np.deg2rad(400.0)
    assert not find_mask(replace(recording, gyro=replace(recording.gyro, rates=rates)))


def test_stretches_left_out_by_hand_cut_the_intervals_and_are_kept_in_a_recording(tmp_path):
    recording = swing()
    mask = find_mask(recording, [(10.0, 12.0), (30.0, 30.5)])
    left = mask.apply(recording)
    assert [(interval.name, interval.start_s, interval.stop_s) for interval in left.intervals] == [
        ("whole/0", 0.0, 10.0), ("whole/1", pytest.approx(12.0), pytest.approx(30.0)), ("whole/2", 30.5, pytest.approx(59.99)),
    ]  # fmt: skip
    assert mask.compute_share(recording) == pytest.approx(2.5 / 60, abs=1e-3)
    gyrocal.save(replace(left, tables={"masked": mask.to_frame()}), tmp_path)
    assert find_mask(gyrocal.load(tmp_path)) == mask


def test_a_recording_of_which_nothing_is_left_is_refused():
    recording = swing()
    with pytest.raises(gyrocal.InputError, match=r"no two references .* excluded by hand, from 0\.00 to 60\.00 s"):
        DataMask((MaskedStretch("excluded", None, 0.0, 60.0),)).apply(recording)


def test_a_clipped_gyro_is_a_cause_with_its_level():
    (found,) = list_clipped_gyros(find_mask(made("trmm", "rate_saturation:z=0.1")), list(EFFECTS.values()))
    cause = found.cause(DEFAULT)
    assert (cause.effect, cause.axis, cause.size) == ("rate_saturation", "z", pytest.approx(0.1))
    assert cause.probability > 0.9
