"""Discrepancies that are on no list: their columns against closed forms, and their breadth."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from diagnosis.inference.joint_search import JointSearch
from diagnosis.inference.search import Search
from diagnosis.model import bins as bins_of
from diagnosis.model import deterministic_alternatives
from diagnosis.model.bins import observe_rate_errors
from diagnosis.model.candidates import build_linear_model
from diagnosis.model.groups import list_alternative_groups
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.prepare import prepare
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import prepared, recorded

LATE = 1e-5  # of the time since an interval's start, that a reading is late by


@pytest.fixture(scope="module")
def model():
    return prepared(3).model


@pytest.fixture(scope="module")
def bins(model):
    return bins_of.build_bins(model, 8.0)


@pytest.fixture(scope="module")
def families(model):
    return {(family.name, family.axis): family.columns for family in deterministic_alternatives.build_families(model)}


def test_bins_add_up_to_the_steps(model, bins):
    for number, block in enumerate(model.blocks):
        own = bins.interval == number
        expected = (model.to_inertial[block.steps] * model.dt[block.steps][:, None, None]).sum(axis=0)
        np.testing.assert_allclose(bins.turned[own].sum(axis=0), expected, rtol=1e-9, atol=1e-6)
        assert bins.ends[number][-1] == own.sum()
        assert bins.since_s[own][0] == pytest.approx(0.0, abs=8.0)


def test_a_constant_regressor_is_the_column_of_a_bias(model, bins):
    for axis in range(3):
        column = bins_of.observe_rate_errors(model, bins, axis, np.ones((len(bins.t_s), 1)))[:, 0]
        np.testing.assert_allclose(column, model.calibration[:, 9 + axis], atol=1e-9 * np.abs(column).max())


def test_bins_change_a_slow_regressor_little(model, bins):
    """A regressor that follows the rate, of unit size, bin by bin against step by step."""
    square = model.rates[:, 1] ** 2
    exact = model.whiten(model.observe_rate_error(np.eye(3)[None, :, 2, None] * square[:, None, None]))[:, 0]
    binned = bins_of.observe_rate_errors(model, bins, 2, bins.rates[:, [1]] ** 2)[:, 0]
    assert np.linalg.norm(binned - exact) < 0.02 * np.linalg.norm(exact)


def test_errors_of_references_leave_the_steps_before_them_alone(model, families):
    """A step of the references inside one interval shows in no other interval."""
    for columns in families["references step at a time", "x"]:
        shown = {model.observation_block[row // 3] for row in np.flatnonzero(np.abs(columns[:, 0]) > 1e-9)}
        before = [k for k in range(len(model.blocks)) if k < min(shown)]
        assert all(np.abs(columns[model.blocks[k].rows]).max() == 0 for k in before)


def test_of_two_intervals_a_value_of_each_is_a_step_between_them():
    """It is a rival of its own where there are three, or where no step is on the list."""
    model = prepared(3).model
    two, three = (
        linearise_recording(model.recording, model.G, model.bias, pieces=model.recording.intervals[:count]) for count in (2, 3)
    )
    steps = [EFFECTS["bias_step"], EFFECTS["g_matrix_step"]]
    rivals = {"bias differs between intervals", "scale factor or misalignment differs between intervals"}

    def left(model, effects):
        return {one.effect for one in list_alternative_groups(model, {}, effects)} & rivals

    assert left(two, steps) == set()
    assert left(three, steps) == rivals
    assert left(two, []) == rivals
    assert left(two, steps[:1]) == {"scale factor or misalignment differs between intervals"}


# ---- directions, temperatures and the past ----------------------------------------------------------------------------


def test_a_direction_follows_the_attitude_matrix(model, bins, families):
    """Its columns about z from components along x are those of rate errors a_xj, step by step."""
    columns = families["bias follows the direction to something in inertial space", "z"][0]
    A = model.to_inertial.transpose(0, 2, 1)
    error = np.zeros((len(A), 3, 3))
    error[:, 2] = A[:, 0]
    exact = model.project_out_nuisance(model.whiten(model.observe_rate_error(error)))
    for found, one in zip(model.project_out_nuisance(columns).T, exact.T, strict=True):
        cosine = found @ one / np.linalg.norm(found) / np.linalg.norm(one)
        assert cosine > 0.999


def test_a_direction_that_turns_with_the_orbit_is_a_product(bins, model):
    components, orbit = np.random.default_rng(1).standard_normal((5, 3)), 100.0
    t_s = np.arange(5) * 7.0
    once, twice = (deterministic_alternatives.turn_with_orbit(components, t_s, orbit, order) for order in (1, 2))
    angle = 2 * np.pi * t_s / orbit
    np.testing.assert_allclose(once, np.hstack([components * np.cos(angle)[:, None], components * np.sin(angle)[:, None]]))
    np.testing.assert_allclose(twice[:, :3], components)
    np.testing.assert_allclose(twice[:, 6:], components * np.sin(2 * angle)[:, None])


def test_the_past_decays(bins):
    """A constant since each interval's start is approached as 1 − exp(−t/τ)."""
    found = deterministic_alternatives.filter_low_pass(np.ones((len(bins.t_s), 1)), bins, 300.0)[:, 0]
    own = bins.interval == 0
    np.testing.assert_allclose(found[own], 1 - np.exp(-(bins.since_s[own] + 0.5 * bins.dt[own]) / 300.0), atol=0.03)


