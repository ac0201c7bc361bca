"""The page of a calibration, for each thing that can be said of one."""

import dataclasses
import re

import numpy as np
import pytest

import simulator
from gyrocal import InputError, calibrate, save
from studies.report import calibration_page
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


def test_page_is_whole(result, recording):
    page = checked(calibration_page.build_calibration_page(result, recording, made=MADE))
    assert set(page.figures) == {"forest", "residuals", "observability", "correlations", "allan"}
    assert all(len(alt) > 60 for alt in page.figures.values())
    assert "The calibration fits" in page.words
    for name in result.solved_for:
        assert name in page.words
    assert MADE.sha256 in page.words


def test_residuals_and_sigmas_are_the_results_own(result):
    said = calibration_page.list_answers(result)
    roll = result.residuals["after_roll_deg"]
    assert f"to {np.sqrt(np.mean(roll**2)):.4f} deg; pitch" in said["What is left of the residuals (RMS)?"]
    sigma = result.summary()["sigma"].to_numpy()
    shown = [float(one) for one in re.findall(r"(\d[\d.]*) (?:to|ppm|deg/h)", said["How well are they known?"])]
    expected = [1e6 * sigma[:9].min(), 1e6 * sigma[:9].max(), 3600 * sigma[9:].min(), 3600 * sigma[9:].max()]
    np.testing.assert_allclose(shown, expected, rtol=6e-3)


def test_correlations_are_those_of_the_covariance(result):
    found = calibration_page.compute_correlations(result)
    C = result.covariance
    assert found.loc["G_xx", "b_x"] == pytest.approx(C[0, 9] / np.sqrt(C[0, 0] * C[9, 9]))
    np.testing.assert_allclose(np.diag(found), 1.0)
    tight = dataclasses.replace(
        result, own_covariance=C + 1e9 * np.outer(np.eye(12)[0] + np.eye(12)[1], np.eye(12)[0] + np.eye(12)[1])
    )
    assert calibration_page._find_tight_pairs(tight) == [("G_xy", "G_xx")]


@pytest.mark.parametrize(
    ("chi2", "dof", "kind", "text"),
    [
        (1e6, 100, "gap", "Do not believe it yet"),
        (1e-6, 100, "open", "stated too large"),
        (0.0, 0, "open", "nothing is left to check them with"),
        (100.0, 100, "", "The calibration fits"),
    ],
)
def test_headline_follows_the_fit(result, chi2, dof, kind, text):
    other = dataclasses.replace(result, chi2=chi2, dof=dof)
    assert calibration_page.format_headline(other, True)[0] == kind
    assert text in calibration_page.format_headline(other, True)[1]
    if kind:
        assert calibration_page.recommend_next_step(other) != calibration_page.recommend_next_step(result)


def test_what_the_data_do_not_determine_comes_first(recording):
    short = simulator.override(simulator.load("trmm"), {"gyro.sample_s": 5.0})
    free = calibrate(simulator.simulate(short, seed=1), plausible_G=1e-6, apriori_covariance=np.diag([1e-6] * 9 + [1e-12] * 3))
    kind, title = calibration_page.format_headline(free, True)
    assert kind == "open"
    assert "not found by the data" in title
    assert "gyrocal plan" in calibration_page.recommend_next_step(free)


@pytest.mark.usefixtures("blank_figures")
def test_the_command_writes_it(run_cli, tmp_path, recording, monkeypatch):
    def no_noise(*_):
        raise InputError("rec: no stretch of samples shows the gyro's noise")

    monkeypatch.setattr(calibration_page, "estimate_noise_terms", no_noise)
    save(recording, tmp_path / "rec")
    page = tmp_path / "page.html"
    done = run_cli("calibrate", str(tmp_path / "rec"), "--report", str(page), "--solve-for", "all,-misalignment")
    assert done.exit_code == 0, done.stderr
    words = checked(page.read_text()).words
    assert "SHA-256 of samples" in words
    assert "No Allan deviation: rec: no stretch" in words
