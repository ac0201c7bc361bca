"""The command ``gyrocal next`` as a user types it; the comparison itself is tested with `diagnosis.next_recording`."""

import json
from types import SimpleNamespace

import pytest

from diagnosis import next_recording
from diagnosis.next_recording import Band, Comparison, RecordingPrediction
from studies.cli import next as next_command

BANDS = (Band("three: slew", "x", 0.012, 0.010, 0.004, 21.0, 12, 0.05),)


@pytest.fixture
def asked(monkeypatch):
    """What the command asks for, with an answer that is made up."""
    calls = []

    def foretell(recordings, *, own_bias=False, seed=0, tell=None):
        calls.append((list(recordings), own_bias, seed))
        tell("the next recording", 0.95)
        *before, last = recordings
        one = Comparison(90.0, 60, 0.007, BANDS)
        return RecordingPrediction(
            tuple(before), last, "named", ("bias_orbital:z",), ("spikes:x",), one, Comparison(190.0, 60, 1e-15, BANDS)
        )

    monkeypatch.setattr(next_recording, "predict_next_recording", foretell)
    monkeypatch.setattr(next_command, "load", lambda path: SimpleNamespace(gyro=None))
    return calls


def test_the_answer_in_sentences_and_a_table(run_cli, asked):
    result = run_cli("next", "one", "two", "three", "--own-bias", "--seed", "4")
    assert result.exit_code == 0
    assert asked == [(["one", "two", "three"], True, 4)]
    assert "three, predicted from one, two with bias_orbital:z: χ² 90.0 of 60, p = 0.007" in result.stdout
    assert "With G and b alone: p = 1e-15" in result.stdout
    assert "Named, but not in the prediction: spikes:x" in result.stdout
    assert "three: slew" in result.stdout


def test_json_and_the_status(run_cli, asked, tmp_path):
    result = run_cli("next", "one", "three", "--json", "-", "--fail-on", "p<0.01")
    assert result.exit_code == 3
    document = json.loads(result.stdout)
    assert document["p_value"] == 0.007
    assert document["bands"][0]["band_deg"] == 0.010
    result = run_cli("next", "one", "three", "--json", str(tmp_path / "next.json"), "--fail-on", "p<0.001")
    assert result.exit_code == 0
    assert json.loads((tmp_path / "next.json").read_text()) == document