def test_the_last_large_value_keeps_its_sign(bins):
    values = np.zeros(len(bins.t_s))
    own = np.flatnonzero(bins.interval == 1)
    values[own[10]], values[own[20]], values[own[30]] = 5.0, 0.1, -3.0
    found = deterministic_alternatives.keep_last_sign(values, bins)[:, 0]
    assert (found[own[:10]] == 0).all()
    assert (found[own[10:30]] == 1).all()
    assert (found[own[30:]] == -1).all()
    assert (found[bins.interval != 1] == 0).all()


def test_twice_a_heading_is_a_second_harmonic_of_a_direction():
    heading = np.linspace(0, 7, 50)
    direction = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(heading.size)])
    for wave in (np.sin(2 * heading), np.cos(2 * heading)):
        left = (
            wave
            - deterministic_alternatives.build_second_harmonics(direction)
            @ np.linalg.pinv(deterministic_alternatives.build_second_harmonics(direction))
            @ wave
        )
        assert np.abs(left).max() < 1e-12


def disturb_bias(model, bins, shape):
    """A recording whose bias about y follows a shape (n,) over the bins, at 40 sigma."""
    recording = recorded(3)
    strength = np.linalg.norm(model.project_out_nuisance(observe_rate_errors(model, bins, 1, shape[:, None])))
    gyro = recording.gyro
    high = np.interp(gyro.t_s, bins.t_s, shape) * 40.0 / strength
    return replace(recording, gyro=replace(gyro, rates=gyro.rates + high[:, None] * np.array([0.0, 1.0, 0.0])))


def disturb_references(recording, course):
    """A recording whose references are off about z by a course (m,), in units of 0.03 deg."""
    references = recording.attitudes
    error = np.zeros((course.size, 3))
    error[:, 2] = np.deg2rad(0.03) * course
    turned = (Rotation.from_rotvec(-error) * Rotation.from_quat(references.quaternions).inv()).inv()
    return replace(recording, attitudes=replace(references, quaternions=turned.as_quat()))


def make_disturbed(kind, model, bins):
    if kind == "bias and past":
        return disturb_bias(model, bins, deterministic_alternatives.filter_low_pass(np.abs(bins.rates), bins, 300.0)[:, 1])
    recording = recorded(21, every_s=90.0)
    forward = Rotation.from_quat(recording.attitudes.quaternions).as_matrix()[:, :, 0]  # body x in inertial axes
    return disturb_references(recording, forward[:, 0] * forward[:, 2])


RIVALS = {
    "bias and past": "bias follows the rates of the past:y",
    "references and twice the heading": "references follow a direction:z",
}


@pytest.mark.parametrize("kind", RIVALS)
def test_its_own_rival_explains_it_better_than_any_listed_effect(model, bins, kind):
    """Without these rivals, listed effects explain them: processes, an orbital bias, and a scale asymmetry."""
    listed = ["reference_correlated", "reference_orbital"]
    if kind.startswith("bias"):
        listed = ["bias_random_walk", "bias_orbital", "scale_asymmetry"]
    disturbed = prepare(make_disturbed(kind, model, bins)).model
    linear = build_linear_model(disturbed, [EFFECTS[name] for name in listed])
    best = [linear.candidate(member) for member in JointSearch(Search(linear)).find().members]
    assert RIVALS[kind] in [one.label for one in best]
    assert not any(one.listed for one in best)
