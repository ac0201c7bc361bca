import json

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from gyrocal.errors import InputError
from studies.montecarlo.criteria import Requirement, check_independent, count_runs
from studies.montecarlo.study import StudyConfig

THREE_SIGMA = Requirement.parse("p99.73(x) < 0.4 @ 90%")


def rows(values, **columns) -> pd.DataFrame:
    return pd.DataFrame({"case": np.arange(len(values)), "error": "", "x": values} | columns)


def test_a_requirement_is_read_and_written_and_what_is_none_is_refused():
    assert Requirement.parse("p99.73(deg) < 0.4 @ 90%") == Requirement(99.73, "deg", "<", 0.4, 90.0)
    expected = Requirement(1.0, "disp:gyro.x", ">", -2e-3, 97.5)
    assert Requirement.parse(" p1( disp:gyro.x )>-2e-3@97.5 %") == Requirement.parse(str(expected)) == expected
    for text in ("x<1", "p100(x)<1", "p99(x)<nan", "p99(x)<1 @ 50%"):
        with pytest.raises(InputError, match="give it as pNN"):
            Requirement.parse(text)


def test_run_counts_are_the_published_ones():
    # J. M. Hanson and B. B. Beard, NASA/TP-2010-216447: 852 runs for 0.9973 at 10 %; S. S. Wilks: 59 for 95/95, 230 for 99/90.
    assert count_runs(0, 1 - 0.9973, 0.1) == 852
    assert [count_runs(beyond, 1 - 0.9973, 0.1) for beyond in range(5)] == [852, 1440, 1970, 2473, 2959]  # docs/studies.md
    assert (count_runs(0, 0.05, 0.05), count_runs(0, 0.01, 0.1)) == (59, 230)


@pytest.mark.parametrize("success", [0.9, 0.9973, 0.9999])
@pytest.mark.parametrize("risk", [0.01, 0.05, 0.1])
@pytest.mark.parametrize("beyond", [0, 1, 2, 3, 10, 40])
def test_run_counts_are_the_smallest_by_the_binomial_law(success, risk, beyond):
    runs, q = count_runs(beyond, 1 - success, risk), 1 - success
    assert stats.binom.cdf(beyond, runs, q) <= risk < stats.binom.cdf(beyond, runs - 1, q)
    answer = Requirement(100 * success, "x", "<", 0.0, 100 * (1 - risk)).judge_counts(runs, beyond)
    assert answer.outcome == "met"
    before = Requirement(100 * success, "x", "<", 0.0, 100 * (1 - risk)).judge_counts(runs - 1, beyond)
    assert (before.outcome, before.fewest) == ("undecided", 1)


def test_failed_and_empty_cases_count_and_the_worst_row_of_a_case():
    table = rows(np.full(1000, 0.1))
    assert THREE_SIGMA.judge(table).beyond == 0
    table.loc[0, ["error", "x"]] = ["ValueError: bad", np.nan]
    table.loc[1, "x"] = np.nan
    table = pd.concat([table, pd.DataFrame({"case": [2, 3], "error": "", "x": [9.0, 0.2]})])
    answer = THREE_SIGMA.judge(table)
    assert (answer.cases, answer.beyond, answer.failed, answer.empty) == (1000, 3, 1, 1)
    assert str(Requirement.parse("p50(x)>0.1").judge(rows([1.0, np.inf, -np.inf]))).count("among them 1 infinite") == 1
    assert "3 of 1000 cases are beyond the limit, among them 1 failed and 1 without a value" in str(answer)


def test_cases_that_depend_on_each_other_are_refused():
    spread = {"gyro.true_G.0.0": {"kind": "normal", "sigma": 1e-4, "mode": "offset"}}
    check_independent(StudyConfig(dispersions=spread), "--require")
    check_independent(StudyConfig(sampler="lhs"), "--require")  # disperses nothing
    for sampler in ("lhs", "sobol"):
        with pytest.raises(InputError, match="use --set sampler=random"):
            check_independent(StudyConfig(dispersions=spread, sampler=sampler), "--require")


def test_a_study_answers_and_answers_again_without_computing(tmp_path, run_cli):

    mine = tmp_path / "pointing_draws.py"
    mine.write_text(
        '"""Draws."""\n'
        "from studies.montecarlo.study import Study, StudyConfig\n"
        "def case(config, number, streams):\n"
        '    return {"x": streams.generator("x").standard_normal()}\n'
        'STUDY = Study("pointing_draws:STUDY", StudyConfig, case)\n'
    )
    out = tmp_path / "out"
    arguments = ["study", str(mine), "--backend", "serial", "--cases", "300", "--out", str(out)]
    assert run_cli(*arguments).exit_code == 0
    before = (out / "table.parquet").read_bytes()
    found = run_cli(*arguments, "--require", "p99(x)<4 @ 90%", "--require", "p50(x)<-1", "--json", str(tmp_path / "o.json"))
    assert found.exit_code == 0, found.output
    assert "p99(x) < 4 @ 90 %: met; 0 of 300 cases are beyond the limit." in found.stdout
    assert "300 of them from an earlier run" in found.stdout
    assert (out / "table.parquet").read_bytes() == before
    assert "p50(x) < -1 @ 90 %: not met" in (out / "report.md").read_text()
    assert pd.read_csv(out / "checks.csv")["verdict"].tolist() == ["pass", "fail"]
    listed = json.loads((out / "manifest.json").read_text())["requirements"]
    assert listed == json.loads((tmp_path / "o.json").read_text())["requirements"]
    assert [one["outcome"] for one in listed] == ["met", "not met"]
    assert run_cli(*arguments, "--require", "p99(y)<4").exit_code == 2
