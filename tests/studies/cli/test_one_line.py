"""Whatever is wrong, one line says it; and nothing that a file holds reaches the terminal as it is."""

import errno
import json
import sys
import warnings
from dataclasses import replace
from xml.etree import ElementTree

import pandas as pd
import pytest
from matplotlib.figure import Figure

from gyrocal import InputError, load, save
from simulator import scenario as scenarios
from studies.cli.main import main
from studies.report import console as consoles
from studies.report import svg
from tests.builders import piecewise_recording
from tests.gyrocal.recording.test_parquet import recording


@pytest.fixture
def rec(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save(recording(), tmp_path / "rec")
    return tmp_path / "rec"


@pytest.mark.parametrize(
    ("fault", "status", "said"),
    [
        (MemoryError("Unable to allocate 8 TiB"), 2, "gyrocal: not enough memory: Unable to allocate 8 TiB\n"),
        (OSError(errno.ENOSPC, "No space left on device", "a.json"), 2, "gyrocal: a.json: No space left on device\n"),
        (OSError(errno.EPIPE, "Broken pipe"), 1, ""),
    ],
)
def test_faults_of_the_system_are_one_line(run_cli, monkeypatch, fault, status, said):
    def text(name):
        raise fault

    monkeypatch.setattr(scenarios, "read_text", text)
    result = run_cli("scenarios", "trmm")
    assert (result.exit_code, result.stderr) == (status, said)


def test_a_closed_standard_output_is_no_fault(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    main(["effects", "--json", str(tmp_path / "a.json")], standalone_mode=False)
    sys.stdout.close()
    sys.stderr.close()
    assert json.loads((tmp_path / "a.json").read_text())["effects"]


def test_fields_of_a_row_are_not_lost(run_cli, rec):
    lines = pd.read_parquet(rec / "gyro.parquet").to_csv(index=False).splitlines()
    (rec / "gyro.parquet").unlink()
    (rec / "gyro.csv").write_text("\n".join(line.replace(".", ",") for line in lines) + "\n")
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        result = run_cli("calibrate", "rec")
        with pytest.raises(InputError, match="more fields than the header"):
            load(rec)
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1


def test_a_chain_of_scenarios_has_an_end(tmp_path):
    for number in range(1500):
        (tmp_path / f"{number}.toml").write_text(f'base = "{number + 1}.toml"\n')
    (tmp_path / "1500.toml").write_text('base = "trmm"\n')
    with pytest.raises(InputError, match=r"0\.toml: more than 30 scenarios"):
        scenarios.load(tmp_path / "0.toml")
    assert scenarios.load(tmp_path / "1480.toml") == scenarios.load("trmm")


def test_control_characters_of_a_title_reach_neither_terminal_nor_figure(run_cli, tmp_path):
    save(replace(piecewise_recording(series_s=100.0), title="\x1b[2Jred\x00"), tmp_path / "rec")
    assert load(tmp_path / "rec").title == "\x1b[2Jred\x00"
    shown = run_cli("calibrate", str(tmp_path / "rec"), "--prior-sigma-g", "1e-3", "--prior-sigma-bias", "1e-3")
    assert shown.exit_code == 0, shown.stderr
    assert f"{consoles.MISSING}[2Jred{consoles.MISSING}" in shown.stdout
    figure = Figure()
    figure.subplots().set_title("\x1b[2Jred\x00 ψ")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert ElementTree.fromstring(svg.render_svg(figure)).tag.endswith("svg")
