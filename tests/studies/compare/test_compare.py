from dataclasses import replace

import numpy as np
import pytest

from diagnosis.adopt import adopt_causes
from diagnosis.diagnose import diagnose
from gyrocal import calibrate
from simulator.adopted_scenario import AdoptedScenario, ReplayPlan
from simulator.effects import parse
from studies.compare.compare import compare
from studies.compare.measure import MeasurementSetup
from studies.compare.prepared_scenario import PreparedScenario
from tests.diagnosis import recordings

ORBITAL = "bias_orbital:z=0.3,phase_deg=60"


def recorded(seed):
    return recordings.recorded(seed, ORBITAL, sample_s=4.0)


@pytest.fixture(scope="module")
def orbital():
    """A recording with an effect, and the scenario that its diagnosis stands for."""
    recording = recorded(5)
    found = diagnose(recording, library=["bias_orbital"])
    adoption = adopt_causes(found)
    return recording, AdoptedScenario(
        "adopted", ReplayPlan(recording, found.G, found.bias), adoption.effects, adoption.covariance
    )


def test_an_adopted_effect_closes_the_gap_beside_parameters_that_are_not_judged(orbital):
    recording, scenario = orbital
    compared = compare(recording, [("adopted", scenario)], runs=60, seed=1)
    gap = compared.standings[1].gap
    assert gap.before_90[0] > 0
    assert gap.after_90[0] <= 0 <= gap.after_90[1]
    assert gap.shrinkage_90[0] <= 1 <= gap.shrinkage_90[1]
    assert compared.standings[0].extreme[0] > 10
    assert compared.standings[1].extreme[0] < 5
    table = compared.standings[1].statistics
    assert not table.loc[table["statistic"] == "parameter", "judged"].any()
    assert table.loc[table["statistic"] != "parameter", "judged"].mean() > 0.9


def test_of_another_recording_the_parameters_are_judged(orbital):
    # The next recording of the unit, flown with what the first has shown: predicted before it is looked at.
    _, scenario = orbital
    following = recorded(6)
    standing = compare(following, [("predicted", scenario)], runs=60, seed=2).standings[1]
    assert not standing.fitted
    table = standing.statistics
    assert table.loc[table["statistic"] == "parameter", "judged"].all()
    half = 0.5 * (standing.gap.after_90[1] - standing.gap.after_90[0])
    assert abs(standing.gap.after) < 4 / 1.645 * half
    assert standing.gap.after < 0.3 * standing.gap.before


@pytest.mark.parametrize("effect", [ORBITAL, "time_offset=0.4", "reference_orbital:x=0.02"])
def test_the_response_taken_out_leaves_the_flight_without_the_effect(orbital, effect):
    recording, scenario = orbital
    one = replace(scenario, effects=(parse(effect),), covariance=None)
    prepared = PreparedScenario.build(one, recording, MeasurementSetup.build(recording, calibrate(recording).parameters), "one")
    left, without = prepared.stated.subtract_from(one.fly(3, 1)), one.fly(3, 1, effects=())
    np.testing.assert_allclose(left.gyro.rates, without.gyro.rates, rtol=0, atol=1e-15)
    # The reference's error turns a noisy attitude in place of the true one: a product of the two.
    np.testing.assert_allclose(left.attitudes.quaternions, without.attitudes.quaternions, rtol=0, atol=1e-7)
    assert prepared.setup.misfit(left) == pytest.approx(prepared.setup.misfit(without), abs=1e-4)


def test_fitted_flights_lose_a_degree_of_freedom_for_each_amplitude(orbital):
    recording, scenario = orbital
    setup = MeasurementSetup.build(recording, calibrate(recording).parameters)
    prepared = PreparedScenario.build(scenario, recording, setup, "adopted")
    assert prepared.fitted
    assert prepared.W.shape[1] == 2
    dof = setup.degrees_of_freedom
    mean = np.mean([prepared.fly(4, case).under.mean_square for case in range(60)])
    assert mean == pytest.approx((dof - 2) / dof, abs=4 * np.sqrt(2 / dof / 60))
    # The posterior is that of least squares with a wide prior: tr(W C Wᵀ) is the number of amplitudes.
    assert prepared.size_error * dof == pytest.approx(2, rel=0.2)
