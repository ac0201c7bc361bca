"""Scores of the test world against closed forms."""

import json

import numpy as np
import pandas as pd
import pytest

from studies.validation.world import score


def row(kind, outcome, effects="", **changes):
    """A row of the study with what a score needs."""
    values = {
        "kind": kind, "outcome": outcome, "effects": effects, "verdict": "named", "snr": 20.0, "probability": 0.9,
        "unknown_probability": 0.1, "causes": "[]", "p_values": '{"attitude": 0.5}', "posterior": "[]", "size_sigmas": "[]",
        "plan": "a", "grade": "b", "attitude_snr": 20.0, "calibration_sigmas": "[]",
        "closed_low": np.nan, "closed_high": np.nan, "true_closed": np.nan,
        "truth": json.dumps([truth(one) for one in effects.split(" + ") if one]),
    }  # fmt: skip
    return values | changes


def truth(label):
    """A listed effect of size 1, whatever its unit."""
    effect, _, axis = label.partition(":")
    return {"effect": effect, "axis": axis or None, "size": 1.0, "parameters": {}, "listed": True}


def cause(effect, axis, probability):
    return {"effect": effect, "axis": axis, "probability": probability, "group": [], "sigma": 0.0, "size": 1.0}


def test_rates_count_the_cases_they_are_of():
    rows = pd.DataFrame(
        [row("none", "right")] * 3
        + [row("none", "alarm"), row("single", "right", snr=6.0), row("single", "group"), row("single", "unknown")]
        + [row("unlisted", "missed", attitude_snr=0.1), row("unlisted", "unknown"), row("unlisted", "wrong name", snr=7.0)]
    )
    table = score.compute_outcome_rates(rows).set_index("what")
    assert table.loc["no effect: a false alarm", "share"] == 0.25
    assert table.loc["one effect: right or in the group", "count"] == 2
    assert table.loc["one effect of SNR 8 and more: right or in the group", "cases"] == 2
    assert table.loc["unlisted and detected: a confident wrong name", "share"] == 0.5
    assert table.loc["unlisted of SNR 12 and more: unknown", "cases"] == 2
    assert table.loc["unlisted of SNR 12 and more, detected: unknown", "share"] == 1
    assert table.loc["unlisted of SNR 12 and more in the attitude: unknown", "cases"] == 1
    groups = score.count_good_by_group(rows, "plan").set_index("kind")
    assert groups.loc["none", "share"] == 0.75
    assert groups.loc["unlisted", "wrong_names"] == 1


def test_rates_of_mixed_recordings():
    stated = json.dumps([cause("bias_drift", "x", 0.95), cause("bias_drift", "y", 0.95), cause("bias_drift", "z", 0.5)])
    budget = {"verdict": "partial", "causes": stated, "closed_low": 0.3, "closed_high": 0.5}
    rows = [
        row("mixed", "wrong name", "bias_drift:x", true_closed=0.4, **budget),
        row("mixed", "part", "bias_drift:x + bias_drift:y", true_closed=0.6, **budget),
        row("mixed", "unknown", "bias_drift:x", verdict="unknown"),
        row("single", "right", "bias_drift:x", causes=stated, closed_low=0.3, closed_high=0.5),
    ]
    table = score.compute_mixed_rates(pd.DataFrame(rows)).set_index("what")
    assert table["cases"].tolist() == [4, 3, 2]
    assert table["count"].tolist() == [3, 1, 1]


def test_reliability_of_statements():
    causes = json.dumps([cause("bias_drift", "x", 0.9), cause("bias_drift", "y", 0.5)])
    rows = pd.DataFrame([row("single", "right", "bias_drift:x", causes=causes), row("none", "right", verdict="none")])
    stated = score.collect_cause_statements(rows)
    assert stated["there"].tolist() == [True, False]
    assert score.compute_brier_score(stated) == pytest.approx(0.5 * (0.1**2 + 0.5**2))
    assert score.compute_calibration_error(score.compute_reliability(stated)) == pytest.approx(0.5 * (0.1 + 0.5))


