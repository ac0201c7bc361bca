import math

import numpy as np
import pytest
from scipy import integrate, optimize, stats

from gyrocal.errors import InputError
from studies.montecarlo.rare_event import RareLimit, estimate_rare_probability, run_rare_event
from tests.engine_studies import RARE, RareConfig

P = 1e-5


def exceed_parabola(limit: float) -> float:
    """P(z_1 + 0.3 z_2² > limit) by an integral over z_2."""
    return integrate.quad(lambda y: stats.norm.sf(limit - 0.3 * y**2) * stats.norm.pdf(y), -12, 12, points=[-5, 0, 5])[0]


PARABOLA = optimize.brentq(lambda x: math.log(exceed_parabola(x) / P), 4, 9)
# Excess over a limit that is passed with P in closed form, or by an integral.
CASES = {
    "linear": (2, lambda z: z.sum(axis=1) / math.sqrt(2) - stats.norm.isf(P)),
    "two regions": (2, lambda z: np.abs(z.sum(axis=1)) / math.sqrt(2) - stats.norm.isf(P / 2)),
    "two regions, far from alike": (2, lambda z: np.maximum(z[:, 0] - stats.norm.isf(P / 2), -stats.norm.isf(P / 2) - z[:, 1])),
    "chi square": (2, lambda z: (z**2).sum(axis=1) - stats.chi2(2).isf(P)),
    "sum of exponentials": (3, lambda z: -stats.norm.logsf(z).sum(axis=1) - stats.gamma(3).isf(P)),
    "parabola": (2, lambda z: z[:, 0] + 0.3 * z[:, 1] ** 2 - PARABOLA),
}


@pytest.mark.parametrize("name", CASES)
def test_probabilities_are_those_of_a_closed_form(name):
    pytest.importorskip("openturns", reason="the extra rare is not installed")
    dimensions, excess = CASES[name]
    calls = []

    def count(points):
        calls.append(len(points))
        return excess(points)

    probability, sigma, beyond = estimate_rare_probability(count, dimensions, 10_000, 1)
    exact = P if "alike" not in name else 1 - (1 - P / 2) ** 2
    assert sum(calls) == 10_000
    assert probability == pytest.approx(exact, rel=0.2)
    assert abs(probability - exact) < 4 * sigma < 0.8 * exact
    assert beyond > 500


def test_a_limit_out_of_reach_is_no_probability():
    pytest.importorskip("openturns", reason="the extra rare is not installed")
    probability, _, beyond = estimate_rare_probability(lambda z: np.tanh(z[:, 0]) - 2.0, 1, 2000, 1)
    assert math.isnan(probability)
    assert beyond == 0


DISPERSED = {f"gyro.true_bias_deg_s.{axis}": {"kind": "normal", "sigma": 1e-3} for axis in range(2)}


def test_a_study_with_correlated_dispersions_has_its_closed_form():
    pytest.importorskip("openturns", reason="the extra rare is not installed")
    joined = ({"paths": tuple(DISPERSED), "matrix": ((1.0, 0.5), (0.5, 1.0))},)
    config = RareConfig(dispersions=DISPERSED, correlations=joined)
    limit = 1e-3 * math.sqrt(3) * stats.norm.isf(P)  # of a sum with the variance 1 + 1 + 2 · 0.5
    found = run_rare_event(RARE, config, RareLimit("sum", ">", limit), 1000, "serial")
    assert found.runs == 1000
    assert found.probability == pytest.approx(P, rel=5 * found.standard_error / P)
    assert found.standard_error < 0.2 * P
    with pytest.raises(InputError, match="did you mean sum"):
        run_rare_event(RARE, config, RareLimit("sun", ">", limit), 1000, "serial")


def test_failed_cases_count_as_beyond_the_limit():
    limit = RareLimit.parse("x > 2")
    good, bad = {"error": "", "x": 1.0}, {"error": "ValueError: bad"}
    assert limit.measure_excess([good, good | {"x": 2.5}]) == 0.5
    assert RareLimit.parse("x<2").measure_excess([good]) == 1.0
    assert math.isnan(limit.measure_excess([good, bad]))
    assert math.isnan(limit.measure_excess([good | {"x": None}]))
    with pytest.raises(InputError, match="holds no numbers"):
        limit.measure_excess([good | {"x": "text"}])


@pytest.mark.parametrize("text", ["x", "x>", "x>nan", ">1", "p99(x) 3"])
def test_what_is_no_limit_is_refused(text):
    with pytest.raises(InputError, match="give it as COLUMN>LIMIT"):
        RareLimit.parse(text)


def test_a_study_without_dispersions_or_with_too_many_is_refused():
    for count in (0, 11):
        spread = {
            f"gyro.true_G.{k // 3}.{k % 3}": {"kind": "normal", "sigma": 1e-4, "mode": "offset"} for k in range(min(count, 9))
        }
        spread |= {path: one for path, one in DISPERSED.items() if count > 9}
        with pytest.raises(InputError, match="needs at least 1000 runs"):
            run_rare_event(RARE, RareConfig(dispersions=DISPERSED), RareLimit("sum", ">", 1.0), 100, "serial")
        with pytest.raises(InputError, match=f"needs 1 to 10 dispersions, and there are {count}"):
            run_rare_event(RARE, RareConfig(dispersions=spread), RareLimit("sum", ">", 1.0), 100, "serial")
