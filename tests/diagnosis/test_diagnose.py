"""Whole diagnoses: M0 and wrong noise, effects, what cannot be seen, and the practice recordings with their keys."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy.special
from scipy.spatial.transform import Rotation

from diagnosis.adopt import adopt_causes
from diagnosis.answer import UNDECIDED, Cause
from diagnosis.assemble import explain_blindness
from diagnosis.budget import Step
from diagnosis.detectors.sample_report import Symptom
from diagnosis.diagnose import diagnose, doubt_sides
from diagnosis.inference.levels import Level, Levels
from diagnosis.inference.null import compute_null_p
from diagnosis.inference.search import Search
from diagnosis.model.candidates import build_linear_model
from diagnosis.model.prepare import prepare
from diagnosis.model.symptoms import SampleCause, weigh_symptom
from diagnosis.posterior import compute_conditional_listed
from diagnosis.settings import DEFAULT
from diagnosis.verdict import decide_verdict
from gyrocal import calibrate, load
from gyrocal.masking import DataMask, MaskedStretch
from simulator.effects import EFFECTS, parse
from studies.report.diagnosis import format_headline
from tests import SHARED
from tests.diagnosis.recordings import QUICK, of_rates, plan, prepared, recorded, slews
from tests.diagnosis_cases import CASES

PRACTICE = SHARED / "practice"
KEYS = json.loads((PRACTICE / "keys.json").read_text()) if PRACTICE.is_dir() else {}


OF_A_GAP = ("The residuals after a calibration fit", "look at the number")  # notes that have no place without their reason
COARSE = {"sample_s": 4.0, "every_s": 240.0}  # where nothing hangs on what happens within minutes

SLOW = ("bias_step", "bias_orbital", "bias_markov", "reference_correlated", "reference_orbital")  # a library of slow errors


def test_m0_has_no_gap_and_the_same_answer_twice():
    told = []
    answer = diagnose(recorded(11, **COARSE), progress=lambda text, share: told.append(share))
    assert told == sorted(told)
    assert max(np.diff(told)) < 0.2
    assert answer.verdict == "none"
    assert not answer.present
    assert answer.causes == ()
    assert answer.closure is None
    assert answer.p_value > DEFAULT.false_alarm_rate
    assert not any(words in one for one in answer.notes for words in OF_A_GAP)
    document = answer.to_json()
    assert json.loads(json.dumps(document)) == document
    # With the draws of M0, which a recording without a gap takes all of.
    first, second = answer.to_json(), diagnose(recorded(11, **COARSE)).to_json()
    first.pop("runtime_s"), second.pop("runtime_s")
    assert first == second


def test_wrong_stated_noise_is_noise_excess_and_nothing_else():
    """Negative control: M0 data whose header states two thirds of the noise there is, of the gyro and of the references."""
    recording = recorded(12)
    gyro, attitudes = recording.gyro, recording.attitudes
    wrong = replace(
        recording, gyro=replace(gyro, arw=gyro.arw / 1.5), attitudes=replace(attitudes, sigma=attitudes.sigma / 1.5)
    )
    answer = diagnose(wrong, library=["noise_excess", "reference_noise_excess", *SLOW])
    assert {(one.effect, one.axis) for one in answer.causes} == {("noise_excess", None), ("reference_noise_excess", None)}
    assert answer.verdict == "named"
    assert all(abs(cause.size - 1.5) < 4 * cause.sigma for cause in answer.causes)


def test_a_log_at_rest_between_two_references_shows_repeats_and_no_gap_of_the_attitude():
    """A logger that reads each sample three times, at even times: no degree of freedom is left for the attitude."""
    rates = np.repeat(np.deg2rad(0.05) * np.random.default_rng(1).standard_normal((400, 3)), 3, axis=0)
    made = recorded(0)
    ends = np.array([0.0, 12.0])
    at_rest = replace(
        made,
        gyro=replace(made.gyro, t_s=np.arange(len(rates)) / 100, rates=rates, sample_s=0.01, arw=np.deg2rad(0.05) * 0.1),
        attitudes=replace(
            made.attitudes, t_s=ends, quaternions=np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)), sigma=np.full((2, 3), np.deg2rad(0.1))
        ),
        intervals=(replace(made.intervals[0], start_s=0.0, stop_s=12.0),),
        tables={},
    )
    found = diagnose(at_rest)
    assert found.p_values["attitude"] == 1.0
    assert [(cause.effect, cause.probability > 0.5) for cause in found.causes] == [("stale_samples", True)]
    assert found.budget == ()


def test_shuffled_residuals_give_no_cause():
    """Negative control for the whole attitude side: a strong effect, its residuals in another order."""
    model = prepared(13, "bias_orbital:z=0.3", **COARSE).model
    linear = build_linear_model(model, list(EFFECTS.values()))
    assert compute_null_p(Search(linear), 0, DEFAULT.null_draws) < 1e-20
    rng = np.random.default_rng(14)
    p = []
    for _ in range(2):
        shuffled = model.project_out_nuisance(rng.permutation(model.y) * rng.choice([-1.0, 1.0], model.size))
        shuffled *= np.sqrt(model.degrees_of_freedom) / np.linalg.norm(shuffled)
        p.append(compute_null_p(Search(replace(linear, y=shuffled)), 0, DEFAULT.null_draws))
    assert min(p) > DEFAULT.false_alarm_rate


def test_an_effect_is_named_with_its_size_and_closes_the_gap():
    text = "bias_orbital:y=0.25,phase_deg=40"
    setting = parse(text)
    answer = diagnose(recorded(15, text, **COARSE))
    assert answer.verdict == "named"
    assert not any(words in one for one in answer.notes for words in OF_A_GAP)
    (cause,) = answer.causes
    assert (cause.label, cause.unit) == ("bias_orbital:y", "deg/h")
    assert abs(cause.size - setting.size) < 3.5 * cause.sigma
    difference = (cause.parameters["phase_deg"] - setting.parameters["phase_deg"] + 180) % 360 - 180
    assert abs(difference) < 4 * np.rad2deg(cause.sigma / cause.size)
    assert answer.closure is not None
    assert answer.closure.after < answer.closure.before
    # The calibration with the effect in is nearer to the truth than without.
    gyro = plan().gyro
    true_G, true_bias = np.array(gyro.true_G), np.deg2rad(gyro.true_bias_deg_s)
    error, before = (
        np.append((G - true_G).ravel() / answer.sigma_G.ravel(), (bias - true_bias) / answer.sigma_bias)
        for G, bias in ((answer.G, answer.bias), (answer.baseline_G, answer.baseline_bias))
    )
    assert np.abs(error).max() < 4
    assert error @ error < before @ before


def test_a_lag_cannot_lead():
    """Tags that are early have the column of a lag with the wrong sign: only the offset is left."""
    library = ["time_offset", "rate_lag", "scale_asymmetry", "bias_step"]
    early, late = (diagnose(recorded(20, f"time_offset={size}", **COARSE), library=library) for size in (-0.8, 0.8))
    (cause,) = early.causes
    assert cause.group[0] == "time_offset"
    assert "rate_lag" not in cause.group
    assert abs(cause.size + 0.8) < 3.5 * cause.sigma
    assert set(late.causes[0].group) == {"time_offset", "rate_lag"}
    assert late.verdict == "group"


def test_a_correlated_reference_error_is_not_noise_as_well():
    """With a short time constant its second differences look like noise."""
    answer = diagnose(recorded(27, "reference_correlated:x=0.012,time_constant_s=200"))
    assert [cause.label for cause in answer.causes] == ["references slow random:x"]


def test_an_effect_left_out_of_the_library_is_unknown():
    recording = recorded(16, "reference_horizon:x=0.03", **COARSE)
    # A swing of any period, reference_periodic, would describe one with half the orbit's period as well.
    answer = diagnose(recording, library=SLOW)
    assert answer.verdict == "unknown"
    assert answer.unknown_probability > 0.5
    assert answer.causes == ()


def test_a_cause_beside_something_unlisted_in_the_samples_is_a_partial_answer():
    """At seed 9 G_xz absorbs the bias that swings."""
    answer = diagnose(recorded(10, "rate_saturation:z=0.2", "bias_orbital:x=0.3"), library=SLOW)
    assert answer.verdict == "partial"
    assert answer.unknown_probability > 0.99
    assert [cause.label for cause in answer.causes] == ["bias_orbital:x"]
    assert [step.step for step in answer.budget if step.probability is not None] == ["bias_orbital:x"]


def test_a_gap_that_no_calibration_sees_is_told_with_its_reason():
    recording = recorded(3, "bias_orbital:y=0.05")
    found, of_calibration = diagnose(recording), calibrate(recording)
    assert of_calibration.p_value > 0.01
    assert found.present
    (note,) = [one for one in found.notes if one.startswith(OF_A_GAP[0])]
    assert "bias_orbital:y takes " in note
    # The same sum as that of the calibration.
    assert float(scipy.special.chdtrc(of_calibration.dof, of_calibration.chi2)) == pytest.approx(
        float(note.split("p = ")[1].split(")")[0]), rel=0.02
    )


def test_numbers_in_another_unit_are_told():
    """The noise is as it was, and the number that states it is another; sigmas in arcsec are 3600 times too large."""
    arw, sigma = 60.0, 3600.0
    plain = recorded(3, "bias_orbital:y=0.5")
    gyro, attitudes = replace(plain.gyro, arw=arw * plain.gyro.arw), plain.attitudes
    found = diagnose(replace(plain, gyro=gyro, attitudes=replace(attitudes, sigma=sigma * attitudes.sigma)))
    notes = " ".join(one for one in found.notes if "look at the number" in one)
    assert "1/60, as of an angle" in notes
    assert "1/3600, as of sigmas" in notes
    for name, factor in (("noise_excess", 1 / arw), ("reference_noise_excess", 1 / sigma)):
        noise = next(one for one in found.causes if one.effect == name)
        assert abs(noise.size - factor) < 4 * noise.sigma
    # With the noise as it is, what is at work shows as ever.
    other = next(one for one in found.causes if one.effect == "bias_orbital")
    assert abs(other.size - 0.5) < 4 * other.sigma


SWINGING = (
    *("bias_periodic", "bias_orbital", "bias_step", "bias_random_walk", "bias_markov", "noise_flicker"),
    *("reference_periodic", "reference_orbital", "reference_horizon", "reference_correlated"),
)


def test_a_swing_is_found_with_its_period_and_size():
    answer = diagnose(recorded(6, "bias_periodic:z=0.35,period_s=1730,phase_deg=-70"), library=SWINGING)
    assert answer.verdict in ("named", "group")
    (cause,) = answer.causes
    assert "bias_periodic:z" in cause.group
    assert abs(cause.parameters["period_s"] - 1730) < 4 * cause.parameters["period_sigma_s"]
    if cause.effect == "bias_periodic":
        assert abs(cause.size - 0.35) < 3.5 * cause.sigma
    assert answer.closure.closed > 0.7


@pytest.mark.long
@pytest.mark.skipif(not KEYS, reason="the practice recordings are not beside this checkout")
@pytest.mark.parametrize("name", sorted(KEYS))
def test_practice_recordings_answer_as_their_keys(name):
    answer = diagnose(load(PRACTICE / name))
    truth = KEYS[name]["effects"]
    if not truth:
        assert answer.verdict == "none"
        return
    if truth[0]["family"] == "unknown":
        assert answer.verdict == "unknown"
        return
    wanted = [f"{one['family']}:{one['axis']}" if one.get("axis") else one["family"] for one in truth]
    assert answer.verdict in ("named", "group")
    assert len(answer.causes) == len(wanted)
    for label, one in zip(wanted, truth, strict=True):
        cause = next(cause for cause in answer.causes if label in cause.group)
        if cause.label == label:
            assert abs(cause.size - one["size"]) < 3 * cause.sigma + 1e-6 * one["size"]


def turned(recording, offset_deg):
    """The recording with a constant rotation E of its references, A_obs = E A."""
    q = Rotation.from_quat(recording.attitudes.quaternions) * Rotation.from_rotvec(np.deg2rad(offset_deg))
    return replace(recording, attitudes=replace(recording.attitudes, quaternions=q.as_quat()))


def test_a_large_offset_of_the_references_is_not_identifiable():
    found = diagnose(turned(slews(seed=4), [0.0, 3.0, 0.0]), settings=QUICK)
    assert (found.verdict, found.present, found.causes) == ("not identifiable", False, ())
    assert "3 deg" in found.notes[0]
    assert "constant offset of the references" in found.notes[0]
    assert format_headline(found) == "This recording cannot show whether there is a misfit"


def explain(G, sigma=1e-4, apriori=None, plausible=0.01, dof=6):
    return explain_blindness(dof, G, np.full((3, 3), sigma), np.eye(3) if apriori is None else apriori, plausible, DEFAULT)


def test_a_rotation_beyond_its_error_or_no_spare_observation_makes_blind():
    G = Rotation.from_rotvec([0.0, 0.0, 0.05]).as_matrix() @ np.diag([1.02, 0.98, 1.0])
    assert "about x, y, z" in str(explain(G))
    assert explain(np.diag([1.1, 0.9, 1.0])) is None  # scale factors turn nothing
    assert explain(G, sigma=0.02) is None  # within its own error
    assert explain(G, apriori=G) is None
    assert explain(G, plausible=0.1) is None  # as gyros of a coarse grade are mounted
    assert "as many parameters" in str(explain(np.eye(3), dof=0))


def test_a_simulated_error_without_a_name_is_a_gap_without_a_cause():
    assert not EFFECTS["rate_deadzone"].is_nameable
    found = diagnose(recorded(4, "rate_deadzone:z=9e-4"), settings=QUICK)
    assert found.present
    assert [one for one in found.causes if one.probability > QUICK.named] == []


def test_a_body_that_sways_shows_lines_and_no_misfit():
    t_s = 0.25 * np.arange(4800)
    slow = 2.0 * np.sin(2 * np.pi * t_s[:, None] / np.array([170.0, 230.0, 310.0]))
    rates = np.deg2rad(slow + 0.3 * np.sin(2 * np.pi * 0.9 * t_s)[:, None] * [0.0, 1.0, 0.5])
    found = prepare(of_rates(rates, 16, 0.25, np.deg2rad(2e-4), np.deg2rad(0.004), seed=5))
    assert {line.axis for line in found.samples.lines} == {1, 2}
    assert all(line.frequency_hz == pytest.approx(0.9, abs=1e-3) for line in found.samples.lines)
    assert found.samples.symptoms == ()
    assert not found.has_odd_references
    dof = found.model.degrees_of_freedom
    assert found.model.y @ found.model.y == pytest.approx(dof, abs=5 * np.sqrt(2 * dof))


LIBRARY = ("bias_step", "bias_drift", "scale_asymmetry", "time_offset")
TIME_S, SIZE = 3000.0, 2.0  # s since the epoch, deg/h
AXES = "xyz"


def plain():
    return recorded(5, f"bias_step:z={SIZE},time_s={TIME_S}", sample_s=5.0, every_s=300.0)


def asked(recording):
    return diagnose(recording, library=LIBRARY)


@cache
def before():
    found = asked(plain())
    assert (found.verdict, [cause.label for cause in found.causes]) == ("named", ["bias_step:z"])
    return found


def assert_same(found, axes=AXES, by_s=0.0, rel=1e-6):
    """The same answer to rounding; an unlikely set worth 1e-4 of the probability may be kept or not by the last bits."""
    named = dict(zip(AXES, axes, strict=True))
    assert found.verdict == before().verdict
    assert found.p_value == pytest.approx(before().p_value, rel=1e-3)
    assert found.unknown_probability == pytest.approx(before().unknown_probability, abs=3e-4)
    (one,), (own,) = found.causes, before().causes
    assert (one.effect, one.axis) == (own.effect, named[own.axis])
    assert (one.size, one.sigma) == pytest.approx((own.size, own.sigma), rel=rel)
    assert one.probability == pytest.approx(own.probability, abs=3e-4)
    assert one.parameters["time_s"] - by_s == pytest.approx(own.parameters["time_s"], rel=rel)
    order = [axes.index(axis) for axis in AXES]  # the axis that has each name now
    np.testing.assert_allclose(found.bias, before().bias[order], rtol=rel)
    np.testing.assert_allclose(found.G, before().G[np.ix_(order, order)], atol=rel * before().sigma_G.min())
    assert found.closure.closed == pytest.approx(before().closure.closed, rel=100 * rel)


def test_epoch_signs_of_quaternions_and_names_of_axes_change_nothing_but_these():
    """The body's axes and its gyros are called otherwise, x what was y or z: a turn by a third about the diagonal."""
    recording, by_s, axes = plain(), 10**8, "yzx"
    P = np.eye(3)[[axes.index(axis) for axis in AXES]]  # components by the new names
    gyro, own = recording.gyro, recording.attitudes
    signs = np.random.default_rng(1).choice([-1.0, 1.0], (len(own.t_s), 1))
    q = signs * (Rotation.from_quat(own.quaternions) * Rotation.from_matrix(P).inv()).as_quat()
    G, bias = P @ gyro.apriori_G @ P.T, P @ gyro.apriori_bias
    changed = replace(
        recording,
        gyro=replace(gyro, t_s=gyro.t_s + by_s, rates=gyro.rates @ P.T, apriori_G=G, apriori_bias=bias),
        attitudes=replace(own, t_s=own.t_s + by_s, quaternions=q, sigma=own.sigma @ P.T),
        intervals=tuple(replace(one, start_s=one.start_s + by_s, stop_s=one.stop_s + by_s) for one in recording.intervals),
    )
    assert_same(asked(changed), axes, by_s)


