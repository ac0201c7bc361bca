"""Scores of the blind check on answers and results made by hand, against numbers counted by hand."""

from typing import Any

import numpy as np
import pandas as pd
import pytest

from diagnosis.model.linearise import linearised
from gyrocal import calibrate
from simulator.effects import Setting
from simulator.scenario import load, override
from simulator.simulate import simulate
from studies.montecarlo.statistics import binomial_interval
from studies.validation.blind_check.reach import true_closed
from studies.validation.blind_check.score import case_row, merged, reliability, scored


def effect(name: str, axis: str | None, size: float = 1.0, snr: float | None = 10.0, **parameters: object) -> dict[str, Any]:
    return {"effect": name, "axis": axis, "size": size, "parameters": parameters, "snr": snr, "separate_snr": snr}


def answer(kind: str, *effects: dict[str, Any], unlisted: dict[str, Any] | None = None) -> dict[str, Any]:
    return {"case": 0, "kind": kind, "effects": list(effects), "unlisted": unlisted, "true_G": np.eye(3).tolist()}


def cause(name: str, axis: str | None, probability: float = 0.99, size: float = 1.0, *others: str) -> dict[str, Any]:
    own = name if axis is None else f"{name}:{axis}"
    return {
        "effect": name, "axis": axis, "size": size, "sigma": 0.1, "parameters": {}, "probability": probability,
        "group": [own, *others],
    }  # fmt: skip


def result(verdict: str, *causes: dict[str, Any], closed: float | None = None) -> dict[str, Any]:
    numbers = {"G": (np.eye(3) + 1e-5).tolist(), "baseline_G": (np.eye(3) + 4e-5).tolist()}
    return {
        "error": "",
        "diagnosis": {
            "verdict": verdict,
            "gap": {"present": verdict != "none"},
            "causes": list(causes),
            "unknown_probability": 1.0 if verdict == "unknown" else 0.0,
            "closure": None if closed is None else {"closed": closed},
            "calibration": numbers,
            "runtime_s": 2.0,
        },
    }


ODD = {"effect": "chirp", "axis": "x", "size": 1.0, "snr": 15.0, "novelty": 9.0}
DRIFT = effect("bias_drift", "z")
CASES = [
    (answer("none"), result("none")),
    (answer("none"), result("named", cause("spikes", None))),  # a false alarm
    (answer("one", DRIFT), result("named", cause("bias_drift", "z", 0.99, 1.2))),  # two sigma off
    (answer("one", DRIFT), result("named", cause("bias_drift", "z", 0.97, 1.5))),  # five
    (answer("one", DRIFT), result("group", cause("bias_step", "z", 0.60, 1.0, "bias_drift:z"))),
    (answer("one", DRIFT), result("named", cause("bias_step", "x", 0.96))),  # wrong
    (answer("one", effect("bias_drift", "z", snr=5.0)), result("none")),
    (answer("one", effect("vibration", "y", snr=None)), result("named", cause("vibration", "y"))),
    (answer("two", DRIFT, effect("rate_lag", None)), result("named", cause("rate_lag", None), cause("bias_drift", "z"))),
    (answer("two", DRIFT, effect("rate_lag", None)), result("named", cause("bias_drift", "z"))),  # one of two
    (answer("unlisted", unlisted=ODD), result("unknown")),
    (answer("unlisted", unlisted=ODD), result("named", cause("bias_orbital", "x"))),  # wrong
    (answer("unlisted", unlisted=ODD | {"snr": 5.0}), result("none")),
    (answer("withheld", DRIFT), result("unknown")),
]


@pytest.fixture(scope="module")
def rows() -> pd.DataFrame:
    return pd.DataFrame([case_row(one, said) | {"case": number} for number, (one, said) in enumerate(CASES)])


def test_rates_are_those_counted_by_hand(rows: pd.DataFrame) -> None:
    table = scored(rows).table.set_index("what")
    expected = {
        "false alarm, nothing there": (1, 2),
        "single, SNR ≥ 8: detected": (4, 4),
        "single, SNR ≥ 8: cause and axis exact": (2, 4),
        "single, SNR ≥ 8: cause exact or in group": (3, 4),
        "single, SNR ≥ 8: axis": (3, 4),
        "single, SNR ≥ 8: confident wrong name": (1, 4),
        "single, SNR < 8: detected": (0, 1),
        "single, seen in the samples: cause and axis exact": (1, 1),
        "pair: exact": (1, 2),
        "pair: at least one of the two": (2, 2),
        "pair: confident wrong name": (0, 2),
        "unlisted: unknown": (1, 3),
        "unlisted: confident wrong name": (1, 3),
        "unlisted, SNR ≥ 12: unknown": (1, 2),
        "withheld: unknown": (1, 1),
        "wrong, of all named": (3, 8),
        "size within 3 sigma, of named and right": (5, 6),
    }
    for what, (hits, of) in expected.items():
        row = table.loc[what]
        assert (row["hits"], row["of"]) == (hits, of), what
        assert row["value"] == hits / of
        assert (row["low"], row["high"]) == binomial_interval(hits, of)


