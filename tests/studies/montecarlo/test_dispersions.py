import numpy as np
import pandas as pd
import pytest
from pydantic import TypeAdapter
from scipy import stats

from gyrocal.errors import InputError
from gyrocal.recording import Recording
from simulator.scenario import Scenario, load, override
from studies.montecarlo.dispersions import Correlation, Dispersion, draw_uniforms, get_scenario_value
from studies.montecarlo.study import (
    Streams,
    StudyConfig,
    dispersed,
    draw_case_values,
    resolve_config,
)
from tests.docs.blocks import blocks
from tests.engine_studies import observed

NORMAL = {"kind": "normal", "sigma": 1e-3, "mode": "offset"}


def config(dispersions: dict[str, dict], cases: int = 4, sampler: str = "random", **fields) -> StudyConfig:
    return resolve_config(StudyConfig(cases=cases, dispersions=dispersions, sampler=sampler, **fields))


def sample(sampler: str, cases: int, paths: tuple[str, ...] = ("a",), entropy: int = 5) -> np.ndarray:
    return np.array([list(draw_uniforms(paths, sampler, entropy=entropy, case=case, cases=cases)) for case in range(cases)])


@pytest.mark.parametrize("sampler", ["random", "lhs", "sobol"])
@pytest.mark.parametrize(
    ("distribution", "law"),
    [
        ({"kind": "normal", "mean": 2.0, "sigma": 0.5}, stats.norm(2.0, 0.5)),
        ({"kind": "uniform", "low": -1.0, "high": 3.0}, stats.uniform(-1.0, 4.0)),
        ({"kind": "loguniform", "low": 0.1, "high": 10.0}, stats.loguniform(0.1, 10.0)),
    ],
    ids=lambda value: value["kind"] if isinstance(value, dict) else "",
)
def test_distributions(sampler, distribution, law):
    dispersion = TypeAdapter(Dispersion).validate_python(distribution)
    draws = [dispersion.quantile(u) for u in sample(sampler, 1024)[:, 0]]
    # At this fixed entropy a wrong law must be seen, and a right one pass: 1e-3 is the chance that the random sampler fails.
    assert stats.kstest(draws, law.cdf).pvalue > 1e-3
    assert stats.kstest(draws, stats.norm(law.mean() + 0.2 * law.std(), law.std()).cdf).pvalue < 1e-3


def test_stratified_samples_have_one_case_in_each_stratum():
    for column in sample("lhs", 250, ("a", "b", "c")).T:
        np.testing.assert_array_equal(np.sort(np.floor(250 * column)), np.arange(250))
    paths = ("a", "b", "c")
    few, many = sample("sobol", 20, paths), sample("sobol", 1100, paths)
    np.testing.assert_array_equal(few, many[:20])
    assert np.unique(many).size == many.size
    # Any block of 2^k rows is stratified, on both sides of the border between the blocks the rows are made in.
    for block in (many[:64], many[960:1024], many[1024:1088]):
        for column in block.T:
            np.testing.assert_array_equal(np.sort(np.floor(64 * column)), np.arange(64))


@pytest.mark.parametrize("sampler", ["random", "lhs", "sobol"])
def test_paths_and_entropies_share_nothing(sampler):
    columns = np.column_stack([sample(sampler, 512, ("a", "b", "c"), entropy) for entropy in (5, 6)])
    assert np.unique(columns).size == columns.size
    if sampler == "sobol":  # two scramblings of one net walk through it alike
        columns = columns[:, :3]
    correlation = np.corrcoef(columns.T)[np.triu_indices(columns.shape[1], 1)]
    # At most 15 pairs, standard deviation 1/sqrt(512) each if random, less if stratified; beyond 4.5 sigma with 1e-4.
    assert np.abs(correlation).max() < 4.5 / np.sqrt(512)


