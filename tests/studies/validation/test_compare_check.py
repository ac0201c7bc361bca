"""`gyrocal study compare`: its cases, and a report that tells percentiles and intervals that hold from those that do not."""

import numpy as np
import pandas as pd
import pytest

from studies.montecarlo.study import Streams
from studies.validation.world import compare_check as check
from studies.validation.world.compare_check import PERCENTILES, CompareConfig

SMALL = {"cases": 4, "controls": 1, "flights": 20}


def rows(pairs, rng, shrink=1.0, percentile=None):
    """Made-up rows of pairs whose shrinkage is estimated with sigma 0.1, an interval of `shrink` times the right width."""
    estimate = 1 + 0.1 * rng.standard_normal(pairs)
    half = 1.645 * 0.1 * shrink
    table = pd.DataFrame(
        {
            "case": np.arange(pairs),
            "kind": "pair",
            "effect": "bias_drift:x",
            "tries": 1,
            "before": 0.5,
            "after": 0.0,
            "shrinkage": estimate,
            "shrinkage_low": estimate - half,
            "shrinkage_high": estimate + half,
            "true_shrinkage": 1.0,
        }
    )
    for name in PERCENTILES:
        table[name] = rng.random(pairs) if percentile is None else percentile(rng, pairs)
    return table


def verdicts(table):
    return {one.name: one.verdict for one in check.report(CompareConfig(), table).checks if one.verdict != "note"}


def test_percentiles_and_intervals_that_hold_pass():
    assert set(verdicts(rows(400, np.random.default_rng(1))).values()) == {"pass"}


@pytest.mark.parametrize(
    "percentile",
    [
        pytest.param(lambda rng, n: 0.3 + 0.4 * rng.random(n), id="fitted twice"),
        pytest.param(lambda rng, n: rng.random(n) ** 2, id="biased"),
    ],
)
def test_percentiles_that_are_not_uniform_fail(percentile):
    found = verdicts(rows(100, np.random.default_rng(2), percentile=percentile))
    assert sum(verdict == "fail" for verdict in found.values()) == len(PERCENTILES)


@pytest.mark.parametrize("shrink", [0.5, 2.0])
def test_intervals_of_another_width_fail(shrink):
    found = verdicts(rows(200, np.random.default_rng(3), shrink=shrink))
    assert [verdict for name, verdict in found.items() if "interval" in name] == ["fail"]


def test_unbounded_intervals_are_counted_apart():
    table = rows(50, np.random.default_rng(4))
    table.loc[:9, ["shrinkage_low", "shrinkage_high"]] = [-np.inf, np.inf]
    report = check.report(CompareConfig(), table)
    assert report.check("pairs without a gap in the attitude, unbounded interval").value == 10
    assert any("of 40" in one.name for one in report.checks)


def test_a_pair_and_a_control():
    config = CompareConfig(**SMALL)
    pair = check.case(config, 1, Streams(config.entropy, 1))  # the first draw of this one is named
    again = check.case(config, 1, Streams(config.entropy, 1))
    pd.testing.assert_series_equal(pd.Series(pair), pd.Series(again))
    assert pair["kind"] == "pair"
    assert np.isfinite(pair["true_shrinkage"])
    control = check.case(config, 2, Streams(config.entropy, 2))
    assert control["kind"] == "M0, slews_and_rests"
    assert 0 <= control["samples lag-1 correlation z"] <= 1  # the samples are looked at
