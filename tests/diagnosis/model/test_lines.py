"""Lines in the samples of a fast gyro: a body that sways is no vibration, and a vibration is one."""

from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from diagnosis.detectors.sample_report import Line
from diagnosis.diagnose import diagnose
from diagnosis.model import lines
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.lines import compute_log_ratio
from diagnosis.model.prepare import prepare
from simulator import scenario
from simulator.effects import parse
from simulator.simulate import simulate
from tests.diagnosis.recordings import NOISE
from tests.diagnosis.recordings import recorded as series

INTERVALS = [
    {"name": "a", "activity": "+x forward", "start_s": 0.0, "stop_s": 200.0, "mode": "+x"},
    {
        "name": "b",
        "activity": "yaw slew",
        "start_s": 1000.0,
        "stop_s": 1200.0,
        "mode": "+x",
        "slew": [{"axis": [0.0, 0.0, 1.0], "angle_deg": 30.0, "start_s": 20.0, "duration_s": 140.0}],
    },
    {"name": "c", "activity": "-x forward", "start_s": 2000.0, "stop_s": 2200.0, "mode": "-x"},
]


RIVALS = ["vibration", "bias_periodic", "reference_periodic", "noise_excess"]


@lru_cache
def plan(every_s=1.0):
    """Samples at 100 Hz and a reference each second, over ten minutes."""
    changes = {"gyro.sample_s": 0.01, "reference.every_s": every_s, "interval": INTERVALS}
    return scenario.override(scenario.load("trmm_series"), NOISE | changes)


@lru_cache
def recorded(*effects, every_s=1.0):
    return simulate(plan(every_s), seed=1, effects=[parse(text) for text in effects])


def swaying(recording, turn):
    """M0 with a body that also turns by θ about y: with A' = exp(−[θ×]) A the rate is ω + dθ/dt + ω × θ."""
    G = np.array(plan().gyro.true_G)
    gyro, attitudes = recording.gyro, recording.attitudes
    before, after = turn(gyro.t_s), turn(gyro.t_s + gyro.sample_s)
    change = (after - before) / gyro.sample_s + np.cross(gyro.rates @ G.T, 0.5 * (before + after))
    rates = gyro.rates + change @ np.linalg.inv(G).T
    turned = Rotation.from_quat(attitudes.quaternions) * Rotation.from_rotvec(turn(attitudes.t_s))
    return replace(recording, gyro=replace(gyro, rates=rates), attitudes=replace(attitudes, quaternions=turned.as_quat()))


def tone(amplitude_deg, frequency_hz):
    """A steady sway about y."""

    def turn(t_s):
        angle = np.zeros((t_s.size, 3))
        angle[:, 1] = np.deg2rad(amplitude_deg) * np.sin(2 * np.pi * frequency_hz * t_s)
        return angle

    return turn


@lru_cache
def prepared(*effects):
    return prepare(recorded(*effects))


@lru_cache
def prepared_sway():
    """A sway so slow that the references follow it."""
    return prepare(swaying(recorded(), tone(0.002, 1 / 5.1)))


def band(amplitude_deg, frequency_hz, width_hz, seed=1):
    """A sway about y over a band of frequencies, whose amplitude comes and goes."""
    rng = np.random.default_rng(seed)
    frequencies, phases = frequency_hz + width_hz * rng.standard_normal(40), rng.uniform(0, 2 * np.pi, 40)

    def turn(t_s):
        angle = np.zeros((t_s.size, 3))
        waves = np.sin(2 * np.pi * np.outer(t_s, frequencies) + phases)
        angle[:, 1] = np.deg2rad(amplitude_deg) * waves.sum(axis=1) / np.sqrt(20)
        return angle

    return turn


@pytest.mark.parametrize(
    "turn",
    [
        pytest.param(None, marks=pytest.mark.long),
        band(0.002, 0.3, 0.03),
        pytest.param(band(5e-5, 6.3, 0.2), marks=pytest.mark.long),
    ],
)
def test_a_body_that_sways_is_no_vibration(turn):
    """Steady and slow, where the references follow it; over a band, whether they can or not, far beyond their rate too."""
    found = prepare(swaying(recorded(), turn)) if turn else prepared_sway()
    assert [line.axis for line in found.samples.lines]
    assert {line.axis for line in found.samples.lines} == {1}
    assert [symptom.kind for symptom in found.samples.symptoms] == []
    assert len(found.samples.motions) + len(found.samples.unconfirmed) == len(found.samples.lines)


