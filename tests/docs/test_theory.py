"""The list of the papers' slips is that of the reproduction, with its numbers; equations are those of the code."""

import re

import numpy as np
from scipy.integrate import quad_vec

from gyrocal import psi_matrix
from gyrocal.attitude import rotation_matrix
from studies.natanson.claims import NATANSON_CLAIMS as NATANSON
from studies.report import committed_results
from studies.report.claims import PaperResults, judge_claims
from studies.robertson.claims import ROBERTSON_CLAIMS as ROBERTSON
from tests import ROOT

TEXT = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8")
RESULTS = ROOT / "results"
ROWS = re.findall(r"^\| ([NR] .*?) \| (.*) \|$", TEXT.split("## Where the papers slip")[1], flags=re.MULTILINE)


def found(paper):
    return PaperResults(committed_results.read(RESULTS / paper), RESULTS / "studies")


def test_every_slip_is_listed_and_no_other():
    papers = {"reproduction": NATANSON, "mission": ROBERTSON}
    verdicts = [one for paper, claims in papers.items() for one in judge_claims(claims, found(paper))]
    slips = [one.claim.where for one in verdicts if one.verdict == "the paper slips"]
    assert [where for where, _ in ROWS] == slips


def test_the_numbers_of_the_slips_are_the_committed_ones():
    summary = found("reproduction").results.summary
    rows = dict(ROWS)
    signs = "residual_sign_gap_rms_deg"
    for where, numbers in {
        "N (29)": [f"{summary[f'{signs}.N (16)']:.3f}", f"{summary[f'{signs}.N (29) as printed']:.3f}"],
        "N (31), (32)": [f"{summary['nees_references_only.value']:.1f}", f"{summary['nees.value']:.1f}"],
        "N V, Figure 2": [f"{summary[f'minus_y_rate_rpo.gap_rms_deg.{sign}']:.3f}" for sign in (1, -1)],
        "N Table 2, 2 s": [
            f"{summary['own_calibration.2.as_printed_deg']:.4f}",
            f"{summary['own_calibration_rms_deg.assumed.2']:.4f}",
        ],
        "N Table 3, 0.5 s": [f"{summary[f'own_calibration.{step}.gradient_deg']:.3f}" for step in ("0.5", "1")],
        "N V, Table 5": [f"{summary[f'own_digits_changed.0.5.{table}']:.0f} of" for table in ("table2", "table4")],
    }.items():
        assert [number for number in numbers if number not in rows[where]] == [], where


def test_eta_as_mended_makes_psi_its_integral_and_as_printed_does_not():
    omega, dt = np.array([0.02, -0.01, 0.03]), 2.0
    integral = quad_vec(lambda tau: rotation_matrix(-omega * tau), 0.0, dt, epsabs=1e-15)[0]
    phi = np.linalg.norm(omega) * dt
    cross = np.array([[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]])

    def psi(eta):
        nu = np.sin(phi / 2) / (phi / 2)
        return dt * np.eye(3) - 0.5 * nu**2 * cross * dt**2 + 2 * eta * cross @ cross * dt**3

    np.testing.assert_allclose(psi((1 - np.sin(phi) / phi) / (2 * phi**2)), integral, atol=1e-14)
    np.testing.assert_allclose(psi_matrix(omega, dt), integral, atol=1e-14)
    assert np.abs(psi((1 - np.sin(phi)) / (2 * phi**2)) - integral).max() > 0.1
