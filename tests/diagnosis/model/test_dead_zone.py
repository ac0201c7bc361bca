"""The candidate of a dead zone: its columns, its axis, and the whole diagnosis of a wide one."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.detectors.dead_zone_rests import MOST_PARTS, convert_zone
from diagnosis.detectors.sample_report import Zone
from diagnosis.diagnose import diagnose
from diagnosis.model import dead_zone
from diagnosis.model.prepare import prepare
from simulator import scenario
from simulator.effects import EFFECTS
from simulator.simulate import simulate
from tests.diagnosis.recordings import of_rates, plan, prepared

DEG = np.deg2rad(1.0)
WIDE, WIDE_S = 0.03, 0.25  # half width, deg/s, and the time between two samples, s
EFFECT = next(effect for effect in EFFECTS.values() if effect.symptom == "dead_zone")


@pytest.fixture(scope="module")
def found():
    """A gyro that reads zero below 9e-4 deg/s, in which there is one piece of evidence."""
    return prepared(4, f"{EFFECT.name}:z=9e-4", sample_s=0.5, every_s=60.0)


def test_a_gyro_without_bias_is_no_dead_zone():
    """Negative control: raw rates that are zero because there is nothing to read."""
    assert all(one.log_odds <= 2 for one in prepared(4).dead)
    changes = {"gyro.true_bias_deg_s": (0.0, 0.0, 0.0), "gyro.true_G": np.eye(3).tolist()}
    answer = diagnose(simulate(scenario.override(plan(), changes), seed=25))
    assert {"none", "unknown"} <= set(answer.conformal_90)
    assert answer.verdict == "none"  # whatever the samples look like, no rate is missing in the attitude


def test_what_is_missing_is_a_rate_in_the_runs_and_nowhere_else(found):
    (shown,) = found.dead
    model = found.model
    one = replace(shown, part=np.where(shown.part < MOST_PARTS, shown.part, -1))
    toward = model.G[:, one.axis]
    columns = dead_zone.observe_missing_rates(model, one, toward)
    assert columns.shape == (model.size, 2 + one.part.max())
    # What is too short for a rate of its own shares the common one.
    assert dead_zone.observe_missing_rates(model, shown, toward).shape == columns.shape
    # All runs alike are the sum of each by itself.
    np.testing.assert_allclose(columns[:, 0], columns[:, 1:].sum(axis=1) / dead_zone.DIFFERENCE, atol=1e-12)
    # Where every sample may miss a rate, that is a bias of the opposite sign.
    all_of_it = replace(one, part=np.zeros_like(one.part))
    everywhere = dead_zone.observe_missing_rates(model, all_of_it, toward)[:, 0]
    bias = model.observe_rate_error(np.tile(model.G[:, [one.axis]], (len(model.t_s), 1, 1)))[:, 0]
    np.testing.assert_allclose(everywhere, DEG * bias, atol=1e-9 * np.abs(bias).max() * DEG)


@pytest.fixture(scope="module")
def wide():
    """A body that turns slowly to and fro, and a quiet gyro x whose zone it passes through, hundreds of sigmas wide."""
    t_s = WIDE_S * np.arange(8000)
    true = np.deg2rad([0.12, 0.1, 0.08]) * np.sin(2 * np.pi * np.array([1 / 310, 1 / 730, 1 / 170]) * t_s[:, None])
    made = of_rates(true, 12, WIDE_S, np.deg2rad(1e-4) * np.sqrt(WIDE_S), np.deg2rad(0.004), seed=5)
    hidden = (np.abs(true) < WIDE * DEG) & [True, False, False]
    return replace(made, gyro=replace(made.gyro, rates=np.where(hidden, made.gyro.rates - true, made.gyro.rates)))


@pytest.fixture(scope="module")
def ready_of_wide(wide):
    return prepare(wide)


def test_what_is_missing_acts_along_the_true_input_axis(ready_of_wide):
    """M0 explains some of what is missing with its G; the column of the true one is (1, 0, 0), to four sigmas of M0's."""
    ready, (one,) = ready_of_wide, ready_of_wide.dead
    assert one.passed
    sigma = ready.sigma[:9].reshape(3, 3)[:, 0]
    without, beside = ready.model.G[:, 0], dead_zone.estimate_input_axis(ready.model, one)
    assert np.abs((without - [1, 0, 0]) / sigma).max() > 100
    assert np.abs((beside - [1, 0, 0]) / sigma).max() < 4


def test_the_course_between_the_edges_is_nearly_the_hidden_motion(ready_of_wide):
    """The straight course of each pass turns the body by what the zone hides, to a twentieth."""
    (one,) = ready_of_wide.dead
    model, toward = ready_of_wide.model, np.array([1.0, 0.0, 0.0])
    true = np.deg2rad(0.12) * np.sin(2 * np.pi / 310 * model.t_s)
    hidden = model.observe_rate_error(toward[:, None] * np.where(np.abs(true) < WIDE * DEG, true, 0.0)[:, None, None])
    course = dead_zone.bridge_passes(model, one, toward)
    assert np.linalg.norm(course - hidden) < 0.05 * np.linalg.norm(hidden)


def test_a_zone_of_hundreds_of_sigmas_is_named_with_its_size(wide):
    found = diagnose(wide, library=[EFFECT.name, "scale_asymmetry", "bias_drift", "bias_random_walk"])
    assert [(one.effect, one.axis) for one in found.causes] == [(EFFECT.name, "x")]
    assert found.verdict == "named"
    assert abs(found.causes[0].size - WIDE) < 3 * found.causes[0].sigma


@pytest.fixture(scope="module")
def passed(found):
    """A gyro of the same recording that is seen to read zero below 0.02 deg/s, which its body passes in every slew."""
    zone = Zone(0.02 * DEG, 0.0006 * DEG, 8.0, np.abs(found.samples.rates[:, 2]) < 0.012 * DEG)
    return replace(found, dead=(convert_zone(2, zone),))