def test_a_diagnosis_of_a_swaying_body_finds_no_gap_and_says_why():
    answer = diagnose(swaying(recorded(), tone(0.002, 1 / 5.1)), library=RIVALS)
    assert answer.verdict == "none"
    assert answer.causes == ()
    assert any("of the body" in note for note in answer.notes)


@pytest.mark.parametrize(("frequency", "size"), [(0.43, 0.004), (41.0, 0.002)])
def test_a_vibration_is_one_at_any_frequency(frequency, size):
    found = prepared(f"vibration:y={size},apparent_hz={frequency}")
    (symptom,) = found.samples.symptoms
    assert (symptom.kind, symptom.axis) == ("spectral_line", "y")
    assert abs(symptom.size - size) < 4 * symptom.sigma
    assert float(symptom.parameters["apparent_hz"]) == pytest.approx(frequency, abs=1e-3)
    assert [*found.samples.motions, *found.samples.unconfirmed] == []
    # It is taken out of the samples, and with it what it would have turned the attitude by.
    clean = recorded().gyro.rates[:, 1]
    before = np.std(recorded(f"vibration:y={size},apparent_hz={frequency}").gyro.rates[:, 1] - clean)
    assert np.std(found.samples.rates[:, 1] - clean) < 0.2 * before


def test_a_vibration_beside_a_sway_is_told_from_it():
    """On another axis, and beyond the band of the motion on the same one."""
    found = prepare(swaying(recorded("vibration:z=0.002,apparent_hz=31.0"), tone(0.002, 1 / 5.1)))
    assert [(symptom.kind, symptom.axis) for symptom in found.samples.symptoms] == [("spectral_line", "z")]
    assert {line.axis for line in [*found.samples.motions, *found.samples.unconfirmed]} == {1}


def test_a_tone_that_no_reference_resolves_is_a_vibration_only_in_the_upper_part_of_the_band():
    """Structures ring in each octave alike, and a vibration shows evenly: the lower a tone, the likelier it is a motion."""
    low, high = (prepared(f"vibration:y=0.002,apparent_hz={hz}").samples for hz in (9.0, 41.0))
    assert ([one.axis for one in low.unconfirmed], low.vibrations) == ([1], ())
    assert ([one.axis for one in high.vibrations], high.unconfirmed) == ([1], ())


def test_the_log_ratio_is_what_the_references_can_tell():
    """About ½ cᵀc in favour of a vibration, the same against it for a motion, and nothing where they could not see it."""
    still, moved = prepared("vibration:y=0.004,apparent_hz=0.43"), prepared_sway()
    (line,) = still.samples.lines
    before = replace(still.samples, rates=recorded("vibration:y=0.004,apparent_hz=0.43").gyro.rates)
    # The model of the repaired samples does not hold the line any more: put the other way round it is a motion.
    assert compute_log_ratio(still.model, line) < 0
    assert before.lines == still.samples.lines
    slow = next(one for one in moved.samples.lines if abs(one.frequency_hz - 1 / 5.1) < 0.01)
    ratio = compute_log_ratio(moved.model, slow)
    twice = compute_log_ratio(moved.model, replace(slow, waveform=2 * slow.waveform))
    # Of yᵀc − ½ cᵀc the second part goes with the square of the waveform.
    c2 = 2 * ratio - twice
    assert ratio == pytest.approx(-0.5 * c2, abs=3 * np.sqrt(c2))
    assert c2 > 20
    unseen = prepare(swaying(recorded(), tone(2e-5, 6.3)))
    (fast,) = unseen.samples.lines
    assert abs(compute_log_ratio(unseen.model, fast)) < 1


def test_a_gap_between_intervals_takes_nothing_from_what_a_line_turns():
    """Slow samples, of which the last before a gap turns as much as any: yᵀc is cᵀc, so of twice the line nothing is left."""
    effect = "vibration:x=0.2,apparent_hz=0.1834"
    recording, clean = series(3, effect), series(3)
    wave = recording.gyro.rates[:, 0] - clean.gyro.rates[:, 0]
    gaps = np.diff(recording.gyro.t_s) > 1.5 * recording.gyro.sample_s
    assert gaps.sum() == 5
    model = linearise_recording(recording, prepare(clean).model.G, prepare(clean).model.bias)
    line = Line(0, 0.1834, float(np.abs(wave).max()), 1e-7, 1e-9, wave, isolated=True, log_constancy=0.6)
    once, twice = (compute_log_ratio(model, replace(line, waveform=factor * wave)) for factor in (1, 2))
    assert once > 1000
    assert abs(twice) < 0.05 * once


