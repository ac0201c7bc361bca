"""Discrepancies that are on no list: their columns against closed forms, and their breadth."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.inference.joint_search import JointSearch
from diagnosis.inference.search import Search
from diagnosis.model import alternatives
from diagnosis.model import bins as bins_of
from diagnosis.model.candidates import build_linear_model
from diagnosis.model.prepare import prepare
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import prepared, recorded


@pytest.fixture(scope="module")
def model():
    return prepared(3).model


@pytest.fixture(scope="module")
def bins(model):
    return bins_of.build_bins(model, 8.0)


def test_columns_of_a_constant_and_of_a_direction_are_closed_forms(model, bins):
    for axis in range(3):
        column = bins_of.observe_rate_errors(model, bins, axis, np.ones((len(bins.t_s), 1)))[:, 0]
        np.testing.assert_allclose(column, model.calibration[:, 9 + axis], atol=1e-9 * np.abs(column).max())
    # Its columns about z from components along x are those of rate errors a_xj, step by step.
    families = {(family.effect, family.axis): family.columns for family in alternatives.list_deterministic_rivals(model)}
    columns = families["bias follows the direction to something in inertial space", "z"][0]
    A = model.to_inertial.transpose(0, 2, 1)
    error = np.zeros((len(A), 3, 3))
    error[:, 2] = A[:, 0]
    exact = model.project_out_nuisance(model.whiten(model.observe_rate_error(error)))
    for found, one in zip(model.project_out_nuisance(columns).T, exact.T, strict=True):
        cosine = found @ one / np.linalg.norm(found) / np.linalg.norm(one)
        assert cosine > 0.999


def test_its_own_rival_explains_it_better_than_any_listed_effect(model, bins):
    """Without this rival, listed effects explain it: a process, an orbital bias, and a scale asymmetry."""
    past = alternatives.filter_low_pass(np.abs(bins.rates), bins, 300.0)[:, 1]
    strength = np.linalg.norm(model.project_out_nuisance(bins_of.observe_rate_errors(model, bins, 1, past[:, None])))
    recording = recorded(3)
    gyro = recording.gyro
    high = np.interp(gyro.t_s, bins.t_s, past) * 40.0 / strength  # sigmas
    moved = replace(gyro, rates=gyro.rates + high[:, None] * np.array([0.0, 1.0, 0.0]))
    disturbed = prepare(replace(recording, gyro=moved)).model
    listed = [EFFECTS[name] for name in ("bias_random_walk", "bias_orbital", "scale_asymmetry")]
    linear = build_linear_model(disturbed, listed)
    best = [linear.candidate(member) for member in JointSearch(Search(linear)).find().members]
    assert "bias follows the rates of the past:y" in [one.label for one in best]
    assert not any(one.listed for one in best)
