"""The study of real gyros: on a simulated trial whose gyro is late by a known time, and on the names of the real ones."""

import numpy as np
import pandas as pd
import pytest
from threadpoolctl import threadpool_limits

from studies.montecarlo.study import Streams
from studies.report import entry
from studies.validation import broad, real_gyro
from studies.validation.real_gyro import RealConfig
from tests.studies.validation.test_broad import SAMPLE_S, trial_frame, write

LATE = 3  # samples


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with one trial, whose rates are late."""
    path = tmp_path_factory.mktemp("trials")
    frame = trial_frame(((12, 40), (52, 80)), 92.0)
    names = list(broad.IMU_RATE_COLUMNS)
    frame[names] = np.roll(frame[names].to_numpy(), LATE, axis=0)
    write(frame, path / "01_late.parquet")
    return path


def test_the_delay_is_identified_and_reported(folder, tmp_path):
    config = RealConfig(folder=str(folder))
    with threadpool_limits(1):
        rows = pd.DataFrame(real_gyro.run_case(config, 0, Streams(config.entropy, 0))).assign(case=0, error="")
    (cause,) = real_gyro.select_rows(rows, "cause").to_dict("records")
    assert "time_offset" in cause["group"]
    assert cause["size"] == pytest.approx(LATE * SAMPLE_S, abs=3 * cause["sigma"])
    steps = real_gyro.select_rows(rows, "step")
    assert steps["step"].tolist() == ["baseline", cause["cause"], "remainder", "floor"]
    assert steps["closed"][1] > 0.9
    assert steps["closed"][1] + steps["closed"][2] == pytest.approx(1.0)
    made = real_gyro.build_report(config, rows)
    (shown,) = made.tables["trials"].get_shown_data().to_dict("records")
    assert " s (" in shown["causes"]  # a size in s and a probability
    assert "%" in shown["closed"]
    assert made.check("causes identified in every trial").value == ", ".join(sorted(cause["group"].split(", ")))
    entry.write(made, "real", tmp_path)
    text = (tmp_path / "report.md").read_text()
    assert "CC-BY-4.0" in text
    assert "Laidig" in text
    assert (tmp_path / "waterfalls.svg").is_file()
