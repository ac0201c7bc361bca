"""What N's scenario leaves out: the drift's size, its parts, and the tables on few seeds."""

import numpy as np
import pytest

from simulator import adopted_scenario
from simulator import load as load_scenario
from studies.calibration.maneuvers_needed import select_intervals
from studies.natanson import drift, omitted_effects
from studies.robertson import published_tables

FLOWN = adopted_scenario.load(drift.SCENARIO)


def test_the_walks_scatter_as_r_says():
    """The variance of a Wiener process about its mean over a time T is K² T/6 on average: ∫∫ of min(s, t) over it."""
    hours = 61 * 24.0
    t = np.linspace(0.0, 1.0, 401)
    share = np.mean(t) - np.mean(np.minimum.outer(t, t))
    assert share == pytest.approx(1 / 6, rel=1e-2)
    for effect in FLOWN.effects:
        published = published_tables.read_published_performance("gyro_bias_std_deg_h", effect.axis, "postcalibration")
        assert effect.size * np.sqrt(hours / 6) == pytest.approx(published, rel=5e-3)
        assert effect.parameters["gaps"] == "grow"


def test_the_bias_moves_between_the_months():
    """K √T over 32 days for the last interval, three sigma; without drift the rates are those of trmm."""
    plain, moved = (FLOWN.fly(1, 0, effects) for effects in ([], list(FLOWN.effects)))
    apart = np.rad2deg(moved.gyro.rates - plain.gyro.rates) * 3600.0
    last = plain.gyro.t_s > plain.intervals[5].start_s
    for k, effect in enumerate(FLOWN.effects):
        sigma = effect.size * np.sqrt(plain.intervals[5].start_s / 3600.0)
        assert 1e-3 * sigma < abs(apart[last, k].mean()) < 3 * sigma
        within_first = np.abs(apart[plain.gyro.t_s < 6000.0, k]).max()
        assert within_first < 4 * effect.size * np.sqrt(6000.0 / 3600.0)


def test_a_drift_leaves_more_in_january():
    table = drift.build_drift_table(1998, seeds=6, scales=(0.0, 1.0)).set_index("scatter_of_R")
    assert table.loc[1.0, "six_january_deg"] > 1.5 * table.loc[0.0, "six_january_deg"]
    assert table.loc[0.0, "share_below_flight"] == 1.0
    # A December that fits twelve numbers by twelve parameters says little of January's, with a drift or without.
    assert table.loc[0.0, "december_january_deg"] > 3 * table.loc[0.0, "six_january_deg"]
    assert table.loc["flight", "six_january_deg"] == pytest.approx(0.0159, abs=1e-4)


def test_january_alone_is_a_recording():
    january = select_intervals(FLOWN.fly(1, 0, []), drift.JANUARY)
    assert [one.name for one in january.intervals] == ["m5", "m6"]
    assert len(january.attitudes.t_s) == 4


def test_packets_and_orbits_hardly_matter():
    """J2's turn of the node makes the rate about x of N Figure 3; rounding to 0.05 arcsec is far below the noise."""
    scenario = load_scenario("trmm")
    packets = omitted_effects.build_packet_table(scenario, 1).set_index("lsb_arcsec")
    assert packets.loc[0.05, "largest_change_sigma"] < 0.01 < packets.loc[3.2, "largest_change_sigma"]
    assert (packets["wraps"] > 10).all()
    np.testing.assert_allclose(packets["rate_rms_deg_s"][:2], packets.index[:2] / 3600 / np.sqrt(6) / 0.5, rtol=0.05)
