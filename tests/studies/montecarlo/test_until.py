import json
import math

import numpy as np
import pandas as pd
import pytest
import scipy.stats

from gyrocal.errors import InputError
from studies.montecarlo.criteria import FIRST, StoppingRule, list_checkpoints
from studies.montecarlo.engine import run
from tests.engine_studies import DRAWS, DrawsConfig


def rows(values, column="x") -> pd.DataFrame:
    return pd.DataFrame({"case": np.arange(len(values)), "error": "", column: values})


def test_a_criterion_is_read_and_what_is_none_is_refused():
    assert StoppingRule.parse("sigma_G_xx<1e-6") == StoppingRule("mean", "sigma_G_xx", 1e-6)
    assert StoppingRule.parse(" p95( disp:gyro.x ) < 0.5 ") == StoppingRule("p95", "disp:gyro.x", 0.5)
    for text in ("x", "x<0", "x<nan", "max(x)<1", "p00(x)<1"):
        with pytest.raises(InputError, match="give it as COLUMN<LIMIT"):
            StoppingRule.parse(text)


def test_half_widths_are_those_of_other_implementations():
    values = np.random.default_rng(1).gamma(2.0, size=300)
    table = rows(values)
    low, high = scipy.stats.t.interval(0.95, 299, values.mean(), scipy.stats.sem(values))
    assert StoppingRule("mean", "x", 1.0).half_width(table) == pytest.approx((high - low) / 2, rel=1e-12)
    for statistic, share in (("median", 0.5), ("p90", 0.9)):
        interval = scipy.stats.quantile_test(values, p=share).confidence_interval(0.95)
        assert StoppingRule(statistic, "x", 1.0).half_width(table) == pytest.approx(
            (interval.high - interval.low) / 2, rel=1e-12
        )
    good = rows(values > 1)
    interval = scipy.stats.binomtest(int((values > 1).sum()), 300).proportion_ci(0.95, method="wilson")
    assert StoppingRule("mean", "x", 1.0).half_width(good) == pytest.approx((interval.high - interval.low) / 2, rel=1e-9)


@pytest.mark.parametrize("statistic", ["std", "p90"])
def test_intervals_of_that_half_width_cover(statistic):
    rng = np.random.default_rng(5)
    truth = {"std": 1.0, "p90": math.log(10)}[statistic]  # of the exponential distribution
    point = {"std": lambda y: np.std(y, ddof=1), "p90": lambda y: np.quantile(y, 0.9)}
    tries, covered = 150, 0
    for _ in range(tries):
        values = rng.exponential(size=400)
        covered += abs(point[statistic](values) - truth) <= StoppingRule(statistic, "x", 1.0).half_width(rows(values))
    # Of 93 % or more, fewer than 126 of 150 with less than 1e-4; a quantile's interval is not centred on its estimate.
    assert covered >= 126


def test_too_few_odd_or_absent_values_are_never_enough(tmp_path):
    for values in ([], [1.0], [1.0, math.inf, 2.0]):
        assert StoppingRule("mean", "x", 1.0).half_width(rows(values)) == math.inf
    assert StoppingRule("p99", "x", 1.0).half_width(rows(np.arange(50.0))) == math.inf
    # None of sixty-four failed: the share is not known to be nothing.
    assert StoppingRule("mean", "failed", 1.0).half_width(rows(np.zeros(64))) == pytest.approx(0.028, abs=0.001)
    with pytest.raises(InputError, match="holds no numbers"):
        StoppingRule("mean", "x", 1.0).half_width(rows(["a", "b"]))
    with pytest.raises(InputError, match="gyr: the rows have no such column; did you mean gyro"):
        run(DRAWS, DrawsConfig(cases=70, size=3), tmp_path, backend="serial", until=StoppingRule("mean", "gyr", 0.1))


def test_a_study_stops_when_it_has_enough(tmp_path):
    config = DrawsConfig(cases=1000, size=3, fail=(5,))

    def ask(limit):
        return run(DRAWS, config, tmp_path, backend="serial", until=StoppingRule("mean", "gyro", limit))

    first = ask(0.2)
    table = first.load()
    assert FIRST <= first.cases == len(table) < 300
    enough = StoppingRule("mean", "gyro", 0.2).half_width(table)
    assert enough < 0.2
    # It was not enough at the look before.
    before = max(count for count in list_checkpoints(1000, 8) if count < first.cases)
    assert StoppingRule("mean", "gyro", 0.2).half_width(table[table["case"] < before]) >= 0.2
    document = json.loads((tmp_path / "manifest.json").read_text())
    assert (document["cases"], document["done"], document["config"]["cases"]) == (first.cases, first.cases, 1000)
    assert (document["until"]["half_width"], document["until"]["met"]) == (enough, True)
    # Asked again it computes nothing, asked for more it goes on; the first rows stay.
    assert ask(0.2).resumed == first.cases
    more = ask(0.12)
    assert more.resumed == first.cases < more.cases
    assert more.load().head(first.cases).equals(table)
