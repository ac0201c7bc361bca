"""The page of a calibration, for each thing that can be said of one."""

import dataclasses
import io
import json
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console
from scipy import stats

import simulator
from gyrocal import GyroParameters, calibrate
from gyrocal.calibration.remainder_processes import Remainder
from studies.report import calibration as report
from studies.report.pages import ProvenanceFooter
from tests.pages import checked

MADE = ProvenanceFooter("1", "2026-01-01", "gyrocal calibrate rec --report page.html", "a" * 64)


@pytest.fixture(scope="module")
def recording():
    plan = simulator.override(
        simulator.load("trmm"), {"gyro.sample_s": 5.0, "reference.at": "series", "reference.every_s": 600.0}
    )
    return simulator.simulate(plan, seed=3)


@pytest.fixture(scope="module")
def result(recording):
    return calibrate(recording)


@pytest.mark.usefixtures("blank_figures")
def test_page_is_whole(result):
    page = checked(report.build_calibration_page(result, "Held-out.", provenance=MADE).render_html())
    assert set(page.figures) == {"forest", "residuals"}
    assert all(len(alt) > 60 for alt in page.figures.values())
    assert page.words.count(result.verdict.summary.rstrip(".")) >= 1
    assert page.words.count("They fit the stated noise") == 1
    for name in result.solved_for:
        assert name in page.words
    assert MADE.sha256 in page.words


def test_correlations_are_those_of_the_covariance(result):
    found = report.compute_correlations(result)
    C = result.covariance
    assert found.loc["G_xx", "b_x"] == pytest.approx(C[0, 9] / np.sqrt(C[0, 0] * C[9, 9]))
    np.testing.assert_allclose(np.diag(found), 1.0)
    tight = dataclasses.replace(
        result, own_covariance=C + 1e9 * np.outer(np.eye(12)[0] + np.eye(12)[1], np.eye(12)[0] + np.eye(12)[1])
    )
    assert "only combinations are known well of G_xy and G_xx" in report.describe_observability(tight)


@given(
    size=st.sampled_from([1e-6, 0.5, 0.9, 1.0, 1.1, 1.5, 1e4]) | st.floats(0.01, 10),
    dof=st.sampled_from([0, 1, 9, 10, 100, 3000]),
    remainder_p=st.none() | st.sampled_from([0.0, 1e-6, 0.0099, 0.0101, 1.0]),
    converged=st.booleans(),
    iterations=st.none() | st.just(1),
    bias=st.sampled_from([0.0, 1.0]),
    range_G=st.sampled_from([0.1, 1e-9]),
)
@settings(max_examples=12)
def test_terminal_and_json_state_one_verdict(result, size, dof, remainder_p, converged, iterations, bias, range_G):
    wider = Remainder((), 2.0, 9.0, remainder_p, 4 * result.covariance) if remainder_p is not None else None
    other = dataclasses.replace(
        result,
        chi2=size * max(dof, 1),
        dof=dof,
        remainder=wider,
        converged=converged,
        options={**result.options, "iterations": iterations},
        parameters=GyroParameters(result.G, result.bias + bias),
        plausible=dataclasses.replace(result.plausible, G=range_G),
    )
    verdict, stream = other.verdict, io.StringIO()
    report.build_calibration_page(other, "").show(Console(file=stream, width=500, soft_wrap=True))
    document = json.loads(json.dumps(other.to_json()))
    for text in (
        stream.getvalue(),
        "\n".join([document["verdict"]["summary"], *document["verdict"]["reasons"]]),
    ):
        assert text.count(verdict.summary.rstrip(".")) == 1
        about = [one for one in re.split(r"[.\n]", text) if re.search("noise|residual|They ", one)]
        told = [one for one in about if re.search(r"\bfit|exceed|larger than|smaller than", one)]
        assert len(told) == 1
        assert ("They fit" in told[0]) == (verdict.fit == "fits")
        assert ("Use the" in text) == (verdict.belief in ("yes", "with_wider_sigmas"))
        assert ("do not trust" in text) <= (verdict.belief == "no")
    chi2_p, significant = stats.chi2.sf(other.chi2, dof) if dof else np.nan, remainder_p is not None and remainder_p < 0.01
    assert (verdict.fit == "fits") == (dof > 0 and 0.01 <= chi2_p <= 0.99 and not significant)
    wrong = (
        bool(bias)
        or (range_G < 1e-8 and size > 1 and dof > 0)
        or (iterations is None and not converged)
        or (chi2_p < 0.01 and not significant)
    )
    expected = "no" if wrong else "unchecked" if not dof else "with_wider_sigmas" if significant else "yes"
    assert document["verdict"]["belief"] == verdict.belief == expected or (verdict.belief == "no" and size > 1)
    assert document["verdict"]["sigmas"] == document["recommended"] == ("with_remainder" if significant else "nominal")
    steps = {"fits": "gyrocal predict", "smaller": "gyrocal allan", "untested": "Add reference"}
    if not other.warnings:
        assert steps.get(verdict.fit, "gyrocal diagnose") in report.recommend_next_step(other)


def test_the_verdict_counts_what_the_data_do_not_determine(recording):
    short = simulator.override(simulator.load("trmm"), {"gyro.sample_s": 5.0})
    free = calibrate(simulator.simulate(short, seed=1), plausible_G=1e-6, apriori_covariance=np.diag([1e-6] * 9 + [1e-12] * 3))
    assert any("combinations are not determined by the data" in text for text in free.verdict.reasons)
    assert "gyrocal plan" in report.recommend_next_step(free)
