import pytest

from simulator import scenario as scenarios
from studies import psi_sweep

TRMM = scenarios.load("trmm")


def test_linear_psi_fails_first_at_high_rates_and_long_steps():
    table = psi_sweep.run(TRMM, (0.25, 2.0), (0.5, 4.0)).set_index(["slew_rate_deg_s", "step_s"])
    difference = table["G_difference"]
    assert difference[(0.25, 0.5)] < psi_sweep.GOOD_ENOUGH  # TRMM
    assert difference[(2.0, 4.0)] > psi_sweep.GOOD_ENOUGH
    # First order in |ω|Δt: eight times the rate times eight times the step.
    assert 5 < difference[(0.25, 4.0)] / difference[(0.25, 0.5)] < 11
    assert 5 < difference[(2.0, 0.5)] / difference[(0.25, 0.5)] < 20
    # Both converge to the same parameters; linear ψ takes longer.
    assert abs(table["linear_error_G"] - table["full_error_G"]).max() < 1e-7
    assert (table["linear_iterations"] >= table["full_iterations"]).all()


def test_slews_keep_their_angle_and_fit():
    flown = psi_sweep.with_slew_rate(TRMM, 0.1)
    for before, after in zip(TRMM.interval, flown.interval, strict=True):
        assert [slew.angle_deg for slew in before.slew] == [slew.angle_deg for slew in after.slew]
    slew = flown.interval[1].slew[0]
    assert abs(slew.angle_deg) / (slew.duration_s * (1 - slew.ramp_fraction)) == pytest.approx(0.1, rel=1e-12)
