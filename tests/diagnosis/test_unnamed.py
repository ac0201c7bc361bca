"""Errors that the simulator makes and a diagnosis never names: a gap is seen, and no other effect is stated for it."""

import pytest

from diagnosis.diagnose import diagnose
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import QUICK, recorded


@pytest.mark.parametrize("text", ["rate_deadzone:z=9e-4"])
def test_a_simulated_error_without_a_name_is_a_gap_without_a_cause(text):
    assert not EFFECTS[text.partition(":")[0]].is_nameable
    found = diagnose(recorded(4, text, sample_s=0.5, every_s=60.0), settings=QUICK)
    assert found.present
    assert [one for one in found.causes if one.probability > QUICK.named] == []
