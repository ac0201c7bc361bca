"""Errors that the simulator makes and a diagnosis never names: a gap is seen, and no other effect is stated for it."""

import numpy as np
import pytest

from diagnosis.diagnose import diagnose
from diagnosis.model.prepare import prepare
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import QUICK, of_rates, recorded


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