def test_power_beside_a_line_that_is_none_of_noise_takes_from_what_the_references_tell():
    """A projection of ten sigmas by references with ten times their noise, weighed by its power, is a tenth of that."""
    found = prepared_sway()
    model, (line,) = found.model, found.samples.lines
    assert compute_log_ratio(model, line) < -10
    rng, ratios = np.random.default_rng(5), []
    for _ in range(10):
        noise = 10 * np.deg2rad(plan().reference.sigma_deg) * rng.standard_normal(model.residuals.shape)
        ratios.append(compute_log_ratio(replace(model, zeta=noise.ravel(), residuals=noise), line))
    assert np.abs(ratios).max() < 4


def test_a_vibration_within_the_band_of_a_motion_is_one_where_the_references_deny_it():
    """Slower sways lead up to it, above which it stands far; it is faster than the averages of references."""
    frequencies = [0.05, 0.13, 0.3, 0.75]

    def turn(t_s):
        return sum(tone(0.01 * 0.05 / f, f)(t_s) for f in frequencies)

    beside = prepare(swaying(recorded("vibration:y=0.03,apparent_hz=1.7", every_s=0.25), turn)).samples
    (symptom,) = beside.symptoms
    assert abs(symptom.size - 0.03) < 4 * symptom.sigma
    assert float(symptom.parameters["apparent_hz"]) == pytest.approx(1.7, abs=1e-3)
    # The same tone as a sway of the body, which the references follow.
    moved = prepare(swaying(recorded(), lambda t_s: turn(t_s) + tone(0.03 / (2 * np.pi * 1.7), 1.7)(t_s)))
    assert any(abs(line.frequency_hz - 1.7) < 1e-3 for line in moved.samples.motions)
    assert moved.samples.symptoms == ()


def a_line(frequency_hz, phase=0.7, gap=(0, 0), sample_s=0.1, count=8000):
    """A line of one gyro, (line, gyro stream), which some samples do not hold."""
    t = 500.0 + sample_s * np.arange(count)
    wave = 1e-4 * np.sin(2 * np.pi * frequency_hz * (t + 0.5 * sample_s) + phase)
    wave[gap[0] : gap[1]] = 0.0
    return Line(2, frequency_hz, 1e-4, 1e-6, 1e-9, wave, isolated=True, log_constancy=0.6), SimpleNamespace(
        t_s=t, sample_s=sample_s
    )


def test_a_swing_of_a_bias_has_its_amplitude_period_and_phase():
    """A sample is the mean of the swing: sinc(f d) of it."""
    line, gyro = a_line(0.31, gap=(1000, 1500))
    found = lines.make_symptom(line, 0.97, 0.8, gyro)
    assert (found.kind, found.unit, found.of_line, found.probability) == ("bias_tone", "deg/h", True, 0.97)
    assert found.size == pytest.approx(np.rad2deg(1e-4) * 3600 / np.sinc(0.031))
    assert found.sigma == pytest.approx(np.rad2deg(1e-6) * 3600 / np.sinc(0.031))
    assert found.parameters["period_s"] == pytest.approx(1 / 0.31)
    assert found.parameters["phase_deg"] == pytest.approx(np.rad2deg(0.7))
    assert found.rivals == (("spectral_line", pytest.approx(0.2)),)
    vibration = lines.make_symptom(line, 0.97, 0.3, gyro)
    assert (vibration.kind, vibration.rivals) == ("spectral_line", (("bias_tone", 0.3),))
    assert lines.make_symptom(line, 0.97, 0.0, gyro).rivals == ()


@pytest.mark.parametrize(
    ("frequency_hz", "fastest_hz", "expected"),
    [(0.1, 0.4, 10 / 11), (1.0, 4.0, 0.5), (4.0, 5.0, 0.2), (1.0, 0.9, 0.0)],
)
def test_a_swing_is_as_likely_in_each_octave_and_a_vibration_at_each_frequency(frequency_hz, fastest_hz, expected):
    """Half the sampling rate is 5 Hz, and the periods span five in their logarithm: densities 1/5 and 1/(5 f)."""
    line, gyro = a_line(frequency_hz)
    assert lines.compute_probability_of_bias(line, gyro, fastest_hz) == pytest.approx(expected)


SWING = "bias_periodic:z=25,period_s=1.25"


def test_a_swing_that_the_samples_show_may_be_either():
    """References every 0.4 s follow a swing of 1.25 s, and a vibration may show at its frequency, too."""
    (symptom,) = prepare(recorded(SWING, every_s=0.4)).samples.symptoms
    assert (symptom.kind, symptom.axis) == ("bias_tone", "z")
    assert [kind for kind, _ in symptom.rivals] == ["spectral_line"]
    assert abs(symptom.size - 25) < 4 * symptom.sigma
