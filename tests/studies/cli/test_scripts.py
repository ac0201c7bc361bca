"""What scripts rely on: exit statuses, JUnit's XML, JSON, and names that were meant."""

import json
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest

from gyrocal import InputError, save
from simulator import load, simulate
from studies.cli.options import compare_conditions
from studies.report.checks import Check
from studies.report.junit import Verdict, convert_checks, write_junit


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scripts") / "rec"
    save(simulate(load("trmm"), seed=1), folder)
    return folder


@pytest.mark.parametrize(
    ("condition", "status"), [("p<0.001", 0), ("p>0.001", 3), ("condition<1e9", 3), ("condition > 1e9", 0)]
)
def test_a_calibration_fails_on_a_condition(condition, status, recording, run_cli, tmp_path):
    report = tmp_path / "out.xml"
    found = run_cli("calibrate", str(recording), "--fail-on", condition, "--junit", str(report))
    assert found.exit_code == status, found.output
    assert "G_xx" in found.stdout
    suite = ElementTree.parse(report).getroot()[0]
    assert suite.attrib == {
        "name": "gyrocal calibrate",
        "tests": "1",
        "errors": "0",
        "skipped": "0",
        "failures": str(status // 3),
    }
    assert suite[0].get("classname") == str(recording)
    assert len(suite[0]) == status // 3


def test_what_is_not_known_fails():
    assert compare_conditions(["p<0.001"], {"p": float("nan")}) == [Verdict("p<0.001", "p is not known")]
    assert compare_conditions(["p<0.001"], {"p": 0.001}) == [Verdict("p<0.001")]
    with pytest.raises(InputError):
        compare_conditions(["x<1"], {"p": 0.5})


def test_checks_as_tests(tmp_path):
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
        ("unknown", True, ["gap"], 3),
        ("unknown", True, ["unknown"], 3),
        ("named", True, ["unknown"], 0),
        ("named", True, ["unknown", "gap"], 3),
        ("none", False, ["gap", "unknown"], 0),
    ],
)
def test_a_diagnosis_fails_on_a_gap_or_on_an_unknown_one(
    verdict, present, asked, status, recording, run_cli, tmp_path, monkeypatch
):
    answer = SimpleNamespace(verdict=verdict, present=present, p_value=1e-9, to_json=lambda: {"verdict": verdict})
    monkeypatch.setattr("diagnosis.diagnose.diagnose", lambda *arguments, **options: answer)
    options = [text for name in asked for text in ("--fail-on", name)]
    report = tmp_path / "out.xml"
    found = run_cli("diagnose", str(recording), *options, "--json", "-", "--junit", str(report))
    assert found.exit_code == status, found.output
    assert json.loads(found.stdout) == {"verdict": verdict}  # the answer is written before the status
    suite = ElementTree.parse(report).getroot()[0]
    assert [case.get("name") for case in suite] == asked
    assert int(suite.get("failures")) == sum({"gap": present, "unknown": verdict == "unknown"}[name] for name in asked)
