"""R's data beside Table 3 in its linear model: what R prints, signs, slips and rivals on made-up windows."""

import numpy as np
import pandas as pd
import pytest

from studies.robertson import all_data, diagnosis, ladder
from studies.robertson.calendar import PERIODS
from studies.robertson.further import NAMES
from studies.robertson.windows import simulated
from tests.studies.robertson.test_ground import windows_of

SIGMA = np.array([0.02, 0.01, 0.04, 0.01, 0.01, 0.005, 30.0, 90.0, 60.0, 140.0])


@pytest.fixture
def made(monkeypatch):
    """Windows without any difference to the flight, and R's other data as printed but for c of DSS-1, ten times as large."""
    base = windows_of({}).assign(forward=["+x", "-x"] * 18)
    windows = dict.fromkeys([one.setting for one in diagnosis.TRIALS if one.setting] + [ladder.NOMINAL], base)
    windows |= dict.fromkeys([rung.effects for rung in ladder.RUNGS], base)
    planted = simulated(base)
    monkeypatch.setattr(diagnosis, "published", lambda: planted)
    monkeypatch.setattr(all_data, "sigmas", lambda _: SIGMA)
    values = dict(zip(NAMES, all_data.observed(), strict=True))
    values["c_1_1e6"] *= 10.0
    return windows, dict.fromkeys(windows, values)


def test_r_prints():
    change, turn, coefficients = np.split(all_data.observed(), [3, 6])
    np.testing.assert_allclose(change, [0.254215, 0.004945, -0.05231], atol=1e-9)
    np.testing.assert_allclose(turn, np.rad2deg([-0.00273, -0.00199, 0.00199]), atol=1e-3)
    np.testing.assert_allclose(coefficients, [47.0, 85.0, -23.0, 53.0], atol=1e-6)


def test_a_slipped_zero_is_named_and_nothing_else(made):
    found = all_data.diagnose(*made)
    likely = {label: p for label, p in found.probabilities.items() if p > 0.3}
    assert list(likely) == ["slipped zeros:c_1_1e6"]
    assert found.fitted[0].parameters["slip"] == 10.0
    assert len(found.left) == 28
    assert np.abs(found.left).max() < 0.5


def test_a_difference_in_a_block_is_unknown(made):
    windows, further = made
    values = dict(further[ladder.NOMINAL]) | {"c_1_1e6": 47.0, "m_x_deg": 0.2, "m_y_deg": 0.1, "m_z_deg": -0.2}
    found = all_data.diagnose(windows, dict.fromkeys(windows, values))
    assert found.attribution.unknown > 0.9
    assert max(found.probabilities, key=found.probabilities.get) == "unknown in data beside:R (3)"


def test_signs_weigh_what_turns_them_round():
    rng = np.random.default_rng(2)
    rows = pd.DataFrame({"period": PERIODS[1], "forward": ["+x", "-x"] * 20})
    size = np.where(rows["forward"] == "-x", 0.10, 0.05) * (1 + 0.05 * rng.standard_normal(40))
    rows = rows.assign(yaw_update_deg=size, onboard_minus_ground_yaw_deg=size)
    ratio, sigma = all_data.signs(rows)["yaw update"]
    assert ratio == pytest.approx(np.log(2.0), abs=4 * sigma)
    assert sigma == pytest.approx(0.05 * np.sqrt(2 / 20), rel=0.3)
    assert all_data.sign_evidence(rows) == pytest.approx(0.0, abs=1e-6)
    turned = rows.assign(forward=rows["forward"].map({"+x": "-x", "-x": "+x"}))
    assert all_data.sign_evidence(turned) < -100.0


def test_tables_have_every_rung_number_and_cause(made):
    windows, further = made
    rungs, numbers = all_data.rungs_table(windows, further), all_data.numbers_table(further)
    assert rungs["effect"].tolist() == [rung.name for rung in ladder.RUNGS]
    assert rungs["R Table 2 rms deg"].max() == 0.0
    assert rungs["R (6) rms 1e6"].to_numpy() == pytest.approx(9 * 47.0 / 2)
    assert numbers["number"].tolist() == list(NAMES)
    together = all_data.diagnose(windows, further)
    table = all_data.probabilities_table(diagnosis.diagnose(windows), together).set_index("cause")
    assert table.loc["slipped zeros:c_1_1e6", "all_data"] > 0.5
    assert np.isnan(table.loc["slipped zeros:c_1_1e6", "table_3"])
