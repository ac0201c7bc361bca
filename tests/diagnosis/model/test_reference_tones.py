"""Tones that all references show and their averages do not: which, of what, how large; and what is none."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from diagnosis.inference.criticism import combine_checks
from diagnosis.model import reference_tones
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.misfit import check_baseline
from diagnosis.model.prepare import prepare
from diagnosis.model.reference_tones import find_coherent, find_peak, find_reference_tone, list_aliases, make_innovations
from diagnosis.model.sinusoid_causes import BIAS, PICKUP, REFERENCE, UNLISTED, ReferenceTone, SinusoidCause
from diagnosis.sinusoids.spectrum import compute_power
from gyrocal import calibrate
from simulator.effects import parse
from simulator.simulate import simulate
from simulator.truth.rotation import apply_rotation_errors
from tests.diagnosis.model.test_lines import plan, recorded, swaying, tone

P, EVERY = 1e-5, 0.5  # s between references, of which two are averaged
SWING, VIBRATION = "reference_periodic:z=0.008,period_s=1.7,phase_deg=40", "vibration:y=0.2,apparent_hz=12.7"


@lru_cache
def model_of(*effects, seed=1):
    recording = (
        recorded(*effects, every_s=EVERY)
        if seed == 1
        else simulate(plan(EVERY), seed=seed, effects=[parse(text) for text in effects])
    )
    return modelled(recording)


def modelled(recording):
    result = calibrate(recording)
    return linearise_recording(recording, result.G, result.bias)


def found(model):
    return find_reference_tone(model, model.recording.gyro.rates, P, 0.2)


@lru_cache
def found_of(*effects, seed=1):
    return found(model_of(*effects, seed=seed))


def test_a_swing_of_the_references_is_told():
    first, probability = found_of(SWING).causes[0]
    assert (first.kind, first.axis) == (REFERENCE, 2)
    assert probability > 0.9
    size, sigma, unit, parameters = first.state()
    assert unit == "deg"
    assert abs(size - 0.008) < 4 * sigma
    assert parameters["period_s"] == pytest.approx(1.7, rel=1e-3)
    assert parameters["phase_deg"] == pytest.approx(40.0, abs=np.rad2deg(6 * sigma / size))


def test_a_vibration_is_told_from_its_aliases():
    """The references, half a second apart, see 12.7 Hz as 0.7 Hz; the samples tell."""
    first, probability = found_of(VIBRATION).causes[0]
    assert (first.kind, first.axis) == (PICKUP, 1)
    assert probability > 0.9
    assert first.frequency_hz == pytest.approx(12.7, abs=1e-4)
    size, sigma, _, _ = first.state()
    assert abs(size - 0.2) < 4 * sigma


@pytest.mark.parametrize("seed", [1, 2])
def test_noise_has_no_tone(seed):
    assert find_peak(model_of(seed=seed))[1] > 1e-3
    assert found_of(seed=seed) is None


def test_what_follows_the_motion_is_no_tone():
    """A body that sways at 0.61 Hz, with references that are late, leaves a line at that frequency."""
    turn = tone(0.3, 0.61)
    swayed = swaying(recorded(every_s=EVERY), turn)
    attitudes = swayed.attitudes
    behind = turn(attitudes.t_s) - turn(attitudes.t_s - 0.02)
    model = modelled(
        replace(swayed, attitudes=replace(attitudes, quaternions=apply_rotation_errors(attitudes.quaternions, behind)))
    )
    assert find_peak(model)[1] < P
    assert found(model) is None


def test_a_wave_that_is_not_steady_is_on_no_list():
    recording = recorded(every_s=EVERY)
    attitudes = recording.attitudes
    error = np.zeros((attitudes.t_s.size, 3))
    error[:, 1] = np.deg2rad(0.01) * np.sin(2 * np.pi * attitudes.t_s / 1.7) * (attitudes.t_s < 300)
    wrong = replace(recording, attitudes=replace(attitudes, quaternions=apply_rotation_errors(attitudes.quaternions, error)))
    first, probability = found(modelled(wrong)).causes[0]
    assert first.kind == UNLISTED
    assert probability > 0.9


@pytest.mark.parametrize("effect", [SWING, VIBRATION])
def test_without_it_nothing_is_left(effect):
    model = model_of(effect)
    recording, rates = found_of(effect).causes[0][0].remove(model.recording, model.recording.gyro.rates)
    assert found(modelled(replace(recording, gyro=replace(recording.gyro, rates=rates)))) is None


def test_the_phases_between_intervals_are_those_of_the_waves():
    """The moved frequency explains as much as the best of all that are whitened afresh."""
    model = model_of(SWING)
    series, centre = make_innovations(model), 1 / 1.7 + 4e-4
    (moved,) = find_coherent(series, np.array([centre]), 2, 1e-3)
    near = centre + np.arange(-1e-3, 1e-3, 2e-5)
    columns = series.make_columns(near, True, [2])
    chi2 = [series.compute_chi2(columns[:, 2 * k : 2 * k + 2], series.taken) for k in range(near.size)]
    assert moved == pytest.approx(near[int(np.argmax(chi2))], abs=6e-5)


def test_aliases_of_a_series():
    """References half a second apart: f and 2 j ± f, up to half the rate of the samples."""
    aliases = list_aliases(model_of(), 0.7)
    assert aliases[:4] == pytest.approx([0.7, 1.3, 2.7, 3.3])
    assert aliases.max() < 50


def test_it_is_a_symptom_of_a_prepared_recording_and_no_misfit_any_more():
    ready = prepare(recorded(SWING, every_s=EVERY))
    assert [(one.kind, one.axis) for one in ready.samples.symptoms] == [(REFERENCE, "z")]
    assert combine_checks(check_baseline(ready.model)) > 1e-3
    # Without the tone taken out, the misfit is certain.
    assert combine_checks(check_baseline(model_of(SWING))) < 1e-6


def test_a_listed_way_is_taken_out_where_the_unlisted_are_likelier_than_each():
    """What is named is what is taken out, or the same tone would be found again."""
    shares = ((UNLISTED, 0.38), (REFERENCE, 0.32), (BIAS, 0.30))
    tone = ReferenceTone(tuple((SinusoidCause(kind, 2, 0.7, np.array([1e-5, 0.0]), 1e-6), p) for kind, p in shares), 1e-9)
    symptom = tone.make_symptom(0.02, 0.4)
    assert symptom.kind == tone.listed_causes[0][0].kind == REFERENCE
    assert symptom.probability == pytest.approx(0.62)
    assert symptom.rivals == ((BIAS, pytest.approx(0.30 / 0.62)),)
    assert tone.make_symptom(0.02, 0.3).kind == UNLISTED


def test_slow_errors_are_no_tone_of_an_interval_with_few_references(monkeypatch):
    """At the rate of its own references an interval shows its slow errors once more, where others have faster references."""
    model = model_of()
    e, later, taken = reference_tones.compute_innovations(model)
    later = np.flatnonzero(later) if later.dtype == bool else later
    few = model.interval_of_reference[later] == 0
    kept = ~few | (np.arange(later.size) % 8 == 0)
    drift = np.where(few, np.linspace(-8, 8, later.size), 0.0)[:, None]
    own, t_s = few & kept, model.references.t_s[later]
    assert (~few).any()
    assert compute_power(t_s[own], (e + drift)[own], 1 / (8 * EVERY) + np.linspace(-2e-3, 2e-3, 9)).max() > 30
    monkeypatch.setattr(reference_tones, "compute_innovations", lambda model: ((e + drift)[kept], later[kept], taken))
    found = find_peak(model)
    assert found is None or found[1] > 1e-3
