"""The bound on what may shake the spacecraft: closed forms against a flight, and the sizes that use up R's limit."""

import pytest

from studies.robertson import stability


@pytest.mark.parametrize(("name", "size"), [("instrument scan", 2.0), ("array steps", 0.3), ("wheel imbalance", 1e-3)])
def test_the_size_of_the_limit_gives_the_limit(name, size):
    bound = stability._compute_limit_size(name, size, 0.1)
    assert stability.compute_peak_to_peak(name, bound["size_of_limit"]) == pytest.approx(0.1)
    assert bound["size_of_limit"] == pytest.approx(stability._compute_limit_size(name, 2 * size, 0.1)["size_of_limit"])


def test_a_scan_is_flown_as_large_as_its_closed_form(monkeypatch):
    """A second holds half of its period of 1.9 s: the whole swing; samples a quarter second apart see most of it."""
    monkeypatch.setattr(stability, "SIMULATED_ORBITS", 2.0)  # the first has the start in it
    alone = stability.compute_peak_to_peak("instrument scan", 40.0)
    with_it = stability.simulate_jitter(("scan_torque", 40.0), 0.25, 3)
    # The wheels' controller and the cycle's mean of the torque change it by a few percent; about x by the smaller 1/I.
    assert with_it["pitch_deg"] == pytest.approx(alone, rel=0.15)
    assert with_it["roll_deg"] == pytest.approx(alone * 6000.0 / 8500.0, rel=0.15)
