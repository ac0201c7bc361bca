"""Effects that follow housekeeping: accelerations and temperatures, by their equation, sign and need of a column."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import simulator
from diagnosis.diagnose import diagnose
from simulator.effects import EFFECTS, extract_stream, extract_surroundings, parse
from simulator.effects.housekeeping_columns import STANDARD_GRAVITY
from simulator.effects.recording_view import interpolate_housekeeping
from tests.simulator.effects.test_clock import agile, sparse
from tests.simulator.effects.test_effects import ACCELERATIONS, PLAIN

LIBRARY = ("acceleration_sensitivity", "g_matrix_temperature", "bias_temperature", "bias_drift", "bias_step", "scale_asymmetry")


def test_accelerations_are_those_of_a_body_on_a_rate_table():
    """Standard gravity in any attitude, to five sigma of the noise of 0.01 m/s² about each axis."""
    table = ACCELERATIONS.tables["housekeeping"]
    norm = np.linalg.norm(table[[f"gyro_acceleration_{k}_m_s2" for k in "xyz"]].to_numpy(), axis=1)
    np.testing.assert_allclose(norm, STANDARD_GRAVITY, atol=0.05)


@pytest.mark.parametrize("name", ["acceleration_sensitivity", "g_matrix_temperature"])
def test_without_its_column_it_is_no_candidate(name):
    recording = simulator.simulate(agile(), seed=1)
    around = extract_surroundings(recording, recording.gyro.apriori_G, recording.gyro.apriori_bias)
    assert "no housekeeping column" in EFFECTS[name].missing(around)


@pytest.mark.parametrize("filler", [1e300, np.inf, np.nan])
def test_housekeeping_is_read_in_order_of_time_and_without_fillers(filler):
    t_s = np.arange(1000.0, -1.0, -10.0)
    table = pd.DataFrame(
        {"t_s": t_s, "gyro_temperature_c": np.where(t_s == 500.0, filler, 20.0 + 0.01 * t_s), "mode": "nominal"}
    )
    found = interpolate_housekeeping(replace(PLAIN, tables={"housekeeping": table}), np.array([100.0, 503.0]))
    assert found.keys() == {"gyro_temperature_c"}
    np.testing.assert_allclose(found["gyro_temperature_c"], [21.0, 25.03])


def warmed(size):
    """A recording whose temperature rises and falls by 3 K in 370 s each, so that no drift and no orbit looks like it."""
    recording = simulator.simulate(sparse(), seed=4)
    t_s = np.arange(0.0, 1501.0, 10.0)
    table = pd.DataFrame({"t_s": t_s, "gyro_temperature_c": 20 + 3 * np.abs(t_s / 370 % 2 - 1)})
    recording = replace(recording, tables={"housekeeping": table})
    stream = extract_stream(recording, recording.gyro.apriori_G, recording.gyro.apriori_bias)
    column = EFFECTS["g_matrix_temperature"].columns(stream, "z", {"toward": "z"})[:, :, 0]
    return replace(recording, gyro=replace(recording.gyro, rates=recording.gyro.rates + size * column))


@pytest.mark.long
def test_a_diagnosis_names_a_sensitivity_to_acceleration():
    made = simulator.simulate(sparse(), seed=4, effects=[parse("acceleration_sensitivity:x=60,toward=y")])
    (cause,) = diagnose(made, library=LIBRARY).causes
    assert (cause.label, cause.parameters["toward"]) == ("acceleration_sensitivity:x", "y")
    assert cause.size == pytest.approx(60, rel=0.2)


@pytest.mark.long
def test_a_diagnosis_names_a_matrix_that_follows_temperature():
    (cause,) = diagnose(warmed(2000.0), library=LIBRARY).causes
    assert (cause.label, cause.parameters["toward"]) == ("g_matrix_temperature:z", "z")
    assert cause.size == pytest.approx(2000, rel=0.2)


@pytest.mark.long
def test_a_temperature_that_changes_is_no_cause_by_itself():
    """Negative control."""
    assert diagnose(warmed(0.0)).causes == ()