@pytest.mark.parametrize("sampler", ["random", "lhs", "sobol"])
def test_one_more_dispersion_changes_no_other(sampler):
    one = config({"gyro.true_G.0.0": NORMAL}, sampler=sampler)
    two = config({"gyro.true_G.0.0": NORMAL, "gyro.arw_deg_per_sqrt_s": NORMAL | {"sigma": 1e-6}}, sampler=sampler)
    for case in range(4):
        alone, beside = draw_case_values(one, case), draw_case_values(two, case)
        assert beside["gyro.true_G.0.0"] == alone["gyro.true_G.0.0"]
        a, b = observed(one, case, Streams(1998, case)), observed(two, case, Streams(1998, case))
        np.testing.assert_array_equal(a.attitudes.quaternions, b.attitudes.quaternions)


@pytest.mark.parametrize(("mode", "expected"), [("absolute", 3.0), ("offset", 3.5), ("factor", 1.5)])
def test_modes(mode, expected):
    uniform = {"kind": "uniform", "low": 3.0, "high": np.nextafter(3.0, 4.0), "mode": mode}
    study = config({"gyro.sample_s": uniform}, overrides={"gyro.sample_s": 0.5}, scenario=load("trmm"))
    np.testing.assert_allclose(draw_case_values(study, 0)["gyro.sample_s"], expected, rtol=1e-15)


# What each scenario value must move, and nothing else: gyro rates, reference attitudes, their times, what is known a priori.
MOVES = {
    "gyro.true_G.0.1": (NORMAL, {"rates"}),
    "gyro.apriori_G.1.0": (NORMAL, {"apriori_G"}),
    "reference.sigma_deg.0": ({"kind": "uniform", "low": 0.02, "high": 0.05}, {"quaternions", "sigma"}),
    "reference.every_s": ({"kind": "uniform", "low": 70.0, "high": 90.0}, {"times", "quaternions"}),
    # The references of a series keep clear of the slew's ramps, so that their times move too.
    "interval.0.slew.0.start_s": (
        {"kind": "uniform", "low": 65.0, "high": 115.0, "mode": "offset"},
        {"rates", "times", "quaternions"},
    ),
    "interval.0.slew.0.angle_deg": ({"kind": "uniform", "low": 0.8, "high": 0.9, "mode": "factor"}, {"rates", "quaternions"}),
    "orbit.altitude_km": ({"kind": "normal", "sigma": 5.0, "mode": "offset"}, {"rates", "quaternions", "orbit"}),
    "control_motion.amplitude_deg.1": ({"kind": "uniform", "low": 0.1, "high": 0.2}, {"rates", "quaternions"}),
}


@pytest.fixture(scope="module")
def short() -> Scenario:
    """A yaw maneuver with everything in it that can be dispersed."""
    whole = load("trmm")
    document = whole.model_dump(exclude_none=True)
    document["interval"] = [document["interval"][1] | {"start_s": 0.0, "stop_s": 1080.0}]
    document["reference"] |= {"at": "series", "every_s": 60.0}
    document["control_motion"] = {"amplitude_deg": (0.05, 0.05, 0.05), "period_s": (300.0, 200.0, 250.0)}
    document["control_motion"]["phase_deg"] = (0.0, 0.0, 0.0)
    return Scenario.model_validate(document)


def contents(recording: Recording) -> dict[str, np.ndarray]:
    gyro, attitudes = recording.gyro, recording.attitudes
    return {
        "t_s": gyro.t_s,
        "rates": gyro.rates,
        "arw": np.array(gyro.arw),
        "apriori_G": gyro.apriori_G,
        "apriori_bias": gyro.apriori_bias,
        "times": attitudes.t_s,
        "quaternions": attitudes.quaternions,
        "sigma": attitudes.sigma[0],
        "orbit": np.array([recording.orbit.period_s]),
    }


def differs(before: np.ndarray, after: np.ndarray) -> bool:
    """By more than rounding: other reference times cut the integration of the same rates into other steps."""
    return before.shape != after.shape or not np.allclose(before, after, rtol=0, atol=1e-15)