SURE = 1 - DEFAULT.unlisted_in_samples


def seen(kind, axis, effect="an_effect", probability=1.0):
    return SampleCause(Symptom(kind, axis, 1.0, "", 0.1, {}, 1e-30, probability=probability), effect, None)


LESS = weigh_symptom(seen("outliers", "y", probability=0.6).symptom, DEFAULT).listed


@pytest.mark.parametrize(
    ("samples", "likely"),
    [
        ([seen("outliers", "x")], [SURE]),
        ([seen("outliers", "x"), seen("outliers", "y")], [SURE, 1.0]),  # as one
        ([seen("outliers", "x"), seen("plateau", "y")], [SURE, SURE]),  # each for itself
        ([seen("white_noise_level", "x"), seen("readout_noise", "y")], [SURE, 1.0]),  # of the noise, both
        ([seen("outliers", "x"), seen("outliers", "y", probability=0.6)], [SURE, LESS / SURE]),  # the least of them
        ([seen("outliers", "x", effect=None), seen("outliers", "y")], [0.0, 0.0]),  # no effect claims one
    ],
)
def test_symptoms_of_one_kind_have_one_unlisted_cause_or_none(samples, likely):
    assert compute_conditional_listed([one.summarise(DEFAULT) for one in samples]) == pytest.approx(likely)


