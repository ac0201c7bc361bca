"""Scores of rows by hand, and the comparison of two runs."""

import json

import numpy as np
import pandas as pd
import pytest

from gyrocal.errors import InputError
from studies.withheld import score
from studies.withheld.cases import WithheldConfig


def make_rows(probabilities, right, kind="single", outcome=None):
    """A case a statement."""
    rows = []
    for case, (p, hit) in enumerate(zip(probabilities, right, strict=True)):
        one = {"cause": "bias_step:x", "p": float(p), "named": True, "right": bool(hit), "in_set": True}
        one |= {"hits": [0] if hit else [], "near": [0]}
        truth = [{"effect": "bias_step", "axis": "x", "listed": True, "snr": 10.0}]
        row = {"case": case, "kind": kind, "plan": "walk", "grade": "phone", "effects": "bias_step:x", "snr": 10.0 + case % 40}
        row |= {"snr_attitude": 10.0, "snr_samples": 0.0, "outcome": outcome or ("right" if hit else "wrong"), "said": "x"}
        row |= {"statements": json.dumps([one]), "truth": json.dumps(truth), "size_sigmas": "[0.5, -1.5]"}
        row |= {"truth_score": 0.0, "closed": 0.9, "closed_low": 0.8, "closed_high": 1.0, "true_closed": 0.95, "error": ""}
        rows.append(row | {"make_s": 1.0, "diagnose_s": 10.0, "peak_mb": 300.0})
    return pd.DataFrame(rows)


def draw_rows(bias=0.0, count=400):
    """Statements that are right as often as they say, or less often."""
    rng = np.random.default_rng(1)
    p = rng.uniform(0.5, 0.99, count)
    return make_rows(p, rng.random(count) < p - bias)


def test_calibrated_and_over_confident_statements():
    fair, bold = (score.score_statements(score.collect_statements(draw_rows(bias))).iloc[2] for bias in (0.0, 0.15))
    assert abs(fair["z"]) < 2
    assert bold["z"] < -4
    assert bold["log_score"] > fair["log_score"] + 2 * fair["log_score_se"]


def test_z_of_three_statements():
    rows = make_rows([0.9, 0.9, 0.6], [True, True, False])
    line = score.score_statements(score.collect_statements(rows)).iloc[2]
    assert line["z"] == pytest.approx((2 - 2.4) / np.sqrt(0.09 + 0.09 + 0.24))
    assert line["log_score"] == pytest.approx(-np.mean(np.log([0.9, 0.9, 0.4])))


def test_rates():
    rates = score.compute_rates(draw_rows()).set_index("what")
    single = rates.loc["one listed effect of SNR 8 and more: right"]
    assert single["cases"] == 400
    assert single["low"] < single["share"] < single["high"]
    assert rates.loc["sizes within 1 sigma", "share"] == pytest.approx(0.5)
    assert rates.loc["90 % interval of the share closed holds the true share", "share"] == 1
    withheld = score.compute_rates(make_rows([0.95, 0.95], [False, False], "withheld", "localised")).set_index("what")
    assert withheld.loc["withheld, SNR 8 and more: localised or unknown", "hits"] == 2
    assert withheld.loc["withheld: a wrong name at 0.9 and more", "hits"] == 2


def test_two_runs():
    before = make_rows([0.9] * 20, [True] * 10 + [False] * 10)
    after = make_rows([0.9] * 20, [False] + [True] * 19)
    line = score.compare_runs(before, after.assign(diagnose_s=5.0)).iloc[0]
    assert (line["gained"], line["lost"], line["seconds_ratio"]) == (10, 1, 0.5)
    assert line["p"] == pytest.approx(24 / 2**11)
    with pytest.raises(InputError, match="not of the same cases"):
        score.compare_runs(before, after.assign(effects="bias_drift:y"))


def test_report(tmp_path):
    rows = draw_rows(count=30)
    rows.to_parquet(tmp_path / "before.parquet")
    made = score.report(WithheldConfig(cases=31, compare=str(tmp_path / "before.parquet")), rows)
    assert set(made.tables) == {"statements", "rates", "compare"}
    assert set(made.figures) == {"found", "stated"}
    assert made.check("cases whose diagnosis failed").value == 1
    for name, draw in made.figures.items():
        draw(tmp_path / f"{name}.svg")
    with pytest.raises(InputError, match="cannot be read"):
        score.read_run(tmp_path / "nowhere.parquet")


def test_report_of_no_effect():
    rows = make_rows([0.9], [True], "none").assign(statements="[]", size_sigmas="[]", truth="[]", true_closed=np.nan)
    assert score.report(WithheldConfig(cases=1), rows).tables["statements"].data["causes"].tolist() == [0, 0, 0, 0]