@pytest.mark.parametrize("path", MOVES)
def test_a_dispersion_moves_what_it_should_and_only_that(short, path):
    dispersion, moved = MOVES[path]
    still, moving = config({}, scenario=short), config({path: dispersion}, scenario=short)
    for case in range(2):
        drawn = draw_case_values(moving, case)[path]
        assert get_scenario_value(dispersed(moving, case), path) == drawn != get_scenario_value(short, path)
        assert override(dispersed(moving, case), {path: get_scenario_value(short, path)}) == short
        before, after = (contents(observed(which, case, Streams(1998, case))) for which in (still, moving))
        assert {name for name in before if differs(before[name], after[name])} == moved
    assert draw_case_values(moving, 0) != draw_case_values(moving, 1)


def test_dispersions_that_cannot_act_and_matrices_that_correlate_nothing_are_refused():
    for path, dispersion, message in (
        ("gyro.true_H.0.0", NORMAL, "gyro.true_H.0.0: the scenario has no such value; there is no 'true_H'"),
        ("title", NORMAL, "only a number can be dispersed"),
        ("orbit.raan_deg", NORMAL | {"mode": "factor"}, "a factor leaves its value, 0, as it is"),
        ("interval.1.slew.0.start_s", {"kind": "uniform", "low": 1e4, "high": 1e5}, "after the interval's"),
    ):
        with pytest.raises(InputError, match=message):
            config({path: dispersion})
    for matrix, message in (
        (((1.0, 0.5), (0.4, 1.0)), "symmetric"),
        (((1.0, 1.5), (1.5, 1.0)), "positive definite"),
        (((2.0, 0.5), (0.5, 2.0)), "ones on its diagonal"),
    ):
        with pytest.raises(ValueError, match=message):
            Correlation(paths=("a", "b"), matrix=matrix)


B0, B1, ARW = "gyro.true_bias_deg_s.0", "gyro.true_bias_deg_s.1", "gyro.arw_deg_per_sqrt_s"
SPREAD = {B0: NORMAL, ARW: NORMAL | {"sigma": 1e-6}, B1: NORMAL | {"sigma": 2e-3}}
JOINED = ({"paths": (B0, B1), "matrix": ((1.0, 0.8), (0.8, 1.0))},)


@pytest.mark.parametrize("sampler", ["random", "lhs", "sobol"])
def test_correlated_draws_have_their_covariance_and_leave_the_others(sampler):
    n = 1024
    alone, joined = config(SPREAD, n, sampler), config(SPREAD, n, sampler, correlations=JOINED)
    free, drawn = (np.array([list(draw_case_values(one, case).values()) for case in range(n)]) for one in (alone, joined))
    np.testing.assert_array_equal(drawn[:, :2], free[:, :2])  # the first of the group, and the path outside
    covariance = np.cov(drawn[:, [0, 2]].T)
    # Standard errors of a variance √(2/n) = 4.4 %, of a correlation (1 − ρ²)/√n = 0.011.
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [1e-3, 2e-3], rtol=0.1)
    assert np.corrcoef(drawn[:, [0, 2]].T)[0, 1] == pytest.approx(0.8, abs=0.045)
    assert abs(np.corrcoef(free[:, [0, 2]].T)[0, 1]) < 0.14
    assert stats.kstest((drawn[:, 2] - drawn[:, 2].mean()) / 2e-3, stats.norm.cdf).pvalue > 1e-3
    assert np.isfinite(stats.norm.ppf(Correlation(**JOINED[0]).correlate(np.array([2.0**-54, 1 - 2.0**-53])))).all()


def test_other_packages_read_the_rows_as_the_docs_say(tmp_path, capsys):
    pytest.importorskip("openturns", reason="no dependency of the project")
    rng = np.random.default_rng(0)
    arw, b = 10 ** rng.uniform(-4, -3, 500), 1e-4 * rng.standard_normal(500)
    rows = {"case": range(500), "error": "", "disp:arw": arw, "disp:b": b, "largest_error_ppm": 1e5 * arw * (1 + 1e4 * b) ** 2}
    pd.DataFrame(rows).to_parquet(tmp_path / "table.parquet")
    exec(blocks("docs/studies.md", "python")[0].replace("/tmp/noise", str(tmp_path)), {})
    indices, probability = capsys.readouterr().out.splitlines()
    assert indices.startswith("[0.")
    assert 0.02 < float(probability) < 0.04