CERTAIN = Cause("bias_drift", "x", 1.0, "deg/h per day", 0.1, {}, 0.95, ("bias_drift:x",), 0.95)
OPEN = replace(CERTAIN, probability=0.6)


@pytest.mark.parametrize(
    ("present", "causes", "unlisted", "further", "verdict"),
    [
        (False, [], 0.0, {}, "none"),
        (False, [], 0.0, {"blind": True}, "not identifiable"),
        (True, [CERTAIN], 0.1, {}, "named"),
        (True, [CERTAIN, OPEN], 0.1, {}, "group"),
        (True, [CERTAIN], 0.51, {}, "partial"),
        (True, [], 0.1, {}, "unknown"),
        (True, [CERTAIN], 0.99, {"has_remainder": True}, "partial"),
        (True, [CERTAIN], 0.1, {"blind": True}, "named"),
        (True, [replace(CERTAIN, named=False)], 0.1, {}, "group"),
    ],
)
def test_the_verdict_of_causes_and_probabilities(present, causes, unlisted, further, verdict):
    assert decide_verdict(present, causes, unlisted, DEFAULT, **further) == verdict


SLOW_ERROR = Cause(
    "bias_markov", "z", 900.0, "deg/h", 60.0, {"time_constant_s": 0.3}, 0.97, ("bias_markov:z", "noise_flicker:z"), 0.97,
    Levels(Level("gyro", 0.97), Level("z", 0.97), Level("slow random", 0.97)), named=False,
)  # fmt: skip


