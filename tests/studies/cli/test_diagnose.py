"""The command ``gyrocal diagnose`` as a user types it."""

import json
import re

import pytest

from simulator.effects.sensor import ALL_EFFECTS
from studies.cli.main import main
from tests import ROOT
from tests.diagnosis_cases import CASES
from tests.pages import checked


@pytest.fixture
def asked(monkeypatch):
    """What diagnose was called with; it answers with the case that is set."""
    seen = {"case": "named"}

    def answer(recording, *, progress=None, seed=0, library=None, exclude=()):
        progress("gyro stream", 0.0)
        progress("closure", 0.9)
        seen.update(recording=recording, seed=seed, library=library, exclude=exclude)
        return CASES[seen["case"]]()

    monkeypatch.setattr("diagnosis.diagnose.diagnose", answer)
    return seen


@pytest.fixture(scope="module")
def rec(tmp_path_factory):
    from click.testing import CliRunner

    folder = tmp_path_factory.mktemp("diagnose") / "rec"
    assert CliRunner().invoke(main, ["simulate", "trmm", str(folder), "--set", "gyro.sample_s=2"]).exit_code == 0
    return str(folder)


def refuse(text):
    raise AssertionError(text)


def test_effects_and_stretches_are_left_out(run_cli, asked, rec):
    assert run_cli("diagnose", rec).exit_code == 0
    assert asked["library"] is None
    assert run_cli("diagnose", rec, "--without", "spikes", "--without", "rate_lag", "--seed", "5").exit_code == 0
    assert set(asked["library"]) == set(ALL_EFFECTS) - {"spikes", "rate_lag"}
    assert asked["seed"] == 5
    shown = run_cli("diagnose", rec, "--exclude", "100:120.5", "--exclude", "1e3:1.1e3")
    assert (shown.exit_code, asked["exclude"]) == (0, [(100.0, 120.5), (1000.0, 1100.0)])
    shown = run_cli("diagnose", rec, "--exclude", "120:100")
    assert (shown.exit_code, "give FROM:TO" in shown.stderr) == (2, True)


def test_a_real_recording(run_cli, rec, tmp_path):
    page, result = tmp_path / "page.html", tmp_path / "result.json"
    shown = run_cli("diagnose", rec, "--json", str(result), "--report", str(page))
    assert shown.exit_code == 0, shown.output
    document = json.loads(result.read_text(), parse_constant=refuse)
    assert _keys(document).keys() == _keys(CASES["none"]().to_json()).keys()
    assert ("No misfit" in shown.stdout) == (document["verdict"] == "none")
    assert page.stat().st_size < 1_500_000


def _keys(value):
    if isinstance(value, dict):
        return {key: _keys(one) for key, one in value.items() if key not in ("parameters", "p_values")}
    return _keys(value[0]) if isinstance(value, list) and value and isinstance(value[0], dict) else None


def test_documented_format_is_the_result():
    text = (ROOT / "docs" / "diagnosis.md").read_text()
    (block,) = re.findall(r"```json\n(.*?)```", text, flags=re.DOTALL)
    assert _keys(json.loads(block)) == _keys(CASES["named"]().to_json())
    rows = dict(re.findall(r"^\| `(\w+)` \| [^|]* \| ([^|]*) \|.*\|$", text, flags=re.MULTILINE))
    assert set(rows) >= {name for name, effect in ALL_EFFECTS.items() if effect.is_nameable}


SMALL = ("--set", "gyro.sample_s=4", "--set", "reference.every_s=240")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder with a recording and the scenario that its diagnosis adopts."""
    from click.testing import CliRunner

    folder = tmp_path_factory.mktemp("compare")
    run = CliRunner().invoke
    effect = ("--effect", "bias_orbital:z=0.4,phase_deg=60")
    assert run(main, ["simulate", "trmm_series", str(folder / "rec"), *SMALL, *effect]).exit_code == 0
    shown = run(main, ["diagnose", str(folder / "rec"), "--adopt", str(folder / "a.toml")])
    assert shown.exit_code == 0
    assert "a scenario with bias_orbital:z" in shown.stdout
    return folder


def test_an_adopted_scenario_closes_the_gap_and_a_changed_recording_is_refused(run_cli, made, tmp_path):
    page, result = made / "page.html", made / "result.json"
    shown = run_cli(
        "compare", str(made / "rec"), str(made / "a.toml"), "--runs", "30", "--json", str(result), "--report", str(page)
    )
    assert shown.exit_code == 0, shown.output
    document = json.loads(result.read_text())
    _, adopted = document["scenarios"]
    assert adopted["effects"] == ["bias_orbital:z"]
    assert adopted["fitted_to_this_recording"]
    low, high = adopted["gap"]["shrinkage_90"]
    assert low <= 1 <= high
    assert "SHA-256" in checked(page.read_text()).words
    keys = re.findall(r"`(\w+)`", (ROOT / "docs" / "compare.md").read_text().split("## JSON")[1])
    assert set(adopted) <= set(keys)
    assert set(adopted["gap"]) <= set(keys)
    assert set(adopted["statistics"][0]) <= set(keys)
    text = (made / "a.toml").read_text().replace('recording = "rec"', f'recording = "{made / "other"}"')
    (tmp_path / "b.toml").write_text(text)
    assert run_cli("simulate", "trmm_series", str(made / "other"), *SMALL, "--seed", "9").exit_code == 0
    shown = run_cli("compare", str(made / "rec"), str(tmp_path / "b.toml"))
    assert shown.exit_code == 2
    assert "not what it was" in shown.stderr


def test_an_adopted_scenario_is_flown_and_drawn(run_cli, made):
    sizes = []
    for seed in ("1", "2"):
        out, truth = made / f"again{seed}", made / f"truth{seed}.json"
        shown = run_cli("simulate", str(made / "a.toml"), str(out), "--seed", seed, "--draw", "--truth", str(truth))
        assert shown.exit_code == 0, shown.output
        sizes.append(json.loads(truth.read_text())["effects"][0]["size"])
    assert sizes[0] != sizes[1]
    assert sizes == pytest.approx([0.4, 0.4], abs=0.15)
