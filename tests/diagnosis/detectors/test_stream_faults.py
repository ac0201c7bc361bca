"""Stretches without a rate or an attitude: found where they are, not found in other effects, and taken out of the recording."""

from dataclasses import replace

import numpy as np
import pytest

import simulator
from diagnosis.detectors.stream_faults import find_faults, remove_faults
from diagnosis.diagnose import diagnose
from simulator.effects import REGISTRY, parse
from simulator.truth.rotation import apply_rotation_errors
from tests.simulator.effects.test_clock import agile

SCENARIOS = {"agile": agile(), "trmm": simulator.load("trmm_series")}


def made(scenario, *texts, seed=1):
    return simulator.simulate(SCENARIOS[scenario], seed=seed, effects=[parse(text) for text in texts])


def found(recording):
    return find_faults(recording, list(REGISTRY.values()))


@pytest.mark.parametrize(
    ("scenario", "text", "axis", "level"),
    [
        ("agile", "gyro_stop=0,begin_s=500,end_s=520", None, 0.0),
        ("agile", "gyro_stop:y=0.1,begin_s=500,end_s=520", "y", 0.1),
        ("trmm", "gyro_stop=0.01,begin_s=600,end_s=1000", None, 0.01),
    ],
)
def test_a_gyro_that_stops_is_found_with_its_level_and_times(scenario, text, axis, level):
    recording = made(scenario, text)
    (fault,) = found(recording)
    seen = fault.detection
    assert (seen.effect, seen.axis, seen.size) == ("gyro_stop", axis, pytest.approx(level, abs=1e-9))
    wanted = parse(text).parameters
    assert seen.parameters["begin_s"] == pytest.approx(wanted["begin_s"], abs=0.6)
    assert seen.parameters["end_s"] == pytest.approx(wanted["end_s"], abs=0.6)
    lost = recording.gyro.t_s[fault.samples]
    assert lost[0] <= wanted["begin_s"]
    assert lost[-1] >= wanted["end_s"] - 0.5
    assert not fault.references.any()


def test_references_that_freeze_are_found_all_of_them():
    """The 15 from 600 s on that repeat the one of 598 s."""
    recording = made("agile", "reference_freeze=30,begin_s=600")
    (fault,) = found(recording)
    assert fault.detection.effect == "reference_freeze"
    assert fault.detection.size == pytest.approx(30.0)
    np.testing.assert_array_equal(recording.attitudes.t_s[fault.references], np.arange(600.0, 630.0, 2.0))


def test_references_that_are_false_for_a_moment_are_found_all_of_them():
    plain, recording = made("agile"), made("agile", "reference_glitch=3,fraction=0.02")
    (fault,) = found(recording)
    assert fault.detection.effect == "reference_glitch"
    assert fault.detection.size == pytest.approx(3.0, abs=1.5)
    off = (plain.attitudes.quaternions != recording.attitudes.quaternions).any(axis=1)
    np.testing.assert_array_equal(fault.references, off)


@pytest.mark.parametrize(
    ("scenario", "text"),
    [
        ("agile", "reference_jump=0.5,begin_s=500,end_s=520"),
        ("agile", "reference_correlated:x=0.2,time_constant_s=20"),
        ("agile", "reference_noise_excess=5"),
        ("agile", "stale_samples=8,fraction=0.1"),
        ("agile", "rate_quantization=0.2"),
        ("agile", "time_offset=0.3"),
        ("trmm", "bias_step:y=2000,time_s=1500"),
        ("trmm", "rate_deadzone:z=0.01"),
        ("trmm", "rate_saturation:z=0.1"),
        ("trmm", "stale_samples=100,fraction=0.1"),
        ("trmm", "noise_excess=5"),
    ],
)
def test_other_effects_are_no_faults(scenario, text):
    assert found(made(scenario, text)) == ()


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_recording_without_effects_has_no_faults(scenario):
    for seed in range(2):
        recording = made(scenario, seed=seed)
        assert found(recording) == ()
        assert remove_faults(recording, ()) is recording


def test_lost_samples_cut_the_interval_and_lost_references_are_missing():
    recording = made("agile", "gyro_stop=0,begin_s=500,end_s=520", "reference_freeze=30,begin_s=800")
    left = remove_faults(recording, found(recording))
    assert [(one.start_s, one.stop_s) for one in left.intervals] == [(0.0, 498.0), (522.0, 1500.0)]
    gone = np.setdiff1d(recording.attitudes.t_s, left.attitudes.t_s)
    np.testing.assert_array_equal(gone, [*np.arange(500.0, 521.0, 2.0), *np.arange(800.0, 830.0, 2.0)])
    np.testing.assert_array_equal(left.gyro.rates, recording.gyro.rates)


def test_a_diagnosis_names_the_faults_and_judges_the_rest_well():
    """No saturation, dead zone, repeated samples or outliers beside them, and no misfit of the attitude."""
    texts = ["gyro_stop=0,begin_s=500,end_s=520", "reference_freeze=30,begin_s=800", "reference_glitch=3,fraction=0.02"]
    answer = diagnose(made("agile", *texts))
    assert {cause.effect for cause in answer.causes} == {text.partition("=")[0] for text in texts}
    assert len(answer.causes) == len(texts)
    assert answer.verdict == "named"


@pytest.mark.parametrize(("across", "count"), [(False, 0), (True, 1)])
def test_a_reference_that_is_off_along_the_change_of_the_rate_may_have_a_late_tag(across, count):
    recording = made("agile")
    attitudes, gyro = recording.attitudes, recording.gyro
    rates = gyro.rates[np.searchsorted(gyro.t_s, attitudes.t_s).clip(0, gyro.t_s.size - 1)]
    change = np.diff(rates, axis=0, prepend=rates[:1])
    middle = slice(50, len(change) - 50)
    k = 50 + int(np.argmax(np.linalg.norm(change[middle], axis=1)))
    along = change[k] / np.linalg.norm(change[k])
    direction = np.cross(along, np.eye(3)[np.argmin(np.abs(along))]) if across else along
    off = np.deg2rad(3.0) * direction / np.linalg.norm(direction)
    quaternions = attitudes.quaternions.copy()
    quaternions[k : k + 1] = apply_rotation_errors(quaternions[k : k + 1], off[None])
    faults = found(replace(recording, attitudes=replace(attitudes, quaternions=quaternions)))
    assert [fault.detection.effect for fault in faults] == ["reference_glitch"] * count
