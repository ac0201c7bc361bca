"""R's data beside Table 3 in its linear model: what R prints, signs, slips and rivals on made-up windows."""

import numpy as np
import pandas as pd
import pytest

from studies.robertson import combined_diagnosis, diagnosis, ladder, printed_coefficients
from studies.robertson.calendar import PERIODS
from studies.robertson.windows import compute_simulated_numbers
from tests.studies.robertson.test_ground import windows_of

SIGMA = np.array([0.02, 0.01, 0.04, 0.01, 0.01, 0.005])


@pytest.fixture
def made(monkeypatch):
    """Windows and other data without any difference to the flight."""
    base = windows_of({}).assign(forward=["+x", "-x"] * 18)
    windows = dict.fromkeys([one.setting for one in diagnosis.TRIED_EFFECTS if one.setting] + [ladder.NOMINAL], base)
    windows |= dict.fromkeys([rung.effects for rung in ladder.RUNGS], base)
    planted = compute_simulated_numbers(base)
    monkeypatch.setattr(diagnosis, "read_published_numbers", lambda: planted)
    monkeypatch.setattr(combined_diagnosis, "compute_observation_sigmas", lambda _: SIGMA)
    values = dict(zip(combined_diagnosis.COMPARED, combined_diagnosis.read_further_observations(), strict=True))
    return windows, dict.fromkeys(windows, values)


def test_r_prints():
    change, turn = np.split(combined_diagnosis.read_further_observations(), [3])
    np.testing.assert_allclose(change, [0.254215, 0.004945, -0.05231], atol=1e-9)
    np.testing.assert_allclose(turn, np.rad2deg([-0.00273, -0.00199, 0.00199]), atol=1e-3)
    np.testing.assert_allclose(printed_coefficients.read_printed_coefficients(), [47.0, 85.0, -23.0, 53.0], atol=1e-6)


def test_a_difference_in_a_block_is_unknown_and_named_by_it(made):
    windows, further = made
    alike = combined_diagnosis.diagnose_all_data(windows, further)
    assert max(alike.probabilities.values(), default=0.0) < 0.5
    assert len(alike.left) == 24
    values = dict(further[ladder.NOMINAL]) | {"m_x_deg": 0.2, "m_y_deg": 0.1, "m_z_deg": -0.2}
    found = combined_diagnosis.diagnose_all_data(windows, dict.fromkeys(windows, values))
    assert found.attribution.unknown > 0.9
    assert max(found.probabilities, key=found.probabilities.get) == "unknown in data beside:R (3)"


def test_level_boresights_speak_against_r6(made):
    """Raised, DSS-1's numbers are R's with a zero slipped in c; level, there is nothing to compensate that R could print."""
    raised, level = (
        printed_coefficients.build_reading_table(one).set_index("number") for one in (ladder.NOMINAL, ladder.LANDED)
    )
    assert raised.loc["c - 1 of DSS-1", "one_zero"] > 0.9
    assert raised.loc["d of DSS-1", "as_printed"] > 0.5
    assert raised.loc["d of DSS-2", "something_else"] > 0.5
    assert level.loc["c - 1 of DSS-1", "something_else"] > 0.9
    parts = raised[["as_printed", "one_zero", "two_zeros", "something_else"]].sum(axis=1)
    np.testing.assert_allclose(parts, 1.0, rtol=1e-12)
    apart = printed_coefficients.compute_coefficient_evidence(
        ladder.LANDED
    ) - printed_coefficients.compute_coefficient_evidence(ladder.NOMINAL)
    assert apart < -2.0
    model = diagnosis.build_performance_model(made[0], combined_diagnosis.build_further_observations(made[1]))
    odds = dict(
        zip([one.label for one in model.candidates], combined_diagnosis.compute_further_odds(model, made[0]), strict=True)
    )
    assert odds.get("boresights level", apart) == pytest.approx(apart)


def test_signs_weigh_what_turns_them_round():
    rng = np.random.default_rng(2)
    rows = pd.DataFrame({"period": PERIODS[1], "forward": ["+x", "-x"] * 20})
    size = np.where(rows["forward"] == "-x", 0.10, 0.05) * (1 + 0.05 * rng.standard_normal(40))
    rows = rows.assign(yaw_update_deg=size, onboard_minus_ground_yaw_deg=size)
    ratio, sigma = combined_diagnosis.compare_orientation_signs(rows)["yaw update"]
    assert ratio == pytest.approx(np.log(2.0), abs=4 * sigma)
    assert sigma == pytest.approx(0.05 * np.sqrt(2 / 20), rel=0.3)
    assert combined_diagnosis.compute_sign_evidence(rows) == pytest.approx(0.0, abs=1e-6)
    turned = rows.assign(forward=rows["forward"].map({"+x": "-x", "-x": "+x"}))
    assert combined_diagnosis.compute_sign_evidence(turned) < -100.0
