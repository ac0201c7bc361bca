"""The study of reference attitudes: its rows agree where they must, its verdicts and report follow the rows."""

import numpy as np
import pytest

from studies.estimation import references
from studies.estimation.references import (
    BLOCKS,
    COMPARED_TIMES_S,
    EXACT,
    FILTER,
    FORMAL,
    FULL,
    INDEPENDENT,
    PLAIN,
    SMOOTHER,
    STATED,
    STUDY,
    UNSTATED,
    WHOLE,
)
from studies.montecarlo.statistics import CONSISTENT
from studies.montecarlo.study import load_config
from tests.studies.rows import run_study

CONFIG = load_config(STUDY, changes={"cases": 3, "full_filter_every": 2, "misalignments_deg": [0.04]})


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    return run_study(STUDY, CONFIG, tmp_path_factory.mktemp("references"))


def test_batch_filter_and_smoother_are_one_answer_where_they_know_the_same(rows):
    apart = rows.groupby(["estimator", "setup"])["apart_sigma"].max()
    assert apart[SMOOTHER].max() < 3e-3  # what filter and smoother start from is not nothing
    assert apart[FILTER, f"{COMPARED_TIMES_S[-1]:g} s"] < 3e-3
    assert apart[FILTER, f"{COMPARED_TIMES_S[0]:g} s"] > 0.3  # the filter knows the past only
    assert apart[PLAIN].max() > 0.3


def test_formal_covariance_is_far_too_small(rows):
    part = rows[rows["setup"] == f"{COMPARED_TIMES_S[1]:g} s"].groupby("estimator")[["sigma_mdeg", "nees"]].mean()
    assert part.loc[FORMAL, "sigma_mdeg"] < 0.6 * part.loc[PLAIN, "sigma_mdeg"]
    assert part.loc[FORMAL, "nees"] > 3 * part.loc[PLAIN, "nees"]
    assert part.loc[EXACT, "sigma_mdeg"] < part.loc[PLAIN, "sigma_mdeg"]


def test_one_V_is_the_blocks_where_intervals_share_nothing(rows):
    part = rows[rows["part"] == "calibration"].set_index(["setup", "estimator", "treatment", "case"]).sort_index()["nees"]
    for source in (EXACT, PLAIN):
        whole, blocks = (part["apart", source, name].to_numpy() for name in (WHOLE, BLOCKS))
        np.testing.assert_allclose(whole, blocks, rtol=1e-6)
        whole, blocks = (part["chain", source, name].to_numpy() for name in (WHOLE, BLOCKS))
        assert np.abs(whole / blocks - 1).min() > 0.01


def test_stated_G_is_better_with_what_the_chain_shares(rows):
    part = rows[rows["part"] == "calibration"].groupby(["setup", "estimator", "treatment"])["G_sigma_ppm"].mean()
    assert part["chain", EXACT, WHOLE] < 0.7 * part["chain", EXACT, BLOCKS]
    assert part["chain", EXACT, WHOLE] < 0.9 * part["chain", EXACT, INDEPENDENT]


def test_a_misaligned_sensor_makes_the_full_filter_too_sure(rows):
    nees = rows[rows["part"] == "full filter"].groupby(["setup", "estimator"])["nees"].mean()
    wrong = "misaligned by 0.04 deg"
    assert nees[wrong, FULL] > nees[wrong, UNSTATED] > 3 * 12
    assert nees[wrong, STATED] < 2 * 12
    assert nees["as modelled", FULL] < 2.5 * 12
    assert ("as modelled", STATED) not in nees.index


def test_verdicts_follow_the_rows(rows):
    perfect = rows.copy()
    perfect["nees"], perfect["nees_bias"] = perfect["dof"].astype(float), 3.0
    tables = (
        references.build_attitude_verdicts(perfect),
        references.build_calibration_verdicts(perfect),
        references.build_full_filter_verdicts(perfect),
    )
    for table in tables:
        assert (table["verdict"] == CONSISTENT).all()
    found = [check for check in references.report(CONFIG, perfect).checks if check.unit == "NEES/dof"]
    controls = sum((table["expected"] == f"not {CONSISTENT}").sum() for table in tables)
    assert controls == 3 + 6 + 1 + 2  # formal; apart and chain, by two batches; timeline; misaligned
    controls += (tables[1]["bias_expected"] == f"not {CONSISTENT}").sum()
    total = sum((table["expected"] != "").sum() for table in tables) + (tables[1]["bias_expected"] != "").sum()
    assert len(found) == total
    failed = [check.name for check in found if check.verdict == "fail"]
    assert len(failed) == controls
    assert f"{FORMAL}, 900 s" in failed


def test_full_filter_runs_in_every_so_many_cases(rows):
    assert set(rows.loc[rows["part"] == "full filter", "case"]) == {0, 2}
    assert set(rows.loc[rows["part"] == "calibration", "case"]) == {0, 1, 2}


def test_coverage_counts_cases(rows):
    part = rows[(rows["setup"] == "chain") & (rows["estimator"] == EXACT) & (rows["treatment"] == WHOLE)].index
    changed = rows.copy()
    changed.loc[part, "nees"], changed.loc[part, "nees_bias"] = [21.0, 21.1, 5.0], [7.8, 7.9, 7.9]
    table = references.build_calibration_verdicts(changed).set_index(["flight", "references", "treatment"])
    line = table.loc[("chain", EXACT, WHOLE)]  # the 95 % quantiles of χ² are 21.03 and 7.815
    assert (line["coverage_95"], line["bias_coverage_95"]) == (pytest.approx(2 / 3), pytest.approx(1 / 3))


def test_a_small_misalignment_need_not_show(rows):
    small = rows.copy()
    small["misaligned_deg"] *= 0.1
    table = references.build_full_filter_verdicts(small)
    assert (table.loc[table["sensors"] != "as modelled", "expected"] == "").all()