def test_the_open_set_area_is_a_chance():
    rng = np.random.default_rng(1)
    a, b = rng.normal(1.0, 1, 60), rng.normal(0.0, 1, 50)
    right = rng.random(50) < 0.8
    assert score.compute_open_set_auc(a, b, right) == pytest.approx(np.mean(right[:, None] * (b[:, None] < a)))
    assert score.compute_open_set_auc(np.ones(3), np.ones(2), np.ones(2, bool)) == 0.5


def test_calibration_and_closure_count_rightly_answered_cases_only():
    sure = {"calibration_sigmas": json.dumps([0.5] * 11 + [3.0]), "closed_low": 0.8, "closed_high": 1.1}
    rows = pd.DataFrame(
        [row("single", "right", **sure)] * 12 + [row("single", "unknown", calibration_sigmas=json.dumps([9.0]))]
    )
    table = score.compute_outcome_rates(rows).set_index("what")
    assert table.loc["G and b within 1 sigma, answered rightly", ["count", "cases"]].tolist() == [11, 12]
    assert table.loc["right single cause: 90 % interval of the closure holds 1", ["count", "cases"]].tolist() == [12, 12]


def test_a_mixed_case_counts_its_listed_causes():
    named = json.dumps([cause("bias_drift", "x", 0.95), cause("bias_step", "y", 0.9)])
    rows = pd.DataFrame([row("mixed", "wrong name", "bias_drift:x", causes=named)])
    table = score.compute_outcome_rates(rows).set_index("what")
    assert table.loc["mixed: causes stated that are there", ["count", "cases"]].tolist() == [1, 2]
    assert table.loc["mixed: a confident wrong name", "count"] == 1
    assert score.label_truth(score.list_records(rows)[0]) == ("unknown",)


def test_sizes_within_their_sigmas_and_sets():
    errors = np.random.default_rng(2).standard_normal(4000)
    table = score.compute_size_coverage(errors).set_index("level")
    assert table.loc["68 %", "share"] == pytest.approx(0.6827, abs=4 * np.sqrt(0.22 / 4000))
    sure = json.dumps([{"effects": ["bias_drift:x"], "probability": 1.0}])
    open_ = json.dumps([{"effects": ["bias_drift:x"], "probability": 0.6}, {"effects": ["unknown"], "probability": 0.4}])
    rows = pd.DataFrame(
        [row("single", "right", "bias_drift:x", posterior=sure), row("unlisted", "group", "mine:x", posterior=open_)]
    )
    narrow, wide = (score.compute_set_coverage(rows, limit).iloc[0] for limit in (0.0, 0.5))
    assert (narrow["share"], narrow["mean_length"]) == (0.5, 1.0)
    assert (wide["share"], wide["mean_length"]) == (1.0, 1.5)


def test_sizes_that_are_read_off_the_samples_are_counted_apart():
    there = json.dumps([truth("rate_quantization:x")])

    def with_size(size, sigma):
        named = {**cause("rate_quantization", "x", 0.9), "size": size, "sigma": sigma, "parameters": {}}
        return row("single", "right", "rate_quantization:x", causes=json.dumps([named]), truth=there)

    rows = pd.DataFrame([with_size(1.0, 1e-6), with_size(1.2, 0.1), with_size(2.0, 0.1)])
    assert score.select_estimated_errors(rows) == pytest.approx([2.0, 10.0])
    table = score.build_size_coverage(rows).set_index(["sizes", "level"])
    assert table.loc[("read off the samples", "68 %"), "count"] == 1
    assert table.loc[("all", "99.7 %"), ["cases", "count"]].tolist() == [3, 2]
    assert table.loc[("estimated", "99.7 %"), ["cases", "count"]].tolist() == [2, 1]
    none = pd.DataFrame([row("none", "right", truth="[]")])
    assert score.select_estimated_errors(none).size == 0