def test_criteria_are_met_or_not(rows: pd.DataFrame) -> None:
    met = scored(rows).criteria.set_index("criterion")["met"]
    assert met["false alarms"] == "no"
    assert met["withheld: confident wrong name"] == "yes"
    assert met["pairs exact"] == "no"


def test_few_cases_without_a_false_alarm_do_not_meet_the_upper_bound() -> None:
    quiet = pd.DataFrame([case_row(answer("none"), result("none"))] * 50)
    assert scored(quiet).criteria["met"].tolist() == ["no"]  # 0 of 50: up to 7 %
    quiet = pd.DataFrame([case_row(answer("none"), result("none"))] * 80)
    assert scored(quiet).criteria["met"].tolist() == ["yes"]


def test_confusion_and_effects(rows: pd.DataFrame) -> None:
    made = scored(rows)
    counted = made.confusion.set_index(["kind", "truth", "said"])["cases"]
    assert counted["one", "bias_drift", "bias_drift"] == 2
    assert counted["none", "nothing", "spikes"] == 1
    assert counted["two", "bias_drift + rate_lag", "bias_drift + rate_lag"] == 1
    assert counted.sum() == len(CASES)
    drift = made.by_effect.set_index(["kind", "effect"]).loc[("one", "bias_drift")]
    assert drift[["cases", "detected", "exact", "exact or in group", "wrong name"]].tolist() == [5, 4, 2, 3, 1]
    assert drift["size off by sigma, rms"] == pytest.approx(np.sqrt((2**2 + 5**2) / 2))


def test_by_snr_counts_each_bin(rows: pd.DataFrame) -> None:
    table = scored(rows).by_snr.set_index(["kind", "snr_from", "what"])
    assert table.loc[("one", 8.0, "detected"), ["hits", "of"]].tolist() == [4, 4]
    assert table.loc[("one", 4.0, "detected"), ["hits", "of"]].tolist() == [0, 1]
    assert table.loc[("unlisted", 12.0, "unknown"), ["hits", "of"]].tolist() == [1, 2]


def test_a_failed_case_is_not_counted(rows: pd.DataFrame) -> None:
    failed = case_row(answer("one", DRIFT), {"error": "ValueError: no"})
    made = scored(pd.concat([rows, pd.DataFrame([failed])], ignore_index=True))
    pd.testing.assert_frame_equal(made.table, scored(rows).table)


def test_closure_is_compared_with_that_of_the_truth() -> None:
    strong = effect("bias_drift", "z", snr=20.0)
    pairs = [(0.9, 1.0), (0.8, 0.8)]
    made = [case_row(answer("one", strong), result("named", cause("bias_drift", "z"), closed=c), t) for c, t in pairs]
    row = scored(pd.DataFrame(made)).criteria.set_index("criterion").loc["closure over that of the true model, named, SNR ≥ 12"]
    assert row["value"] == pytest.approx(1.7 / 1.8)
    assert row["met"] == "yes"


def test_a_step_towards_another_axis_has_no_size_to_compare() -> None:
    true = effect("g_matrix_step", "z", toward="y")
    same, other = cause("g_matrix_step", "z"), cause("g_matrix_step", "z")
    same["parameters"], other["parameters"] = {"toward": "y"}, {"toward": "x"}
    assert case_row(answer("one", true), result("named", same))["size_sigmas"] == [0.0]
    assert case_row(answer("one", true), result("named", other))["size_sigmas"] == []


def test_an_effect_named_on_every_axis_is_that_on_all() -> None:
    whole = merged([cause("noise_excess", axis) for axis in "xyz"])
    assert [(one["effect"], one["axis"]) for one in whole] == [("noise_excess", None)]
    apart = merged([cause("bias_drift", axis) for axis in "xyz"])
    assert len(apart) == 3  # which has no form for all axes
    assert case_row(answer("one", effect("noise_excess", None)), result("named", *whole))["exact"]


def test_reliability_bins_are_counted_by_hand() -> None:
    table = reliability([(0.96, True), (0.97, False), (1.0, True), (0.3, False)])
    assert table["of"].tolist() == [1, 2, 1]
    assert table["frequency"].tolist() == [0.0, 0.5, 1.0]
    assert table["stated"].tolist() == pytest.approx([0.3, 0.965, 1.0])


def test_the_truth_closes_the_gap_and_nothing_closes_nothing() -> None:
    base = override(load("trmm_series"), {"gyro.sample_s": 4.0, "reference.every_s": 120.0})
    strong = [Setting("bias_orbital", "y", 1.0, {"phase_deg": 30.0})]
    recording = simulate(base, 3, effects=strong)
    found = calibrate(recording)
    model = linearised(recording, found.G, found.bias)
    response = (
        linearised(simulate(base, 3, noise=False, effects=strong), found.G, found.bias).zeta
        - linearised(simulate(base, 3, noise=False), found.G, found.bias).zeta
    )
    assert true_closed(model, response) == pytest.approx(1.0, abs=0.02)
    assert true_closed(model, 0 * response) == 0.0
    assert true_closed(model, 0.5 * response) == pytest.approx(0.75, abs=0.02)
