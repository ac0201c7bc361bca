"""What scripts rely on: exit statuses, JUnit's XML, JSON, and names that were meant."""

import copy
import json
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from gyrocal import NAMES, InputError, save
from gyrocal.calibration.change import CalibrationChange
from simulator import load, override, simulate
from studies.cli.main import main
from studies.cli.options import compare_conditions
from studies.report.calibration import check_limits, parse_limit
from studies.report.checks import Check
from studies.report.junit import Verdict, convert_checks, write_junit
from tests.diagnosis_cases import CASES


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scripts") / "rec"
    save(simulate(load("trmm"), seed=1), folder)
    return folder


@pytest.mark.parametrize(("condition", "status"), [("p>0.001", 3), ("condition > 1e9", 0)])
def test_a_calibration_fails_on_a_condition(condition, status, recording, run_cli, tmp_path):
    report = tmp_path / "out.xml"
    found = run_cli("calibrate", str(recording), "--fail-on", condition, "--junit", str(report))
    assert found.exit_code == status, found.output
    assert "G_xx" in found.stdout
    suite = ElementTree.parse(report).getroot()[0]
    assert (suite.get("tests"), suite.get("failures")) == ("1", str(status // 3))
    assert suite[0].get("classname") == str(recording)
    assert len(suite[0]) == status // 3


def test_checks_and_what_is_not_known_as_tests(tmp_path):
    assert compare_conditions(["p<0.001"], {"p": float("nan")}) == [Verdict("p<0.001", "p is not known")]
    assert compare_conditions(["p<0.001"], {"p": 0.001}) == [Verdict("p<0.001")]
    with pytest.raises(InputError):
        compare_conditions(["x<1"], {"p": 0.5})
    checks = [
        Check("inside", 1.0, (0.0, 2.0), "deg"),
        Check("outside", 3.0, (0.0, 2.0), "deg"),
        Check("a note", 5.0),
        Check("a word", "bad", "good"),
    ]
    verdicts = convert_checks(checks)
    assert [bool(one.failure) for one in verdicts] == [False, True, False, True]
    assert [bool(one.skipped) for one in verdicts] == [False, False, True, False]
    assert verdicts[1].failure == "3 deg, asked 0 to 2"
    write_junit(tmp_path / "a.xml", "s", "rec\x1b[31m <&>", verdicts)
    suite = ElementTree.parse(tmp_path / "a.xml").getroot()[0]
    assert [case.get("name") for case in suite] == [check.name for check in checks]
    assert suite[0].get("classname") == "rec\ufffd[31m <&>"
    assert (suite.get("tests"), suite.get("failures"), suite.get("skipped")) == ("4", "2", "1")


def test_scenarios_have_titles(run_cli, tmp_path):
    found = run_cli("scenarios", "--json", str(tmp_path / "a.json"))
    lines = found.stdout.splitlines()
    assert any(line.startswith("trmm ") and "TRMM in-flight gyro calibration" in line for line in lines)
    listed = json.loads((tmp_path / "a.json").read_text())["scenarios"]
    assert [one["name"] for one in listed] == [line.split()[0] for line in lines]
    assert all(one["title"] for one in listed)
    assert run_cli("scenarios", "trmm", "--json", str(tmp_path / "b.json")).exit_code == 0
    assert json.loads((tmp_path / "b.json").read_text())["gyro"]["sample_s"] == 0.5
    (tmp_path / "mine.toml").write_text(run_cli("scenarios", "trmm").stdout)
    assert load(tmp_path / "mine.toml") == load("trmm")


@pytest.mark.parametrize(
    ("verdict", "present", "asked", "status"),
    [
        ("unknown", True, ["unknown"], 3),
        ("named", True, ["unknown", "gap"], 3),
        ("none", False, ["gap", "unknown"], 0),
    ],
)
def test_a_diagnosis_fails_on_a_gap_or_on_an_unknown_one(
    verdict, present, asked, status, recording, run_cli, tmp_path, monkeypatch
):
    answer = replace(CASES[verdict](), present=present)
    monkeypatch.setattr("diagnosis.diagnose.diagnose", lambda *arguments, **options: answer)
    options = [text for name in asked for text in ("--fail-on", name)]
    report = tmp_path / "out.xml"
    found = run_cli("diagnose", str(recording), *options, "--json", "-", "--junit", str(report))
    assert found.exit_code == status, found.output
    assert json.loads(found.stdout)["verdict"] == verdict  # the answer is written before the status
    suite = ElementTree.parse(report).getroot()[0]
    assert [case.get("name") for case in suite] == asked
    assert int(suite.get("failures")) == sum({"gap": present, "unknown": verdict == "unknown"}[name] for name in asked)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A short recording and the result of its calibration."""
    folder = tmp_path_factory.mktemp("saved")
    save(simulate(override(load("trmm"), {"gyro.sample_s": 15.0}), seed=2), folder / "rec")
    assert CliRunner().invoke(main, ["calibrate", str(folder / "rec"), "--json", str(folder / "a.json")]).exit_code == 0
    return folder / "rec", json.loads((folder / "a.json").read_text())


@pytest.mark.parametrize(("sigmas", "is_same", "status"), [(4, True, 1), (2.5 * 2**0.5, False, 0)])
def test_a_calibration_is_guarded_by_a_saved_one(sigmas, is_same, status, saved, run_cli, tmp_path):
    folder, document = copy.deepcopy(saved)
    document["bias_deg_s"][1] += sigmas * document["sigma_bias_deg_s"][1]
    if not is_same:
        del document["provenance"]
    (tmp_path / "a.json").write_text(json.dumps(document))
    command = ["calibrate", str(folder), "--against", str(tmp_path / "a.json")]
    limits = ["--max-sigma", "3", "--max-change", "scale,misalignment<1ppm", "--junit", str(tmp_path / "a.xml")]
    found = run_cli(*command, *limits)
    assert found.exit_code == status, found.output
    assert ("Not met: b_y < 3 sigma: moved by 4.0 sigma" in found.stdout) == bool(status)
    assert ("share its noise" in found.stdout) == is_same
    suite = ElementTree.parse(tmp_path / "a.xml").getroot()[0]
    assert {one.get("name") for one in suite if len(one)} == ({"b_y < 3 sigma"} if status else set())
    assert len(suite) == 14
    if status:
        assert run_cli(*command).exit_code == 0  # without a limit nothing fails
        assert run_cli(*command, "--max-sigma", "3", "--fail-on", "p>0").exit_code == 3


@given(
    index=st.integers(0, 11), unit=st.sampled_from(["ppm", "%", "arcsec", "deg", "deg/h", "rad/s"]), limit=st.floats(1e-9, 1e9)
)
def test_limits_are_read_in_their_unit(index, unit, limit):
    factor = {"ppm": 1e-6, "%": 1e-2, "arcsec": np.pi / 648000, "deg": np.pi / 180, "deg/h": np.pi / 648000, "rad/s": 1.0}[unit]
    text, name = f" {NAMES[index]} < {limit!r} {unit}", NAMES[index]
    if ("/" in unit) != name.startswith("b") or (name in ("G_xx", "G_yy", "G_zz") and unit in ("arcsec", "deg")):
        with pytest.raises(InputError, match=f"no unit of {name}"):
            parse_limit(text)
        return
    size = np.eye(12)[index] * factor * limit
    for share, kept in ((0.999, True), (-0.999, True), (1.001, False), (-1.001, False)):
        (verdict,) = check_limits(CalibrationChange(share * size, np.ones(12), 0.0, 12, False), None, [text])
        assert (verdict.failure == "") == kept
