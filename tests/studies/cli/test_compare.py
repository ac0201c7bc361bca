"""The commands ``gyrocal diagnose --adopt`` and ``gyrocal compare`` as a user types them."""

import json
import re

import pytest

from studies.cli.main import main
from tests import ROOT
from tests.pages import checked

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