def test_a_random_error_is_stated_without_an_effect_and_simulated_as_its_first():
    found = replace(CASES["group"](), causes=(SLOW_ERROR,))
    (stated,) = found.to_json()["causes"]
    assert "effect" not in stated
    assert (stated["group"], stated["levels"]["side"]["name"]) == (["bias_markov:z", "noise_flicker:z"], "gyro")
    assert SLOW_ERROR.label == "gyro slow random:z"
    adoption = adopt_causes(found)
    assert [one.label() for one in adoption.effects] == ["bias_markov:z"]
    assert adoption.instead == (("bias_markov:z", ("noise_flicker:z",)),)


@pytest.mark.parametrize(("jumps", "size", "side"), [(3, 0.5, UNDECIDED), (2, 0.5, "gyro"), (3, 0.05, "gyro")])
def test_references_that_jump_far_and_often_leave_the_side_undecided(jumps, size, side):
    """The misfit adds 0.087 deg; a cause with a name and one of the references stay as they are."""
    budget = (Step("baseline", 4.0, 0.1), Step("floor", 1.0, 0.05))
    of_references = replace(
        SLOW_ERROR, effect="reference_correlated", levels=SLOW_ERROR.levels._replace(side=Level("references", 1))
    )
    mask = DataMask(tuple(MaskedStretch("reference jump", "x", 10.0 * k, 10.0 * k, size) for k in range(jumps)))
    found = replace(CASES["group"](), causes=(SLOW_ERROR, CERTAIN, of_references), budget=budget, mask=mask)
    doubted = doubt_sides(found, intervals=3)
    assert doubted.causes[0].levels.side.name == side
    assert doubted.causes[1:] == found.causes[1:]
    assert ("or the reference attitudes" in format_headline(doubted)) == (side == UNDECIDED)
